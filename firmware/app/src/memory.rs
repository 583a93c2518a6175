//! What is remembered of commands: how they were answered, what was carried out, and how many
//! refusals may still be given.

use core::cell::RefCell;

use crawler_hal::Instant;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::ledger::Ledger;

/// Refusals and repeated answers given per second, after a burst of as many.
pub const ANSWER_RATE: u32 = 20;
/// Refusals logged per second, after a burst of as many.
pub const LOG_RATE: u32 = 2;

/// What was carried out since the program started, halts left out: they are obeyed as often as they
/// come. Whoever gave the commands can tell from it that none ran twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    /// How many commands.
    pub commands: u32,
    /// The sum of their numbers, modulo 2^64.
    pub numbers: u64,
    /// When the last one that moves the robot arrived.
    pub motion: Option<Instant>,
}

impl Tally {
    const NONE: Self = Self {
        commands: 0,
        numbers: 0,
        motion: None,
    };
}

/// What is remembered between commands: about 1 KB.
pub(crate) struct CommandMemory<M: RawMutex> {
    memory: Mutex<M, RefCell<Memory>>,
}

pub(crate) struct Memory {
    pub(crate) ledger: Ledger,
    pub(crate) tally: Tally,
    /// Refusals and repeated answers that may be given.
    pub(crate) answers: Bucket,
    /// Refusals that may be logged.
    pub(crate) logs: Bucket,
}

impl<M: RawMutex> CommandMemory<M> {
    /// A memory of nothing yet.
    pub(crate) const fn new() -> Self {
        Self {
            memory: Mutex::new(RefCell::new(Memory {
                ledger: Ledger::new(),
                tally: Tally::NONE,
                answers: Bucket::full(ANSWER_RATE),
                logs: Bucket::full(LOG_RATE),
            })),
        }
    }

    /// Reads and changes it.
    pub(crate) fn with<R>(&self, f: impl FnOnce(&mut Memory) -> R) -> R {
        self.memory.lock(|memory| f(&mut memory.borrow_mut()))
    }
}

/// A token bucket: so many at once, and so many a second.
#[derive(Debug)]
pub(crate) struct Bucket {
    rate: u32,
    /// Microtokens.
    level: u64,
    at: Instant,
}

impl Bucket {
    const TOKEN: u64 = 1_000_000;

    const fn full(rate: u32) -> Self {
        Self {
            rate,
            level: rate as u64 * Self::TOKEN,
            at: Instant::BOOT,
        }
    }

    /// Whether there is one more now; it is then taken.
    pub(crate) fn take(&mut self, now: Instant) -> bool {
        let rate = u64::from(self.rate);
        let gained = (now - self.at).as_micros().saturating_mul(rate);
        self.at = now;
        self.level = self.level.saturating_add(gained).min(rate * Self::TOKEN);
        match self.level.checked_sub(Self::TOKEN) {
            Some(rest) => {
                self.level = rest;
                true
            }
            None => false,
        }
    }
}
