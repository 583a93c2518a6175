//! Whose manifests are believed.

use crawler_release::{
    ENVELOPE_MAX, MANIFEST_MAX, Malformed, Manifest, PublicKey, PublicKeys, Refusal, Signed,
    image_hash, verify,
};
use proptest::prelude::*;

use crate::support::{Draft, drafts, envelope, key, public, sign, target};

/// What a robot with the keys 1 and 2 makes of an envelope, with whatever else it would ask left out.
fn opened(envelope: &[u8]) -> Result<Manifest<'_>, Refusal> {
    let keys = PublicKeys {
        current: public(&key(1)),
        next: Some(public(&key(2))),
    };
    let signed = Signed::parse(envelope)?;
    match keys.find(signed.key()) {
        Some(key) => signed.authenticate(key),
        None => Err(Refusal::UnknownKey(signed.key())),
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(32))]

    #[test]
    fn what_either_key_signed_is_believed(draft in drafts(), with in 1..=2_u8) {
        let manifest = draft.encoded();
        let envelope = sign(&key(with), &manifest);
        prop_assert!(envelope.len() <= ENVELOPE_MAX);
        prop_assert_eq!(opened(&envelope), Ok(draft.manifest()));
    }

    /// Whoever signed it, and nothing but its own bytes.
    #[test]
    fn a_release_is_named_by_its_manifest(one in drafts(), other in drafts()) {
        let id = |key_number, draft: &Draft| {
            let envelope = sign(&key(key_number), &draft.encoded());
            Signed::parse(&envelope).map(|signed| signed.id())
        };
        prop_assert_eq!(id(1, &one)?, id(2, &one)?);
        prop_assert_eq!(id(1, &one)? == id(1, &other)?, one.encoded() == other.encoded());
        let hash = image_hash(&one.encoded());
        prop_assert!(hash.starts_with(&id(1, &one)?));
    }

    /// One changed bit, anywhere.
    #[test]
    fn no_bit_can_be_changed(draft in drafts(), at in any::<proptest::sample::Index>(), bit in 0..8_u8) {
        let mut envelope = sign(&key(1), &draft.encoded());
        *at.get_mut(&mut envelope) ^= 1 << bit;
        prop_assert!(opened(&envelope).is_err());
    }

    #[test]
    fn nothing_can_be_left_out_or_added(draft in drafts(), at in any::<proptest::sample::Index>(), more: u8) {
        let mut envelope = sign(&key(1), &draft.encoded());
        let end = at.index(envelope.len());
        prop_assert!(opened(&envelope[..end]).is_err());
        envelope.push(more);
        prop_assert!(opened(&envelope).is_err());
    }

    /// The signature of one release under the manifest of another.
    #[test]
    fn no_two_can_be_mixed(one in drafts(), other in drafts()) {
        let (one, other) = (sign(&key(1), &one.encoded()), sign(&key(1), &other.encoded()));
        let mixed = [&one[..76], &other[76..]].concat();
        prop_assume!(mixed != one && mixed != other);
        prop_assert_eq!(opened(&mixed), Err(Refusal::BadSignature));
    }

    #[test]
    fn anything_can_arrive(bytes in proptest::collection::vec(any::<u8>(), 0..=1_100)) {
        prop_assert!(opened(&bytes).is_err());
        let headed = [&b"TCR\x01"[..], &bytes].concat();
        prop_assert!(opened(&headed).is_err());
    }
}

/// Each bit of one envelope, not some of many.
#[test]
fn every_bit_counts() {
    let envelope = sign(&key(1), &Draft::of(b"image").encoded());
    for bit in 0..envelope.len() * 8 {
        let mut changed = envelope.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let refusal = opened(&changed).expect_err("changed");
        let expected = match bit / 8 {
            0..4 => "malformed",
            4..12 => "unknown_key",
            _ => "bad_signature",
        };
        assert_eq!(refusal.code(), expected, "bit {bit}");
    }
}

#[test]
fn a_stranger_is_not_believed() {
    let manifest = Draft::of(b"image").encoded();
    let forged = sign(&key(3), &manifest);
    let id = public(&key(3)).id();
    assert_eq!(opened(&forged), Err(Refusal::UnknownKey(id)));
    // Nor when he says that it is ours.
    let signature = forged[12..76].try_into().expect("64 bytes");
    let claimed = envelope(&public(&key(1)), signature, &manifest);
    assert_eq!(opened(&claimed), Err(Refusal::BadSignature));
    // Signatures that an implementation without checks would take for right.
    for signature in [[0; 64], [0xFF; 64]] {
        let claimed = envelope(&public(&key(1)), &signature, &manifest);
        assert_eq!(opened(&claimed), Err(Refusal::BadSignature));
    }
}

#[test]
fn what_was_signed_and_is_no_manifest_is_refused_as_that() {
    let mut later = Draft::of(b"image").encoded();
    later[2] = 2;
    let refusal = opened(&sign(&key(1), &later)).map(drop);
    assert_eq!(refusal, Err(Refusal::Malformed(Malformed::Format(2))));
    assert_eq!(refusal.expect_err("refused").code(), "unknown_format");
    // The same bytes of somebody else are not looked at.
    assert!(matches!(
        opened(&sign(&key(3), &later)),
        Err(Refusal::UnknownKey(_))
    ));
    assert_eq!(
        opened(&sign(&key(1), b"")),
        Err(Refusal::Malformed(Malformed::Cbor))
    );
    let long = [0; MANIFEST_MAX + 1];
    let id = public(&key(1)).id();
    assert_eq!(Signed::new(id, &[0; 64], &long), Err(Malformed::Oversize));
}

#[test]
fn the_signature_comes_first() {
    // A robot of another board, and a release that is not signed: which of them it is told of.
    let mut target = target();
    target.board = "virt";
    let keys = PublicKeys {
        current: public(&key(1)),
        next: None,
    };
    let manifest = Draft::of(b"image").encoded();
    let genuine = sign(&key(1), &manifest);
    assert_eq!(verify(&genuine, &keys, &target), Err(Refusal::WrongBoard));
    let mut forged = genuine.clone();
    forged[20] ^= 1;
    assert_eq!(verify(&forged, &keys, &target), Err(Refusal::BadSignature));
    target.board = "xiao-c3";
    assert!(verify(&genuine, &keys, &target).is_ok());
    let unknown = sign(&key(2), &manifest);
    assert!(matches!(
        verify(&unknown, &keys, &target),
        Err(Refusal::UnknownKey(_))
    ));
}

#[test]
fn a_key_is_the_same_however_it_is_written() {
    let signing = key(1);
    let compressed = signing.verifying_key().to_sec1_point(true);
    let key = PublicKey::from_sec1(compressed.as_bytes()).expect("a point");
    assert_eq!(key, public(&signing));
    for wrong in [&[][..], &[0], &[4; 65], &compressed.as_bytes()[..32]] {
        assert!(PublicKey::from_sec1(wrong).is_err(), "{wrong:02x?}");
    }
}
