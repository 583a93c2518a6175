//! The door: what arrives as bytes leaves as a valid, fresh, new command, or as an answer.
//!
//! In this order, each step answering for itself:
//!
//! 1. Size, then [`Command::parse`]. What cannot be read is `rejected` with its reason, when at
//!    least its `seq` can.
//! 2. `stop` and `estop` are obeyed: however old, however often repeated, whatever the clock
//!    says, and whether or not there is room for the answer. They still count as the latest word
//!    of their source, so a motion command they overtook is stale.
//! 3. The [`Ledger`](crate::ledger::Ledger): a repeated command is answered from memory (not at all while its answer is
//!    still being worked out; that one will come), an older one is `stale`.
//! 4. The clock, for motion commands: `rejected` with `no_clock` while it is not synchronised,
//!    `expired` when older than [`EXPIRY`], `rejected` with `out_of_range` when further in the
//!    future than [`TOLERANCE`]. A sender whose clock runs ahead would otherwise buy its commands
//!    a longer life; no command lives longer than the two together.
//! 5. Room for its answers in the outbox, and in the channel to whoever carries it out: else
//!    `rejected` with `busy`.
//!
//! Whatever was parsed is recorded, also when refused: its repetition gets the same answer.
//! Refusals are answered at most [`ANSWER_RATE`] times a second and logged at most [`LOG_RATE`]
//! times, so a flood does not become one; what was withheld is counted and reported.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, Command, CommandError, Level, Reason, ResponseStatus, Source};
use embassy_sync::blocking_mutex::raw::RawMutex;
use heapless::Vec;

use crate::context::{Robot, Routed};
use crate::ledger::{Answer, SourceNumber, Verdict};
use crate::memory::Memory;
pub use crate::memory::{ANSWER_RATE, LOG_RATE, Tally};
use crate::order::Sender;

/// Age at which a motion command expires.
pub const EXPIRY: Duration = Duration::from_millis(2_000);
/// How far ahead of the robot's clock a motion command may be.
pub const TOLERANCE: Duration = Duration::from_millis(2_000);
/// Orders a halt can take back at once: as many as can wait.
const TAKEN_BACK: usize = 4;

impl<M: RawMutex> Robot<M> {
    /// Takes in one message from a command topic, as it arrived at `now`.
    ///
    /// Whatever the bytes are: they are acted upon, answered, or counted. Synchronous and bounded.
    pub fn submit(&self, payload: &[u8], now: Instant) {
        // Not moved out of where it was parsed: with its values a command takes a kilobyte.
        match &Command::parse(payload) {
            Ok(command) => self.take(command, now),
            Err(error) => self.refuse_unreadable(error, now),
        }
    }

    fn take(&self, command: &Command, now: Instant) {
        let source = &command.source;
        let unix = self.unix_ms(now);
        // What lies beyond the tolerance says nothing about when the command was given.
        let vouched = unix
            .filter(|unix| command.timestamp <= unix.saturating_add(TOLERANCE.as_millis()))
            .map(|_| command.timestamp);
        if matches!(command.action, Action::Stop | Action::Estop) {
            self.commands
                .with(|memory| memory.ledger.record(source, command.seq, vouched, now));
            return self.carry_out(command, now);
        }
        let verdict = self.commands.with(|memory| {
            let verdict = memory.ledger.judge(source, command.seq, command.timestamp);
            if verdict == Verdict::Fresh {
                memory.ledger.record(source, command.seq, vouched, now);
            }
            verdict
        });
        match verdict {
            Verdict::Fresh => {}
            Verdict::Repeated(None) => return,
            Verdict::Repeated(Some(answer)) => {
                return self.tell(Some(source), command.seq, answer, now);
            }
            Verdict::Stale => {
                let answer = Answer {
                    status: ResponseStatus::Stale,
                    reason: None,
                };
                return self.tell(Some(source), command.seq, answer, now);
            }
        }
        match check_clock(command, unix) {
            None => {}
            Some(refusal) => return self.refuse(command, refusal, now),
        }
        if self.outbox.admit(source, command.seq, now).is_err() {
            return self.refuse(command, rejected(Reason::Busy), now);
        }
        self.carry_out(command, now);
    }

    /// What was carried out so far.
    pub fn tally(&self) -> Tally {
        self.commands.with(|memory| memory.tally)
    }

    fn count(&self, command: &Command, now: Instant) {
        if matches!(command.action, Action::Stop | Action::Estop) {
            return;
        }
        self.commands.with(|Memory { tally, .. }| {
            tally.commands = tally.commands.wrapping_add(1);
            tally.numbers = tally.numbers.wrapping_add(command.seq);
            if command.action.is_motion() {
                tally.motion = Some(now);
            }
        });
    }

    fn carry_out(&self, command: &Command, now: Instant) {
        let mut taken_back: Vec<Sender, TAKEN_BACK> = Vec::new();
        let routed = self.route(command, now, |sender| {
            // As many as can wait, so it fits.
            let _ = taken_back.push(sender.clone());
        });
        for sender in &taken_back {
            let interrupted = Some(Reason::Interrupted);
            let failed = ResponseStatus::Failed;
            self.respond(&sender.source, sender.seq, failed, interrupted, now);
        }
        if routed.is_ok() {
            self.count(command, now);
        }
        match routed {
            Ok(Routed::Waiting) => {}
            Ok(Routed::Done) => {
                let completed = ResponseStatus::Completed;
                self.respond(&command.source, command.seq, completed, None, now);
            }
            Ok(Routed::Unattended) => {
                let accepted = ResponseStatus::Accepted;
                self.respond(&command.source, command.seq, accepted, None, now);
            }
            Err(reason) => {
                self.outbox.dismiss(&command.source, command.seq);
                self.refuse(command, rejected(reason), now);
            }
        }
    }

    /// Refuses a command that could be read.
    fn refuse(&self, command: &Command, answer: Answer, now: Instant) {
        let (source, seq) = (&command.source, command.seq);
        self.commands
            .with(|memory| memory.ledger.answer(source, seq, answer));
        self.tell(Some(source), seq, answer, now);
        self.log_refusal(
            format_args!(
                "{} {seq} of {source}: {}",
                command.action.name(),
                answer.reason.map_or(answer.status.name(), Reason::name)
            ),
            now,
        );
    }

    /// Refuses what could not be read.
    fn refuse_unreadable(&self, error: &CommandError, now: Instant) {
        let reason = error.reason;
        match error.seq {
            Some(seq) => {
                self.tell(error.source.as_ref(), seq, rejected(reason), now);
                self.log_refusal(format_args!("command {seq}: {}", reason.name()), now);
            }
            None => self.log_refusal(format_args!("unreadable command: {}", reason.name()), now),
        }
    }

    fn tell(&self, source: Option<&Source>, seq: u64, answer: Answer, now: Instant) {
        let number = self.commands.with(|memory| {
            let given = memory.answers.take(now);
            given.then(|| source.map_or(SourceNumber::NONE, |source| memory.ledger.number(source)))
        });
        if let Some(number) = number {
            self.outbox
                .send_best_effort(self.outgoing(number, seq, answer, now));
        } else {
            self.outbox.withheld();
        }
    }

    fn log_refusal(&self, text: core::fmt::Arguments<'_>, now: Instant) {
        if self.commands.with(|memory| memory.logs.take(now)) {
            self.log(Level::Warn, "command-refused", text, now);
        }
    }
}

const fn rejected(reason: Reason) -> Answer {
    Answer {
        status: ResponseStatus::Rejected,
        reason: Some(reason),
    }
}

/// The refusal of a motion command that the clock does not allow.
fn check_clock(command: &Command, unix: Option<u64>) -> Option<Answer> {
    if !command.action.is_motion() {
        return None;
    }
    let Some(unix) = unix else {
        return Some(rejected(Reason::NoClock));
    };
    if unix.saturating_sub(command.timestamp) > EXPIRY.as_millis() {
        return Some(Answer {
            status: ResponseStatus::Expired,
            reason: None,
        });
    }
    if command.timestamp.saturating_sub(unix) > TOLERANCE.as_millis() {
        return Some(rejected(Reason::OutOfRange));
    }
    None
}

#[cfg(test)]
#[path = "intake_tests.rs"]
mod tests;
