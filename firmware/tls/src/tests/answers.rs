//! What the server is told of its mistakes, as RFC 8446 wants it: found by the tests of `BoGo`
//! (`docs/tls.md`).

use std::boxed::Box;
use std::vec::Vec;

use super::hostile::{said, then};
use super::interop::Made;
use super::server::{Flight, Scripted, extensions};
use super::{NOW, TestRng, talk};
use crate::record::{DATA, HANDSHAKE};
use crate::{Buffers, Connection, Expected, TlsError};

const UNSUPPORTED_EXTENSION: u8 = 110;
const ILLEGAL_PARAMETER: u8 = 47;

/// What the client makes of these extensions, where `hello` in the `ServerHello`, else in
/// `EncryptedExtensions`.
fn answered(hello: bool, kind: u16, content: &'static [u8]) -> TlsError {
    said(move |flight| {
        let version: (u16, &[u8]) = (43, &[3, 4]);
        let extra = (kind, content);
        let mut all = if hello {
            let hello = flight.hello_with([9; 32], 0x1303, &[version, extra]);
            super::record(HANDSHAKE, &hello)
        } else {
            flight.clear_hello()
        };
        let message = flight.encrypted(&[extra]);
        all.extend(flight.seal(HANDSHAKE, &message));
        all
    })
    .unwrap_err()
}

/// Section 4.2: one that was not offered is unsupported, one that belongs elsewhere an illegal parameter.
#[test]
fn an_extension_out_of_place_is_told_from_one_that_nobody_offered() {
    for hello in [true, false] {
        // Application protocols, a secret shared beforehand, one that nobody knows.
        for kind in [16, 41, 0xFFCE] {
            assert_eq!(
                answered(hello, kind, b"\0\0"),
                TlsError::Extension,
                "{kind}"
            );
        }
    }
    for (hello, kind) in [(true, 0), (true, 10), (true, 28), (false, 13), (false, 51)] {
        assert_eq!(answered(hello, kind, b""), TlsError::Choice, "{kind}");
    }
    assert_eq!(TlsError::Extension.alert(), Some(UNSUPPORTED_EXTENSION));
    assert_eq!(TlsError::Choice.alert(), Some(ILLEGAL_PARAMETER));
}

#[test]
fn a_certificate_with_an_extension_was_not_asked_for() {
    let refused = said(|flight| {
        let mut all = flight.clear_hello();
        let message = flight.encrypted(&[]);
        all.extend(flight.seal(HANDSHAKE, &message));
        let mut certificate = flight.certificate();
        // The empty list behind the only certificate, and the three lengths around it.
        certificate.truncate(certificate.len() - 2);
        certificate.extend(extensions(&[(5, b"\x01\0\0\x01x")]));
        for at in [1, 5] {
            let length =
                u32::from_be_bytes([0, certificate[at], certificate[at + 1], certificate[at + 2]]);
            certificate[at..at + 3].copy_from_slice(&(length + 9).to_be_bytes()[1..]);
        }
        all.extend(flight.seal(HANDSHAKE, &certificate));
        all
    });
    assert_eq!(refused, Err(TlsError::Extension));
}

/// A name is offered to a host that has one, and an address is none (RFC 6066, section 3).
#[test]
fn a_server_asked_by_address_has_no_name_to_confirm() {
    let root = Made::root();
    for (host, refused) in [("10.0.2.2", true), (super::HOST, false)] {
        let expected = Expected {
            host,
            authority: root.pin(),
            now: Some(NOW),
        };
        let mut peer = Scripted {
            root: &root,
            script: Some(Box::new(|flight: &mut Flight| {
                let mut all = flight.clear_hello();
                let message = flight.encrypted(&[(0, &[])]);
                all.extend(flight.seal(HANDSHAKE, &message));
                all
            })),
        };
        let mut buffers = Buffers::new();
        let mut client = Connection::start(&mut buffers, &expected, &mut TestRng(1)).unwrap();
        let result = talk(&mut client, &expected, &mut peer, usize::MAX);
        assert_eq!(
            result.err(),
            refused.then_some(TlsError::Extension),
            "{host}"
        );
    }
}

/// As many records without content as there may be, and what comes behind them.
#[test]
fn the_record_behind_the_last_idle_one_is_heard() {
    let heard = |idle: usize| {
        then(move |flight| {
            let mut all: Vec<u8> = (0..idle).flat_map(|_| flight.seal(DATA, b"")).collect();
            all.extend(flight.seal(DATA, b"hello"));
            all
        })
    };
    assert_eq!(heard(32).as_deref(), Ok(&b"hello"[..]));
    assert_eq!(heard(33), Err(TlsError::Flood));
}

fn ticket(body: &[u8]) -> Vec<u8> {
    let mut message = std::vec![4, 0];
    message.extend((body.len() as u16).to_be_bytes());
    message.extend_from_slice(body);
    message
}

/// Section 4.6.1: tickets are not used, but are read.
#[test]
fn a_ticket_has_the_form_of_one() {
    let heard = |body: &'static [u8]| then(move |flight| flight.seal(HANDSHAKE, &ticket(body)));
    // Lifetime, addend; nonce, ticket, extensions, each behind its length.
    assert_eq!(heard(b"\0\0\x0E\x10abcd\x01n\0\x02tt\0\0"), Ok(Vec::new()));
    assert_eq!(
        heard(b"\0\0\x0E\x10abcd\0\0\x01t\0\x06\xFA\xFA\0\x02xy"),
        Ok(Vec::new())
    );
    for wrong in [
        &b""[..],
        b"\0\0\x0E\x10abc",
        b"\0\0\x0E\x10abcd\x01n\0\0\0\0",
        b"\0\0\x0E\x10abcd\x01n\0\x02tt",
        b"\0\0\x0E\x10abcd\x01n\0\x02tt\0\x01x",
        b"\0\0\x0E\x10abcd\x01n\0\x02tt\0\x04\0\x2A\0\x01",
        b"\0\0\x0E\x10abcd\x01n\0\x02tt\0\0\0",
    ] {
        assert_eq!(heard(wrong), Err(TlsError::Malformed), "{wrong:?}");
    }
}

/// Section 4.3.2: nothing is shown whatever is asked for, but the question is read.
#[test]
fn a_request_for_a_certificate_has_the_form_of_one() {
    let asked = |list: &'static [u8]| {
        said(move |flight| {
            let mut all = flight.clear_hello();
            let mut rest = flight.encrypted(&[]);
            rest.extend(flight.request(list));
            rest.extend(flight.certificate());
            rest.extend(flight.verify(0x0403, false));
            rest.extend(flight.finished(false));
            all.extend(flight.seal(HANDSHAKE, &rest));
            all
        })
    };
    assert_eq!(asked(b"\0\x0D\0\x04\0\x02\x04\x03"), Ok(Vec::new()));
    assert_eq!(
        asked(b"\0\x0D\0\x05\0\x02\x04\x03"),
        Err(TlsError::Malformed)
    );
    assert_eq!(asked(b"\0"), Err(TlsError::Malformed));
}
