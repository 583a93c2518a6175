//! The fuzz target of reports on releases. The fuzzer and the replay of its corpus in the tests of `crawler-updates`
//! include this file.

use crawler_release::{KeyId, image_hash};
use crawler_updates::gate::{DOMAIN, GATE_MAX, GateFault, check, open, sign, signer};
use crawler_updates::release::SecretKey;

/// The body of a target. Panics when it finds a fault.
pub type Body = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Body); 1] = [("release_gate", gate)];

/// A key that everybody knows.
const KEY: &str = include_str!("../../host-server/updates/tests/openssl.pem");

/// The bytes are the file of a report, which nobody is believed in, and then what somebody has signed as one. What is
/// read of that is signed to the same bytes again, and holds what it says.
fn gate(data: &[u8]) {
    let key = SecretKey::from_pem(KEY).expect("a key");
    let keys = [key.public()];
    let fault = open(data, &keys).expect_err("nobody has signed");
    assert!(matches!(
        fault,
        GateFault::Oversize
            | GateFault::NoReport
            | GateFault::UnknownKey(_)
            | GateFault::BadSignature
    ));
    let signature = key.sign(&image_hash(&[DOMAIN, data].concat()));
    let id: KeyId = key.public().id();
    let parts: [&[u8]; 4] = [b"TCG\x01", &id.0, &signature, data];
    let file = parts.concat();
    match open(&file, &keys) {
        Ok(report) => {
            assert_eq!(sign(&report, &key).as_deref(), Ok(&file[..]));
            assert_eq!(signer(&file), Ok(id));
            assert_eq!(report.passed, report.outcome());
            assert!(!report.evaluations.is_empty());
            let checked = check(&file, &keys, &report.release);
            assert_eq!(checked.as_ref(), Ok(&report));
            let other = check(&file, &keys, "another");
            assert_eq!(other, Err(GateFault::OtherRelease(report.release)));
            assert_eq!(open(&file, &[]), Err(GateFault::NoKey));
        }
        Err(GateFault::Oversize) => assert!(file.len() > GATE_MAX),
        Err(fault) => assert!(matches!(
            fault,
            GateFault::Malformed(_) | GateFault::Contradiction(_)
        )),
    }
}
