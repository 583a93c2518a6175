//! Log records that wait, and those that may have to be sent again.

use core::fmt::Write as _;

use crawler_hal::{Duration, Instant};
use crawler_protocol::Level;
use heapless::{String, Vec};

use crate::trouble::{KEPT_EVENTS, is_kept};

/// Log records held.
pub const LOGS: usize = 20;
/// Bytes for the texts of all log records held.
pub const LOG_TEXTS: usize = 640;
/// Least time between two records that tell of losses.
pub const LOSS_PERIOD: Duration = Duration::from_secs(1);
/// Longest text of a log record, in bytes; what is longer is cut.
pub const LOG_TEXT: usize = crawler_hal::PANIC_TEXT;

// When all places are taken by records of kept events, two of them share an event, and the older
// one of those can give way.
const _: () = assert!(KEPT_EVENTS.len() < LOGS);
// The length of a text is kept in one byte.
const _: () = assert!(LOG_TEXT <= u8::MAX as usize);
// A line of text for every kept event; more only if not all of them have something to tell.
const _: () = assert!(KEPT_EVENTS.len() * 40 <= LOG_TEXTS);

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

/// A record without its text.
#[derive(Debug, Clone, Copy)]
struct Place {
    timestamp: u64,
    event: &'static str,
    /// The lower half of its number.
    seq: u32,
    level: Level,
    passage: Passage,
    /// Length of its text.
    len: u8,
}

#[derive(Debug)]
pub(super) struct Logs {
    places: Vec<Place, LOGS>,
    /// The texts of all places, one after the other: most are far shorter than the longest.
    texts: String<LOG_TEXTS, u16>,
    next_seq: u64,
    lost: u32,
    told: Option<Instant>,
}

impl Logs {
    pub(super) const fn new() -> Self {
        Self {
            places: Vec::new(),
            texts: String::new(),
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
        let text = cut(text);
        let seq = self.number();
        if self.places.is_full() {
            // More places than kept events: there is always one that can give way.
            let index = self.gives_way(event).unwrap_or(0);
            self.lose(index);
        }
        while self.room() < text.len()
            && let Some(index) = self.gives_way(event)
        {
            self.lose(index);
        }
        let mut len = text.len().min(self.room());
        while !text.is_char_boundary(len) {
            len -= 1;
        }
        // There is room for both: made above.
        let _ = self.texts.push_str(&text[..len]);
        let _ = self.places.push(Place {
            timestamp,
            event,
            seq: seq as u32,
            level,
            passage: Passage::Waiting,
            len: len as u8,
        });
    }

    fn number(&mut self) -> u64 {
        let seq = self.next_seq;
        self.next_seq += 1;
        seq
    }

    fn room(&self) -> usize {
        LOG_TEXTS - self.texts.len()
    }

    /// Where the text of a place begins and ends.
    fn span(&self, index: usize) -> core::ops::Range<usize> {
        let before = self.places.iter().take(index);
        let start = before.map(|place| usize::from(place.len)).sum();
        start..start + usize::from(self.places[index].len)
    }

    /// The oldest record that nobody promised to keep; else the oldest that a newer one of its
    /// event supersedes, one of `event` being about to be written.
    fn gives_way(&self, event: &str) -> Option<usize> {
        let ordinary = |place: &Place| !is_kept(place.event);
        let ordinary = self.places.iter().position(ordinary);
        ordinary.or_else(|| {
            (0..self.places.len()).find(|&index| {
                let old = self.places[index].event;
                let mut newer = self.places[index + 1..].iter();
                old == event || newer.any(|place| place.event == old)
            })
        })
    }

    fn lose(&mut self, index: usize) {
        self.remove(index);
        self.lost = self.lost.saturating_add(1);
    }

    fn remove(&mut self, index: usize) {
        let span = self.span(index);
        self.texts.drain(span);
        self.places.remove(index);
    }

    /// A place as it will be sent.
    fn entry(&self, index: usize) -> LogEntry {
        let place = self.places[index];
        // Fewer records are held than half of its number can tell apart.
        let age = (self.next_seq as u32).wrapping_sub(place.seq);
        LogEntry {
            seq: self.next_seq - u64::from(age),
            timestamp: place.timestamp,
            level: place.level,
            event: place.event,
            text: shortened(&self.texts[self.span(index)]),
        }
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
        let entry = self.entry(index);
        if is_kept(entry.event) {
            self.places[index].passage = Passage::Written;
        } else {
            self.remove(index);
        }
        Some(entry)
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
        let asked = |place: &Place| place.passage == Passage::Asked;
        while let Some(index) = self.places.iter().position(asked) {
            self.remove(index);
        }
    }

    pub(super) fn rewind(&mut self) {
        for place in &mut self.places {
            place.passage = Passage::Waiting;
        }
    }
}

fn shortened(text: &str) -> String<LOG_TEXT> {
    cut(format_args!("{text}"))
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
        let mut fits = text.len().min(LOG_TEXT - self.0.len());
        while !text.is_char_boundary(fits) {
            fits -= 1;
        }
        // There is room for that much.
        let _ = self.0.push_str(&text[..fits]);
        Ok(())
    }
}
