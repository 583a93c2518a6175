//! Log records that wait, and those that may have to be sent again.

use core::fmt::Write as _;

use crawler_hal::{Duration, Instant};
use crawler_protocol::Level;
use heapless::{String, Vec};

use crate::trouble::{KEPT_EVENTS, is_kept};

/// Log records held.
pub const LOGS: usize = 16;
/// Least time between two records that tell of losses.
pub const LOSS_PERIOD: Duration = Duration::from_secs(1);
/// Longest text of a log record, in bytes; what is longer is cut.
pub const LOG_TEXT: usize = crawler_hal::PANIC_TEXT;

// When all places are taken by records of kept events, two of them share an event, and the older
// one of those can give way.
const _: () = assert!(KEPT_EVENTS.len() < LOGS);

/// A log record, as it will be sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogEntry {
    /// Counts all records since boot, lost ones included.
    pub seq: u64,
    /// Unix ms when it was written, 0 when unknown.
    pub timestamp: u64,
    /// How bad it is.
    pub level: Level,
    /// Stable name of what happened.
    pub event: &'static str,
    /// In words.
    pub text: String<LOG_TEXT>,
}

/// How far a record has come. Only those of kept events go beyond the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Passage {
    /// Not sent.
    Waiting,
    /// Written to the stream.
    Written,
    /// Written before the packet whose answer will prove that it arrived.
    Asked,
}

#[derive(Debug)]
struct Place {
    entry: LogEntry,
    passage: Passage,
}

#[derive(Debug)]
pub(super) struct Logs {
    places: Vec<Place, LOGS>,
    next_seq: u64,
    lost: u32,
    told: Option<Instant>,
}

impl Logs {
    pub(super) const fn new() -> Self {
        Self {
            places: Vec::new(),
            next_seq: 0,
            lost: 0,
            told: None,
        }
    }

    pub(super) fn write(
        &mut self,
        level: Level,
        event: &'static str,
        text: core::fmt::Arguments<'_>,
        timestamp: u64,
    ) {
        let entry = LogEntry {
            seq: self.number(),
            timestamp,
            level,
            event,
            text: cut(text),
        };
        if self.places.is_full() {
            let index = self.gives_way();
            self.places.remove(index);
            self.lost = self.lost.saturating_add(1);
        }
        // There is room: made above.
        let _ = self.places.push(Place {
            entry,
            passage: Passage::Waiting,
        });
    }

    fn number(&mut self) -> u64 {
        let seq = self.next_seq;
        self.next_seq += 1;
        seq
    }

    /// The oldest record that nobody promised to keep; else the oldest that a newer one of its
    /// event supersedes.
    fn gives_way(&self) -> usize {
        let ordinary = |place: &Place| !is_kept(place.entry.event);
        if let Some(index) = self.places.iter().position(ordinary) {
            return index;
        }
        let superseded = (0..self.places.len()).find(|&index| {
            let event = self.places[index].entry.event;
            let mut newer = self.places[index + 1..].iter();
            newer.any(|place| place.entry.event == event)
        });
        // More places than events: there is one.
        superseded.unwrap_or(0)
    }

    /// The oldest record not sent. One that tells of losses comes before the others.
    pub(super) fn next(
        &mut self,
        answers_lost: &mut u32,
        timestamp: u64,
        now: Instant,
    ) -> Option<LogEntry> {
        let nothing_lost = self.lost == 0 && *answers_lost == 0;
        let just_told = self.told.is_some_and(|told| now - told < LOSS_PERIOD);
        if !nothing_lost && !just_told {
            self.told = Some(now);
            let lost = core::mem::take(&mut self.lost);
            let answers = core::mem::take(answers_lost);
            return Some(LogEntry {
                seq: self.number(),
                timestamp,
                level: Level::Warn,
                event: "outbox-full",
                text: cut(format_args!(
                    "{lost} log records and {answers} answers were not sent"
                )),
            });
        }
        let waiting = |place: &Place| place.passage == Passage::Waiting;
        let index = self.places.iter().position(waiting)?;
        if is_kept(self.places[index].entry.event) {
            let place = &mut self.places[index];
            place.passage = Passage::Written;
            return Some(place.entry.clone());
        }
        Some(self.places.remove(index).entry)
    }

    /// Whether records were written that nothing under way will prove.
    pub(super) fn are_unproven(&self) -> bool {
        let written = |place: &Place| place.passage == Passage::Written;
        self.places.iter().any(written)
    }

    pub(super) fn asked(&mut self) {
        for place in &mut self.places {
            if place.passage == Passage::Written {
                place.passage = Passage::Asked;
            }
        }
    }

    pub(super) fn proven(&mut self) {
        self.places.retain(|place| place.passage != Passage::Asked);
    }

    pub(super) fn rewind(&mut self) {
        for place in &mut self.places {
            place.passage = Passage::Waiting;
        }
    }
}

fn cut(text: core::fmt::Arguments<'_>) -> String<LOG_TEXT> {
    let mut cut = Cut(String::new());
    // `Cut` never fails.
    let _ = cut.write_fmt(text);
    cut.0
}

/// Takes as much text as fits and drops the rest, at a character boundary.
struct Cut(String<LOG_TEXT>);

impl core::fmt::Write for Cut {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        for character in text.chars() {
            if self.0.push(character).is_err() {
                break;
            }
        }
        Ok(())
    }
}
