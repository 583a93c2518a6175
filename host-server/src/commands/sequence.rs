//! The numbers of commands: rising, also across restarts and clocks set back.

use crate::data::{DataDir, DataError};

const FILE: &str = "command-sequence";
/// Numbers reserved at a time. A restart skips the rest of them.
const BLOCK: u64 = 10_000;

/// The numbers of commands.
///
/// They start at the time in Unix milliseconds, so that a server without its data directory
/// continues above its predecessor; the file takes over when the clock was set back.
pub(crate) struct Sequence {
    next: u64,
    reserved: u64,
    data: Option<DataDir>,
}

impl Sequence {
    /// Continues after whatever was used before.
    ///
    /// # Errors
    /// [`DataError`] when the file cannot be read or written.
    pub(crate) fn open(data: DataDir, unix_ms: u64) -> Result<Self, DataError> {
        let next = unix_ms.max(data.number(FILE)?.unwrap_or(0));
        let reserved = next + BLOCK;
        data.set_number(FILE, reserved)?;
        Ok(Self {
            next,
            reserved,
            data: Some(data),
        })
    }

    #[cfg(test)]
    pub(crate) const fn in_memory(next: u64) -> Self {
        Self {
            next,
            reserved: u64::MAX,
            data: None,
        }
    }

    /// The number of the next command.
    pub(crate) const fn peek(&self) -> u64 {
        self.next
    }

    /// Uses up the number.
    pub(crate) fn advance(&mut self) {
        self.next += 1;
        if self.next < self.reserved {
            return;
        }
        self.reserved = self.next + BLOCK;
        if let Some(data) = &self.data
            && let Err(error) = data.set_number(FILE, self.reserved)
        {
            // Commands matter more than the file: the clock alone will do for the next start.
            tracing::error!(%error, "the numbers of commands are not safe across a restart");
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
            first.advance();
        }
        let last = first.peek();
        drop(first);
        let second = Sequence::open(DataDir::open(&path).expect("open"), 1_000).expect("second");
        assert!(second.peek() >= last, "{} after {last}", second.peek());
        std::fs::remove_dir_all(path).expect("clean up");
    }
}
