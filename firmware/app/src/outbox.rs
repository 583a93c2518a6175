//! What waits to be sent: answers to commands, and log records.
//!
//! # Answers
//! Delivered at QoS 1: an answer stays here, in order, across any number of reconnections, until
//! the broker has acknowledged it. There are [`ANSWERS`] places, and three kinds of answers
//! compete for them:
//!
//! | kind | admitted while places taken or reserved stay within | when there is no room |
//! |---|---|---|
//! | answers to an admitted command | [`ADMIT_LIMIT`], checked *before* the command is admitted | the command is refused with `busy`; an admitted one has its places |
//! | refusals, and answers repeated from memory | [`COURTESY_LIMIT`] | not given; counted and reported |
//! | answers to `stop` and `estop` | [`ANSWERS`] | the oldest such answer not yet sent gives way; counted and reported. The halt itself is never refused |
//!
//! An admitted command is reserved two places, for `accepted` and for what it comes to; its final
//! answer gives back what is left. At most [`RESERVATIONS`] commands are open at a time; a reservation
//! nobody kept for [`RESERVATION_LIFE`] gives way when all are taken.
//!
//! # Log records
//! [`LOGS`] places and [`LOG_TEXTS`] bytes for what they say, and messages at QoS 0. Still no fault
//! that lasts is lost:
//!
//! - When all places are taken, or the bytes do not suffice, the oldest record gives way, but not
//!   the newest of a kept event ([`KEPT_EVENTS`](crate::trouble::KEPT_EVENTS)). There are more
//!   places than such events, so one can always give way: what happens often does not displace
//!   what happened once. When only such records are left, a new text is cut to the bytes there are.
//! - A record of a kept event stays here until the broker has answered something that was sent
//!   after it: the stream keeps its order, so the record arrived as well. When the connection
//!   breaks before, it is sent again on the next one, under the same number.
//!
//! A record of the loss says how many gave way, at most once in [`LOSS_PERIOD`].
//!
//! Telemetry is not queued: the link sends the latest snapshot, or collects a few of them and drops
//! these with the connection.
//!
//! State: about 2.2 KB (32 answers of 24 bytes, 16 records of 32 and their texts).

mod logs;

use core::cell::RefCell;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Level, Reason, ResponseStatus, Source};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::signal::Signal;
use heapless::Vec;

use crate::ledger::SourceNumber;
use logs::Logs;
pub use logs::{LOG_TEXT, LOG_TEXTS, LOGS, LOSS_PERIOD, LogEntry};

/// Places for answers.
pub const ANSWERS: usize = 32;
/// Places taken or reserved up to which a command is admitted.
pub const ADMIT_LIMIT: usize = 20;
/// Places taken or reserved up to which a refusal or a repeated answer is given.
pub const COURTESY_LIMIT: usize = 24;
/// Commands that may be open, that is admitted and not finally answered, at a time.
pub const RESERVATIONS: usize = 8;
/// Age at which a reservation gives way to a new one when all are taken.
pub const RESERVATION_LIFE: Duration = Duration::from_secs(5 * 60);
/// Answers reserved to each admitted command.
const PER_COMMAND: u8 = 2;

/// Names one answer in the outbox.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ticket(u32);

/// An answer to a command, as it will be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outgoing {
    /// Number of the command.
    pub seq: u64,
    /// Outcome.
    pub status: ResponseStatus,
    /// Why, where there is a why.
    pub reason: Option<Reason>,
    /// Unix ms when it was given, 0 when unknown. 48 bits of it are kept: it fits until the year 10889.
    pub timestamp: u64,
    /// Who sent the command.
    pub source: SourceNumber,
}

/// No place is free for the answers of one more command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoRoom;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Reserved,
    Courtesy,
    Halt,
}

/// An answer and what is known of it. Laid out flat: an [`Outgoing`] in it would bring its padding.
#[derive(Debug, Clone, Copy)]
struct Entry {
    seq: u64,
    /// The lowest four bytes of the time.
    timestamp: u32,
    /// The two above them. Not a pair, which would be padded.
    timestamp_high: u16,
    source: SourceNumber,
    ticket: Ticket,
    status: ResponseStatus,
    reason: Option<Reason>,
    kind: Kind,
    in_flight: bool,
}

const _: () = assert!(size_of::<Entry>() == 24);

impl Entry {
    const fn answer(&self) -> Outgoing {
        Outgoing {
            seq: self.seq,
            status: self.status,
            reason: self.reason,
            timestamp: (self.timestamp_high as u64) << u32::BITS | self.timestamp as u64,
            source: self.source,
        }
    }
}

/// Identifies an open command without keeping its source: 64 bits of FNV-1a over it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Key {
    source: u64,
    seq: u64,
}

impl Key {
    fn new(source: &Source, seq: u64) -> Self {
        let source = source
            .as_str()
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
                (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
            });
        Self { source, seq }
    }
}

#[derive(Debug, Clone, Copy)]
struct Reservation {
    key: Key,
    left: u8,
    made: Instant,
}

#[derive(Debug)]
struct Inner {
    answers: Vec<Entry, ANSWERS>,
    reservations: Vec<Reservation, RESERVATIONS>,
    next_ticket: u32,
    logs: Logs,
    answers_lost: u32,
}

/// See the [module](self).
pub struct Outbox<M: RawMutex> {
    inner: Mutex<M, RefCell<Inner>>,
    wake: Signal<M, ()>,
}

impl<M: RawMutex> Outbox<M> {
    /// An empty outbox.
    pub const fn new() -> Self {
        Self {
            inner: Mutex::new(RefCell::new(Inner {
                answers: Vec::new(),
                reservations: Vec::new(),
                next_ticket: 0,
                logs: Logs::new(),
                answers_lost: 0,
            })),
            wake: Signal::new(),
        }
    }

    fn with<R>(&self, f: impl FnOnce(&mut Inner) -> R) -> R {
        self.inner.lock(|inner| f(&mut inner.borrow_mut()))
    }

    /// Reserves room for the answers to one command.
    ///
    /// # Errors
    /// [`NoRoom`]: refuse the command with `busy`.
    pub fn admit(&self, source: &Source, seq: u64, now: Instant) -> Result<(), NoRoom> {
        self.with(|inner| inner.admit(Key::new(source, seq), now))
    }

    /// Takes back a reservation whose command was not accepted after all.
    pub fn dismiss(&self, source: &Source, seq: u64) {
        let key = Key::new(source, seq);
        self.with(|inner| {
            inner
                .reservations
                .retain(|reservation| reservation.key != key);
        });
    }

    /// Queues the answer to an admitted command, or, when there is no reservation for it, to a halt.
    pub fn answer(&self, source: &Source, answer: Outgoing) {
        self.with(|inner| inner.answer(Key::new(source, answer.seq), answer));
        self.wake.signal(());
    }

    /// Queues a refusal or a repeated answer, if there is room beyond what others may need.
    pub fn send_best_effort(&self, answer: Outgoing) {
        self.with(|inner| inner.send_best_effort(answer));
        self.wake.signal(());
    }

    /// Counts a refusal or a repeated answer that its sender will not get, because refusals come
    /// too fast.
    pub fn withheld(&self) {
        self.with(|inner| inner.answers_lost = inner.answers_lost.saturating_add(1));
    }

    /// Queues a log record. `text` is cut at [`LOG_TEXT`] bytes.
    pub fn log(
        &self,
        level: Level,
        event: &'static str,
        text: core::fmt::Arguments<'_>,
        timestamp: u64,
    ) {
        self.with(|inner| inner.logs.write(level, event, text, timestamp));
        self.wake.signal(());
    }

    /// Returns when something may have been queued since the last return.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub async fn changed(&self) {
        self.wake.wait().await;
    }

    /// Wakes the link: something beside the outbox waits for it.
    pub(crate) fn nudge(&self) {
        self.wake.signal(());
    }

    /// The first answer that is not on its way.
    pub fn next_answer(&self) -> Option<(Ticket, Outgoing)> {
        self.with(|inner| {
            let entry = inner.answers.iter().find(|entry| !entry.in_flight)?;
            Some((entry.ticket, entry.answer()))
        })
    }

    /// The answer that `ticket` names, while it is not delivered.
    pub fn get(&self, ticket: Ticket) -> Option<Outgoing> {
        self.with(|inner| {
            let entry = inner.answers.iter().find(|entry| entry.ticket == ticket)?;
            Some(entry.answer())
        })
    }

    /// Notes that an answer is on its way.
    pub fn sent(&self, ticket: Ticket) {
        self.with(|inner| {
            if let Some(entry) = inner.answers.iter_mut().find(|e| e.ticket == ticket) {
                entry.in_flight = true;
            }
        });
    }

    /// Notes that the broker has an answer: its place is free.
    pub fn delivered(&self, ticket: Ticket) {
        self.with(|inner| inner.answers.retain(|entry| entry.ticket != ticket));
    }

    /// Notes that nothing is on its way any more: every answer here is to be sent (again).
    pub fn rewind(&self) {
        self.with(|inner| {
            for entry in &mut inner.answers {
                entry.in_flight = false;
            }
        });
        self.wake.signal(());
    }

    /// The oldest log record not sent yet, which the caller sends. One that tells of losses
    /// comes before the others.
    pub fn next_log(&self, timestamp: u64, now: Instant) -> Option<LogEntry> {
        self.with(|inner| {
            let answers_lost = &mut inner.answers_lost;
            inner.logs.next(answers_lost, timestamp, now)
        })
    }

    /// Whether records of kept events were sent since the broker was last asked for an answer.
    pub fn logs_unproven(&self) -> bool {
        self.with(|inner| inner.logs.are_unproven())
    }

    /// Notes that something is on its way to the broker, after all records sent so far, whose
    /// answer will prove that they arrived.
    pub fn logs_asked(&self) {
        self.with(|inner| inner.logs.asked());
    }

    /// Notes that this answer came.
    pub fn logs_proven(&self) {
        self.with(|inner| inner.logs.proven());
    }

    /// Notes that no answer will come any more: what is not proven is sent again.
    pub fn rewind_logs(&self) {
        self.with(|inner| inner.logs.rewind());
    }

    /// Answers waiting or on their way.
    pub fn pending(&self) -> usize {
        self.with(|inner| inner.answers.len())
    }
}

impl<M: RawMutex> Default for Outbox<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl Inner {
    /// Places taken or reserved.
    fn load(&self) -> usize {
        let reserved: usize = self.reservations.iter().map(|p| usize::from(p.left)).sum();
        self.answers.len() + reserved
    }

    fn admit(&mut self, key: Key, now: Instant) -> Result<(), NoRoom> {
        if self.reservations.is_full() {
            // Oldest first: reservations are pushed in order.
            match self.reservations.first() {
                Some(oldest) if now - oldest.made > RESERVATION_LIFE => {
                    self.reservations.remove(0);
                }
                Some(_) | None => return Err(NoRoom),
            }
        }
        if self.load() + usize::from(PER_COMMAND) > ADMIT_LIMIT {
            return Err(NoRoom);
        }
        let reservation = Reservation {
            key,
            left: PER_COMMAND,
            made: now,
        };
        self.reservations.push(reservation).map_err(|_| NoRoom)
    }

    fn answer(&mut self, key: Key, answer: Outgoing) {
        let Some(index) = self.reservations.iter().position(|p| p.key == key) else {
            return self.answer_halt(answer);
        };
        let reservation = &mut self.reservations[index];
        if answer.status.is_final() {
            self.reservations.remove(index);
        } else if reservation.left > 1 {
            reservation.left -= 1;
        } else {
            // A second `accepted`: the last place is for what the command comes to.
            return self.send_best_effort(answer);
        }
        self.push(Kind::Reserved, answer);
    }

    fn answer_halt(&mut self, answer: Outgoing) {
        if self.load() >= ANSWERS {
            let waiting = |entry: &Entry| entry.kind == Kind::Halt && !entry.in_flight;
            self.answers_lost = self.answers_lost.saturating_add(1);
            match self.answers.iter().position(waiting) {
                Some(oldest) => {
                    self.answers.remove(oldest);
                }
                None => return,
            }
        }
        self.push(Kind::Halt, answer);
    }

    fn send_best_effort(&mut self, answer: Outgoing) {
        let same = |entry: &Entry| {
            !entry.in_flight
                && (entry.seq, entry.status, entry.reason, entry.source)
                    == (answer.seq, answer.status, answer.reason, answer.source)
        };
        if self.answers.iter().any(same) {
            return;
        }
        if self.load() >= COURTESY_LIMIT {
            self.answers_lost = self.answers_lost.saturating_add(1);
            return;
        }
        self.push(Kind::Courtesy, answer);
    }

    fn push(&mut self, kind: Kind, answer: Outgoing) {
        let entry = Entry {
            seq: answer.seq,
            timestamp: answer.timestamp as u32,
            timestamp_high: (answer.timestamp >> u32::BITS) as u16,
            source: answer.source,
            ticket: Ticket(self.next_ticket),
            status: answer.status,
            reason: answer.reason,
            kind,
            in_flight: false,
        };
        self.next_ticket = self.next_ticket.wrapping_add(1);
        if self.answers.push(entry).is_err() {
            // Not reached: every caller has made sure of a place. Counted all the same.
            self.answers_lost = self.answers_lost.saturating_add(1);
        }
    }
}

#[cfg(test)]
#[path = "outbox_tests.rs"]
mod tests;
