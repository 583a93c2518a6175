//! The rules that keep every point between two operations safe, one by one.

use crawler_boot::flash::Operation;
use crawler_boot::otadata::{
    Counter, Entry, Goal, ImageState, Otadata, PlanError, Slots, Standing,
};
use crawler_boot::trailer::{Begin, Record, Trailer};
use crawler_boot::trial::Sensors;

use crate::chip::{Chip, SECTOR};

const VALID: ImageState = ImageState::Valid;
const UNDEFINED: ImageState = ImageState::Undefined;
const STATE_AT: u32 = 24;
const CRC_AT: u32 = 28;

fn otadata(first: Entry, second: Entry) -> Otadata {
    Otadata::new([first, second], Slots::TWO)
}

/// Address and first word of an operation; no word for an erase.
fn told(operation: Operation) -> (u32, Option<u32>) {
    match operation {
        Operation::Erase { at } => (at, None),
        Operation::Program { at, bytes } => {
            let word = bytes.as_bytes()[..4].try_into().unwrap();
            (at, Some(u32::from_le_bytes(word)))
        }
    }
}

/// All operations on the way to a goal, and the entries then.
fn all(first: Entry, second: Entry, goal: Goal) -> (Vec<(u32, Option<u32>)>, Otadata) {
    let mut chip = Chip::new();
    chip.bytes[..32].copy_from_slice(&first.to_bytes());
    chip.bytes[SECTOR..SECTOR + 32].copy_from_slice(&second.to_bytes());
    let mut done = Vec::new();
    loop {
        let present = Otadata::read(&mut chip, 0, Slots::TWO).unwrap();
        let Some(operation) = present.toward(goal).unwrap() else {
            return (done, present);
        };
        done.push(told(operation));
        operation.execute(&mut chip, 0).unwrap();
        assert!(done.len() < 12, "{done:x?}");
    }
}

const ACTIVATE: Goal = Goal::Activate {
    slot: 1,
    running: 0,
};

#[test]
fn an_entry_is_written_from_its_sequence_number_to_its_crc() {
    let second = SECTOR as u32;
    let crc = 0x55F6_3774;
    let (done, _) = all(Entry::new(1, VALID), Entry::ERASED, ACTIVATE);
    assert_eq!(done, [(second, Some(2)), (second + CRC_AT, Some(crc))]);
    let (done, _) = all(Entry::ERASED, Entry::ERASED, Goal::Keep { running: 1 });
    assert_eq!(
        done,
        [(0, Some(2)), (STATE_AT, Some(2)), (CRC_AT, Some(crc))]
    );
}

#[test]
fn an_entry_on_trial_is_given_up_before_its_sector_is_erased() {
    let (done, _) = all(Entry::new(3, VALID), Entry::new(2, UNDEFINED), ACTIVATE);
    let second = SECTOR as u32;
    assert_eq!(done[..2], [(second + STATE_AT, Some(4)), (second, None)]);
}

#[test]
fn an_activation_that_was_counted_or_lacks_a_proven_entry_is_no_activation() {
    let fresh = otadata(Entry::new(1, VALID), Entry::new(2, UNDEFINED));
    assert_eq!(fresh.toward(ACTIVATE), Ok(None));
    let mut counted = Entry::new(2, UNDEFINED).to_bytes();
    counted[4] = 0xFE;
    for (first, second) in [
        (Entry::new(1, VALID), Entry::from_bytes(counted)),
        (Entry::new(1, UNDEFINED), Entry::new(2, UNDEFINED)),
        (Entry::ERASED, Entry::new(2, UNDEFINED)),
    ] {
        let (done, after) = all(first, second, ACTIVATE);
        assert!(!done.is_empty());
        let Standing::OnTrial(counts) = after.standing(1) else {
            panic!("{after:x?}");
        };
        assert!(counts.way_back && counts.attempts == 0);
        let proof = after.entries().iter().find(|entry| entry.state() == VALID);
        assert!(proof.is_some_and(|entry| entry.is_usable() && entry.sequence() % 2 == 1));
    }
}

#[test]
fn what_is_kept_is_proven_afterwards() {
    let keep = Goal::Keep { running: 0 };
    for first in [UNDEFINED, VALID, ImageState::Aborted] {
        let (_, after) = all(Entry::new(1, first), Entry::new(2, VALID), keep);
        assert_eq!(after.standing(0), Standing::Proven);
        assert_eq!(after.toward(keep), Ok(None));
    }
}

#[test]
fn without_a_way_back_nothing_is_given_up() {
    let give_up = Goal::GiveUp { running: 1 };
    for other in [
        Entry::ERASED,
        Entry::new(1, ImageState::Aborted),
        Entry::new(4, VALID),
    ] {
        let alone = otadata(other, Entry::new(6, UNDEFINED));
        assert_eq!(alone.toward(give_up), Err(PlanError::NoWayBack));
        let standing = alone.standing(1);
        assert!(matches!(standing, Standing::OnTrial(counts) if !counts.way_back));
    }
    let two = otadata(Entry::new(1, VALID), Entry::new(2, UNDEFINED));
    assert!(matches!(two.standing(1), Standing::OnTrial(counts) if counts.way_back));
    let proven = otadata(Entry::new(1, VALID), Entry::new(2, VALID));
    assert_eq!(proven.toward(give_up), Err(PlanError::Proven));
}

#[test]
fn a_program_that_runs_for_lack_of_another_is_proven_only_if_an_entry_says_so() {
    let returned = otadata(Entry::new(1, VALID), Entry::new(2, UNDEFINED));
    assert_eq!(returned.standing(0), Standing::Returned);
    let unknown = otadata(Entry::new(1, UNDEFINED), Entry::new(2, VALID));
    let standing = unknown.standing(0);
    assert!(matches!(standing, Standing::OnTrial(counts) if !counts.way_back));
}

#[test]
fn only_giving_up_leaves_a_state_that_says_so() {
    let states = [
        (0xFFFF_FFFD, true),
        (5, true),
        (0xFFFF_0004, true),
        (u32::MAX, false),
        (0xFFFF_FFFB, false),
        (0xFFFF_FFF2, false),
        (6, false),
        (0, false),
        (1, false),
    ];
    for (word, expected) in states {
        let torn = Entry::new(2, ImageState::from_word(word));
        let standing = otadata(Entry::new(1, VALID), torn).standing(1);
        let Standing::OnTrial(counts) = standing else {
            panic!("{word:x}: {standing:?}");
        };
        assert_eq!(counts.giving_up, expected, "{word:x}");
    }
}

#[test]
fn the_last_sequence_numbers_are_refused_not_wrapped() {
    let last = otadata(Entry::new(u32::MAX - 2, VALID), Entry::ERASED);
    let running = 0;
    assert_eq!(last.toward(Goal::Keep { running }), Ok(None));
    let (done, _) = all(Entry::new(u32::MAX - 2, VALID), Entry::ERASED, ACTIVATE);
    assert_eq!(done[0].1, Some(u32::MAX - 1));
    let over = otadata(Entry::new(u32::MAX - 1, VALID), Entry::ERASED);
    let back = Goal::Activate {
        slot: 0,
        running: 1,
    };
    assert_eq!(over.toward(back), Err(PlanError::Exhausted));
}

#[test]
fn counts_are_bits_of_their_own_words() {
    let mut chip = Chip::new();
    chip.bytes[..32].copy_from_slice(&Entry::new(1, VALID).to_bytes());
    chip.bytes[SECTOR..SECTOR + 32].copy_from_slice(&Entry::new(2, UNDEFINED).to_bytes());
    for counted in 1..=32 {
        for counter in [Counter::Attempts, Counter::Restarts] {
            let present = Otadata::read(&mut chip, 0, Slots::TWO).unwrap();
            assert_eq!(present.count(0, counter), None);
            let operation = present.count(1, counter).unwrap();
            operation.execute(&mut chip, 0).unwrap();
        }
        let present = Otadata::read(&mut chip, 0, Slots::TWO).unwrap();
        for counter in [Counter::Attempts, Counter::Restarts] {
            assert_eq!(present.entries()[1].count(counter), counted);
        }
    }
    let full = Otadata::read(&mut chip, 0, Slots::TWO).unwrap();
    assert_eq!(full.count(1, Counter::Attempts), None);
}

/// A sector with this envelope, and these words after it.
fn journal(envelope: &[u8], words: &[u32]) -> Vec<u8> {
    let mut bytes = vec![0xFF; SECTOR];
    for operation in Begin::new(envelope).unwrap().skip(1) {
        let Operation::Program { at, bytes: chunk } = operation else {
            panic!("{operation:?}");
        };
        let chunk = chunk.as_bytes();
        bytes[at as usize..at as usize + chunk.len()].copy_from_slice(chunk);
    }
    for (place, word) in bytes[1_036..].chunks_exact_mut(4).zip(words) {
        place.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

#[test]
fn an_envelope_with_any_bit_wrong_is_none() {
    let envelope = b"signed bytes";
    let whole = journal(envelope, &[]);
    assert_eq!(Trailer::of(&whole).envelope(), Some(12));
    for bit in 0..8 * (12 + envelope.len()) {
        let mut wrong = whole.clone();
        wrong[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(Trailer::of(&wrong), Trailer::EMPTY, "bit {bit}");
    }
}

#[test]
fn a_torn_record_is_left_out_whichever_bits_are_missing() {
    let empty = Trailer::of(&journal(b"e", &[]));
    let records = [
        Record::Block(0),
        Record::Block(0x5A),
        Record::Staged(Sensors::RANGER),
        Record::Activated,
        Record::Confirmed,
    ];
    for record in records {
        let (_, word) = told(empty.append(record).unwrap().unwrap());
        let word = word.unwrap();
        assert!(Trailer::of(&journal(b"e", &[word])).says(record));
        // Half of the bits of a record are to fall: any of them may be missing.
        let falling: Vec<u32> = (0..32).filter(|bit| word >> bit & 1 == 0).collect();
        assert_eq!(falling.len(), 16);
        for missing in 1..1_u32 << falling.len() {
            let bits = falling.iter().enumerate();
            let torn = bits.fold(word, |torn, (index, bit)| {
                torn | (missing >> index & 1) << bit
            });
            let after = Trailer::of(&journal_tail(torn));
            assert!(after.blocks() == 0 && after.staged().is_none() && after.outcome().is_none());
        }
    }
}

/// As [`journal`], cut off after the first record: what is missing counts as blank.
fn journal_tail(word: u32) -> Vec<u8> {
    let mut bytes = journal(b"e", &[word]);
    bytes.truncate(1_040);
    bytes
}
