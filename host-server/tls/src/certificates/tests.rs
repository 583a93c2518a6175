//! Certificates as time passes.

use std::path::PathBuf;

use tokio_rustls::rustls::client::WebPkiServerVerifier;
use tokio_rustls::rustls::client::danger::ServerCertVerifier as _;
use tokio_rustls::rustls::pki_types::UnixTime;

use super::*;

const DAY: i64 = 24 * 60 * 60;
/// 2026-11-22.
const START: i64 = 1_795_305_600;

struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("crawler-tls-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        Self(path)
    }

    /// Of an authority here; `names` are separated by commas.
    fn options(&self, names: &str) -> CertificateOptions {
        CertificateOptions {
            names: names.split(',').map(str::to_owned).collect(),
            dir: self.0.clone(),
            ..CertificateOptions::default()
        }
    }

    fn open(&self, names: &str, now: i64) -> Arc<Certificates> {
        Certificates::open(&self.options(names), now).expect("certificates")
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.0.join(name)).expect(name)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn leaf(certificates: &Certificates) -> Vec<u8> {
    certificates.current().pair.cert[0].to_vec()
}

#[test]
fn a_certificate_is_renewed_before_it_ends_and_the_authority_stays() {
    let scratch = Scratch::new("renew");
    let running = scratch.open("a.example", START);
    let first = leaf(&running);
    let authority = scratch.read("ca.pem");
    running.look(START + 59 * DAY);
    assert_eq!(leaf(&running), first, "not due");
    running.look(START + 61 * DAY);
    let second = leaf(&running);
    assert_ne!(second, first, "due");
    assert_eq!(scratch.read("ca.pem"), authority);
    // The same at a start, and what is good is kept.
    let now = START + 62 * DAY;
    assert_eq!(leaf(&scratch.open("a.example", now)), second);
    let later = now + 200 * DAY;
    let third = scratch.open("a.example", later);
    assert_ne!(leaf(&third), second, "expired");
    assert!(third.current().validity.until > later + 80 * DAY);
    assert_eq!(scratch.read("ca.pem"), authority);
}

#[test]
fn another_name_takes_another_certificate() {
    let scratch = Scratch::new("names");
    let one = leaf(&scratch.open("a.example", START));
    assert_eq!(leaf(&scratch.open("a.example", START)), one);
    assert_ne!(leaf(&scratch.open("a.example,192.0.2.9", START)), one);
}

#[test]
fn damaged_certificates_are_replaced_and_a_lost_authority_comes_back_from_its_key() {
    let scratch = Scratch::new("damage");
    let one = leaf(&scratch.open("a.example", START));
    std::fs::write(scratch.0.join("server.key"), "nonsense").expect("ours");
    let two = leaf(&scratch.open("a.example", START));
    assert_ne!(one, two);
    // With the same key and name, so that what clients pinned goes on serving.
    std::fs::remove_file(scratch.0.join("ca.pem")).expect("ours");
    assert_eq!(leaf(&scratch.open("a.example", START)), two);
    // Another authority's certificate is not that of our key.
    let other = Scratch::new("other");
    other.open("a.example", START);
    std::fs::copy(other.0.join("ca.pem"), scratch.0.join("ca.pem")).expect("ours");
    let options = scratch.options("a.example");
    let error = Certificates::open(&options, START).expect_err("foreign");
    assert!(matches!(error, TlsError::Mismatch { .. }), "{error}");
}

#[test]
fn an_old_authority_is_renewed_with_its_key() {
    let scratch = Scratch::new("authority");
    let one = leaf(&scratch.open("a.example", START));
    let pinned = scratch.read("ca.pem");
    let later = START + 19 * 365 * DAY;
    let two = scratch.open("a.example", later);
    assert_ne!(leaf(&two), one);
    assert_ne!(scratch.read("ca.pem"), pinned);
    // Who pinned the old one trusts what is served now.
    std::fs::write(scratch.0.join("ca.pem"), pinned).expect("ours");
    let roots = files::authorities(&scratch.0.join("ca.pem")).expect("roots");
    let client = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider());
    let now = std::time::Duration::from_secs(later as u64);
    client
        .build()
        .expect("verifier")
        .verify_server_cert(
            &two.current().pair.cert[0],
            &[],
            &"a.example".try_into().expect("name"),
            &[],
            UnixTime::since_unix_epoch(now),
        )
        .expect("trusted");
}
