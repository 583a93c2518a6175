//! Outside position references, from `{fleet}/pose/{id}` to control.
//!
//! A fix is taken when it names this robot, is within the [`FARTHEST`] and [`VAGUEST`] a robot can
//! make sense of, and is of this moment: once the clock is synchronised, not older than
//! [`FRESH_FOR`], not further in the future than [`AHEAD`], and newer than the last one. Without
//! a clock it counts as seen when it arrived. Only the newest waits for control, which weighs it
//! against odometry (see [`crate::motion::Odometry::correct`]); what is refused is counted, and
//! told at most every [`TOLD_EVERY`].
//!
//! A fix moves the estimate, never the robot: no state and no duty depends on its arrival.

use core::cell::Cell;
use core::f32::consts::TAU;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Pose, PoseFix, RobotId};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

/// Age from which a fix is useless: at half a metre per second the robot is elsewhere.
pub const FRESH_FOR: Duration = Duration::from_millis(1_000);
/// How far in the future a fix may lie: the robot's clock runs late by the delay of the time
/// messages, and that of the tracker may be off by a little.
pub const AHEAD: Duration = Duration::from_millis(250);
/// Farthest place a fix may name, in metres along each axis: what `goto` can lead to.
pub const FARTHEST: f32 = 1_000.0;
/// Greatest sigma that is a reference at all, in metres.
pub const VAGUEST: f32 = 10.0;
/// Least time between two log records about refused fixes.
pub const TOLD_EVERY: Duration = Duration::from_secs(10);

/// An outside position reference that passed every check that needs no odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// Where the robot was seen, and how surely.
    pub pose: Pose,
    /// When it was seen, on the robot's own clock.
    pub seen: Instant,
}

/// Why a fix was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// It is no fix.
    Malformed,
    /// It is about another robot.
    OtherRobot,
    /// No robot is there, or no such sigma means anything.
    OutOfRange,
    /// It is older than [`FRESH_FOR`].
    Stale,
    /// It is further in the future than [`AHEAD`].
    Future,
    /// A newer one, or itself, was taken already.
    Repeated,
}

impl Refusal {
    /// Name in log records.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Malformed => "malformed",
            Self::OtherRobot => "about another robot",
            Self::OutOfRange => "out of range",
            Self::Stale => "stale",
            Self::Future => "from the future",
            Self::Repeated => "repeated",
        }
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct State {
    /// Waits for control.
    newest: Option<Fix>,
    /// When the last one that was taken had been seen.
    last_seen: Option<Instant>,
    refused: u32,
    /// How many had been refused at the last log record, and when that was.
    told: Option<(u32, Instant)>,
}

/// The hand-over of fixes from link to control.
pub(crate) struct Tracking<M: RawMutex> {
    state: Mutex<M, Cell<State>>,
}

impl<M: RawMutex> Tracking<M> {
    pub(crate) const fn new() -> Self {
        Self {
            state: Mutex::new(Cell::new(State {
                newest: None,
                last_seen: None,
                refused: 0,
                told: None,
            })),
        }
    }

    /// Whether one waits.
    pub(crate) fn waits(&self) -> bool {
        self.with(|state| state.newest.is_some())
    }

    /// The newest fix that was not taken yet.
    pub(crate) fn take(&self) -> Option<Fix> {
        self.with(|state| state.newest.take())
    }

    /// Takes in the payload of a message on the pose topic of the robot `own`, at `now` and by its
    /// clock at `unix` ms.
    ///
    /// # Errors
    /// Why it was refused; that is counted here already.
    pub(crate) fn observe(
        &self,
        payload: &[u8],
        own: &RobotId,
        unix: Option<u64>,
        now: Instant,
    ) -> Result<(), Refusal> {
        let result = self.check(payload, own, unix, now);
        self.with(|state| match result {
            Ok(fix) => {
                state.newest = Some(fix);
                state.last_seen = Some(fix.seen);
            }
            Err(_) => state.refused = state.refused.saturating_add(1),
        });
        result.map(|_| ())
    }

    /// How many were refused so far.
    pub(crate) fn refused(&self) -> u32 {
        self.with(|state| state.refused)
    }

    /// How many were refused since that was told last, when it is time to tell it again.
    pub(crate) fn refusals_to_tell(&self, now: Instant) -> Option<u32> {
        self.with(|state| {
            let (before, due) = match state.told {
                Some((before, at)) => (before, now - at >= TOLD_EVERY),
                None => (0, true),
            };
            due.then(|| {
                state.told = Some((state.refused, now));
                state.refused - before
            })
        })
    }

    fn check(
        &self,
        payload: &[u8],
        own: &RobotId,
        unix: Option<u64>,
        now: Instant,
    ) -> Result<Fix, Refusal> {
        let fix = PoseFix::from_json(payload).map_err(|_| Refusal::Malformed)?;
        if fix.robot != *own {
            return Err(Refusal::OtherRobot);
        }
        let pose = fix.pose;
        let there = |value: f32| libm::fabsf(value) <= FARTHEST;
        // Written so that what is not a number fails.
        if !(there(pose.x)
            && there(pose.y)
            && libm::fabsf(pose.theta) <= TAU
            && (0.0..=VAGUEST).contains(&pose.sigma))
        {
            return Err(Refusal::OutOfRange);
        }
        let seen = match unix {
            None => now,
            Some(unix) => {
                if fix.timestamp > unix.saturating_add(AHEAD.as_millis()) {
                    return Err(Refusal::Future);
                }
                let age = unix.saturating_sub(fix.timestamp);
                if age > FRESH_FOR.as_millis() {
                    return Err(Refusal::Stale);
                }
                Instant::from_micros(now.as_micros().saturating_sub(age * 1_000))
            }
        };
        let last = self.with(|state| state.last_seen);
        if last.is_some_and(|last| seen <= last) {
            return Err(Refusal::Repeated);
        }
        Ok(Fix { pose, seen })
    }

    fn with<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        self.state.lock(|cell| {
            let mut state = cell.get();
            let result = change(&mut state);
            cell.set(state);
            result
        })
    }
}

#[cfg(test)]
#[path = "tracking_tests.rs"]
mod tests;
