//! Why the program started and how it last panicked, in memory that a reset keeps.
//!
//! The board places a [`BootRecord`] where neither its loader nor its runtime writes. What it
//! finds there at boot is either what an earlier program of the same power-on left, or nothing:
//! a magic number and a checksum tell.

use core::fmt::{self, Write};

use crawler_hal::{PANIC_TEXT, ResetCause};

/// Changes with the form of the record.
const MAGIC: u32 = 0x5443_0001;

/// What the program knew of its end.
const RUNNING: u32 = 1;
const ASKED: u32 = 2;
const PANICKED: u32 = 3;
const STARVED: u32 = 4;

/// A record as it lies in memory: only whole words, all bit patterns valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub struct BootRecord {
    magic: u32,
    end: u32,
    /// Ends of this sort in a row.
    repeated: u32,
    len: u32,
    text: [u8; PANIC_TEXT],
    check: u32,
}

/// How a program ends, as it tells its successor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// It asked for a reset.
    Reset,
    /// It panicked.
    Panic,
    /// It did not feed its watchdog.
    Watchdog,
}

impl BootRecord {
    /// The record of a program that runs: whoever finds it there was reset from outside.
    pub const fn running() -> Self {
        Self {
            magic: MAGIC,
            end: RUNNING,
            repeated: 0,
            len: 0,
            text: [0; PANIC_TEXT],
            check: 0,
        }
        .sealed()
    }

    /// The record of a program that ends like this. `before` is what it found when it started.
    pub const fn ending(end: End, before: Option<&Self>) -> Self {
        let end = match end {
            End::Reset => ASKED,
            End::Panic => PANICKED,
            End::Watchdog => STARVED,
        };
        let repeated = match before {
            Some(before) if before.end == end => before.repeated.saturating_add(1),
            _ => 1,
        };
        Self {
            end,
            repeated,
            ..Self::running()
        }
        .sealed()
    }

    /// The record of a panic at `file`:`line`, cut to what fits. Of the path its last two parts
    /// are kept.
    pub fn panic(file: &str, line: u32, text: &dyn fmt::Display, before: Option<&Self>) -> Self {
        let mut record = Self::ending(End::Panic, before);
        let mut writer = Writer {
            text: &mut record.text,
            len: 0,
        };
        // A text that does not fit is cut, which is no error here.
        let _ = write!(writer, "{}:{line}: {text}", tail(file));
        record.len = writer.len as u32;
        record.sealed()
    }

    /// This record, if it is one.
    pub fn checked(self) -> Option<Self> {
        let sound = self.magic == MAGIC
            && self.check == self.checksum()
            && (RUNNING..=STARVED).contains(&self.end)
            && core::str::from_utf8(self.bytes()).is_ok();
        sound.then_some(self)
    }

    /// Why the program started that finds `record`.
    pub fn cause(record: Option<&Self>) -> ResetCause {
        match record.map(|record| record.end) {
            None => ResetCause::PowerOn,
            Some(ASKED) => ResetCause::Software,
            Some(PANICKED) => ResetCause::Panic,
            Some(STARVED) => ResetCause::Watchdog,
            Some(_) => ResetCause::External,
        }
    }

    /// How the program before panicked.
    pub fn panic_text(&self) -> Option<&str> {
        (self.end == PANICKED)
            .then(|| core::str::from_utf8(self.bytes()).ok())
            .flatten()
    }

    /// How often in a row programs ended like this.
    pub const fn repeated(&self) -> u32 {
        self.repeated
    }

    fn bytes(&self) -> &[u8] {
        self.text.get(..self.len as usize).unwrap_or(&[0xFF])
    }

    const fn sealed(mut self) -> Self {
        self.check = self.checksum();
        self
    }

    /// FNV-1a over everything but itself.
    const fn checksum(&self) -> u32 {
        let mut sum = 0x811C_9DC5;
        let words = [self.magic, self.end, self.repeated, self.len];
        let mut i = 0;
        while i < words.len() {
            sum = fold(sum, words[i]);
            i += 1;
        }
        let mut i = 0;
        while i < PANIC_TEXT {
            sum = fold(sum, self.text[i] as u32);
            i += 1;
        }
        sum
    }
}

const fn fold(sum: u32, word: u32) -> u32 {
    (sum ^ word).wrapping_mul(0x0100_0193)
}

/// The last two parts of a path.
fn tail(path: &str) -> &str {
    let mut slashes = path.rmatch_indices(['/', '\\']).map(|(at, _)| at);
    let _ = slashes.next();
    slashes.next().map_or(path, |at| &path[at + 1..])
}

/// Writes what fits, whole characters alone.
struct Writer<'a> {
    text: &'a mut [u8; PANIC_TEXT],
    len: usize,
}

impl fmt::Write for Writer<'_> {
    fn write_str(&mut self, s: &str) -> fmt::Result {
        for character in s.chars() {
            let end = self.len + character.len_utf8();
            let place = self.text.get_mut(self.len..end).ok_or(fmt::Error)?;
            character.encode_utf8(place);
            self.len = end;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Ways to spoil a record.
    const WORDS: usize = size_of::<BootRecord>() / 4;

    fn spoilt(mut record: BootRecord, at: usize, bit: u32) -> BootRecord {
        let word = 1_u32 << bit;
        match at {
            0 => record.magic ^= word,
            1 => record.end ^= word,
            2 => record.repeated ^= word,
            3 => record.len ^= word,
            _ if at == WORDS - 1 => record.check ^= word,
            _ => record.text[(at - 4) * 4 + bit as usize / 8] ^= 1 << (bit % 8),
        }
        record
    }

    #[test]
    fn each_end_is_a_cause() {
        let cause = |record: BootRecord| BootRecord::cause(record.checked().as_ref());
        assert_eq!(BootRecord::cause(None), ResetCause::PowerOn);
        assert_eq!(cause(BootRecord::running()), ResetCause::External);
        for (end, expected) in [
            (End::Reset, ResetCause::Software),
            (End::Panic, ResetCause::Panic),
            (End::Watchdog, ResetCause::Watchdog),
        ] {
            assert_eq!(cause(BootRecord::ending(end, None)), expected);
        }
    }

    #[test]
    fn a_panic_tells_where_and_why() {
        let record = BootRecord::panic("/a/b/src/main.rs", 12, &"too hot", None);
        let kept = record.checked().expect("sound");
        assert_eq!(kept.panic_text(), Some("src/main.rs:12: too hot"));
        assert_eq!(kept.repeated(), 1);
        let again = BootRecord::panic("main.rs", 1, &"x", Some(&kept));
        assert_eq!(again.repeated(), 2);
        assert_eq!(again.panic_text(), Some("main.rs:1: x"));
        assert_eq!(BootRecord::ending(End::Reset, Some(&again)).repeated(), 1);
        assert_eq!(BootRecord::ending(End::Reset, None).panic_text(), None);
    }

    #[test]
    fn one_flipped_bit_is_no_record() {
        let record = BootRecord::panic("src/lib.rs", 3, &"why", None);
        for at in 0..WORDS {
            for bit in 0..32 {
                assert_eq!(
                    spoilt(record, at, bit).checked(),
                    None,
                    "word {at} bit {bit}"
                );
            }
        }
    }

    proptest! {
        #[test]
        fn a_long_text_is_cut_between_characters(file in "\\PC{0,80}", text in "\\PC{0,120}") {
            let kept = BootRecord::panic(&file, 7, &text, None).checked();
            let kept = kept.as_ref().and_then(BootRecord::panic_text);
            let kept = kept.expect("every panic leaves a sound record");
            prop_assert!(kept.len() <= PANIC_TEXT);
            let whole = std::format!("{}:7: {text}", tail(&file));
            prop_assert!(whole.starts_with(kept));
        }
    }
}
