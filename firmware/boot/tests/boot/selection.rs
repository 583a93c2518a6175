//! The decision of the bootloader, for all states of both entries.

use crate::loader;
use crawler_boot::otadata::{Bootloader, Entry, ImageState, Otadata, Slots};

/// The states of ESP-IDF, and one that is none of them.
const STATES: [u32; 7] = [0, 1, 2, 3, 4, u32::MAX, 6];
/// Sequence numbers: none, blank, in either order, equal, and at the end of the range.
const SEQUENCES: [u32; 6] = [0, 1, 2, 3, u32::MAX - 1, u32::MAX];

/// An entry of these words, with a CRC that fits or one that does not.
fn entry(sequence: u32, state: u32, fits: bool) -> [u8; 32] {
    let mut bytes = Entry::new(sequence, ImageState::from_word(state)).to_bytes();
    if !fits {
        bytes[28] ^= 0x10;
    }
    bytes
}

/// Every pair of entries, in the order of the recorded answers: sequence numbers, then CRCs, then states.
fn pairs() -> impl Iterator<Item = [[u8; 32]; 2]> {
    let numbers = SEQUENCES.map(|first| SEQUENCES.map(|second| (first, second)));
    numbers.into_iter().flatten().flat_map(|(first, second)| {
        (0..4 * 49).map(move |index| {
            let (crc, states) = (index / 49, index % 49);
            [
                entry(first, STATES[states / 7], crc & 2 == 0),
                entry(second, STATES[states % 7], crc & 1 == 0),
            ]
        })
    })
}

fn otadata(pair: [[u8; 32]; 2], slots: u8) -> Otadata {
    Otadata::new(pair.map(Entry::from_bytes), Slots::new(slots).unwrap())
}

#[test]
fn all_states_are_decided_as_a_bootloader_does() {
    let mut count = 0;
    for slots in [1, 2, 3, 16] {
        for pair in pairs() {
            count += 1;
            let otadata = otadata(pair, slots);
            let about = format!("{slots} slots, {pair:x?}");

            let (index, initial) = loader::plain([&pair[0], &pair[1]], slots.into());
            let selection = otadata.select(Bootloader::Plain);
            assert_eq!(selection.slot.map_or(-1, i32::from), index, "{about}");
            assert_eq!(selection.initial, initial, "{about}");
            assert_eq!(selection.writes, [None; 2], "{about}");
            let tries: Vec<usize> = selection.tries(otadata.slots()).map(usize::from).collect();
            assert_eq!(tries, loader::order(index, slots.into()), "{about}");

            let (index, initial, after) = loader::rolls_back(pair, slots.into());
            let selection = otadata.select(Bootloader::RollsBack);
            assert_eq!(selection.slot.map_or(-1, i32::from), index, "{about}");
            assert_eq!(selection.initial, initial, "{about}");
            let mut written = pair;
            for (entry, state) in written.iter_mut().zip(selection.writes) {
                if let Some(state) = state {
                    entry[24..28].copy_from_slice(&state.word().to_le_bytes());
                }
            }
            assert_eq!(written, after, "{about}");
        }
    }
    assert_eq!(count, 4 * 36 * 4 * 49);
}

#[test]
fn what_this_crate_writes_means_the_same_to_both_kinds_of_bootloader() {
    let ours = [
        ImageState::Valid,
        ImageState::Aborted,
        ImageState::Undefined,
    ];
    for first in ours {
        for second in ours {
            let pair = [Entry::new(1, first), Entry::new(2, second)];
            let otadata = Otadata::new(pair, Slots::TWO);
            let plain = otadata.select(Bootloader::Plain);
            assert_eq!(plain, otadata.select(Bootloader::RollsBack));
        }
    }
}

#[test]
fn decisions_only_clear_bits() {
    let undefined = ImageState::Undefined.word();
    for state in [ImageState::Valid, ImageState::Aborted] {
        assert_eq!(undefined & state.word(), state.word());
    }
    for word in [0, 1, 2, 3, 4, 5, 6, u32::MAX] {
        assert_eq!(ImageState::from_word(word).word(), word);
    }
}

/// What the ESP32-C3 bootloader of espflash answered under an emulator: `tests/oracle/bootloader.py`.
const ANSWERS: &str = include_str!("../oracle/answers.txt");

#[test]
fn a_shipped_bootloader_decides_the_same() {
    let mut lines = ANSWERS.lines().filter(|line| !line.starts_with('#'));
    let mut count = 0;
    for slots in [2, 3] {
        let mut line = "";
        for (index, pair) in pairs().enumerate() {
            if index % 49 == 0 {
                line = lines
                    .next()
                    .expect("a line for each pair of sequence numbers and CRCs");
                let [first, second] = pair.map(|entry| Entry::from_bytes(entry).sequence());
                let [fits, other_fits] = pair.map(|entry| Entry::from_bytes(entry).is_intact());
                let mark = |fits: bool| if fits { '+' } else { 'x' };
                let (mark, other) = (mark(fits), mark(other_fits));
                let head = format!("{slots} {first:08x} {second:08x} {mark}{other} ");
                line = line.strip_prefix(&head).expect(&head);
                assert_eq!(line.len(), 49);
            }
            let selection = otadata(pair, slots).select(Bootloader::Plain);
            let ours = match (selection.slot, selection.initial) {
                (Some(0), true) => "i".to_owned(),
                (Some(slot), false) => slot.to_string(),
                (None, false) => "-".to_owned(),
                other => panic!("{other:?}"),
            };
            let theirs = &line[index % 49..=index % 49];
            assert_eq!(ours, theirs, "{slots} slots, {pair:x?}");
            count += 1;
        }
    }
    assert_eq!(lines.next(), None);
    assert_eq!(count, 2 * 36 * 4 * 49);
}
