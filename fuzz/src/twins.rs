//! Fuzz targets of what a twin is made of. The fuzzer and the replay of its corpus in the tests of `crawler-twin`
//! include this file.

use crawler_twin::certificate::{About, Certificate, certify};
use crawler_twin::table;

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 2] = [
    ("twin_table", twin_table),
    ("twin_certificate", twin_certificate),
];

/// Whatever can be read is identified or is not; certificates are of sound bodies.
fn twin_table(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    if let Ok(evidence) = table::read(text)
        && let Ok(made) = certify(&evidence, About::default(), None)
    {
        assert!(made.parameters.is_sound());
        assert!(Certificate::read(made.write().as_bytes()).is_ok());
    }
}

/// A certificate that is taken is written as it was read.
fn twin_certificate(data: &[u8]) {
    if let Ok(read) = Certificate::read(data) {
        assert!(read.parameters.is_sound());
        let again =
            Certificate::read(read.write().as_bytes()).expect("what is written can be read");
        assert_eq!(again.id(), read.id());
    }
}
