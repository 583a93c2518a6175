//! The numbers of commands: rising, also across restarts and clocks set back, and across the servers
//! of a fleet where there are several.

use std::sync::Arc;

use crawler_cluster::{LONGEST_BLOCK, Numbers};

use super::journal::Lines;
use crawler_system::clock;
use crawler_system::data::{DataDir, DataError};

/// File of the number that all used ones are below.
pub(super) const FILE: &str = "command-sequence";
/// Numbers reserved at a time. A restart skips the rest of them.
const BLOCK: u64 = 20_000;
/// What every reader of JSON can still count to, and far beyond the time in milliseconds.
const GREATEST: u64 = 1 << 53;

/// The numbers of commands.
///
/// They start at the time in Unix milliseconds, so that a server without its data directory
/// continues above its predecessor; the file takes over when the clock was set back.
///
/// Of several servers each has numbers of its own, by a clock that they share. The file holds a
/// number beyond all that went then too, so that a server that is alone again goes on above them.
pub struct Sequence {
    next: u64,
    /// Up to where numbers are kept free, or are about to be.
    reserved: u64,
    /// Who writes that down; nobody needs to before [`Sequence::write_to`].
    lines: Option<Arc<Lines>>,
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
    pub fn open(data: &DataDir, unix_ms: u64) -> Result<Self, DataError> {
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
            lines: None,
            numbers: None,
            known,
        })
    }

    #[cfg(test)]
    pub(crate) const fn in_memory(next: u64) -> Self {
        Self {
            next,
            reserved: 0,
            lines: None,
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
        // Numbers follow the clock here: also while none is used, those to come must be free.
        self.keep_free();
    }

    /// Has the numbers to come written down by those who write `lines`, from here on.
    pub(super) fn write_to(&mut self, lines: &Arc<Lines>) {
        self.lines = Some(Arc::clone(lines));
    }

    /// Up to where numbers are to be kept free before any of them is used, if the file does not say so.
    pub(super) fn reserve_first(&mut self) -> Option<u64> {
        let (next, block) = (self.peek(), self.block());
        (next + block / 2 >= self.reserved).then(|| {
            self.reserved = next + block;
            self.reserved
        })
    }

    fn block(&self) -> u64 {
        self.numbers.map_or(BLOCK, |_| LONGEST_BLOCK)
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

    /// Uses up a number from [`Sequence::peek`].
    pub(crate) fn used(&mut self, number: u64) {
        self.next = self.next.max(number + 1);
        self.keep_free();
    }

    /// Asks for the next block while half of the last one is left, so that it is on the disk, as one that
    /// a restart skips, before anybody can use it. A disk that takes longer than half a block delays
    /// whoever is told that a command is safe. It delays no halt: the clock alone does for the next
    /// start then.
    fn keep_free(&mut self) {
        let (next, block) = (self.peek(), self.block());
        if let Some(lines) = &self.lines
            && next + block / 2 >= self.reserved
        {
            self.reserved = next + block;
            lines.reserve(self.reserved);
        }
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
    use std::path::Path;
    use std::time::Instant;

    use super::super::journal::{Journal, JournalQueue};
    use super::*;
    use crawler_metrics::Metrics;
    use crawler_system::data::test_disk::LIMIT;

    /// Numbers in `path` as a server with a clock at `unix_ms` has them, and what writes them down.
    fn open(path: &Path, unix_ms: u64) -> (Sequence, JournalQueue) {
        let data = Arc::new(DataDir::open(path).expect("open"));
        let mut sequence = Sequence::open(&data, unix_ms).expect("numbers");
        let journal = Journal::of(&data).expect("a journal");
        let queue = journal.start(Arc::clone(&data), FILE, Arc::new(Metrics::new()));
        let queue = queue.expect("a thread");
        assert_eq!(sequence.reserve_first(), None, "kept free by opening");
        sequence.write_to(queue.lines());
        (sequence, queue)
    }

    /// Uses a number. A disk that takes longer than half a block is not what is looked at here.
    fn take(sequence: &mut Sequence, path: &Path) {
        let before = sequence.reserved;
        sequence.take();
        let end = Instant::now() + LIMIT;
        while sequence.reserved != before && kept_free(path) < sequence.reserved {
            assert!(Instant::now() < end, "{} is not written", sequence.reserved);
            std::thread::yield_now();
        }
    }

    fn kept_free(path: &Path) -> u64 {
        let text = std::fs::read_to_string(path.join(FILE)).expect("a file");
        text.trim().parse().expect("a number")
    }

    /// Ends what writes the numbers down, so that the directory is free.
    fn end(queue: &JournalQueue) {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.build().expect("a runtime");
        runtime.block_on(queue.lines().end().cancelled());
    }

    #[test]
    fn a_restart_with_the_clock_set_back_goes_on_rising() {
        let path = std::env::temp_dir().join(format!("crawler-sequence-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        let (mut first, queue) = open(&path, 5_000_000);
        for _ in 0..3 * BLOCK {
            take(&mut first, &path);
        }
        let last = first.peek();
        end(&queue);
        let (second, queue) = open(&path, 1_000);
        assert!(second.peek() >= last, "{} after {last}", second.peek());
        end(&queue);
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
            // The clock is of no help.
            let (mut sequence, queue) = open(&path, 0);
            for _ in 0..numbers {
                assert!(sequence.peek() > used || used == 0, "{numbers}");
                used = sequence.peek();
                take(&mut sequence, &path);
                if sequence.next.is_multiple_of(1_000) {
                    let kept = kept_free(&path);
                    assert!(kept > used, "{kept} is kept free, {used} is used");
                }
            }
            // Nothing is left to be written: this is as good as a crash.
            let kept = kept_free(&path);
            end(&queue);
            assert_eq!(kept_free(&path), kept);
        }
        std::fs::write(path.join(FILE), "18446744073709551615").expect("write");
        let data = DataDir::open(&path).expect("open");
        assert!(Sequence::open(&data, 0).is_err(), "no number follows");
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
        let open = || open(&path, clock::unix_ms());
        let (mut sequence, queue) = open();
        let alone = sequence.take();
        sequence.share(Numbers::new(3, 0), 0);
        let first = sequence.take();
        assert!(first > alone);
        sequence.above(first + 160);
        assert!(sequence.take() > first + 160);
        let last = sequence.take();
        end(&queue);

        let (mut again, queue) = open();
        assert!(again.take() > last, "alone again");
        end(&queue);
        std::thread::sleep(std::time::Duration::from_millis(50));
        let (mut back, queue) = open();
        back.share(Numbers::new(4, 0), last);
        let next = back.take();
        assert!(next > last);
        let clock = Numbers::new(4, 0).next(clock::unix_us(), 0);
        assert!(next <= clock.max(last + 16), "not ahead of the others");
        end(&queue);
        std::fs::remove_dir_all(path).expect("clean up");
    }
}
