//! Releases as files: what is made is what is verified, and nothing else is.

use crawler_bundle::Bundle;
use crawler_release::{
    Chip, ENVELOPE_MAX, Kind, MANIFEST_MAX, MAX_IMAGE, Malformed, Manifest, PublicKey, Requires,
    Signed, image_hash,
};
use crawler_updates::release::{
    Expected, FileFault, ImageFault, Inspection, KeyFault, SecretKey, SignFault, SignOptions,
    inspect, join, public_from_pem, split,
};
use proptest::prelude::*;

/// 2027-01-01.
const NOW: u64 = 1_798_761_600;

/// What a case has done to what is to be signed.
type Change = fn(&mut SignOptions<'static>);

fn options() -> SignOptions<'static> {
    SignOptions {
        kind: Kind::Program,
        name: None,
        board: "virt",
        chip: None,
        version: "0.4.0",
        build: Some("abc123"),
        sequence: 12,
        floor: 0,
        expires: None,
        requires: Requires::default(),
    }
}

fn key() -> SecretKey {
    SecretKey::generate().expect("random numbers")
}

fn made(options: &SignOptions<'_>, image: &[u8], key: &SecretKey) -> Vec<u8> {
    let envelope = options.sign(image, key).expect("signed");
    join(&envelope, image).expect("an envelope")
}

fn codes(found: &Inspection<'_>) -> Vec<&'static str> {
    found.faults.iter().map(|fault| fault.code).collect()
}

/// What is found against a file, of which nothing else is expected.
fn found(file: &[u8], keys: &[PublicKey]) -> Vec<&'static str> {
    let expected = Expected {
        now: NOW,
        ..Expected::default()
    };
    match inspect(file, keys, &expected) {
        Ok(found) => codes(&found),
        Err(FileFault) => vec!["file"],
    }
}

#[test]
fn what_is_signed_is_verified() {
    let key = key();
    let image = vec![7; 200_000];
    let file = made(&options(), &image, &key);
    let (envelope, inside) = split(&file).expect("a file");
    assert_eq!(inside, image);
    let expected = Expected {
        board: Some("virt"),
        above: Some(11),
        image: Some(&image),
        now: NOW,
    };
    let other = SecretKey::generate().expect("random numbers");
    let keys = [other.public(), key.public()];
    let came = inspect(&file, &keys, &expected).expect("a file");
    assert!(came.authentic && came.faults.is_empty(), "{came:?}");
    assert_eq!(came.key, key.public().id());
    let manifest = came.manifest.expect("a manifest");
    assert_eq!(manifest.build, "abc123");
    let signed = Signed::parse(envelope).expect("an envelope");
    assert_eq!(signed.authenticate(&key.public()), Ok(manifest));

    // Without a key, or with another, it is a claim.
    for (keys, code) in [(&[][..], "no_key"), (&keys[..1], "unknown_key")] {
        let came = inspect(&file, keys, &expected).expect("a file");
        assert!(!came.authentic && came.manifest.is_some(), "{came:?}");
        assert_eq!(codes(&came), [code]);
    }
    let other = Expected {
        board: Some("sim"),
        above: Some(12),
        image: Some(b"another"),
        now: NOW,
    };
    let came = inspect(&file, &keys, &other).expect("a file");
    assert_eq!(codes(&came), ["other_image", "wrong_board", "downgrade"]);
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    #[test]
    fn a_file_that_was_changed_is_found_out(length in 1..80_000_usize, at: proptest::sample::Index, bit in 0..8_u8) {
        let key = SecretKey::from_pem(PRIVATE).expect("a key");
        let image: Vec<u8> = (0..length).map(|at| at as u8).collect();
        let mut file = made(&options(), &image, &key);
        prop_assert!(found(&file, &[key.public()]).is_empty());
        let place = at.index(file.len());
        file[place] ^= 1 << bit;
        prop_assert!(!found(&file, &[key.public()]).is_empty());
    }

    #[test]
    fn a_file_that_was_cut_or_continued_is_found_out(length in 1..80_000_usize, at: proptest::sample::Index) {
        let key = SecretKey::from_pem(PRIVATE).expect("a key");
        let mut file = made(&options(), &vec![3; length], &key);
        prop_assert!(!found(&file[..at.index(file.len())], &[key.public()]).is_empty());
        file.push(0);
        prop_assert_eq!(found(&file, &[key.public()]), ["image_too_long"]);
    }

    #[test]
    fn anything_can_be_a_file(bytes in proptest::collection::vec(any::<u8>(), 0..2_000)) {
        let key = SecretKey::from_pem(PRIVATE).expect("a key");
        prop_assert_eq!(found(&bytes, &[key.public()]), ["file"]);
    }
}

#[test]
fn envelope_and_image_of_two_releases_do_not_mix() {
    let key = key();
    let (one, other) = (vec![1; 100_000], vec![2; 100_000]);
    let envelope = options().sign(&one, &key).expect("signed");
    let file = join(&envelope, &other).expect("an envelope");
    assert_eq!(found(&file, &[key.public()]), ["bad_block"]);
}

/// An envelope whose manifest says something else, signed all the same.
fn altered(envelope: &[u8], key: &SecretKey, change: impl FnOnce(&mut Manifest<'_>)) -> Vec<u8> {
    let signed = Signed::parse(envelope).expect("an envelope");
    let mut manifest = signed.unverified().expect("a manifest");
    change(&mut manifest);
    let mut encoded = [0; MANIFEST_MAX];
    let length = manifest.encode(&mut encoded).expect("valid");
    let signature = key.sign(&image_hash(&encoded[..length]));
    let signed = Signed::new(key.public().id(), &signature, &encoded[..length]);
    let mut envelope = vec![0; ENVELOPE_MAX];
    let length = signed.expect("short").write(&mut envelope).expect("room");
    envelope.truncate(length);
    envelope
}

/// What `sign` does not sign: somebody else has, with the key.
#[test]
fn an_image_for_another_chip_is_found_out() {
    let key = key();
    let mut image = vec![0; 100];
    (image[0], image[1], image[12]) = (0xE9, 4, 5);
    let options = SignOptions {
        board: "xiao-c3",
        ..options()
    };
    let good = options.sign(&image, &key).expect("signed");
    for (board, chip, code) in [
        ("xiao-c6", Chip::ESP32_C6, "wrong_chip"),
        ("xiao-c3", Chip::ESP32_C6, "wrong_chip"),
        ("virt", Chip::NONE, "wrong_chip"),
        ("mine", Chip::ESP32_C3, ""),
    ] {
        let envelope = altered(&good, &key, |manifest| {
            (manifest.board, manifest.chip) = (board, chip);
        });
        let file = join(&envelope, &image).expect("an envelope");
        assert_eq!(found(&file, &[key.public()]).concat(), code, "{board}");
    }
}

/// The same of names.
#[test]
fn a_bundle_that_names_another_program_is_found_out() {
    let key = key();
    let bundle = Bundle::new("0.4.0", "abc123").image(2_000, 0);
    let image = bundle.expect("a bundle");
    let options = SignOptions {
        board: "sim",
        ..options()
    };
    let good = options.sign(&image, &key).expect("signed");
    for (version, build, code) in [
        ("0.4.0", "abc123", ""),
        ("0.4.1", "abc123", "wrong_image"),
        ("0.4.0", "abc124", "wrong_image"),
    ] {
        let envelope = altered(&good, &key, |manifest| {
            (manifest.version, manifest.build) = (version, build);
        });
        let file = join(&envelope, &image).expect("an envelope");
        let came = found(&file, &[key.public()]).concat();
        assert_eq!(came, code, "{version} {build}");
    }
}

#[test]
fn a_release_ends() {
    let key = key();
    for (expires, faults) in [(NOW, &["expired"][..]), (NOW + 1, &[])] {
        let options = SignOptions {
            expires: Some(expires),
            ..options()
        };
        assert_eq!(
            found(&made(&options, b"image", &key), &[key.public()]),
            faults
        );
    }
}

#[test]
fn what_no_robot_could_take_is_not_signed() {
    let key = key();
    let large = vec![0; MAX_IMAGE as usize + 1];
    let out = |field| SignFault::Manifest(Malformed::OutOfRange(field));
    let cases: [(&[u8], Change, SignFault); 9] = [
        (b"", |_| {}, ImageFault::Empty.into()),
        (&large, |_| {}, ImageFault::TooLarge.into()),
        (b"x", |options| options.build = None, SignFault::NoBuild),
        (
            b"x",
            |options| options.board = "xiao-c3",
            ImageFault::NotEsp.into(),
        ),
        (
            b"x",
            |options| options.board = "toaster",
            ImageFault::UnknownBoard.into(),
        ),
        (b"x", |options| options.floor = 13, out("floor")),
        (b"x", |options| options.sequence = 0, out("sequence")),
        (b"x", |options| options.name = Some("eyes"), out("name")),
        (
            b"x",
            |options| options.requires.sequence = 12,
            out("requires"),
        ),
    ];
    for (image, change, fault) in cases {
        let mut options = options();
        change(&mut options);
        assert_eq!(options.sign(image, &key).map(drop), Err(fault));
        assert!(!fault.to_string().is_empty());
    }
}

#[test]
fn a_model_goes_by_its_hash() {
    let key = key();
    let options = SignOptions {
        kind: Kind::Model,
        name: Some("eyes"),
        build: None,
        ..options()
    };
    let file = made(&options, b"abc", &key);
    let came = inspect(&file, &[key.public()], &Expected::default()).expect("a file");
    // The first half of SHA-256("abc"), FIPS 180-2, appendix B.1.
    let build = came.manifest.expect("a manifest").build;
    assert_eq!(build, "ba7816bf8f01cfea414140de5dae2223");
}

/// Made by `openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256`, and good for nothing else.
const PRIVATE: &str = include_str!("openssl.pem");
/// Its public half, by `openssl pkey -pubout`.
const PUBLIC: &str = include_str!("openssl-public.pem");

#[test]
fn keys_survive_their_files() {
    let key = key();
    let again = SecretKey::from_pem(&key.to_pem()).expect("a key");
    assert_eq!(again.public(), key.public());
    assert_eq!(public_from_pem(&key.public_pem()), Ok(key.public()));
    assert_ne!(SecretKey::generate().expect("a key").public(), key.public());
    // Nothing of the secret shows where it should not.
    assert_eq!(
        format!("{key:?}"),
        format!("SecretKey({})", key.public().id())
    );
}

#[test]
fn keys_of_openssl_are_read() {
    let key = SecretKey::from_pem(PRIVATE).expect("a key");
    assert_eq!(public_from_pem(PUBLIC), Ok(key.public()));
    assert_eq!(key.public_pem(), PUBLIC);
    let labelled = |label: &str| format!("-----BEGIN {label}-----\nAAAA\n-----END {label}-----\n");
    for (text, fault) in [
        (PUBLIC.to_owned(), KeyFault::PublicGiven),
        (labelled("EC PRIVATE KEY"), KeyFault::Sec1),
        (labelled("ENCRYPTED PRIVATE KEY"), KeyFault::Encrypted),
        (labelled("PRIVATE KEY"), KeyFault::NotPrivate),
        (String::new(), KeyFault::NotPrivate),
        (PRIVATE.replace('M', "N"), KeyFault::NotPrivate),
    ] {
        assert_eq!(SecretKey::from_pem(&text).map(drop), Err(fault), "{text}");
    }
    assert_eq!(public_from_pem(PRIVATE), Err(KeyFault::PrivateGiven));
    assert_eq!(public_from_pem("text"), Err(KeyFault::NotPublic));
}
