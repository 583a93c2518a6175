//! What is wrong with a plan.

use std::collections::BTreeSet;
use std::fmt;

use crawler_protocol::RobotId;

use super::names::{BoardName, ReleaseId};
use super::plan::{Phase, Plan, Selection};
use super::window::MOST_OFFSET_MINUTES;

/// Most releases of a rollout.
pub const MOST_RELEASES: usize = 32;
/// Most phases of a rollout.
pub const MOST_PHASES: usize = 32;
/// Most robots of a rollout, and most that its groups name.
pub const MOST_ROBOTS: usize = 20_000;
/// Largest image, in bytes.
pub const MOST_BYTES: u32 = 16 << 20;
/// The lowest limit of bytes per second: what one robot may have asked for and not received.
pub const LEAST_BYTES_PER_SECOND: u32 = 16 << 10;

/// The longest time that a plan may name, in seconds: 90 days.
const MOST_SECONDS: u32 = 90 * 24 * 3_600;
/// The shortest trial, in seconds: robots watch themselves for half of that.
const LEAST_TRIAL_S: u32 = 60;
const MOST_ATTEMPTS: u8 = 10;

/// Why a plan cannot be carried out.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum PlanError {
    /// There must be at least one, and at most so many.
    Count {
        /// Of what.
        what: &'static str,
        /// The most there may be.
        most: usize,
    },
    /// A number is outside of what makes sense.
    Range {
        /// Which.
        what: &'static str,
        /// The lowest that does.
        least: u64,
        /// The highest that does.
        most: u64,
    },
    /// There are robots that both releases suit.
    Overlap(ReleaseId, ReleaseId),
    /// One release brings a program and the other a model, or another model.
    Mixed(ReleaseId, ReleaseId),
    /// A phase by share does not reach beyond the one before it.
    Share(u8),
    /// A robot is named twice.
    Twice(RobotId),
    /// A phase selects what an earlier one has selected.
    Repeated(usize),
    /// No release is for the board, or the kind, of a phase.
    Unserved(usize),
    /// The window is never open.
    NeverOpen,
    /// Robots that run a release of this board refuse one of this sequence.
    Sequence {
        /// The board.
        board: BoardName,
        /// The sequence of the plan.
        sequence: u64,
        /// What it must exceed.
        newest: u64,
    },
}

impl fmt::Display for PlanError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count { what, most } => write!(f, "{what}: at least one, at most {most}"),
            Self::Range { what, least, most } => write!(f, "{what}: from {least} to {most}"),
            Self::Overlap(a, b) => {
                write!(
                    f,
                    "releases {a} and {b} are for the same robots: leave one out"
                )
            }
            Self::Mixed(a, b) => write!(
                f,
                "releases {a} and {b} bring different things: programs, each model, and policies have rollouts of their own"
            ),
            Self::Share(percent) => write!(
                f,
                "a share of {percent} % adds no robot: shares count those of earlier phases, and rise"
            ),
            Self::Twice(robot) => write!(f, "{robot} is named twice"),
            Self::Repeated(phase) => {
                write!(f, "phase {}: an earlier phase selects the same", phase + 1)
            }
            Self::Unserved(phase) => {
                write!(
                    f,
                    "phase {}: no release is for the robots that it selects",
                    phase + 1
                )
            }
            Self::NeverOpen => f.write_str(
                "the window closes when it opens: leave it out for a rollout at any time",
            ),
            Self::Sequence {
                board,
                sequence,
                newest,
            } => write!(
                f,
                "{board}: sequence {sequence} must exceed {newest}, which was released before. An earlier version \
                 goes out again as a new release: sign its image with a sequence of at least {}",
                newest.saturating_add(1)
            ),
        }
    }
}

impl std::error::Error for PlanError {}

fn range(
    what: &'static str,
    value: impl Into<u64>,
    least: u64,
    most: u64,
) -> Result<(), PlanError> {
    if (least..=most).contains(&value.into()) {
        Ok(())
    } else {
        Err(PlanError::Range { what, least, most })
    }
}

fn count(what: &'static str, count: usize, most: usize) -> Result<(), PlanError> {
    if (1..=most).contains(&count) {
        Ok(())
    } else {
        Err(PlanError::Count { what, most })
    }
}

impl Plan {
    /// Whether it can be carried out.
    ///
    /// # Errors
    /// [`PlanError`], the first that is found.
    pub fn check(&self) -> Result<(), PlanError> {
        self.check_releases()?;
        self.check_phases()?;
        self.check_numbers()
    }

    fn check_releases(&self) -> Result<(), PlanError> {
        count("releases", self.releases.len(), MOST_RELEASES)?;
        for (at, release) in self.releases.iter().enumerate() {
            range("bytes of a release", release.bytes, 1, MOST_BYTES.into())?;
            range("sequence", release.sequence, 1, u64::MAX)?;
            if release.model.as_ref() != self.model() || Some(release.replaces()) != self.replaces()
            {
                let (a, b) = (self.releases[0].release.clone(), release.release.clone());
                return Err(PlanError::Mixed(a, b));
            }
            let mut before = self.releases[..at].iter();
            if let Some(other) = before.find(|other| other.overlaps(release)) {
                let (a, b) = (other.release.clone(), release.release.clone());
                return Err(PlanError::Overlap(a, b));
            }
        }
        Ok(())
    }

    fn check_phases(&self) -> Result<(), PlanError> {
        count("phases", self.phases.len(), MOST_PHASES)?;
        let mut share = 0;
        let mut named = BTreeSet::new();
        for (at, phase) in self.phases.iter().enumerate() {
            phase.check()?;
            match &phase.select {
                Selection::Share(percent) => {
                    range("share", *percent, 1, 100)?;
                    if *percent <= share {
                        return Err(PlanError::Share(*percent));
                    }
                    share = *percent;
                }
                Selection::Group(robots) => {
                    count("robots of a group", robots.len(), MOST_ROBOTS)?;
                    for robot in robots {
                        if !named.insert(robot) {
                            return Err(PlanError::Twice(robot.clone()));
                        }
                    }
                    count("robots of all groups", named.len(), MOST_ROBOTS)?;
                }
                Selection::Board(board) => {
                    if !self.releases.iter().any(|one| one.board == *board) {
                        return Err(PlanError::Unserved(at));
                    }
                }
                Selection::Kind(kind) => {
                    let mut kinds = self.releases.iter().map(|one| one.kind);
                    if !kinds.any(|own| own.is_none_or(|own| own == *kind)) {
                        return Err(PlanError::Unserved(at));
                    }
                }
            }
            let mut before = self.phases[..at].iter();
            if before.any(|other| other.select == phase.select) {
                return Err(PlanError::Repeated(at));
            }
        }
        Ok(())
    }

    fn check_numbers(&self) -> Result<(), PlanError> {
        let seconds = |what, value: u32| range(what, value, 1, MOST_SECONDS.into());
        range(
            "limits.parallel",
            self.limits.parallel,
            1,
            MOST_ROBOTS as u64,
        )?;
        if let Some(rate) = self.limits.bytes_per_second {
            let least = LEAST_BYTES_PER_SECOND.into();
            range("limits.bytes_per_second", rate, least, u32::MAX.into())?;
        }
        if let Some(wait) = self.limits.wait_s {
            range("limits.wait_s", wait, 0, MOST_SECONDS.into())?;
        }
        range(
            "retries.attempts",
            self.retries.attempts,
            1,
            MOST_ATTEMPTS.into(),
        )?;
        seconds("retries.pause_s", self.retries.pause_s)?;
        let pause = self.retries.pause_s.into();
        range(
            "retries.longest_pause_s",
            self.retries.longest_pause_s,
            pause,
            MOST_SECONDS.into(),
        )?;
        seconds("retries.deferred_s", self.retries.deferred_s)?;
        let timeouts = &self.timeouts;
        seconds("timeouts.offered_s", timeouts.offered_s)?;
        seconds("timeouts.preparing_s", timeouts.preparing_s)?;
        seconds("timeouts.receiving_s", timeouts.receiving_s)?;
        seconds("timeouts.verifying_s", timeouts.verifying_s)?;
        seconds("timeouts.staged_s", timeouts.staged_s)?;
        let least = LEAST_TRIAL_S.into();
        range(
            "timeouts.trial_s",
            timeouts.trial_s,
            least,
            MOST_SECONDS.into(),
        )?;
        seconds("timeouts.attempt_s", timeouts.attempt_s)?;
        if let Some(window) = &self.window {
            let most = MOST_OFFSET_MINUTES.unsigned_abs();
            let offset = window.offset_minutes.unsigned_abs();
            range("minutes of window.offset_minutes", offset, 0, most.into())?;
            if window.length_ms() == 0 {
                return Err(PlanError::NeverOpen);
            }
        }
        Ok(())
    }
}

impl Phase {
    fn check(&self) -> Result<(), PlanError> {
        range("soak_s", self.soak_s, 0, MOST_SECONDS.into())?;
        range("success_percent", self.success_percent, 1, 100)?;
        range("stop_percent", self.stop_percent, 1, 100)?;
        range("min_count", self.min_count, 1, MOST_ROBOTS as u64)?;
        range("stop_min_count", self.stop_min_count, 1, MOST_ROBOTS as u64)
    }
}

#[cfg(test)]
#[path = "check_tests.rs"]
mod tests;
