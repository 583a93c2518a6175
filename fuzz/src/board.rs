//! Fuzz targets of what a board reads from a person's browser or phone. The fuzzer and the replay
//! of its corpus in the tests of `crawler-board` include this file.

use core::fmt::Write;
use core::net::Ipv4Addr;

use crawler_board::provision::access_point::{ADDRESS, DATAGRAM, Lender, answer_name};
use crawler_board::provision::{Form, Request};

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 3] = [
    ("provision_request", request),
    ("provision_form", form),
    ("provision_datagram", datagram),
];

/// A head that is accepted names one host and ends where it says, and a cut one is refused.
fn request(data: &[u8]) {
    let Ok(read) = Request::parse(data) else {
        return;
    };
    assert_eq!(read.head, data.len());
    assert!(data.ends_with(b"\n"));
    let lower = data.to_ascii_lowercase();
    let hosts = lower.windows(6).filter(|part| *part == b"\nhost:").count();
    assert_eq!(hosts, 1, "two readers could take it for different requests");
    let lengths = lower
        .windows(16)
        .filter(|part| *part == b"\ncontent-length:")
        .count();
    assert_eq!(lengths, usize::from(read.content_length.is_some()));
    assert!(Request::parse(&data[..data.len() - 1]).is_err());
}

/// What was read survives being written and read again.
fn form(data: &[u8]) {
    let Ok(read) = Form::parse(data) else {
        return;
    };
    let fields = [
        ("token", &read.token),
        ("ssid", &read.ssid),
        ("wifi_password", &read.wifi_password),
        ("wifi_open", &read.wifi_open),
        ("broker", &read.broker),
        ("authority", &read.authority),
        ("id", &read.id),
        ("fleet", &read.fleet),
        ("username", &read.username),
        ("password", &read.password),
        ("ranger", &read.ranger),
    ];
    let mut again = String::new();
    for (name, value) in fields {
        again += name;
        again.push('=');
        for byte in value.as_str().bytes() {
            write!(again, "%{byte:02x}").expect("a string takes everything");
        }
        again.push('&');
    }
    let again = Form::parse(again.as_bytes()).expect("our own form");
    assert_eq!(again.broker.as_str(), read.broker.as_str());
    assert_eq!(again.wifi_password.as_str(), read.wifi_password.as_str());
    assert_eq!(again.token.as_str(), read.token.as_str());
}

/// An answer is no longer than a datagram, goes back to who asked, and is never answered itself.
fn datagram(data: &[u8]) {
    let mut out = [0; DATAGRAM];
    if let Some(length) = answer_name(data, ADDRESS, &mut out) {
        assert_eq!(out[..2], data[..2]);
        let answer = out[..length].to_vec();
        assert_eq!(answer_name(&answer, ADDRESS, &mut out), None);
    }
    let mut lender = Lender::new(|| 0);
    if let Some((answer, to)) = lender.answer(data, &mut out) {
        assert_ne!(to, Ipv4Addr::UNSPECIFIED);
        assert_eq!(answer[0], 2, "a reply");
        assert_eq!(answer[4..8], data[4..8]);
    }
    assert!(lender.lent() <= 1);
}
