//! Fuzz targets of what a robot finds in flash when it starts. The fuzzer and the replay of their corpus in
//! the tests of `crawler-boot` include this file.

use crawler_boot::RollbackReason;
use crawler_boot::flash::{Operation, SECTOR};
use crawler_boot::otadata::{Bootloader, Counter, Entry, Goal, Otadata, Slots, Standing};
use crawler_boot::trailer::{ENVELOPE_MAX, Record, Scanner, Trailer};
use crawler_boot::trial::Sensors;

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 2] = [("boot_otadata", otadata), ("boot_trailer", trailer)];

/// Does an operation on bytes that stand for flash.
fn execute(flash: &mut [u8], operation: Operation) {
    match operation {
        Operation::Erase { at } => flash[at as usize..][..SECTOR as usize].fill(0xFF),
        Operation::Program { at, bytes } => {
            let bytes = bytes.as_bytes();
            for (old, new) in flash[at as usize..][..bytes.len()].iter_mut().zip(bytes) {
                assert_eq!(*old & new, *new, "a bit would have to rise");
                *old = *new;
            }
        }
    }
}

fn entries(flash: &[u8], slots: Slots) -> Otadata {
    let entry = |at: usize| flash[at..at + Entry::BYTES].try_into().expect("an entry");
    let entries = [entry(0), entry(SECTOR as usize)];
    Otadata::new(entries.map(Entry::from_bytes), slots)
}

/// Three bytes say what is wanted, the rest are both entries. Whatever they hold, a goal is reached in a few
/// operations or refused before the first one, and then it is reached.
fn otadata(data: &[u8]) {
    let mut data = data.iter().copied();
    let mut next = || data.next();
    let (Some(count), Some(running), Some(kind)) = (next(), next(), next()) else {
        return;
    };
    let slots = Slots::new(1 + count % 4).expect("1 to 4 slots");
    let (running, slot) = (running & 0xF, running >> 4);
    let mut flash = vec![0xFF; 2 * SECTOR as usize];
    for at in (0..Entry::BYTES).chain(SECTOR as usize..SECTOR as usize + Entry::BYTES) {
        flash[at] = next().unwrap_or(0xFF);
    }
    // A CRC that fits is hard to guess.
    for (flag, at) in [(0x40, 0), (0x80, SECTOR as usize)] {
        if kind & flag != 0 {
            let sequence = flash[at..at + 4].try_into().expect("a word");
            let crc = crawler_boot::crc32_le(u32::MAX, &flash[at..at + 4]);
            assert_eq!(
                entries(&flash, slots).entries()[usize::from(at > 0)].sequence(),
                u32::from_le_bytes(sequence)
            );
            flash[at + 28..at + 32].copy_from_slice(&crc.to_le_bytes());
        }
    }
    let present = entries(&flash, slots);
    for bootloader in [Bootloader::Plain, Bootloader::RollsBack] {
        let selection = present.select(bootloader);
        let mut tries: Vec<u8> = selection.tries(slots).collect();
        tries.sort_unstable();
        assert!(tries.iter().copied().eq(0..slots.count()), "each slot once");
    }
    for counter in [Counter::Attempts, Counter::Restarts] {
        if let Some(operation) = present.count(running, counter) {
            let mut flash = flash.clone();
            execute(&mut flash, operation);
            let before = present.standing(running);
            let after = entries(&flash, slots).standing(running);
            let counts = |standing| match standing {
                Standing::OnTrial(counts) => counts.attempts + counts.restarts,
                Standing::Proven | Standing::Returned => panic!("not on trial"),
            };
            assert_eq!(counts(before) + 1, counts(after));
        }
    }
    let goal = match kind % 4 {
        0 => Goal::Activate { slot, running },
        1 => Goal::Confirm { running },
        2 => Goal::GiveUp { running },
        _ => Goal::Keep { running },
    };
    let mut erased = [0; 2];
    for _ in 0..12 {
        match entries(&flash, slots).toward(goal) {
            Err(_) => return,
            Ok(Some(operation)) => {
                if let Operation::Erase { at } = operation {
                    erased[usize::from(at > 0)] += 1;
                }
                execute(&mut flash, operation);
            }
            Ok(None) => {
                assert!(erased.iter().all(|&times| times <= 1), "an erase too many");
                reached(&entries(&flash, slots), goal);
                return;
            }
        }
    }
    panic!("{goal:?} is not reached");
}

fn reached(otadata: &Otadata, goal: Goal) {
    let selected = otadata.select(Bootloader::Plain);
    match goal {
        Goal::Activate { slot, .. } => {
            assert_eq!(selected.slot, Some(slot));
            let Standing::OnTrial(counts) = otadata.standing(slot) else {
                panic!("not on trial");
            };
            assert!(counts.way_back && counts.attempts == 0 && counts.restarts == 0);
        }
        Goal::Confirm { running } | Goal::Keep { running } => {
            assert_eq!(selected.slot, Some(running));
            assert_eq!(otadata.standing(running), Standing::Proven);
        }
        Goal::GiveUp { running } => {
            let given_up = selected.entry.is_none() || selected.slot != Some(running);
            assert!(given_up);
        }
    }
}

/// Whatever a sector holds is a state, however it is read; and what is appended is there afterwards.
fn trailer(data: &[u8]) {
    let mut flash = data.to_vec();
    // A CRC that fits is hard to guess: an odd last byte asks for one.
    if flash.len() >= 12 && flash.last().is_some_and(|last| last % 2 == 1) {
        let length = usize::from(u16::from_le_bytes([flash[4], flash[5]]));
        if let Some(envelope) = flash.get(12..12 + length) {
            let crc = crawler_boot::crc32_le(0, envelope);
            flash[8..12].copy_from_slice(&crc.to_le_bytes());
        }
    }
    let found = Trailer::of(&flash);
    let mut scanner = Scanner::new();
    for piece in flash.chunks(7) {
        scanner.feed(piece);
    }
    assert_eq!(scanner.finish(), found);
    assert!(
        found
            .envelope()
            .is_none_or(|length| (1..=ENVELOPE_MAX).contains(&usize::from(length)))
    );
    flash.resize(SECTOR as usize, 0xFF);
    let records = [
        Record::Block(data.len() as u8),
        Record::Staged(Sensors::from_bits(data.len() as u8)),
        Record::Activated,
        Record::RolledBack(RollbackReason::NoLink),
        Record::Confirmed,
    ];
    for record in records {
        let present = Trailer::of(&flash);
        match present.append(record) {
            Ok(Some(operation)) => {
                assert!(!present.says(record));
                execute(&mut flash, operation);
            }
            Ok(None) => assert!(present.says(record)),
            Err(_) => continue,
        }
        let now = Trailer::of(&flash);
        assert!(now.says(record) && now.envelope() == present.envelope());
    }
}
