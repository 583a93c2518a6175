//! Which slot starts, from flash as a launcher and updates leave it.

use std::convert::Infallible;

use crawler_boot::otadata::{Bootloader, Goal, Otadata, Slots};
use crawler_image_format::elf::{self, ElfError};
use crawler_image_format::factory;
use crawler_image_format::header::Header;
use crawler_image_format::layout::{
    BANK, ERASE_BLOCK, FLASHED, Group, OTADATA, PROGRAM_MAX, SLOT_BYTES, SLOTS,
};
use crawler_image_format::start;
use embedded_storage::nor_flash::{ErrorType, MultiwriteNorFlash, NorFlash, ReadNorFlash};

/// The second bank, with the rules of its chips.
struct Bank(Vec<u8>);

impl Bank {
    /// As a file of zeros, which is what an emulator begins with.
    fn new() -> Self {
        Self(vec![0; BANK as usize])
    }

    fn flashed(image: &[u8]) -> Self {
        let mut bank = Self::new();
        bank.flash(image);
        bank
    }

    fn flash(&mut self, image: &[u8]) {
        for (offset, bytes) in factory::writes(image) {
            self.0[offset as usize..][..bytes.len()].copy_from_slice(&bytes);
        }
    }

    fn receive(&mut self, slot: u8, image: &[u8]) {
        let start = SLOTS[usize::from(slot)];
        self.erase(start, start + SLOT_BYTES).expect("erased");
        self.write(start, image).expect("written");
    }

    fn load(&mut self) -> Option<(u8, Vec<u8>)> {
        let mut memory = vec![0xAA; PROGRAM_MAX as usize];
        let slot = start::load(self, &mut memory)?;
        Some((slot, memory))
    }

    fn starts(&mut self) -> Option<u8> {
        self.load().map(|(slot, _)| slot)
    }

    fn reach(&mut self, goal: Goal) -> Otadata {
        Otadata::reach(self, OTADATA, Slots::TWO, goal).expect("a way")
    }
}

impl ErrorType for Bank {
    type Error = Infallible;
}

impl ReadNorFlash for Bank {
    const READ_SIZE: usize = 1;

    fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        for piece in Group::pieces(at, bytes.len()).expect("in the slots") {
            let part = &mut bytes[piece.from..piece.to];
            let length = part.len();
            part.copy_from_slice(&self.0[piece.offset as usize..][..length]);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        BANK as usize
    }
}

impl NorFlash for Bank {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4_096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
        for piece in Group::pieces(from, (to - from) as usize).expect("in the slots") {
            let block = (piece.offset - piece.offset % ERASE_BLOCK) as usize;
            self.0[block..block + ERASE_BLOCK as usize].fill(0xFF);
        }
        Ok(())
    }

    fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), Infallible> {
        for piece in Group::pieces(at, bytes.len()).expect("in the slots") {
            let kept = &mut self.0[piece.offset as usize..];
            for (kept, byte) in kept.iter_mut().zip(&bytes[piece.from..piece.to]) {
                *kept &= byte;
            }
        }
        Ok(())
    }
}

impl MultiwriteNorFlash for Bank {}

/// An image whose program is `length` bytes that depend on `seed`.
fn image(seed: u32, length: usize) -> Vec<u8> {
    let mut state = seed;
    let program: Vec<u8> = std::iter::repeat_with(|| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    })
    .take(length)
    .collect();
    let header = Header::of(&program).expect("a size that fits");
    [&header.to_bytes()[..], &program].concat()
}

#[test]
fn a_bank_that_was_flashed_starts_slot_0() {
    let image = image(1, 600_000);
    let (slot, memory) = Bank::flashed(&image).load().expect("a program");
    assert_eq!(slot, 0);
    assert_eq!(memory[..600_000], image[Header::BYTES..]);
    // Nothing beyond the program is touched.
    assert!(memory[600_000..].iter().all(|byte| *byte == 0xAA));
}

#[test]
fn without_a_program_nothing_starts() {
    assert_eq!(Bank::new().load(), None);
    assert_eq!(Bank(vec![0xFF; BANK as usize]).load(), None);
}

#[test]
fn an_update_starts_when_it_is_activated_and_the_other_when_it_is_given_up() {
    let mut bank = Bank::flashed(&image(1, 5_000));
    bank.reach(Goal::Keep { running: 0 });
    bank.receive(1, &image(2, 700));
    assert_eq!(bank.starts(), Some(0));
    bank.reach(Goal::Activate {
        slot: 1,
        running: 0,
    });
    assert_eq!(bank.starts(), Some(1));
    bank.reach(Goal::GiveUp { running: 1 });
    assert_eq!(bank.starts(), Some(0));
}

#[test]
fn a_bad_program_is_passed_over_whichever_slot_it_is_in() {
    for (bad, expected) in [(0, 1), (1, 0)] {
        let mut bank = Bank::flashed(&image(1, 70_000));
        bank.receive(1, &image(2, 70_000));
        bank.reach(Goal::Keep { running: bad });
        assert_eq!(bank.starts(), Some(bad));
        // One bit, beyond the first erase block.
        let at = SLOTS[usize::from(bad)] + 69_000;
        let byte = Group::of(at).expect("in a slot").offset(at);
        bank.0[byte as usize] ^= 4;
        assert_eq!(bank.starts(), Some(expected));
        let other = SLOTS[usize::from(expected)];
        bank.erase(other, other + 4_096).expect("erased");
        assert_eq!(bank.starts(), None);
    }
}

#[test]
fn flashing_anew_undoes_updates_and_keeps_parameters() {
    let mut bank = Bank::flashed(&image(1, 100));
    bank.0[100] = 42;
    bank.receive(1, &image(2, 100));
    bank.reach(Goal::Keep { running: 0 });
    bank.reach(Goal::Activate {
        slot: 1,
        running: 0,
    });
    let newer = image(3, 50);
    assert!(bank.0[FLASHED as usize..].starts_with(&factory::mark(&image(1, 100))));
    bank.flash(&newer);
    assert!(bank.0[FLASHED as usize..].starts_with(&factory::mark(&newer)));
    let (slot, memory) = bank.load().expect("a program");
    assert_eq!((slot, &memory[..50]), (0, &newer[Header::BYTES..]));
    assert_eq!(bank.0[100], 42);
    let otadata = Otadata::read(&mut bank, OTADATA, Slots::TWO).expect("read");
    assert!(otadata.select(Bootloader::Plain).initial);
}

#[test]
fn a_program_knows_its_slot_only_from_the_boot_stage() {
    for slot in [0, 1] {
        assert_eq!(start::told(start::tell(slot)), Some(slot));
    }
    // What QEMU tells a program that it starts itself, and others.
    for other in [0, 1, 0x1028, start::tell(0) + 2, usize::MAX] {
        assert_eq!(start::told(other), None);
    }
}

#[test]
fn a_file_that_is_no_program_makes_no_image() {
    assert_eq!(elf::image(b"#!/bin/sh"), Err(ElfError::NotElf));
    assert_eq!(elf::boot_stage(b"#!/bin/sh"), Err(ElfError::NotElf));
}
