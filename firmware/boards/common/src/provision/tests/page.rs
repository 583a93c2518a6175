//! The documents themselves.

use std::format;
use std::string::String;
use std::vec::Vec;

use proptest::prelude::*;
use sha2::{Digest, Sha256};

use super::super::form::Value;
use super::super::http::{Render, SCRIPT_HASH, STYLE_HASH};
use super::super::page::{PAGE, Page, Word, form_of};
use super::super::*;
use super::harness::{ALL, portal};
use crate::settings::testing::{any_settings, settings};
use crate::settings::{Flaw, Passphrase, Settings};

fn rendered(features: Features, form: &Form, flaws: Flaws, notice: Option<&str>) -> String {
    let portal = portal(features);
    let mut text = String::new();
    Page {
        features,
        token: &portal.token,
        form,
        flaws,
        current: None,
        robot: form.id.as_str(),
        notice,
    }
    .render(&mut text)
    .expect("every place of the document is known");
    text
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for three in bytes.chunks(3) {
        let bits = three
            .iter()
            .fold(0_u32, |bits, byte| bits << 8 | u32::from(*byte));
        let bits = bits << (8 * (3 - three.len()));
        for place in 0..4 {
            text.push(if place <= three.len() {
                char::from(LETTERS[(bits >> (18 - 6 * place) & 63) as usize])
            } else {
                '='
            });
        }
    }
    text
}

fn between<'a>(text: &'a str, open: &str, close: &str) -> &'a str {
    text.split_once(open)
        .and_then(|(_, rest)| rest.split_once(close))
        .expect(open)
        .0
}

/// The browser runs no other style and script than these.
#[test]
fn the_policy_names_the_style_and_the_script_of_the_pages() {
    let hash = |text: &str| format!("sha256-{}", base64(&Sha256::digest(text)));
    let page = rendered(ALL, &Form::default(), Flaws::default(), None);
    assert_eq!(hash(between(&page, "<style>", "</style>")), STYLE_HASH);
    assert_eq!(hash(between(&page, "<script>", "</script>")), SCRIPT_HASH);
    let mut word = String::new();
    Word::Refused(Status::NotFound).render(&mut word).unwrap();
    assert_eq!(hash(between(&word, "<style>", "</style>")), STYLE_HASH);
    for text in [&page, &word] {
        assert!(!text.contains(" style=") && !text.contains(" onclick="));
        assert!(!text.contains("{{"), "{text}");
    }
}

#[test]
fn the_page_asks_for_nothing_from_elsewhere() {
    for outside in ["http://", "https://", "src=", "//cdn", "@import", "url("] {
        assert!(!PAGE.contains(outside), "{outside}");
    }
}

#[test]
fn every_field_has_a_label_and_a_place_for_its_flaw() {
    let page = rendered(ALL, &Form::default(), Flaws::default(), None);
    for name in super::super::form::NAMES.iter().skip(1) {
        assert!(page.contains(&format!("name=\"{name}\"")), "{name}");
        if *name != "wifi_open" {
            assert!(page.contains(&format!("<label for=\"{name}\">")), "{name}");
            assert!(page.contains(&format!("id=\"{name}-flaw\"")), "{name}");
        }
    }
}

#[test]
fn documents_are_well_formed_with_every_set_of_features() {
    for bits in 0..8_u8 {
        let features = Features {
            wifi: bits & 1 != 0,
            scan: bits & 2 != 0,
            ranger: bits & 4 != 0,
        };
        let page = rendered(features, &Form::default(), Flaws::default(), Some("Note"));
        for element in [
            "fieldset", "label", "p", "select", "button", "div", "ol", "li", "main", "form",
        ] {
            let opened = page.matches(&format!("<{element}>")).count()
                + page.matches(&format!("<{element} ")).count();
            let closed = page.matches(&format!("</{element}>")).count();
            assert_eq!(opened, closed, "{element} {features:?}");
        }
        assert!(page.len() < 12_000, "{}", page.len());
    }
}

/// Angle brackets and quotes of a document: what makes it one.
fn marks(text: &str) -> Vec<char> {
    text.chars()
        .filter(|c| matches!(c, '<' | '>' | '"' | '\''))
        .collect()
}

proptest! {
    /// Whatever is entered, the document keeps its shape.
    #[test]
    fn nothing_entered_becomes_markup(texts in prop::collection::vec("[<>\"'&a-z/= ]{0,20}|\\PC{0,20}", 8)) {
        let value = |index: usize| Value::shown(&texts[index]);
        let form = Form {
            ssid: value(0),
            wifi_password: value(1),
            broker: value(2),
            id: value(3),
            fleet: value(4),
            username: value(5),
            password: value(6),
            ranger: value(7),
            ..Form::default()
        };
        let flaws = Flaws { ssid: Some(Flaw::TooLong), id: Some(Flaw::Character), ..Flaws::default() };
        let filled = rendered(ALL, &form, flaws, Some(&texts[0]));
        let empty = rendered(ALL, &Form { ranger: value(7), ..Form::default() }, flaws, Some(""));
        prop_assert_eq!(marks(&filled), marks(&empty));
        let mut word = String::new();
        let mut odd: Settings = settings();
        if let (Ok(ssid), Some(wifi)) = (crate::settings::Ssid::new(&texts[0]), odd.wifi.as_mut()) {
            wifi.ssid = ssid;
        }
        Word::Saved(&odd).render(&mut word).unwrap();
        let mut plain = String::new();
        Word::Saved(&settings()).render(&mut plain).unwrap();
        prop_assert_eq!(marks(&word), marks(&plain));
    }

    /// No password of any settings is in any document made from them.
    #[test]
    fn passwords_are_never_shown(settings in any_settings()) {
        let form = form_of(Some(&settings), &portal(ALL).suggestion);
        prop_assert!(form.wifi_password.is_empty() && form.password.is_empty());
        let page = rendered(ALL, &form, Flaws::default(), None);
        let mut word = String::new();
        Word::Saved(&settings).render(&mut word).unwrap();
        let bare = rendered(ALL, &Form::default(), Flaws::default(), None);
        let phrase = settings.wifi.as_ref().and_then(|wifi| wifi.passphrase.as_ref());
        let account = settings.credentials.as_ref().map(|account| account.password.as_str());
        for secret in [phrase.map(Passphrase::reveal), account].into_iter().flatten() {
            // A short one may stand in the page's own words, or in what is not secret.
            let shown = [
                settings.id.as_str(), settings.fleet.as_str(), settings.broker.host.as_str(),
                settings.wifi.as_ref().map_or("", |wifi| wifi.ssid.as_str()),
                settings.credentials.as_ref().map_or("", |account| &account.username),
            ];
            let elsewhere = bare.contains(secret) || shown.iter().any(|text| text.contains(secret));
            prop_assert!(secret.len() < 8 || elsewhere || !(page.contains(secret) || word.contains(secret)));
        }
    }

    #[test]
    fn what_is_shown_is_taken_back(settings in any_settings(), ranger in any::<bool>()) {
        let features = Features { wifi: settings.wifi.is_some(), scan: false, ranger };
        let form = form_of(Some(&settings), &portal(features).suggestion);
        let mut form = form;
        // A network without a password is ticked as such; a password is kept.
        if !features.wifi {
            form.wifi_open = Value::default();
        }
        prop_assert_eq!(form.check(features, Some(&settings)), Ok(settings.clone()));
    }
}
