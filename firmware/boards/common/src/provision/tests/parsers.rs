//! The form parser and the page's memory-free rendering against models.

use std::string::String;
use std::vec::Vec;

use proptest::prelude::*;

use super::super::form::NAMES;
use super::super::http::{Render, head_end, length, part};
use super::super::*;
use super::harness::encode;

/// Longest value that is kept.
const KEPT: usize = 80;

fn values(form: &Form) -> [&Value; 11] {
    [
        &form.token,
        &form.ssid,
        &form.wifi_password,
        &form.wifi_open,
        &form.broker,
        &form.authority,
        &form.id,
        &form.fleet,
        &form.username,
        &form.password,
        &form.ranger,
    ]
}

#[test]
fn debug_of_a_form_tells_no_secret() {
    let fields = [
        ("token", "t0k3n"),
        ("wifi_password", "w1f1"),
        ("password", "p4ss"),
        ("id", "a"),
    ];
    let form = Form::parse(encode(&fields).as_bytes()).unwrap();
    let shown = std::format!("{form:?}");
    for secret in ["t0k3n", "w1f1", "p4ss"] {
        assert!(!shown.contains(secret), "{shown}");
    }
}

#[test]
fn malformed_forms_are_refused() {
    for (body, error) in [
        ("id=%", FormError::Encoding),
        ("id=%4", FormError::Encoding),
        ("id=%4g", FormError::Encoding),
        ("id=%C3", FormError::Encoding),
        ("id=%C3%28", FormError::Encoding),
        ("id=%FF", FormError::Encoding),
        ("id=a b", FormError::Encoding),
        ("id=a\r\n", FormError::Encoding),
        ("id=\u{e4}", FormError::Encoding),
        ("admin=1", FormError::Unknown),
        ("=1", FormError::Unknown),
        ("ID=1", FormError::Unknown),
        ("%69d=1", FormError::Unknown),
        ("id=1&id=1", FormError::Twice),
    ] {
        assert_eq!(Form::parse(body.as_bytes()), Err(error), "{body}");
    }
    let form = Form::parse(b"&&id=a%20b+c&ssid&fleet=x=y&").unwrap();
    assert_eq!(form.id.as_str(), "a b c");
    assert!(form.ssid.is_empty());
    assert_eq!(form.fleet.as_str(), "x=y");
}

#[test]
fn the_end_of_a_head_is_found_wherever_it_was_cut() {
    let head = b"GET / HTTP/1.1\r\nA: b\r\n\r\nrest\r\n\r\n";
    for seen in 0..24 {
        assert_eq!(head_end(head, seen), Some(24), "{seen}");
    }
    assert_eq!(head_end(b"", 0), None);
    assert_eq!(head_end(b"\r\n\r", 3), None);
}

proptest! {
    #[test]
    fn what_a_browser_encodes_is_decoded(
        texts in prop::collection::vec(prop::option::of("\\PC{0,30}|[ -~]{60,120}|[ä☃]{30,50}"), 11)
    ) {
        let fields: Vec<(&str, &str)> = NAMES
            .iter()
            .zip(&texts)
            .filter_map(|(name, text)| Some((*name, text.as_deref()?)))
            .collect();
        let form = Form::parse(encode(&fields).as_bytes()).unwrap();
        for (value, text) in values(&form).iter().zip(&texts) {
            let text = text.as_deref().unwrap_or_default();
            prop_assert_eq!(value.is_cut(), text.len() > KEPT);
            if value.is_cut() {
                prop_assert!(text.starts_with(value.as_str()) && value.as_str().len() > KEPT - 4);
            } else {
                prop_assert_eq!(value.as_str(), text);
            }
        }
    }

    #[test]
    fn noise_is_no_form_or_a_small_one(body in prop::collection::vec(any::<u8>(), 0..600)) {
        if let Ok(form) = Form::parse(&body) {
            for value in values(&form) {
                prop_assert!(value.as_str().len() <= KEPT);
            }
        }
        let _ = Request::parse(&body);
    }

    #[test]
    fn parts_of_any_size_make_the_whole(text in "\\PC{0,60}", sizes in prop::collection::vec(1_usize..20, 1..8)) {
        let text = text.as_str();
        let mut made = Vec::new();
        for size in sizes.iter().cycle() {
            let mut buffer = std::vec![0; *size];
            let piece = part(text, made.len(), &mut buffer);
            if piece.is_empty() {
                break;
            }
            made.extend_from_slice(piece);
        }
        prop_assert_eq!(String::from_utf8(made).unwrap(), text);
        prop_assert_eq!(length(text), text.len());
    }

    #[test]
    fn networks_stay_few_and_in_order_and_their_json_is_json(
        found in prop::collection::vec(("\\PC{0,8}|[\"\\\\\u{1}<&]{1,8}", any::<i8>(), any::<bool>()), 0..60)
    ) {
        let mut networks = Networks::new();
        for (ssid, rssi_dbm, open) in &found {
            if let Ok(ssid) = heapless::String::try_from(ssid.as_str()) {
                networks.add(Nearby { ssid, rssi_dbm: *rssi_dbm, open: *open });
            }
        }
        let kept: Vec<&Nearby> = networks.iter().collect();
        prop_assert!(kept.len() <= MAX_NETWORKS);
        prop_assert!(kept.windows(2).all(|pair| pair[0].rssi_dbm >= pair[1].rssi_dbm));
        let mut json = String::new();
        networks.render(&mut json).unwrap();
        let read: serde_json::Value = serde_json::from_str(&json).unwrap();
        prop_assert_eq!(read.as_array().unwrap().len(), kept.len());
        for (place, nearby) in kept.iter().enumerate() {
            prop_assert_eq!(read[place]["ssid"].as_str(), Some(nearby.ssid.as_str()));
            // The strongest of its name.
            let best = found.iter().filter(|(ssid, ..)| *ssid == *nearby.ssid).map(|(_, rssi, _)| *rssi).max();
            prop_assert_eq!(best, Some(nearby.rssi_dbm));
        }
    }
}
