//! The bytes of a manifest.

use crawler_release::{
    FORMAT, HASH, Kind, MANIFEST_MAX, MAX_BLOCKS, MAX_IMAGE, Malformed, Manifest, Requires,
    block_size,
};
use proptest::prelude::*;

use crate::support::{Draft, drafts};

proptest! {
    #[test]
    fn what_is_written_is_read(draft in drafts()) {
        let bytes = draft.encoded();
        prop_assert!(bytes.len() <= MANIFEST_MAX);
        prop_assert_eq!(Manifest::decode(&bytes), Ok(draft.manifest()));
    }

    /// There is one encoding: whatever is read is written the same.
    #[test]
    fn what_is_read_was_written_so(draft in drafts(), at in any::<proptest::sample::Index>(), value: u8) {
        let mut bytes = draft.encoded();
        *at.get_mut(&mut bytes) = value;
        if let Ok(manifest) = Manifest::decode(&bytes) {
            let mut again = [0; MANIFEST_MAX];
            prop_assert_eq!(manifest.encode(&mut again), Ok(bytes.len()));
            prop_assert_eq!(&again[..bytes.len()], &bytes[..]);
        }
    }

    #[test]
    fn no_beginning_of_a_manifest_is_one(draft in drafts(), more: u8) {
        let mut bytes = draft.encoded();
        for end in 0..bytes.len() {
            prop_assert!(Manifest::decode(&bytes[..end]).is_err(), "{} bytes", end);
        }
        bytes.push(more);
        prop_assert!(matches!(
            Manifest::decode(&bytes),
            Err(Malformed::Trailing | Malformed::Oversize)
        ));
    }

    #[test]
    fn anything_can_arrive(bytes in proptest::collection::vec(any::<u8>(), 0..=1_100)) {
        let _ = Manifest::decode(&bytes);
    }
}

#[test]
fn the_largest_of_all_fits() {
    let long = |length| "x".repeat(length);
    let draft = Draft {
        kind: Kind::Model,
        name: Some(long(16)),
        board: long(16),
        chip: u16::MAX,
        version: long(32),
        build: long(40),
        sequence: u32::MAX,
        floor: u32::MAX,
        expires: Some(u64::MAX),
        size: MAX_IMAGE,
        sha256: [1; HASH],
        block_size: 128 * 1024,
        blocks: vec![2; MAX_BLOCKS * 16],
        delta: Some(([3; HASH], "y".repeat(40), MAX_IMAGE)),
        requires: Requires {
            sequence: u32::MAX - 1,
            protocol: u8::MAX,
        },
    };
    let bytes = draft.encoded();
    assert!(bytes.len() <= MANIFEST_MAX, "{}", bytes.len());
    assert_eq!(Manifest::decode(&bytes), Ok(draft.manifest()));
}

#[test]
fn blocks_grow_where_small_ones_would_be_too_many() {
    const KIB: u32 = 1024;
    for (size, expected) in [
        (0, None),
        (1, Some(64 * KIB)),
        (36 * 64 * KIB, Some(64 * KIB)),
        (36 * 64 * KIB + 1, Some(128 * KIB)),
        // The slot of a board with 8 MB of flash.
        (0x38_0000, Some(128 * KIB)),
        (MAX_IMAGE, Some(128 * KIB)),
        (MAX_IMAGE + 1, None),
        (u32::MAX, None),
    ] {
        assert_eq!(block_size(size), expected, "{size}");
    }
    let draft = Draft::of(&vec![0; 150_000]);
    let manifest = draft.manifest();
    let lengths: Vec<_> = (0..4).map(|index| manifest.block_length(index)).collect();
    assert_eq!(lengths, [Some(65_536), Some(65_536), Some(18_928), None]);
}

#[test]
fn what_contradicts_itself_is_neither_written_nor_read() {
    type Change = fn(&mut Draft);
    let changes: [(&str, Change); 20] = [
        ("name", |draft| draft.name = Some("eyes".into())),
        ("name", |draft| draft.kind = Kind::Model),
        ("name", |draft| {
            (draft.kind, draft.name) = (Kind::Model, Some("Eyes".into()));
        }),
        ("board", |draft| draft.board.clear()),
        ("board", |draft| draft.board = "a/b".into()),
        ("board", |draft| draft.board = "x".repeat(17)),
        ("version", |draft| draft.version = "1 2".into()),
        ("version", |draft| draft.version = "\u{1b}[2J".into()),
        ("build", |draft| draft.build = "x".repeat(41)),
        ("sequence", |draft| draft.sequence = 0),
        ("floor", |draft| draft.floor = draft.sequence + 1),
        ("size", |draft| draft.size = 0),
        ("size", |draft| draft.size = MAX_IMAGE + 1),
        ("block_size", |draft| draft.block_size = 4096),
        ("blocks", |draft| draft.blocks.truncate(16)),
        ("blocks", |draft| draft.blocks.push(0)),
        ("delta", |draft| {
            draft.delta = Some((draft.sha256, "old".into(), 10));
        }),
        ("delta", |draft| {
            draft.delta = Some(([0; HASH], "new".into(), 10));
        }),
        ("delta", |draft| {
            draft.delta = Some(([0; HASH], "old".into(), draft.size + 1));
        }),
        ("requires", |draft| draft.requires.sequence = draft.sequence),
    ];
    for (field, change) in changes {
        let mut draft = Draft::of(&vec![7; 100_000]);
        change(&mut draft);
        let refused = draft.manifest().encode(&mut [0; MANIFEST_MAX]);
        assert_eq!(refused, Err(Malformed::OutOfRange(field)));
        // Somebody who signs does not have to use this encoder.
        let bytes = crate::support::forced(&draft);
        assert_eq!(Manifest::decode(&bytes), Err(Malformed::OutOfRange(field)));
    }
}

#[test]
fn each_fault_has_its_reason() {
    let bytes = Draft::of(b"image").encoded();
    let changed = |at: usize, value: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = value;
        bytes
    };
    // A map of twelve fields: format, kind, board…
    assert_eq!(bytes[..6], [0xAC, 0, FORMAT, 1, 0, 3]);
    for (bytes, reason) in [
        (vec![], Malformed::Cbor),
        (vec![0xF7], Malformed::WrongType),
        (vec![0; 901], Malformed::Oversize),
        (changed(2, 2), Malformed::Format(2)),
        (changed(0, 0xBF), Malformed::NotCanonical),
        (changed(1, 1), Malformed::MissingField(0)),
        (changed(3, 0), Malformed::FieldOrder(0)),
        (changed(3, 16), Malformed::UnknownField),
        (changed(4, 3), Malformed::OutOfRange("kind")),
        // A policy has a name, as a model has.
        (changed(4, 2), Malformed::OutOfRange("name")),
        (changed(5, 1), Malformed::FieldOrder(1)),
        (changed(0, 0xAB), Malformed::MissingField(13)),
        (changed(0, 0xAD), Malformed::Cbor),
        // 1 in two bytes.
        (
            [&bytes[..2], &[0x18, FORMAT], &bytes[3..]].concat(),
            Malformed::NotCanonical,
        ),
        ([&bytes[..], &[0]].concat(), Malformed::Trailing),
    ] {
        assert_eq!(Manifest::decode(&bytes), Err(reason), "{bytes:02x?}");
    }
    // A requirement of nothing is not written.
    let mut nothing = bytes.clone();
    nothing[0] = 0xAD;
    nothing.extend([15, 0x82, 0, 0]);
    assert_eq!(Manifest::decode(&nothing), Err(Malformed::NotCanonical));
}
