//! The numbers of commands: rising, also across restarts and clocks set back, and across the servers
//! of a fleet where there are several.

use crawler_cluster::{LONGEST_BLOCK, Numbers};

use crate::clock;
use crate::data::{DataDir, DataError};

const FILE: &str = "command-sequence";
/// Numbers reserved at a time. A restart skips the rest of them.
const BLOCK: u64 = 10_000;
/// What every reader of JSON can still count to, and far beyond the time in milliseconds.
const GREATEST: u64 = 1 << 53;

/// The numbers of commands.
///
/// They start at the time in Unix milliseconds, so that a server without its data directory
/// continues above its predecessor; the file takes over when the clock was set back.
///
/// Of several servers each has numbers of its own, by a clock that they share. The file holds a
/// number beyond all that went then too, so that a server that is alone again goes on above them.
pub(crate) struct Sequence {
    next: u64,
    reserved: u64,
    data: Option<DataDir>,
    /// How the numbers of several servers are kept apart.
    numbers: Option<Numbers>,
    /// What the file held at the start.
    known: u64,
}

impl Sequence {
    /// Continues after whatever was used before.
    ///
    /// # Errors
    /// [`DataError`] when the file cannot be read or written.
    pub(crate) fn open(data: DataDir, unix_ms: u64) -> Result<Self, DataError> {
        let known = data.number(FILE)?.unwrap_or(0);
        if known > GREATEST {
            return Err(data.damaged(FILE, "is no number of a command; remove the file"));
        }
        let next = unix_ms.min(GREATEST).max(known);
        let reserved = next + BLOCK;
        data.set_number(FILE, reserved)?;
        Ok(Self {
            next,
            reserved,
            data: Some(data),
            numbers: None,
            known,
        })
    }

    #[cfg(test)]
    pub(crate) const fn in_memory(next: u64) -> Self {
        Self {
            next,
            reserved: u64::MAX,
            data: None,
            numbers: None,
            known: 0,
        }
    }

    /// Goes on with the numbers of one of several servers, above `greatest`.
    pub(crate) fn share(&mut self, numbers: Numbers, greatest: u64) {
        if self.numbers.is_none() {
            // The shared clock knows better than the one that `next` began with. What the file says
            // counts only where no clock that went forward can explain it.
            let now = numbers.next(clock::unix_us(), 0);
            self.next = if self.known > now.saturating_add(LONGEST_BLOCK) {
                self.known
            } else {
                0
            };
            self.reserved = 0;
        }
        self.numbers = Some(numbers);
        self.above(greatest);
    }

    /// Goes on above a number that another server gave.
    pub(crate) fn above(&mut self, number: u64) {
        if number < GREATEST {
            self.next = self.next.max(number + 1);
        }
    }

    /// The number of the next command, now.
    pub(crate) fn peek(&self) -> u64 {
        match &self.numbers {
            None => self.next,
            Some(numbers) => numbers.next(clock::unix_us(), self.next),
        }
    }

    /// Uses up the next number.
    pub(crate) fn take(&mut self) -> u64 {
        let number = self.peek();
        self.used(number);
        number
    }

    /// Uses up a number from [`Sequence::peek`]. What follows is on the disk, as one of a block that
    /// a restart skips, before anybody can use it.
    pub(crate) fn used(&mut self, number: u64) {
        self.next = self.next.max(number + 1);
        if self.next < self.reserved {
            return;
        }
        let block = self.numbers.map_or(BLOCK, |_| LONGEST_BLOCK);
        let reserved = self.next + block;
        if let Some(data) = &self.data
            && let Err(error) = data.set_number(FILE, reserved)
        {
            // Commands matter more than the file: the clock alone will do for the next start. The
            // next number tries again.
            tracing::error!(%error, "the numbers of commands are not safe across a restart");
            return;
        }
        self.reserved = reserved;
    }

    /// Takes back the number used last, which has not gone anywhere.
    pub(crate) const fn take_back(&mut self, number: u64) {
        if number + 1 == self.next {
            self.next = number;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restart_with_the_clock_set_back_goes_on_rising() {
        let path = std::env::temp_dir().join(format!("crawler-sequence-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        let mut first =
            Sequence::open(DataDir::open(&path).expect("open"), 5_000_000).expect("first");
        for _ in 0..3 * BLOCK {
            first.take();
        }
        let last = first.peek();
        drop(first);
        let second = Sequence::open(DataDir::open(&path).expect("open"), 1_000).expect("second");
        assert!(second.peek() >= last, "{} after {last}", second.peek());
        std::fs::remove_dir_all(path).expect("clean up");
    }

    /// A crash can come between any two numbers: whatever was used by then, the next start is above.
    #[test]
    fn a_crash_between_any_two_numbers_repeats_none() {
        let path =
            std::env::temp_dir().join(format!("crawler-sequence-crash-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        let mut used = 0;
        for numbers in [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK, 3] {
            let data = DataDir::open(&path).expect("open");
            // The clock is of no help.
            let mut sequence = Sequence::open(data, 0).expect("open");
            for _ in 0..numbers {
                assert!(sequence.peek() > used || used == 0, "{numbers}");
                used = sequence.peek();
                sequence.take();
            }
            // Nothing is written at the end: dropping is as good as a crash.
        }
        std::fs::write(path.join(FILE), "18446744073709551615").expect("write");
        let data = DataDir::open(&path).expect("open");
        assert!(Sequence::open(data, 0).is_err(), "no number follows");
        std::fs::remove_dir_all(path).expect("clean up");
    }

    #[test]
    fn a_number_that_went_nowhere_is_used_again() {
        let mut sequence = Sequence::in_memory(5);
        sequence.take();
        sequence.take_back(5);
        assert_eq!(sequence.peek(), 5);
        sequence.take();
        sequence.take();
        sequence.take_back(5);
        assert_eq!(sequence.peek(), 7, "another came after it");
    }

    /// A server that was one of several and is alone again goes on above what went, by its file; one
    /// that comes back to the others does not run ahead of them because of it.
    #[test]
    fn numbers_rise_into_a_cluster_and_out_of_it() {
        let path =
            std::env::temp_dir().join(format!("crawler-sequence-shared-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        let open = || Sequence::open(DataDir::open(&path).expect("open"), clock::unix_ms());
        let mut sequence = open().expect("open");
        let alone = sequence.take();
        sequence.share(Numbers::new(3, 0), 0);
        let first = sequence.take();
        assert!(first > alone);
        sequence.above(first + 160);
        assert!(sequence.take() > first + 160);
        let last = sequence.take();
        drop(sequence);

        let mut again = open().expect("open");
        assert!(again.take() > last, "alone again");
        drop(again);
        std::thread::sleep(std::time::Duration::from_millis(50));
        let mut back = open().expect("open");
        back.share(Numbers::new(4, 0), last);
        let next = back.take();
        assert!(next > last);
        let clock = Numbers::new(4, 0).next(clock::unix_us(), 0);
        assert!(next <= clock.max(last + 16), "not ahead of the others");
        drop(back);
        std::fs::remove_dir_all(path).expect("clean up");
    }
}
