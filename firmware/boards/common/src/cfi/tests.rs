//! The driver against chips that mind their commands.

use core::cell::Cell;
use std::collections::HashMap;
use std::vec::Vec;

use embassy_futures::block_on;
use proptest::prelude::*;

use super::*;
use crate::EmbassyClock;

const BLOCKS: u16 = 2;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Array,
    Query,
    Status,
    Program,
    Erase,
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

struct Chips {
    words: HashMap<u32, u32>,
    mode: Mode,
    status: u32,
    wrong: Wrong,
    /// Looks until the chips are ready.
    busy: Cell<u32>,
}

impl Chips {
    fn new(wrong: Wrong) -> Self {
        Self {
            words: HashMap::new(),
            mode: Mode::Array,
            status: READY,
            wrong,
            busy: Cell::new(0),
        }
    }

    fn done(&mut self) {
        self.mode = Mode::Status;
        self.busy.set(3);
        if self.wrong == Wrong::OneRefuses {
            self.status |= 0x0010_0000;
        }
    }
}

impl Bus for &mut Chips {
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
            Mode::Program | Mode::Erase => panic!("read in the middle of a command"),
        }
    }

    fn write(&mut self, offset: u32, word: u32) {
        assert!(offset.is_multiple_of(WORD));
        match self.mode {
            Mode::Program => {
                let kept = self.words.entry(offset).or_insert(ERASED);
                *kept &= word;
                if self.wrong == Wrong::BadCell {
                    *kept |= 1;
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
                other => panic!("no such command: {other:#x}"),
            },
        }
    }
}

fn flash(chips: &mut Chips) -> CfiFlash<&mut Chips, EmbassyClock> {
    CfiFlash::new(chips, EmbassyClock, BLOCKS)
}

#[test]
fn what_is_written_is_read_from_any_offset_until_it_is_erased() {
    let mut chips = Chips::new(Wrong::Nothing);
    let mut flash = flash(&mut chips);
    assert_eq!(flash.probe(), Ok(()));
    block_on(async {
        flash.write(8, b"terracrawler").await.expect("erased");
        let mut back = [0; 7];
        flash.read(11, &mut back).await.expect("in bounds");
        assert_eq!(&back, b"racrawl");
        assert_eq!(flash.write(12, b"else").await, Err(CfiError::NotErased));
        flash.erase(0, ERASE_BLOCK).await.expect("a block");
        flash.read(11, &mut back).await.expect("in bounds");
        assert_eq!(back, [0xFF; 7]);
    });
    assert_eq!(chips.mode, Mode::Array);
}

#[test]
fn mistakes_of_the_caller_reach_no_chip() {
    let mut chips = Chips::new(Wrong::NeverReady);
    let mut flash = flash(&mut chips);
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
    });
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
        let mut chips = Chips::new(wrong);
        let mut flash = flash(&mut chips);
        assert_eq!(flash.probe(), probed, "{wrong:?}");
        let outcome = block_on(flash.write(0, &[0; 4]));
        assert_eq!(outcome, written, "{wrong:?}");
        assert_eq!(chips.mode, Mode::Array, "{wrong:?}: left readable");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn it_is_an_array_of_bytes(
        writes in prop::collection::vec(
            (0_u32..64, prop::collection::vec(any::<u8>(), 0..24)), 0..12),
    ) {
        let mut chips = Chips::new(Wrong::Nothing);
        let mut flash = flash(&mut chips);
        let mut expected = [0xFF_u8; 512];
        for (word, bytes) in writes {
            let (at, len) = (word * WORD, bytes.len() / 4 * 4);
            let before: Vec<u8> = expected[at as usize..at as usize + len].to_vec();
            let outcome = block_on(flash.write(at, &bytes[..len]));
            let words = before.chunks(4).zip(bytes.chunks(4));
            for (i, (old, new)) in words.enumerate() {
                if old != [0xFF; 4] {
                    prop_assert_eq!(outcome, Err(CfiError::NotErased));
                    break;
                }
                let start = at as usize + i * 4;
                expected[start..start + 4].copy_from_slice(new);
            }
        }
        let mut kept = [0; 512];
        prop_assert_eq!(block_on(flash.read(0, &mut kept)), Ok(()));
        prop_assert_eq!(kept, expected);
    }
}
