//! Bundles there and back, and what is none.

#![allow(missing_docs)]

use crawler_bundle::{
    Bundle, BundleFault, Defect, DefectKind, Digest, HEADER_MAX, Header, SIZE_MAX, decode,
};
use proptest::collection::{btree_map, vec};
use proptest::prelude::*;

fn bundle() -> Bundle {
    Bundle {
        parameters: vec![
            ("max_speed".to_owned(), 40.0),
            ("safe_distance".to_owned(), 350.5),
        ],
        defects: vec![
            Defect::everywhere(DefectKind::Panic, 5_000),
            Defect {
                kind: DefectKind::NeverLink,
                percent: 10,
                value: 0,
            },
        ],
        ..Bundle::new("0.4.0-rc.1", "9f2c1ab")
    }
}

fn any_bundle() -> impl Strategy<Value = Bundle> {
    let defect = |kind| {
        let value = match kind {
            DefectKind::NeverLink | DefectKind::RangerDead => 0..1,
            _ => 200..4_500_u32,
        };
        (1..=100_u8, value).prop_map(move |(percent, value)| Defect {
            kind,
            percent,
            value,
        })
    };
    let defects = DefectKind::ALL
        .map(|kind| prop::option::of(defect(kind)))
        .to_vec();
    (
        "[A-Za-z0-9.+_-]{1,32}",
        "[A-Za-z0-9.+_-]{1,40}",
        btree_map(
            "[a-z0-9_]{1,24}",
            any::<f32>().prop_filter("finite", |v| v.is_finite()),
            0..=8,
        ),
        defects,
    )
        .prop_map(|(version, build, parameters, defects)| Bundle {
            version,
            build,
            parameters: parameters.into_iter().collect(),
            defects: defects.into_iter().flatten().collect(),
        })
}

#[test]
fn an_image_has_its_size_and_says_what_it_said() {
    for size in [200, 1_024, 4_099, 608_000, SIZE_MAX] {
        let image = bundle().image(size, 7).expect("it can be");
        assert_eq!(image.len(), size as usize);
        assert_eq!(decode(&image), Ok(bundle()));
        let front = &image[..image.len().min(HEADER_MAX)];
        assert_eq!(Header::decode(front).map(|header| header.size), Ok(size));
    }
}

#[test]
fn a_changed_bit_is_found_wherever_it_is() {
    let image = bundle().image(600, 7).expect("it can be");
    for bit in 0..image.len() * 8 {
        let mut changed = image.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        assert!(decode(&changed).is_err(), "bit {bit}");
    }
    for length in 0..image.len() {
        assert!(decode(&image[..length]).is_err(), "{length} bytes");
    }
    assert_eq!(decode(&[&image[..], &[0]].concat()), Err(BundleFault::Long));
}

#[test]
fn images_of_one_seed_differ_where_they_say_something_else() {
    let images = ["a", "bb"].map(|build| Bundle::new("1", build).image(64_000, 3).expect("so"));
    let [one, other] = &images;
    let differ = one.iter().zip(other).filter(|(a, b)| a != b).count();
    assert!(differ < 60, "{differ} bytes");
    let third = Bundle::new("1", "a").image(64_000, 4).expect("so");
    let alike = one.iter().zip(&third).filter(|(a, b)| a == b).count();
    assert!(alike < 1_000, "{alike} bytes");
}

#[test]
fn what_cannot_be_is_not_made() {
    let made = |change: fn(&mut Bundle)| {
        let mut bundle = bundle();
        change(&mut bundle);
        bundle.image(4_096, 0).map(|_| ())
    };
    assert_eq!(made(|_| ()), Ok(()));
    let (version, build) = (
        BundleFault::Malformed("version"),
        BundleFault::Malformed("build"),
    );
    assert_eq!(made(|b| b.version = String::new()), Err(version));
    assert_eq!(made(|b| b.version = "1".repeat(33)), Err(version));
    assert_eq!(made(|b| b.version = "é".to_owned()), Err(version));
    assert_eq!(made(|b| b.build = "a b".to_owned()), Err(build));
    assert_eq!(made(|b| b.build = "b".repeat(41)), Err(build));
    let parameters = BundleFault::Malformed("parameters");
    assert_eq!(made(|b| b.parameters.reverse()), Err(parameters));
    assert_eq!(made(|b| b.parameters[0].1 = f32::NAN), Err(parameters));
    assert_eq!(
        made(|b| b.parameters[0].0 = "A".to_owned()),
        Err(parameters)
    );
    let many = |b: &mut Bundle| b.parameters = (0..9).map(|n| (format!("p{n}"), 0.0)).collect();
    assert_eq!(made(many), Err(parameters));
    let defects = BundleFault::Malformed("defects");
    assert_eq!(made(|b| b.defects.reverse()), Err(defects));
    assert_eq!(made(|b| b.defects[1] = b.defects[0]), Err(defects));
    assert_eq!(made(|b| b.defects[0].percent = 0), Err(defects));
    let size = BundleFault::Malformed("size");
    for wrong in [0, 40, SIZE_MAX + 1, u32::MAX] {
        assert_eq!(bundle().image(wrong, 0), Err(size), "{wrong}");
    }
}

#[test]
fn what_does_not_begin_like_one_is_none() {
    assert_eq!(decode(b""), Err(BundleFault::NotBundle));
    assert_eq!(decode(&[0xFF; 600]), Err(BundleFault::NotBundle));
    assert_eq!(decode(b"TCSB"), Err(BundleFault::Short));
    assert_eq!(decode(b"TCSB\x02"), Err(BundleFault::Format(2)));
    assert_eq!(
        decode(b"TCSB\x01\xFF\xFF"),
        Err(BundleFault::Malformed("length"))
    );
    assert_eq!(
        decode(b"TCSB\x01\x03\x00"),
        Err(BundleFault::Malformed("length"))
    );
    // The smallest header whose checksum fits.
    let crc = [0x1A, 0x0B];
    assert!(decode(&[b"TCSB\x01\x0B\x00", &crc[..], &[0; 2]].concat()).is_err());
}

proptest! {
    #[test]
    fn there_and_back(bundle in any_bundle(), more in 0..2_000_u32, seed: u64) {
        let image = bundle.image(HEADER_MAX as u32 + 8 + more, seed).expect("it can be");
        prop_assert_eq!(decode(&image), Ok(bundle));
    }

    #[test]
    fn any_bytes_are_a_bundle_or_none(bytes in vec(any::<u8>(), 0..600)) {
        let framed = [&b"TCSB\x01"[..], &bytes].concat();
        for bytes in [&bytes, &framed] {
            if let Ok(header) = Header::decode(bytes) {
                let encoded = header.encode().expect("what was read can be");
                prop_assert_eq!(&bytes[..encoded.len()], encoded);
            }
        }
    }

    #[test]
    fn a_digest_does_not_depend_on_the_pieces(
        bytes in vec(any::<u8>(), 0..200),
        cuts in vec(0..200_usize, 0..8),
    ) {
        let mut whole = Digest::new();
        whole.update(&bytes);
        let mut pieces = Digest::new();
        let mut rest = &bytes[..];
        for cut in cuts {
            let (piece, behind) = rest.split_at(cut.min(rest.len()));
            pieces.update(piece);
            rest = behind;
        }
        pieces.update(rest);
        prop_assert_eq!(whole.finish(), pieces.finish());
    }
}
