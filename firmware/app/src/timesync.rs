//! The robot's idea of Unix time, from the server's `{fleet}/time` messages.
//!
//! A time message carries the server's clock as it was sent; how long it travelled is unknown,
//! but never negative. So each message gives a *lower bound* of the offset between Unix time and
//! the robot's monotonic clock, and the greatest bound comes from the message that was delayed
//! least. The filter holds that one. Because the two clocks drift apart, a held bound is worth
//! less with every second: it loses [`DRIFT_PPM`] of its age before it is compared with a new
//! one, so a truly drifting clock is followed, and a late message moves the clock back by no more
//! than what drift allows.
//!
//! A server clock may also be *set*. A bound that is far off ([`STEP`]) is therefore remembered
//! apart; when [`STEP_CONFIRMATIONS`] messages that came at least [`STEP_SPACING`] apart agree
//! with each other, the clock is moved there. A burst of messages that a stalled stream delivers
//! at once does not agree with itself, nor does it keep the spacing. Only while the clock is
//! young, that is before as many messages have agreed with it, is a *greater* bound adopted at
//! once however far off: then the first message was simply late.
//!
//! State: 96 bytes.

use core::cell::Cell;

use crawler_hal::{Duration, Instant};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

/// Greatest rate at which two clocks are expected to drift apart, in parts per million. A
/// crystal keeps 50 over temperature; two of them and a margin.
pub const DRIFT_PPM: u64 = 200;
/// How long the clock is trusted without hearing from the server. At [`DRIFT_PPM`] the error
/// grows to 0.36 s in that time, well inside the 2 s after which a command expires.
pub const VALID_FOR: Duration = Duration::from_secs(30 * 60);
/// A bound that differs by more than this is not delay or drift but a clock that was set.
pub const STEP: Duration = Duration::from_millis(1_000);
/// Messages that must agree before the clock is moved by more than [`STEP`].
pub const STEP_CONFIRMATIONS: u8 = 3;
/// Least time between two messages that confirm a step.
pub const STEP_SPACING: Duration = Duration::from_secs(2);
/// Least time between two log records of a time that is not believed.
pub const WARN_PERIOD: Duration = Duration::from_secs(60);
/// How well the messages that confirm a step must agree.
const STEP_AGREEMENT_US: u64 = 250_000;
/// 2020-01-01 and 2200-01-01 in Unix milliseconds: what lies outside is not a date but a fault.
const PLAUSIBLE_MS: core::ops::Range<u64> = 1_577_836_800_000..7_258_118_400_000;

/// Offset of Unix time from the monotonic clock in microseconds, and when it was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Bound {
    offset_us: i64,
    at: Instant,
}

impl Bound {
    fn of(server_ms: u64, now: Instant) -> Self {
        // Both fit: plausible dates stay below 2^53 µs, and a robot does not run for 292,000 years.
        let server_us = (server_ms * 1_000) as i64;
        let now_us = i64::try_from(now.as_micros()).unwrap_or(i64::MAX);
        Self {
            offset_us: server_us.saturating_sub(now_us),
            at: now,
        }
    }

    /// What the bound is still worth at `now`, after possible drift.
    fn worth(self, now: Instant) -> i64 {
        let age = (now - self.at).as_micros();
        let drift = age / 1_000_000 * DRIFT_PPM + age % 1_000_000 * DRIFT_PPM / 1_000_000;
        self.offset_us
            .saturating_sub(i64::try_from(drift).unwrap_or(i64::MAX))
    }
}

/// Bounds that disagree with the held one but perhaps with each other do not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Step {
    best: Bound,
    last: Instant,
    agreeing: u8,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct State {
    held: Option<Bound>,
    step: Option<Step>,
    /// When a message last agreed with the held bound.
    heard: Instant,
    /// Messages that made or agreed with the held bound, up to [`STEP_CONFIRMATIONS`].
    agreed: u8,
    /// When someone was last told of a time that is not believed.
    warned: Option<Instant>,
}

/// What became of a time message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Observation {
    /// It is the least delayed so far, or the first.
    Adopted,
    /// It agrees; a better one is held.
    Confirmed,
    /// It is far off; more of its kind are needed before the clock is moved.
    Doubted,
    /// Enough of its kind came: the clock was moved.
    Stepped,
    /// It is no date.
    Implausible,
}

/// Unix time as far as the robot knows it.
pub struct TimeSync<M: RawMutex> {
    state: Mutex<M, Cell<State>>,
}

impl<M: RawMutex> TimeSync<M> {
    /// A clock that has heard nothing yet.
    pub const fn new() -> Self {
        Self {
            state: Mutex::new(Cell::new(State {
                held: None,
                step: None,
                heard: Instant::BOOT,
                agreed: 0,
                warned: None,
            })),
        }
    }

    /// Takes in a time message that carried `server_ms` (Unix milliseconds) and arrived at `now`.
    pub fn observe(&self, server_ms: u64, now: Instant) -> Observation {
        if !PLAUSIBLE_MS.contains(&server_ms) {
            return Observation::Implausible;
        }
        self.state.lock(|cell| {
            let mut state = cell.get();
            let observation = state.observe(Bound::of(server_ms, now), now);
            cell.set(state);
            observation
        })
    }

    /// Moves the clock by so many milliseconds, as a fault does; what was heard of another time
    /// is forgotten. Does nothing before the first message.
    pub fn jump(&self, ms: i64) {
        self.state.lock(|cell| {
            let mut state = cell.get();
            if let Some(held) = &mut state.held {
                held.offset_us = held.offset_us.saturating_add(ms.saturating_mul(1_000));
                state.step = None;
                // A clock that is off is not young: it is moved back only by messages that agree.
                state.agreed = STEP_CONFIRMATIONS;
                cell.set(state);
            }
        });
    }

    /// Whether to tell of a time that is not believed: once in [`WARN_PERIOD`].
    pub fn may_warn(&self, now: Instant) -> bool {
        self.state.lock(|cell| {
            let mut state = cell.get();
            let due = state.warned.is_none_or(|told| now - told >= WARN_PERIOD);
            if due {
                state.warned = Some(now);
                cell.set(state);
            }
            due
        })
    }

    /// Unix time in milliseconds at `now`; `None` before the first message, and when none that
    /// agrees has been heard for [`VALID_FOR`].
    pub fn unix_ms(&self, now: Instant) -> Option<u64> {
        let state = self.state.lock(Cell::get);
        let held = state.held?;
        if now - state.heard > VALID_FOR {
            return None;
        }
        let now_us = i64::try_from(now.as_micros()).unwrap_or(i64::MAX);
        u64::try_from(held.offset_us.saturating_add(now_us) / 1_000).ok()
    }
}

impl<M: RawMutex> Default for TimeSync<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl State {
    fn observe(&mut self, new: Bound, now: Instant) -> Observation {
        let Some(held) = self.held.filter(|_| now - self.heard <= VALID_FOR) else {
            self.agreed = 1;
            return self.adopt(new, now, Observation::Adopted);
        };
        let worth = held.worth(now);
        let ahead = new.offset_us >= worth;
        let young = self.agreed < STEP_CONFIRMATIONS;
        if new.offset_us.abs_diff(worth) > STEP.as_micros() && !(ahead && young) {
            return self.doubt(new, now);
        }
        self.step = None;
        self.agreed = self.agreed.saturating_add(1).min(STEP_CONFIRMATIONS);
        if ahead {
            self.adopt(new, now, Observation::Adopted)
        } else {
            self.heard = now;
            Observation::Confirmed
        }
    }

    fn adopt(&mut self, new: Bound, now: Instant, observation: Observation) -> Observation {
        self.held = Some(new);
        self.step = None;
        self.heard = now;
        observation
    }

    fn doubt(&mut self, new: Bound, now: Instant) -> Observation {
        let agreeing = self
            .step
            .filter(|step| new.offset_us.abs_diff(step.best.worth(now)) <= STEP_AGREEMENT_US);
        let Some(mut step) = agreeing else {
            self.step = Some(Step {
                best: new,
                last: now,
                agreeing: 1,
            });
            return Observation::Doubted;
        };
        if now - step.last < STEP_SPACING {
            return Observation::Doubted;
        }
        step.last = now;
        step.agreeing += 1;
        if new.offset_us >= step.best.worth(now) {
            step.best = new;
        }
        if step.agreeing < STEP_CONFIRMATIONS {
            self.step = Some(step);
            return Observation::Doubted;
        }
        self.agreed = STEP_CONFIRMATIONS;
        self.adopt(step.best, now, Observation::Stepped)
    }
}

#[cfg(test)]
#[path = "timesync_tests.rs"]
mod tests;
