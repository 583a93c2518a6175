//! What can be told to a live world, what it says to that, and the watch it goes by.

use std::fmt;
use std::time::Instant as Real;

use crawler_hal::Instant;
use crawler_protocol::RobotId;
use crawler_sim_protocol::SimulatorCommand;
use tokio::sync::oneshot;

use crate::run::control::Factor;

/// Orders that may wait; one more is refused.
pub(super) const MAX_ORDERS: usize = 64;

/// How a live world is, as far as it can be told what to do.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct LiveState {
    /// Whether it stands still.
    pub paused: bool,
    /// How many times as fast as real time it is to run.
    pub factor: f64,
    /// Time since its beginning.
    pub time: Instant,
    /// Its seed.
    pub seed: u64,
    /// Robots in it.
    pub robots: u32,
    /// Fingerprint of its history at the end of the last whole second; 0 before there is one.
    /// Live worlds do not repeat it: their robots' messages take as long as they take.
    pub hash: u64,
}

/// What came of an order.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LiveDone {
    /// How the world is now.
    pub state: LiveState,
    /// The robot that was added.
    pub robot: Option<RobotId>,
    /// The number of what was dropped.
    pub item: Option<u32>,
}

/// Why a live world does not do what it is told.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum ControlError {
    /// Too many orders are waiting.
    Busy,
    /// The world has ended.
    Ended,
    /// There is no such robot.
    NoRobot,
    /// It cannot be done, and why.
    Refused(String),
}

impl fmt::Display for ControlError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Busy => f.write_str("too many orders are waiting"),
            Self::Ended => f.write_str("the world has ended"),
            Self::NoRobot => f.write_str("there is no such robot in the world"),
            Self::Refused(text) => f.write_str(text),
        }
    }
}

impl std::error::Error for ControlError {}

pub(super) type Answer = oneshot::Sender<Result<LiveDone, ControlError>>;

/// Something a live world is to do.
#[derive(Debug)]
pub(super) struct Order {
    pub(super) command: SimulatorCommand,
    pub(super) answer: Answer,
}

/// Real time as the world is to follow it: at a factor, and with pauses left out.
#[derive(Debug)]
pub(super) struct Watch {
    base: Instant,
    since: Real,
    factor: Factor,
    paused: bool,
}

impl Watch {
    pub(super) fn start(now: Real) -> Self {
        Self {
            base: Instant::BOOT,
            since: now,
            factor: Factor::REAL_TIME,
            paused: false,
        }
    }

    pub(super) fn is_paused(&self) -> bool {
        self.paused
    }

    pub(super) fn factor(&self) -> f64 {
        self.factor.get()
    }

    pub(super) fn read(&self, now: Real) -> Instant {
        if self.paused {
            return self.base;
        }
        self.base + self.factor.of(now.saturating_duration_since(self.since))
    }

    /// When the watch will show `due`; `None` while it stands, or far too late to matter.
    pub(super) fn when(&self, due: Instant) -> Option<Real> {
        if self.paused || due == Instant::FAR_FUTURE {
            return None;
        }
        let span = due.saturating_since(self.base).as_micros() as f64 / self.factor.get();
        let span = std::time::Duration::try_from_secs_f64(span * 1e-6).ok()?;
        self.since.checked_add(span)
    }

    fn settle(&mut self, now: Real) {
        self.base = self.read(now);
        self.since = now;
    }

    pub(super) fn set_factor(&mut self, factor: Factor, now: Real) {
        self.settle(now);
        self.factor = factor;
    }

    pub(super) fn set_paused(&mut self, paused: bool, now: Real) {
        self.settle(now);
        self.paused = paused;
    }

    /// Shows `base` from now on: the world went there by itself.
    pub(super) fn put(&mut self, base: Instant, now: Real) {
        self.base = base;
        self.since = now;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration as StdDuration;

    #[test]
    fn a_watch_leaves_pauses_out_and_runs_at_its_factor() {
        let begun = Real::now();
        let after = |ms| begun + StdDuration::from_millis(ms);
        let mut watch = Watch::start(begun);
        assert_eq!(watch.read(after(250)), Instant::from_millis(250));
        watch.set_factor(Factor::new(4.0).expect("usable"), after(1_000));
        assert_eq!(watch.read(after(1_500)), Instant::from_millis(3_000));
        assert_eq!(watch.when(Instant::from_millis(5_000)), Some(after(2_000)));
        watch.set_paused(true, after(2_000));
        assert_eq!(watch.read(after(60_000)), Instant::from_millis(5_000));
        assert_eq!(watch.when(Instant::from_millis(6_000)), None);
        watch.put(Instant::from_millis(5_010), after(61_000));
        watch.set_paused(false, after(62_000));
        assert_eq!(watch.read(after(62_500)), Instant::from_millis(7_010));
        assert_eq!(watch.when(Instant::FAR_FUTURE), None);
    }
}
