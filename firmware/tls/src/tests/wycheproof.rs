//! The vectors of Wycheproof, which collect what went wrong in other people's cryptography, through what
//! this crate reads and decides with.

use std::println;
use std::vec::Vec;

use p256::SecretKey;
use p256::ecdh::diffie_hellman;
use wycheproof::{TestResult, aead, ecdh, ecdsa, hkdf};

use crate::certificate::{key_info, point, verify};
use crate::der::Der;
use crate::keys::{HASH, Secret, expand_info, extract};
use crate::record::{Keys, TAG};
use crate::{POINT, TlsError, handshake};

/// Holds what came of a vector against what should: `None` is a refusal. What is acceptable may be refused,
/// but must not come to something else. Returns whether it was taken.
fn hold<T: PartialEq + core::fmt::Debug>(
    what: &str,
    id: usize,
    result: TestResult,
    expected: &T,
    came: Option<&T>,
) -> bool {
    match (result, came) {
        (TestResult::Valid | TestResult::Acceptable, Some(came)) => {
            assert_eq!(came, expected, "{what} {id}");
            true
        }
        (TestResult::Invalid | TestResult::Acceptable, None) => false,
        (TestResult::Valid, None) => panic!("{what} {id} is valid and was refused"),
        (TestResult::Invalid, Some(_)) => panic!("{what} {id} is invalid and was taken"),
    }
}

/// The point in a `SubjectPublicKeyInfo`, as certificates have it.
fn point_in(info: &[u8]) -> Result<&[u8; POINT], TlsError> {
    let mut outer = Der(info);
    let info = key_info(&mut outer)?;
    outer.end()?;
    point(info)
}

#[test]
fn signatures() {
    let set = ecdsa::TestSet::load(ecdsa::TestName::EcdsaSecp256r1Sha256).expect("in the crate");
    let (mut taken, mut all) = (0, 0);
    for group in &set.test_groups {
        let key = point_in(&group.der).expect("a key of P-256");
        assert_eq!(&key[..], &group.key.key[..]);
        for test in &group.tests {
            let genuine = verify(key, &[&test.msg], &test.sig) == Ok(true);
            let came = genuine.then_some(&());
            taken += usize::from(hold("signature", test.tc_id, test.result, &(), came));
            all += 1;
        }
    }
    println!("{taken} of {all} signatures taken");
    assert_eq!((taken, all), (174, 484));
}

/// What a server's share and a key of ours lead to.
fn agreed(share: Result<&[u8; POINT], TlsError>, private: &[u8]) -> Option<Vec<u8>> {
    // Written as a number: with a zero in front of it, or without the zeros there.
    let digits: Vec<u8> = private
        .iter()
        .copied()
        .skip_while(|byte| *byte == 0)
        .collect();
    let mut secret = [0; 32];
    secret[32 - digits.len()..].copy_from_slice(&digits);
    let secret = SecretKey::from_slice(&secret).expect("a key of P-256");
    let share = handshake::public(share.ok()?).ok()?;
    let shared = diffie_hellman(secret.to_nonzero_scalar(), share.as_affine());
    Some(shared.raw_secret_bytes().to_vec())
}

#[test]
fn exchanges_of_keys() {
    for (name, counted) in [
        (ecdh::TestName::EcdhSecp256r1Ecpoint, (330, 355)),
        (ecdh::TestName::EcdhSecp256r1, (330, 612)),
    ] {
        let set = ecdh::TestSet::load(name).expect("in the crate");
        let (mut taken, mut all) = (0, 0);
        for test in set.test_groups.iter().flat_map(|group| &group.tests) {
            let share = match name {
                // As the extension of a hello has it.
                ecdh::TestName::EcdhSecp256r1Ecpoint => {
                    test.public_key[..].try_into().map_err(|_| TlsError::Choice)
                }
                _ => point_in(&test.public_key),
            };
            let came = agreed(share, &test.private_key);
            let expected = test.shared_secret.to_vec();
            taken += usize::from(hold(
                "exchange",
                test.tc_id,
                test.result,
                &expected,
                came.as_ref(),
            ));
            all += 1;
        }
        println!("{name:?}: {taken} of {all} exchanges taken");
        assert_eq!((taken, all), counted, "{name:?}");
    }
}

#[test]
fn ciphers() {
    let set = aead::TestSet::load(aead::TestName::ChaCha20Poly1305).expect("in the crate");
    let (mut taken, mut all) = (0, 0);
    for test in set.test_groups.iter().flat_map(|group| &group.tests) {
        all += 1;
        // Nonces of another length cannot be written here.
        let Ok(nonce) = <[u8; 12]>::try_from(&test.nonce[..]) else {
            assert_eq!(test.result, TestResult::Invalid, "{}", test.tc_id);
            continue;
        };
        let keys = Keys::with_key(Secret::new(test.key[..].try_into().expect("32 bytes")));
        let tag: [u8; TAG] = test.tag[..].try_into().expect("16 bytes");
        let mut text = test.ct.to_vec();
        let opened = keys.decrypt(nonce, &test.aad, &mut text, tag);
        let came = opened.is_ok().then_some(&text);
        let expected = test.pt.to_vec();
        taken += usize::from(hold("record", test.tc_id, test.result, &expected, came));
        let mut text = test.pt.to_vec();
        let made = keys.encrypt(nonce, &test.aad, &mut text);
        if test.result == TestResult::Valid {
            assert_eq!((made, &text[..]), (Ok(tag), &test.ct[..]), "{}", test.tc_id);
        }
    }
    println!("{taken} of {all} records opened");
    assert_eq!((taken, all), (256, 325));
}

#[test]
fn derivations() {
    let set = hkdf::TestSet::load(hkdf::TestName::HkdfSha256).expect("in the crate");
    let (mut taken, mut all) = (0, 0);
    for test in set.test_groups.iter().flat_map(|group| &group.tests) {
        // HMAC fills its key with zeros: a shorter salt is the same as one of this length. The eleven
        // with a longer one cannot be written here.
        let mut salt = [0; HASH];
        let Some(place) = salt.get_mut(..test.salt.len()) else {
            continue;
        };
        place.copy_from_slice(&test.salt);
        let secret = extract(&salt, &test.ikm);
        let mut out = std::vec![0; test.size];
        let came = expand_info(&secret, &[&test.info], &mut out).is_ok();
        let expected = test.okm.to_vec();
        taken += usize::from(hold(
            "derivation",
            test.tc_id,
            test.result,
            &expected,
            came.then_some(&out),
        ));
        all += 1;
    }
    println!("{taken} of {all} derivations came to something");
    assert_eq!((taken, all), (72, 75));
}
