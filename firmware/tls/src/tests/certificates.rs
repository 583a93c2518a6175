//! Which certificates are accepted, and why the others are not.

use std::string::ToString;
use std::vec;
use std::vec::Vec;

use proptest::prelude::*;
use rcgen::{
    BasicConstraints, CertificateParams, CustomExtension, ExtendedKeyUsagePurpose, IsCa, KeyPair,
    KeyUsagePurpose,
};
use tokio_rustls::rustls::pki_types::CertificateDer;

use super::interop::{Made, Rustls, authority_params, config, date, server, server_params};
use super::{HOST, NOW, expected, shake};
use crate::{Authority, AuthorityError, Expected, TlsError, chain, check_certificates};

/// The list of a Certificate message.
fn list(chain: &[CertificateDer<'_>]) -> Vec<u8> {
    let mut list = Vec::new();
    for der in chain {
        list.extend_from_slice(&(der.len() as u32).to_be_bytes()[1..]);
        list.extend_from_slice(der);
        list.extend([0, 0]);
    }
    list
}

fn check(root: &Made, change: impl Fn(&mut CertificateParams)) -> Result<(), TlsError> {
    let mut params = server_params();
    change(&mut params);
    let (chain, _) = server(root, &params);
    check_certificates(&list(&chain), &expected(root.pin())).map(|_| ())
}

#[test]
fn what_a_certificate_says_counts() {
    let root = Made::root();
    let names = |list: &[&str]| {
        let list: Vec<_> = list.iter().map(ToString::to_string).collect();
        CertificateParams::new(list).unwrap().subject_alt_names
    };
    assert_eq!(check(&root, |_| {}), Ok(()));
    let star = |params: &mut CertificateParams| params.subject_alt_names = names(&["*.lan"]);
    assert_eq!(check(&root, star), Err(TlsError::Name));
    let other = |params: &mut CertificateParams| params.subject_alt_names = names(&["other.lan"]);
    assert_eq!(check(&root, other), Err(TlsError::Name));
    let none = |params: &mut CertificateParams| {
        params.subject_alt_names.clear();
        params
            .distinguished_name
            .push(rcgen::DnType::CommonName, HOST);
    };
    assert_eq!(check(&root, none), Err(TlsError::Name), "no common names");
    let old = |params: &mut CertificateParams| date(params, 2020, 2026);
    assert_eq!(check(&root, old), Err(TlsError::Expired));
    let ended = |params: &mut CertificateParams| date(params, 2020, 2027);
    assert_eq!(check(&root, ended), Ok(()), "to the last second");
    let early = |params: &mut CertificateParams| date(params, 2028, 2030);
    assert_eq!(check(&root, early), Err(TlsError::NotYet));
    let signs = |params: &mut CertificateParams| {
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    };
    assert_eq!(check(&root, signs), Err(TlsError::Purpose));
    let client = |params: &mut CertificateParams| {
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    };
    assert_eq!(check(&root, client), Err(TlsError::Purpose));
    let bare = |params: &mut CertificateParams| {
        params.key_usages.clear();
        params.extended_key_usages.clear();
    };
    assert_eq!(check(&root, bare), Ok(()));
    let unknown = |critical| {
        move |params: &mut CertificateParams| {
            let mut extension = CustomExtension::from_oid_content(&[1, 3, 6, 1, 4, 1], vec![5, 0]);
            extension.set_criticality(critical);
            params.custom_extensions = vec![extension];
        }
    };
    assert_eq!(check(&root, unknown(false)), Ok(()));
    assert_eq!(check(&root, unknown(true)), Err(TlsError::Purpose));
}

#[test]
fn without_a_clock_what_was_old_when_this_was_made_is_refused() {
    let root = Made::root();
    let at = |from, until, now| {
        let mut params = server_params();
        date(&mut params, from, until);
        let (chain, _) = server(&root, &params);
        let expected = Expected {
            now,
            ..expected(root.pin())
        };
        check_certificates(&list(&chain), &expected).map(|_| ())
    };
    assert_eq!(at(2020, 2026, None), Err(TlsError::Expired));
    assert_eq!(at(2020, 2027, None), Ok(()));
    assert_eq!(at(2030, 2031, None), Ok(()), "nobody can know");
    assert_eq!(at(2020, 2027, Some(NOW + 1)), Err(TlsError::Expired));
    // The robot's clock may be wrong; a certificate of its time is not refused for that.
    assert_eq!(at(2020, 2025, Some(1_600_000_000)), Ok(()));
}

#[test]
fn only_the_authority_and_whom_it_made_one_can_sign() {
    let root = Made::root();
    let check = |chain: &[CertificateDer<'_>]| {
        check_certificates(&list(chain), &expected(root.pin())).map(|_| ())
    };
    let (direct, _) = server(&root, &server_params());
    // With the root's own certificate, and with what has nothing to do with it.
    assert_eq!(check(&[direct[0].clone(), root.der.clone()]), Ok(()));
    let other = Made::root();
    assert_eq!(
        check(&[direct[0].clone(), other.der.clone()]),
        Err(TlsError::Untrusted)
    );
    let (foreign, _) = server(&other, &server_params());
    assert_eq!(check(&foreign), Err(TlsError::Untrusted));
    assert_eq!(
        check(&[foreign[0].clone(), other.der]),
        Err(TlsError::Untrusted)
    );

    let unbound = |name| authority_params(name, BasicConstraints::Unconstrained);
    let one = Made::below(&root, unbound("one"));
    let two = Made::below(&one, unbound("two"));
    let three = Made::below(&two, unbound("three"));
    let (leaf, _) = server(&one, &server_params());
    assert_eq!(check(&[leaf[0].clone(), one.der.clone()]), Ok(()));
    assert_eq!(
        check(&leaf),
        Err(TlsError::Untrusted),
        "a certificate is left out"
    );
    let (leaf, _) = server(&two, &server_params());
    assert_eq!(
        check(&[leaf[0].clone(), two.der.clone(), one.der.clone()]),
        Ok(())
    );
    let whole = [
        leaf[0].clone(),
        two.der.clone(),
        one.der.clone(),
        root.der.clone(),
    ];
    assert_eq!(check(&whole), Ok(()));
    let jumbled = [leaf[0].clone(), one.der.clone(), two.der.clone()];
    assert_eq!(check(&jumbled), Err(TlsError::Untrusted));
    let (leaf, _) = server(&three, &server_params());
    let long = [leaf[0].clone(), three.der, two.der, one.der];
    assert_eq!(check(&long), Err(TlsError::LongChain));

    // Whoever has a certificate for a server is no authority.
    let mut params = server_params();
    params.is_ca = IsCa::NoCa;
    let holder = Made::below(&root, params);
    let (leaf, _) = server(&holder, &server_params());
    assert_eq!(
        check(&[leaf[0].clone(), holder.der]),
        Err(TlsError::Purpose)
    );
    // Nor is one that may not sign certificates, or none of authorities.
    let mut params = unbound("silent");
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    let silent = Made::below(&root, params);
    let (leaf, _) = server(&silent, &server_params());
    assert_eq!(
        check(&[leaf[0].clone(), silent.der]),
        Err(TlsError::Purpose)
    );
    let last = Made::below(
        &root,
        authority_params("last", BasicConstraints::Constrained(0)),
    );
    let (leaf, _) = server(&last, &server_params());
    assert_eq!(check(&[leaf[0].clone(), last.der.clone()]), Ok(()));
    let beyond = Made::below(&last, unbound("beyond"));
    let (leaf, _) = server(&beyond, &server_params());
    let beyond = [leaf[0].clone(), beyond.der, last.der];
    assert_eq!(check(&beyond), Err(TlsError::Purpose));
    let mut params = unbound("gone");
    date(&mut params, 2020, 2026);
    let gone = Made::below(&root, params);
    let (leaf, _) = server(&gone, &server_params());
    assert_eq!(check(&[leaf[0].clone(), gone.der]), Err(TlsError::Expired));
    assert_eq!(check(&[]), Err(TlsError::Malformed));
}

#[test]
fn keys_of_another_kind_are_named() {
    let root = Made::root();
    let key = KeyPair::generate_for(&rcgen::PKCS_ECDSA_P384_SHA384).unwrap();
    let der = server_params().signed_by(&key, &root.issuer).unwrap();
    let result = check_certificates(&list(&[der.der().clone()]), &expected(root.pin()));
    assert_eq!(result, Err(TlsError::Algorithm));
    let own = server_params().self_signed(&key).unwrap();
    assert_eq!(
        Authority::of_certificate(own.der()),
        Err(TlsError::Algorithm)
    );
}

#[test]
fn an_authority_is_read_as_it_is_written() {
    let root = Made::root();
    let pin = root.pin();
    let text = pin.to_string();
    assert_eq!((text.len(), text.parse()), (66, Ok(pin)));
    assert_eq!(text.to_uppercase().parse(), Ok(pin));
    for wrong in [
        "",
        &text[1..],
        &text[2..],
        &std::format!("{text}00"),
        &text.replace(&text[..2], "zz"),
    ] {
        assert_eq!(
            wrong.parse::<Authority>(),
            Err(AuthorityError::Digits),
            "{wrong}"
        );
    }
    // A point at infinity, an uncompressed one, and a coordinate off the curve.
    for wrong in [[0; 33], [4; 33], [0xFF; 33]] {
        assert_eq!(Authority::new(wrong), Err(AuthorityError::Point));
    }
}

#[test]
fn a_handshake_names_the_reason() {
    let root = Made::root();
    let peer = || Rustls::new(config(server(&root, &server_params())));
    let right = expected(root.pin());
    assert_eq!(shake(&right, &mut peer()), Ok(()));
    let with = |change: fn(&mut Expected<'static>)| {
        let mut wrong = right;
        change(&mut wrong);
        shake(&wrong, &mut peer())
    };
    assert_eq!(with(|e| e.host = "10.0.2.2"), Ok(()));
    assert_eq!(with(|e| e.now = None), Ok(()));
    assert_eq!(with(|e| e.host = "10.0.2.3"), Err(TlsError::Name));
    assert_eq!(with(|e| e.host = "other.lan"), Err(TlsError::Name));
    assert_eq!(with(|e| e.host = "not a host"), Err(TlsError::Unusable));
    assert_eq!(
        with(|e| e.now = Some(4_000_000_000)),
        Err(TlsError::Expired)
    );
    assert_eq!(
        with(|e| e.authority = Made::root().pin()),
        Err(TlsError::Untrusted)
    );
}

fn sample() -> (Vec<u8>, Expected<'static>) {
    let root = Made::root();
    let one = Made::below(
        &root,
        authority_params("one", BasicConstraints::Unconstrained),
    );
    let (leaf, _) = server(&one, &server_params());
    (list(&[leaf[0].clone(), one.der]), expected(root.pin()))
}

proptest! {
    #![proptest_config(crawler_properties::cases(300))]
    #[test]
    fn no_byte_of_a_certificate_can_be_changed(at in any::<prop::sample::Index>(), by in 1_u8..) {
        let (mut list, expected) = sample();
        prop_assert!(chain::check(&list, &expected).is_ok());
        let at = at.index(list.len());
        list[at] ^= by;
        prop_assert!(chain::check(&list, &expected).is_err(), "byte {at}");
        list.truncate(at);
        prop_assert!(chain::check(&list, &expected).is_err(), "cut at {at}");
    }

    #[test]
    fn no_bytes_make_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let authority = "0279be667ef9dcbbac55a06295ce870b07029bfcdb2dce28d959f2815b16f81798";
        let expected = authority.parse::<Authority>().map_or_else(|_| sample().1, expected);
        let _ = chain::check(&bytes, &expected);
        let _ = Authority::of_certificate(&bytes);
    }
}
