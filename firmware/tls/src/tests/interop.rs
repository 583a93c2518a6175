//! Against rustls, as the server of this project has it.

use std::io::{Read as _, Write as _};
use std::sync::Arc;
use std::vec;
use std::vec::Vec;

use proptest::prelude::*;
use rcgen::{
    BasicConstraints, CertificateParams, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::version::{TLS12, TLS13};
use tokio_rustls::rustls::{RootCertStore, ServerConfig, ServerConnection, crypto};

use super::{HOST, Peer, TestRng, expected, shake, talk};
use crate::{Authority, Buffers, Connection, Expected, Step, TlsError};

/// An authority, and certificates from it.
pub(super) struct Made {
    pub(super) issuer: Issuer<'static, KeyPair>,
    pub(super) der: CertificateDer<'static>,
}

pub(super) fn date(params: &mut CertificateParams, from: i32, until: i32) {
    params.not_before = rcgen::date_time_ymd(from, 1, 1);
    params.not_after = rcgen::date_time_ymd(until, 1, 1);
}

impl Made {
    pub(super) fn root() -> Self {
        let key = KeyPair::generate().unwrap();
        let params = authority_params("root", BasicConstraints::Unconstrained);
        let der = params.self_signed(&key).unwrap().der().clone();
        Self {
            issuer: Issuer::new(params, key),
            der,
        }
    }

    pub(super) fn below(above: &Self, params: CertificateParams) -> Self {
        let key = KeyPair::generate().unwrap();
        let der = params.signed_by(&key, &above.issuer).unwrap().der().clone();
        Self {
            issuer: Issuer::new(params, key),
            der,
        }
    }

    pub(super) fn pin(&self) -> Authority {
        Authority::of_certificate(&self.der).expect("P-256")
    }
}

pub(super) fn authority_params(name: &str, constraints: BasicConstraints) -> CertificateParams {
    let mut params = CertificateParams::default();
    params
        .distinguished_name
        .push(rcgen::DnType::CommonName, name);
    date(&mut params, 2026, 2046);
    params.is_ca = IsCa::Ca(constraints);
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    params
}

pub(super) fn server_params() -> CertificateParams {
    let mut params = CertificateParams::new(vec![HOST.into(), "10.0.2.2".into()]).unwrap();
    date(&mut params, 2026, 2030);
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    params
}

/// A chain from the certificate of the server upwards, and its key.
pub(super) type Shown = (Vec<CertificateDer<'static>>, PrivateKeyDer<'static>);

pub(super) fn server(above: &Made, params: &CertificateParams) -> Shown {
    let key = KeyPair::generate().unwrap();
    let der = params.signed_by(&key, &above.issuer).unwrap().der().clone();
    (vec![der], key.serialize_der().try_into().unwrap())
}

pub(super) fn config((chain, key): Shown) -> ServerConfig {
    ServerConfig::builder_with_provider(Arc::new(crypto::ring::default_provider()))
        .with_protocol_versions(&[&TLS13])
        .unwrap()
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .unwrap()
}

/// A server that says back what it hears, doubled.
pub(super) struct Rustls(pub(super) ServerConnection);

impl Rustls {
    pub(super) fn new(config: ServerConfig) -> Self {
        Self(ServerConnection::new(Arc::new(config)).unwrap())
    }
}

impl Peer for Rustls {
    fn take(&mut self, mut bytes: &[u8]) -> Vec<u8> {
        while !bytes.is_empty() {
            self.0.read_tls(&mut bytes).unwrap();
            let Ok(state) = self.0.process_new_packets() else {
                break;
            };
            let mut heard = vec![0; state.plaintext_bytes_to_read()];
            self.0.reader().read_exact(&mut heard).unwrap();
            self.0.writer().write_all(&heard).unwrap();
            self.0.writer().write_all(&heard).unwrap();
        }
        let mut said = Vec::new();
        while self.0.wants_write() {
            self.0.write_tls(&mut said).unwrap();
        }
        said
    }
}

/// Says `text` and hears it twice, over a stream that delivers `chunk` bytes at a time; then with
/// new keys; then there is a good-bye.
fn echo(config: ServerConfig, expected: &Expected<'_>, text: &[u8], chunk: usize) {
    let mut peer = Rustls::new(config);
    let mut buffers = Buffers::new();
    let mut client = Connection::start(&mut buffers, expected, &mut TestRng(1)).unwrap();
    assert_eq!(client.say(b"too early"), Err(TlsError::Unusable));
    talk(&mut client, expected, &mut peer, chunk).unwrap();
    assert!(client.is_open());
    let mut left = text;
    while !left.is_empty() {
        let count = client.say(left).unwrap();
        let (now, later) = left.split_at(count);
        let heard = talk(&mut client, expected, &mut peer, chunk).unwrap();
        assert!(count > 0 && heard == now.repeat(2));
        left = later;
    }
    // The server takes new keys, and asks for new ones of ours.
    peer.0.refresh_traffic_keys().unwrap();
    assert_eq!(talk(&mut client, expected, &mut peer, chunk), Ok(vec![]));
    client.say(b"new").unwrap();
    assert!(client.pending().len() > 27 + 22, "our new keys first");
    let heard = talk(&mut client, expected, &mut peer, chunk);
    assert_eq!(heard.unwrap(), b"newnew");
    peer.0.send_close_notify();
    assert_eq!(talk(&mut client, expected, &mut peer, chunk), Ok(vec![]));
    assert_eq!(client.step(), Ok(Step::Ended));
    client.close().unwrap();
    let goodbye = client.pending().to_vec();
    peer.0.read_tls(&mut &goodbye[..]).unwrap();
    let state = peer.0.process_new_packets().unwrap();
    assert!(state.peer_has_closed());
}

#[test]
fn rustls_is_understood_and_understands() {
    let root = Made::root();
    for (size, chunk) in [(None, usize::MAX), (Some(200), 7), (Some(2_048), 1)] {
        let mut config = config(server(&root, &server_params()));
        config.max_fragment_size = size;
        config.send_tls13_tickets = 4;
        let text: Vec<u8> = (0..3_000).map(|at| at as u8).collect();
        echo(config, &expected(root.pin()), &text, chunk);
    }
}

#[test]
fn a_server_that_asks_for_a_certificate_gets_none() {
    let root = Made::root();
    let mut roots = RootCertStore::empty();
    roots.add(root.der.clone()).unwrap();
    let provider = Arc::new(crypto::ring::default_provider());
    let optional = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider.clone())
        .allow_unauthenticated()
        .build()
        .unwrap();
    let (chain, key) = server(&root, &server_params());
    let config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_client_cert_verifier(optional)
        .with_single_cert(chain, key)
        .unwrap();
    echo(config, &expected(root.pin()), b"hello", usize::MAX);
}

#[test]
fn a_server_without_what_is_needed_says_so() {
    let root = Made::root();
    let ring = crypto::ring::default_provider();
    let aes = crypto::CryptoProvider {
        cipher_suites: vec![crypto::ring::cipher_suite::TLS13_AES_128_GCM_SHA256],
        ..ring.clone()
    };
    let x25519 = crypto::CryptoProvider {
        kx_groups: vec![crypto::ring::kx_group::X25519],
        ..ring.clone()
    };
    for (provider, version, alert) in [(aes, &TLS13, 40), (x25519, &TLS13, 40), (ring, &TLS12, 70)]
    {
        let (chain, key) = server(&root, &server_params());
        let config = ServerConfig::builder_with_provider(Arc::new(provider))
            .with_protocol_versions(&[version])
            .unwrap()
            .with_no_client_auth()
            .with_single_cert(chain, key)
            .unwrap();
        let result = shake(&expected(root.pin()), &mut Rustls::new(config));
        assert_eq!(result, Err(TlsError::Alert(alert)));
    }
}

/// Changes one bit of what the server says.
struct Tampered {
    peer: Rustls,
    at: usize,
    bit: u8,
    passed: usize,
}

impl Peer for Tampered {
    fn take(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut said = self.peer.take(bytes);
        if let Some(byte) = self
            .at
            .checked_sub(self.passed)
            .and_then(|at| said.get_mut(at))
        {
            *byte ^= 1 << self.bit;
        }
        self.passed += said.len();
        said
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(200))]
    #[test]
    fn no_bit_of_a_handshake_can_be_changed(at in 0_usize..900, bit in 0_u8..8) {
        let root = Made::root();
        let mut config = config(server(&root, &server_params()));
        config.send_tls13_tickets = 0;
        let peer = Rustls::new(config);
        let mut peer = Tampered { peer, at, bit, passed: 0 };
        let expected = expected(root.pin());
        let mut buffers = Buffers::new();
        let mut client = Connection::start(&mut buffers, &expected, &mut TestRng(1)).unwrap();
        let result = talk(&mut client, &expected, &mut peer, usize::MAX);
        // Versions of records in the clear mean nothing (section 5.1): of the ServerHello, and of the
        // message for middleboxes behind its 128 bytes. A length that grows waits for ever.
        let passed = result.is_ok() && client.is_open() && at < peer.passed;
        prop_assert!(!passed || matches!(at, 1 | 2 | 129 | 130), "{at} {bit}");
        if client.is_open() {
            peer.at = usize::MAX;
            client.say(b"hello").unwrap();
            let heard = talk(&mut client, &expected, &mut peer, usize::MAX);
            prop_assert_eq!(heard.unwrap(), b"hellohello");
        }
    }
}
