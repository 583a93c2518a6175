//! Images that have something in common.

use std::fs;
use std::path::Path;

use proptest::prelude::*;

/// How a part of the second image comes about.
#[derive(Debug, Clone)]
enum Edit {
    /// Bytes of the first one, from somewhere.
    Copy(prop::sample::Index, usize),
    /// The same, with a number added to every fourth, as to addresses.
    Moved(prop::sample::Index, usize, u8),
    /// Others.
    Fresh(Vec<u8>),
    /// The same byte again and again.
    Fill(u8, usize),
}

fn edit() -> impl Strategy<Value = Edit> {
    let place = any::<prop::sample::Index>;
    prop_oneof![
        (place(), 0_usize..600).prop_map(|(from, length)| Edit::Copy(from, length)),
        (place(), 0_usize..600, any::<u8>())
            .prop_map(|(from, length, by)| Edit::Moved(from, length, by)),
        prop::collection::vec(any::<u8>(), 0..60).prop_map(Edit::Fresh),
        (any::<u8>(), 0_usize..3_000).prop_map(|(byte, length)| Edit::Fill(byte, length)),
    ]
}

/// Machine code of a kind: few words, again and again.
fn program() -> impl Strategy<Value = Vec<u8>> {
    let words = prop::collection::vec(any::<[u8; 4]>(), 1..20);
    (
        words,
        prop::collection::vec(any::<prop::sample::Index>(), 0..400),
    )
        .prop_map(|(words, places)| {
            let chosen = places.iter().map(|place| *place.get(&words));
            chosen.flatten().collect()
        })
}

fn edited(old: &[u8], edits: &[Edit]) -> Vec<u8> {
    let mut new = Vec::new();
    let from = |place: &prop::sample::Index, length: usize| {
        let rest = &old[place.index(old.len() + 1)..];
        &rest[..length.min(rest.len())]
    };
    for edit in edits {
        match edit {
            Edit::Copy(place, length) => new.extend_from_slice(from(place, *length)),
            Edit::Moved(place, length, by) => {
                let bytes = from(place, *length).iter().enumerate();
                new.extend(
                    bytes.map(|(at, byte)| byte.wrapping_add(if at % 4 == 0 { *by } else { 0 })),
                );
            }
            Edit::Fresh(bytes) => new.extend_from_slice(bytes),
            Edit::Fill(byte, length) => new.extend(std::iter::repeat_n(byte, *length)),
        }
    }
    new
}

/// Two images: of anything, or one of which the other was made by edits.
pub(crate) fn pairs() -> impl Strategy<Value = (Vec<u8>, Vec<u8>)> {
    let bytes = || prop::collection::vec(any::<u8>(), 0..500);
    let few = || prop::collection::vec(0_u8..3, 0..1_500);
    let edits = || prop::collection::vec(edit(), 0..12);
    prop_oneof![
        (bytes(), bytes()),
        (few(), few()),
        (program(), edits()).prop_map(|(old, edits)| {
            let new = edited(&old, &edits);
            (old, new)
        }),
        (few(), edits()).prop_map(|(old, edits)| {
            let new = edited(&old, &edits);
            (old, new)
        }),
    ]
}

/// A file of those that `firmware/delta/tests/golden/make.py` made.
pub(crate) fn golden(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware/delta/tests/golden");
    fs::read(folder.join(name)).expect("a golden file")
}
