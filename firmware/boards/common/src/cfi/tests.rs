//! The driver against chips that mind their commands.

use core::cell::Cell;
use std::collections::HashMap;
use std::vec::Vec;

use crawler_boot::flash::SECTOR;
use crawler_image_format::layout::{END, GROUP, Group, OTADATA, SLOT_BYTES, SLOTS};
use embassy_futures::{block_on, poll_once};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;
use proptest::prelude::*;

use super::*;
use crate::EmbassyClock;
use core::pin::pin;

const BLOCKS: u16 = 2;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Array,
    Query,
    Status,
    Program,
    Erase,
    /// A buffer is asked for; wants so many words; wants its confirmation.
    Asked,
    Filling(u32),
    Filled,
}

/// What is wrong with the chips.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Wrong {
    #[default]
    Nothing,
    /// Another sort of chip, or none.
    Identity,
    BlockSize,
    /// One of the two chips fails at whatever it is told.
    OneRefuses,
    NeverReady,
    /// A cell that cannot be cleared.
    BadCell,
}

struct FakeChips {
    words: HashMap<u32, u32>,
    mode: Mode,
    status: u32,
    wrong: Wrong,
    /// Looks until the chips are ready.
    busy: Cell<u32>,
    /// Words that wait in the buffer.
    buffer: Vec<(u32, u32)>,
    /// Commands that changed something.
    commands: u32,
}

impl FakeChips {
    fn new(wrong: Wrong) -> Self {
        Self {
            words: HashMap::new(),
            mode: Mode::Array,
            status: READY,
            wrong,
            busy: Cell::new(0),
            buffer: Vec::new(),
            commands: 0,
        }
    }

    fn program(&mut self, offset: u32, word: u32) {
        let kept = self.words.entry(offset).or_insert(ERASED);
        // As the emulator has it, which is less than a chip does: bits can rise.
        *kept = word;
        if self.wrong == Wrong::BadCell {
            *kept |= 1;
        }
    }

    fn done(&mut self) {
        self.commands += 1;
        self.mode = Mode::Status;
        self.busy.set(3);
        if self.wrong == Wrong::OneRefuses {
            self.status |= 0x0010_0000;
        }
    }
}

impl Bus for &mut FakeChips {
    fn read(&self, offset: u32) -> u32 {
        assert!(offset.is_multiple_of(WORD));
        match self.mode {
            Mode::Array => *self.words.get(&offset).unwrap_or(&ERASED),
            Mode::Query => both(match offset / WORD {
                0x10 if self.wrong == Wrong::Identity => 0,
                0x10 => b'Q'.into(),
                0x11 => b'R'.into(),
                0x12 => b'Y'.into(),
                0x27 => 24,
                // 1 KiB in each chip.
                0x2A => 10,
                0x2C => 1,
                0x30 if self.wrong == Wrong::BlockSize => 1,
                0x30 => 2,
                _ => 0,
            }),
            Mode::Status => {
                let busy = self.busy.get();
                self.busy.set(busy.saturating_sub(1));
                if busy > 0 || self.wrong == Wrong::NeverReady {
                    // One of the two is slower.
                    0x0000_0080
                } else {
                    self.status
                }
            }
            Mode::Asked => READY,
            Mode::Program | Mode::Erase | Mode::Filling(_) | Mode::Filled => {
                panic!("read in the middle of a command")
            }
        }
    }

    fn write(&mut self, offset: u32, word: u32) {
        assert!(offset.is_multiple_of(WORD));
        match self.mode {
            Mode::Program => {
                self.program(offset, word);
                self.done();
            }
            Mode::Asked => {
                assert_eq!(word, both(word & 0xFFFF), "one count for both chips");
                self.mode = Mode::Filling((word & 0xFFFF) + 1);
            }
            Mode::Filling(left) => {
                let first = self.buffer.first().map_or(offset, |(first, _)| *first);
                assert_eq!(first / BUFFER, offset / BUFFER, "beyond the buffer");
                self.buffer.push((offset, word));
                self.mode = if left > 1 {
                    Mode::Filling(left - 1)
                } else {
                    Mode::Filled
                };
            }
            Mode::Filled => {
                assert_eq!(word, CONFIRM);
                for (offset, word) in core::mem::take(&mut self.buffer) {
                    self.program(offset, word);
                }
                self.done();
            }
            Mode::Erase => {
                assert_eq!(word, CONFIRM);
                let block = offset / ERASE_BLOCK;
                self.words.retain(|at, _| at / ERASE_BLOCK != block);
                self.done();
            }
            _ => match word {
                READ_ARRAY => self.mode = Mode::Array,
                QUERY => self.mode = Mode::Query,
                READ_STATUS => self.mode = Mode::Status,
                CLEAR_STATUS => self.status = READY,
                PROGRAM => self.mode = Mode::Program,
                ERASE => self.mode = Mode::Erase,
                WRITE_BUFFER => self.mode = Mode::Asked,
                other => panic!("no such command: {other:#x}"),
            },
        }
    }
}

/// Regions take turns on these.
type Shared<'c> = SharedChips<NoopRawMutex, &'c mut FakeChips, EmbassyClock>;

fn shared(chips: &mut FakeChips) -> Shared<'_> {
    Mutex::new(Chips::new(chips, EmbassyClock))
}

const fn region<'a, 'c>(
    chips: &'a Shared<'c>,
) -> CfiFlash<'a, NoopRawMutex, &'c mut FakeChips, EmbassyClock> {
    CfiFlash::new(chips, 0, BLOCKS)
}

#[test]
fn what_is_written_is_read_from_any_offset_until_it_is_erased() {
    for probed in [false, true] {
        let mut fake = FakeChips::new(Wrong::Nothing);
        let chips = shared(&mut fake);
        let mut flash = region(&chips);
        block_on(async {
            if probed {
                assert_eq!(flash.probe().await, Ok(()));
            }
            flash.write(8, b"terracrawler").await.expect("erased");
            let mut back = [0; 7];
            flash.read(11, &mut back).await.expect("in bounds");
            assert_eq!(&back, b"racrawl");
            assert_eq!(flash.write(12, b"else").await, Err(CfiError::NotErased));
            flash.erase(0, ERASE_BLOCK).await.expect("a block");
            flash.read(11, &mut back).await.expect("in bounds");
            assert_eq!(back, [0xFF; 7]);
        });
        drop(chips);
        assert_eq!(fake.mode, Mode::Array);
        // Three words and an erasure, or a buffer and an erasure.
        assert_eq!(fake.commands, if probed { 2 } else { 4 });
    }
}

#[test]
fn mistakes_of_the_caller_reach_no_chip() {
    let mut fake = FakeChips::new(Wrong::NeverReady);
    let chips = shared(&mut fake);
    let mut flash = region(&chips);
    let end = flash.len;
    block_on(async {
        assert_eq!(flash.write(2, &[0; 4]).await, Err(CfiError::Misaligned));
        assert_eq!(flash.write(4, &[0; 3]).await, Err(CfiError::Misaligned));
        assert_eq!(flash.write(end, &[0; 4]).await, Err(CfiError::OutOfBounds));
        assert_eq!(flash.erase(4, ERASE_BLOCK).await, Err(CfiError::Misaligned));
        assert_eq!(
            flash.erase(ERASE_BLOCK, 0).await,
            Err(CfiError::OutOfBounds)
        );
        assert_eq!(flash.erase(0, 2 * end).await, Err(CfiError::OutOfBounds));
        let mut byte = [0];
        assert_eq!(flash.read(end, &mut byte).await, Err(CfiError::OutOfBounds));
        assert_eq!(
            flash.read(u32::MAX, &mut byte).await,
            Err(CfiError::OutOfBounds)
        );
        let mut slots = SlotFlash::new(&chips);
        let start = SLOTS[0];
        for (from, to, error) in [
            (start + 4, start + SECTOR, CfiError::Misaligned),
            (start + SECTOR, start, CfiError::OutOfBounds),
            (start - SECTOR, start, CfiError::OutOfBounds),
            (OTADATA, END + SECTOR, CfiError::OutOfBounds),
        ] {
            assert_eq!(slots.erase(from, to).await, Err(error));
        }
        assert_eq!(
            slots.write(start + 2, &[0; 4]).await,
            Err(CfiError::Misaligned)
        );
        assert_eq!(slots.write(END, &[0; 4]).await, Err(CfiError::OutOfBounds));
        assert_eq!(slots.read(END, &mut byte).await, Err(CfiError::OutOfBounds));
    });
    drop(chips);
    assert_eq!(fake.commands, 0);
}

#[test]
fn chips_that_fail_say_how() {
    for (wrong, probed, written) in [
        (Wrong::Identity, Err(CfiError::Absent), Ok(())),
        (Wrong::BlockSize, Err(CfiError::Geometry), Ok(())),
        (
            Wrong::OneRefuses,
            Ok(()),
            Err(CfiError::Refused(0x0090_0080)),
        ),
        (Wrong::NeverReady, Ok(()), Err(CfiError::Stuck)),
        (Wrong::BadCell, Ok(()), Err(CfiError::Differs)),
    ] {
        for length in [4, 8] {
            let mut fake = FakeChips::new(wrong);
            let chips = shared(&mut fake);
            let mut flash = region(&chips);
            assert_eq!(block_on(flash.probe()), probed, "{wrong:?}");
            let outcome = block_on(flash.write(0, &[0; 8][..length]));
            assert_eq!(outcome, written, "{wrong:?}");
            drop(chips);
            assert_eq!(fake.mode, Mode::Array, "{wrong:?}: left readable");
        }
    }
}

#[test]
fn a_command_that_is_given_up_ends_before_the_next_one_of_anybody() {
    let mut fake = FakeChips::new(Wrong::Nothing);
    let chips = shared(&mut fake);
    let mut flash = region(&chips);
    let mut slots = SlotFlash::new(&chips);
    block_on(async {
        flash.probe().await.expect("chips");
        flash.write(0, b"kept").await.expect("erased");
        // While it waits for the chips.
        {
            let mut write = pin!(flash.write(8, b"a buffer"));
            let slow = chips.lock().await;
            assert!(
                poll_once(write.as_mut()).is_pending(),
                "somebody else has the chips"
            );
            drop(slow);
        }
        let mut back = [0; 4];
        slots.read(SLOTS[0], &mut back).await.expect("in bounds");
        flash.read(0, &mut back).await.expect("in bounds");
        assert_eq!(&back, b"kept");
        // In the middle of a command of its own.
        chips.lock().await.bus.wrong = Wrong::NeverReady;
        assert!(poll_once(pin!(slots.write(SLOTS[0], b"a buffer"))).is_pending());
        chips.lock().await.bus.wrong = Wrong::Nothing;
        flash.read(0, &mut back).await.expect("in bounds");
        assert_eq!(&back, b"kept");
    });
    drop(chips);
    assert_eq!(fake.mode, Mode::Array);
}

#[test]
fn bits_of_slots_are_cleared_one_after_the_other() {
    let mut fake = FakeChips::new(Wrong::Nothing);
    let chips = shared(&mut fake);
    let mut slots = SlotFlash::new(&chips);
    block_on(async {
        chips.lock().await.probe(END).expect("chips");
        for (written, expected) in [
            ([0xF0, 0xFF, 0xFF, 0xFF], [0xF0, 0xFF, 0xFF, 0xFF]),
            ([0x0F, 0xFF, 0xFF, 0x7F], [0x00, 0xFF, 0xFF, 0x7F]),
            ([0xFF; 4], [0x00, 0xFF, 0xFF, 0x7F]),
        ] {
            let both = [written, written].concat();
            slots.write(OTADATA + 8, &both).await.expect("bits fall");
            let mut back = [0; 8];
            slots.read(OTADATA + 8, &mut back).await.expect("there");
            assert_eq!(back[..], [expected, expected].concat());
        }
    });
}

#[test]
fn an_image_is_erased_from_its_front_and_nothing_else_with_it() {
    let mut fake = FakeChips::new(Wrong::Nothing);
    let chips = shared(&mut fake);
    let mut slots = SlotFlash::new(&chips);
    let (start, trailer) = (SLOTS[1], SLOTS[1] + SLOT_BYTES - SECTOR);
    block_on(async {
        chips.lock().await.probe(END).expect("chips");
        let full = [0; 3 * SECTOR as usize];
        for at in [start, start + GROUP, start + GROUP + SECTOR] {
            slots.write(at, &full[..8]).await.expect("erased");
        }
        for at in [trailer, OTADATA, OTADATA + SECTOR] {
            slots.write(at, b"kept").await.expect("erased");
        }
        let second = start + GROUP + SECTOR;
        assert_eq!(
            slots.erase(second, second + SECTOR).await,
            Err(CfiError::Shared)
        );
        for sector in (start..trailer).step_by(SECTOR as usize) {
            slots
                .erase(sector, sector + SECTOR)
                .await
                .expect("in order");
        }
        let mut back = [0; SECTOR as usize];
        for at in (start..trailer).step_by(SECTOR as usize) {
            slots.read(at, &mut back).await.expect("there");
            assert!(back.iter().all(|byte| *byte == 0xFF), "{at:#x}");
        }
        for at in [trailer, OTADATA, OTADATA + SECTOR] {
            slots.read(at, &mut back).await.expect("there");
            assert!(back.starts_with(b"kept\xFF"));
        }
    });
    drop(chips);
    // Six writes, and an erasure for each of the two groups that were not blank.
    assert_eq!(fake.commands, 8);
    assert_eq!(Group::of(start).expect("there").length, GROUP);
}

fn multiwrite<F: MultiwriteNorFlash>(_: &F) {}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]
    #[test]
    fn it_is_an_array_of_bytes(
        probed: bool,
        writes in prop::collection::vec(
            (0_u32..64, prop::collection::vec(any::<u8>(), 0..24)), 0..12),
    ) {
        let mut fake = FakeChips::new(Wrong::Nothing);
        let chips = shared(&mut fake);
        let mut flash = region(&chips);
        if probed {
            prop_assert_eq!(block_on(flash.probe()), Ok(()));
        }
        let mut expected = [0xFF_u8; 512];
        for (word, bytes) in writes {
            let (at, len) = (word * WORD, bytes.len() / 4 * 4);
            let before: Vec<u8> = expected[at as usize..at as usize + len].to_vec();
            let outcome = block_on(flash.write(at, &bytes[..len]));
            let mut fits = before.chunks(4).map(|old| old == [0xFF; 4]);
            // What one command writes is written or not.
            let fitting = match fits.position(|fits| !fits) {
                None => len,
                Some(_) if probed => 0,
                Some(words) => words * 4,
            };
            let expected_outcome = if fitting == len { Ok(()) } else { Err(CfiError::NotErased) };
            prop_assert_eq!(outcome, expected_outcome);
            expected[at as usize..at as usize + fitting].copy_from_slice(&bytes[..fitting]);
        }
        let mut kept = [0; 512];
        prop_assert_eq!(block_on(flash.read(0, &mut kept)), Ok(()));
        prop_assert_eq!(kept, expected);
    }

    #[test]
    fn slots_are_an_array_of_bytes_whose_bits_fall(
        writes in prop::collection::vec(
            (0_u32..40, prop::collection::vec(any::<u8>(), 0..24)), 0..12),
    ) {
        let mut fake = FakeChips::new(Wrong::Nothing);
        let chips = shared(&mut fake);
        let mut slots = SlotFlash::new(&chips);
        multiwrite(&slots);
        prop_assert_eq!(block_on(async { chips.lock().await.probe(END) }), Ok(()));
        // Across two groups.
        let base = SLOTS[0] + GROUP - 80;
        let mut expected = [0xFF_u8; 512];
        for (word, bytes) in writes {
            let (at, len) = (word * WORD, bytes.len() / 4 * 4);
            prop_assert_eq!(block_on(slots.write(base + at, &bytes[..len])), Ok(()));
            for (kept, byte) in expected[at as usize..].iter_mut().zip(&bytes[..len]) {
                *kept &= byte;
            }
        }
        let mut kept = [0; 512];
        prop_assert_eq!(block_on(slots.read(base, &mut kept)), Ok(()));
        prop_assert_eq!(kept, expected);
    }
}
