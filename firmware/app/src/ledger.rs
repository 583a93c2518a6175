//! Who sent which command last, and what it came to.
//!
//! `seq` rises per source. A command whose `seq` is the last one of its source again is a
//! repetition and is answered from memory; a lower one came out of order, or is replayed, and is
//! stale. The ledger has room for [`SOURCES`] sources, about 1 KB, and never grows.
//!
//! # When a source must be forgotten
//! A new source takes the place of the one heard from least recently. Forgetting alone would let
//! an old command of the forgotten source pass as new, so the ledger keeps the latest timestamp
//! among all it has forgotten as a *floor*: a source it does not know must bring a timestamp
//! later than the floor, or its command is stale. Timestamps of one sender rise with its `seq`,
//! so whatever was seen of a forgotten source stays behind the floor for good, however many
//! random sources are invented to push it out. What such a flood does achieve is that a source
//! not heard from for a while may find its next command stale when it is not newer than the
//! flood's; the command after that is.
//!
//! Timestamps count only as far as the robot's own clock vouches for them, so no sender can put
//! the floor into the future.

use crawler_hal::Instant;
use crawler_protocol::{Reason, ResponseStatus, Source};
use heapless::Vec;

/// Sources remembered at the same time: a few operators, the server, an experiment, a script.
pub const SOURCES: usize = 8;

/// What a command came to, as far as it is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer {
    /// Outcome.
    pub status: ResponseStatus,
    /// Why, where there is a why.
    pub reason: Option<Reason>,
}

/// What the ledger makes of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Newer than everything its source sent so far.
    Fresh,
    /// The latest command of its source once more, with its latest answer; `None` while the
    /// answer is still being worked out.
    Repeated(Option<Answer>),
    /// Older than the latest command of its source, or not provably newer.
    Stale,
}

/// Stands for a source for as long as that is remembered: two bytes beside an answer in place of a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SourceNumber(u16);

impl SourceNumber {
    /// Of no source.
    pub const NONE: Self = Self(0);
}

#[derive(Debug)]
struct Entry {
    source: Source,
    number: SourceNumber,
    seq: u64,
    answer: Option<Answer>,
    /// Latest vouched-for timestamp of the source, Unix ms.
    timestamp: u64,
    /// The ledger's floor when the source was met (again).
    floor: Option<u64>,
    heard: Instant,
}

/// Bounded memory of sources.
#[derive(Debug, Default)]
pub struct Ledger {
    entries: Vec<Entry, SOURCES>,
    /// Latest timestamp among the forgotten; `None` while none was forgotten.
    floor: Option<u64>,
    /// Number of the source that was met last.
    last: u16,
}

impl Ledger {
    /// An empty ledger.
    pub const fn new() -> Self {
        Self {
            entries: Vec::new(),
            floor: None,
            last: 0,
        }
    }

    /// Judges a command without remembering it.
    pub fn judge(&self, source: &Source, seq: u64, timestamp: u64) -> Verdict {
        let below = |floor: Option<u64>| floor.is_some_and(|floor| timestamp <= floor);
        match self.find(source) {
            Some(entry) if seq == entry.seq => Verdict::Repeated(entry.answer),
            // A halt is obeyed and noted even from below the floor, so a known source may still
            // bring commands from before it was forgotten.
            Some(entry) if seq < entry.seq || below(entry.floor) => Verdict::Stale,
            None if below(self.floor) => Verdict::Stale,
            Some(_) | None => Verdict::Fresh,
        }
    }

    /// Remembers `seq` as the latest of `source`. A `seq` that is not newer changes nothing.
    ///
    /// `vouched` is the command's timestamp if the robot's clock makes it plausible, else
    /// `None`.
    pub fn record(&mut self, source: &Source, seq: u64, vouched: Option<u64>, now: Instant) {
        let vouched = vouched.unwrap_or(0);
        if let Some(entry) = self.entries.iter_mut().find(|e| e.source == *source) {
            if seq > entry.seq {
                entry.seq = seq;
                entry.answer = None;
                entry.timestamp = entry.timestamp.max(vouched);
            }
            entry.heard = now;
            return;
        }
        if self.entries.is_full() {
            self.forget_quietest();
        }
        // One comes again after 65,535 others; an answer is delivered, or has given way, long before.
        self.last = self.last.checked_add(1).unwrap_or(1);
        // There is room: the line above made it. An error would mean the command is not
        // remembered, and a repetition would be judged by its timestamp.
        let _ = self.entries.push(Entry {
            source: source.clone(),
            number: SourceNumber(self.last),
            seq,
            answer: None,
            timestamp: vouched,
            floor: self.floor,
            heard: now,
        });
    }

    /// Notes what `seq` of `source` came to. Only the latest command of a source has an answer
    /// here; others are ignored.
    pub fn answer(&mut self, source: &Source, seq: u64, answer: Answer) {
        if let Some(entry) = self.entries.iter_mut().find(|e| e.source == *source)
            && entry.seq == seq
        {
            entry.answer = Some(answer);
        }
    }

    /// The number of a source, or [`SourceNumber::NONE`] where it is not known.
    pub fn number(&self, source: &Source) -> SourceNumber {
        self.find(source)
            .map_or(SourceNumber::NONE, |entry| entry.number)
    }

    /// The source of this number, while it is remembered.
    pub fn source(&self, number: SourceNumber) -> Option<&Source> {
        let mut entries = self.entries.iter();
        let entry = entries.find(|entry| entry.number == number)?;
        Some(&entry.source)
    }

    fn find(&self, source: &Source) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.source == *source)
    }

    fn forget_quietest(&mut self) {
        let quietest = (0..self.entries.len()).min_by_key(|&i| self.entries[i].heard);
        if let Some(index) = quietest {
            let forgotten = self.entries.swap_remove(index);
            self.floor = self.floor.max(Some(forgotten.timestamp));
        }
    }
}

#[cfg(test)]
#[path = "ledger_tests.rs"]
mod tests;
