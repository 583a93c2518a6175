//! The power goes within every byte of every operation: the robot is never bricked, and nothing unproven
//! is taken for proven.

use std::collections::HashSet;

use crate::chip::{Asked, Chip, SECTOR, TRAILERS, Torn};
use crate::robot::{Nature, resume, settle, start, update};
use crawler_boot::otadata::{Entry, ImageState};
use crawler_boot::trailer::{ENVELOPE_MAX, Outcome, Trailer};
use crawler_hal::ResetCause;

/// A board as it was flashed: version 1 in this slot, and this in the first select entry.
fn flashed(slot: usize, entry: Entry) -> Chip {
    let mut chip = Chip::new();
    chip.images[slot] = Some(1);
    chip.truth.proven.insert(1);
    chip.bytes[..32].copy_from_slice(&entry.to_bytes());
    chip
}

/// The boards that updates begin on.
fn boards() -> [Chip; 3] {
    [
        // Never started.
        flashed(0, Entry::ERASED),
        // Started once: the bootloader writes an entry.
        flashed(0, Entry::new(1, ImageState::Valid)),
        // Only the second slot holds a program, and nothing says so.
        flashed(1, Entry::ERASED),
    ]
}

const UPDATES: [(Nature, usize); 10] = [
    (Nature::Good, 40),
    (Nature::Panics, 40),
    (Nature::Good, ENVELOPE_MAX),
    (Nature::Hangs, 39),
    (Nature::NoLink, 40),
    (Nature::Rots, 40),
    (Nature::CutOff(3), 40),
    (Nature::CutOff(9), 40),
    (Nature::Restarting, 40),
    (Nature::Good, 40),
];

/// Does all updates in a row, undisturbed. Calls `each` after each with what was done to the flash.
fn in_a_row(mut chip: Chip, mut each: impl FnMut(u32, Nature, &Chip)) {
    let (mut running, on_trial) = start(&mut chip, ResetCause::PowerOn).unwrap();
    assert!(!on_trial);
    for (version, (nature, length)) in (2..).zip(UPDATES) {
        let before = chip.images[usize::from(running)];
        let erased = chip.erases;
        chip.history = Some(Vec::new());
        let envelope: Vec<u8> = (0..length).map(|i| (i as u8).wrapping_mul(7)).collect();
        running = update(&mut chip, running, version, nature, &envelope).unwrap();
        let now = chip.images[usize::from(running)];
        let expected = if nature.is_good() {
            Some(version)
        } else {
            before
        };
        assert_eq!(now, expected, "{nature:?}");
        for (before, after) in erased.iter().zip(chip.erases) {
            assert!(after - before <= 1, "wear, {nature:?}");
        }
        each(version, nature, &chip);
        chip.history = None;
        assert_eq!(
            start(&mut chip, ResetCause::PowerOn).unwrap(),
            (running, false)
        );
    }
}

#[test]
fn updates_in_a_row_end_as_they_should_and_spare_the_flash() {
    for board in boards() {
        in_a_row(board, |version, nature, chip| {
            let spare = chip.images.iter().position(|&image| image == Some(version));
            let trailer = spare.map(|slot| Trailer::of(&chip.bytes[TRAILERS[slot] as usize..]));
            let outcome = trailer.and_then(|trailer| trailer.outcome());
            let code = match outcome {
                Some(Outcome::Confirmed) => "confirmed",
                Some(Outcome::RolledBack(reason)) => reason.code(),
                _ => "none",
            };
            let expected = match nature {
                Nature::Good | Nature::Restarting | Nature::CutOff(3) => "confirmed",
                Nature::CutOff(_) => "power_cycles",
                Nature::Panics => "panic",
                Nature::Hangs => "watchdog",
                Nature::NoLink => "no_link",
                // There is no image any more that would have an outcome.
                Nature::Rots => "none",
            };
            assert_eq!(code, expected, "{nature:?}");
        });
    }
}

/// What must hold after a cut, whatever was torn: it starts, and ends what was begun. For one in four, to
/// save time, the next update works as well.
fn survives(mut chip: Chip, version: u32, nature: Nature) {
    let goes_on = chip.fingerprint().is_multiple_of(4);
    let running = resume(&mut chip, version, nature).unwrap();
    let now = chip.images[usize::from(running)].unwrap();
    assert!(chip.truth.proven.contains(&now));
    // Started before it rots, it may prove itself.
    if nature != Nature::Rots {
        assert_eq!(now == version, nature.is_good(), "{nature:?}");
    }
    assert_eq!(
        start(&mut chip, ResetCause::PowerOn).unwrap(),
        (running, false)
    );
    if !goes_on {
        return;
    }
    let next = version + 1;
    let running = update(&mut chip, running, next, Nature::Good, b"next").unwrap();
    assert_eq!(chip.images[usize::from(running)], Some(next));
    assert_eq!(
        start(&mut chip, ResetCause::PowerOn).unwrap(),
        (running, false)
    );
}

#[test]
fn a_cut_within_any_byte_of_any_operation_is_survived() {
    let mut seen = HashSet::new();
    let mut cuts = 0_u64;
    for board in boards() {
        in_a_row(board, |version, nature, chip| {
            for (before, asked) in chip.history.as_ref().unwrap() {
                let (at, length) = match asked {
                    Asked::Erase(at) => (*at, SECTOR),
                    Asked::Program(at, bytes) => (*at, bytes.len()),
                };
                let touched = at..at + length;
                let mut torn_chip = before.clone();
                for torn in Torn::ALL {
                    // Cells fall together before they rise: there is one such cut, not one a byte.
                    let last = match torn {
                        Torn::Programmed(_) => 0,
                        Torn::InOrder(_) | Torn::Together(_) => length,
                    };
                    let mut latest = Vec::new();
                    for cut in 0..=last {
                        cuts += 1;
                        torn_chip.bytes[touched.clone()]
                            .copy_from_slice(&before.bytes[touched.clone()]);
                        torn_chip.tear(asked, cut, torn);
                        // The same contents need no second look; most of a sector is blank.
                        let contents = &torn_chip.bytes[touched.clone()];
                        if latest == contents {
                            continue;
                        }
                        latest = contents.to_vec();
                        if seen.insert((torn_chip.fingerprint(), nature)) {
                            survives(torn_chip.clone(), version, nature);
                        }
                    }
                }
            }
        });
    }
    assert!(
        cuts > 500_000 && seen.len() > 10_000,
        "{cuts} cuts, {} different",
        seen.len()
    );
}

/// Words of an entry that is being erased or programmed do not wait for each other.
#[test]
fn words_of_an_entry_may_be_torn_in_any_combination() {
    const MASKS: [u32; 6] = [0, 1, 2, 4, 0x5555_5555, u32::MAX];
    let mut combinations = 0;
    for board in boards() {
        in_a_row(board, |version, nature, chip| {
            for (before, asked) in chip.history.as_ref().unwrap() {
                let Asked::Erase(at) = *asked else { continue };
                if at >= 2 * SECTOR {
                    continue;
                }
                for choice in 0..12_usize.pow(4) {
                    let mut torn = before.clone();
                    for (power, offset) in [0, 4, 24, 28].into_iter().enumerate() {
                        let pick = choice / 12_usize.pow(power as u32) % 12;
                        let bytes = &mut torn.bytes[at + offset..at + offset + 4];
                        let old = u32::from_le_bytes(bytes.try_into().unwrap());
                        let new = if pick < 6 {
                            old | MASKS[pick]
                        } else {
                            old & !MASKS[pick - 6]
                        };
                        bytes.copy_from_slice(&new.to_le_bytes());
                    }
                    combinations += 1;
                    let mut torn = Chip {
                        history: None,
                        ..torn
                    };
                    let (running, on_trial) = start(&mut torn, ResetCause::PowerOn).unwrap();
                    if on_trial {
                        settle(&mut torn, running, nature).unwrap();
                    }
                    if choice % 97 == 0 {
                        survives(torn, version, nature);
                    }
                }
            }
        });
    }
    assert!(combinations > 100_000, "{combinations}");
}
