//! Whether a phase goes on, passes, or stops the rollout.

use super::plan::Phase;
use super::progress::PauseReason;
use super::robot::{RobotRow, UpdateState};

/// Failures that stop a rollout, however few robots a phase has.
pub const LEAST_FAILURES: u32 = 2;

/// The robots of a phase, counted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Tally {
    states: [u32; UpdateState::ALL.len()],
    /// Failures that do not count any more.
    forgiven: u32,
    /// Robots that wait for the rollout, not for themselves.
    ready: u32,
    /// Bytes that its robots have.
    bytes: u64,
}

impl Tally {
    /// Counts a robot in.
    pub(super) fn add(&mut self, row: &RobotRow, ready: bool) {
        self.states[row.state as usize] += 1;
        self.forgiven += u32::from(row.state.is_failure() && row.forgiven);
        self.ready += u32::from(ready);
        self.bytes += u64::from(row.received);
    }

    /// Takes back what [`Tally::add`] did.
    pub(super) fn remove(&mut self, row: &RobotRow, ready: bool) {
        self.states[row.state as usize] -= 1;
        self.forgiven -= u32::from(row.state.is_failure() && row.forgiven);
        self.ready -= u32::from(ready);
        self.bytes -= u64::from(row.received);
    }

    /// How many are in that state.
    pub(super) const fn count(&self, state: UpdateState) -> u32 {
        self.states[state as usize]
    }

    /// How many are in a state of which `which` says yes.
    pub(super) fn sum(&self, which: impl Fn(UpdateState) -> bool) -> u32 {
        let states = UpdateState::ALL.into_iter().filter(|state| which(*state));
        states.map(|state| self.count(state)).sum()
    }

    /// Robots that wait for the rollout, not for themselves.
    pub(super) const fn ready(&self) -> u32 {
        self.ready
    }

    /// Bytes that its robots have.
    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Failures that count.
    pub(super) fn failures(&self) -> u32 {
        self.sum(UpdateState::is_failure) - self.forgiven
    }

    /// Robots that came to an end which says something about the release.
    pub(super) fn ended(&self) -> u32 {
        self.count(UpdateState::Confirmed) + self.failures()
    }

    /// Robots that count: all but those left out, those of a newer rollout, and forgiven failures.
    pub(super) fn members(&self) -> u32 {
        let left_out = [UpdateState::Skipped, UpdateState::Superseded];
        self.sum(|state| !left_out.contains(&state)) - self.forgiven
    }

    /// Whether no robot is at work or waits for the rollout.
    fn is_idle(&self) -> bool {
        self.ready == 0 && self.sum(UpdateState::is_in_flight) == 0
    }
}

/// What becomes of a phase.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Not all has been seen yet.
    GoOn,
    /// What can be done is done, and it is good.
    Pass,
    /// The rollout stops.
    Stop(PauseReason),
}

impl Phase {
    /// Failures at which the rollout stops, in a phase of so many robots.
    #[must_use]
    pub fn most_failures(&self, members: u32) -> u32 {
        let share = u64::from(members) * u64::from(self.stop_percent);
        LEAST_FAILURES.max(share.div_ceil(100) as u32)
    }

    /// Judges the phase by its robots.
    pub(super) fn judge(&self, tally: &Tally) -> Verdict {
        let (members, ended, failures) = (tally.members(), tally.ended(), tally.failures());
        let enough = ended >= self.stop_min_count.min(members);
        if enough && failures >= self.most_failures(members) {
            return Verdict::Stop(PauseReason::Failures);
        }
        if !tally.is_idle() || ended < self.min_count.min(members) {
            return Verdict::GoOn;
        }
        let confirmed = u64::from(tally.count(UpdateState::Confirmed));
        if confirmed * 100 >= u64::from(ended) * u64::from(self.success_percent) {
            Verdict::Pass
        } else {
            Verdict::Stop(PauseReason::Threshold)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rollout::plan::Selection;
    use crawler_protocol::RobotId;

    fn tally(counts: &[(UpdateState, u32)], forgiven: u32, ready: u32) -> Tally {
        let mut tally = Tally::default();
        let mut row = RobotRow::new(RobotId::new("a").unwrap());
        for &(state, count) in counts {
            row.state = state;
            for n in 0..count {
                row.forgiven = n < forgiven;
                tally.add(&row, state == UpdateState::Waiting && n < ready);
            }
        }
        tally
    }

    /// How many robots are in which state, how many failures are forgiven, how many robots wait for the rollout,
    /// and what follows.
    type Case<'a> = (&'a [(UpdateState, u32)], u32, u32, Verdict);

    #[test]
    fn phases_are_judged_by_their_robots() {
        use UpdateState::{Confirmed, Failed, RolledBack, Skipped, Trial, Waiting};
        let failures = Verdict::Stop(PauseReason::Failures);
        let threshold = Verdict::Stop(PauseReason::Threshold);
        let phase = Phase {
            select: Selection::Share(10),
            soak_s: 0,
            success_percent: 90,
            min_count: 3,
            stop_percent: 5,
            stop_min_count: 4,
        };
        let cases: &[Case<'_>] = &[
            (&[], 0, 0, Verdict::Pass),
            (&[(Waiting, 5)], 0, 0, Verdict::GoOn),
            (&[(Confirmed, 2)], 0, 0, Verdict::Pass),
            (&[(Confirmed, 2), (Waiting, 1)], 0, 0, Verdict::GoOn),
            (&[(Confirmed, 3), (Waiting, 9)], 0, 0, Verdict::Pass),
            (&[(Confirmed, 3), (Waiting, 9)], 0, 1, Verdict::GoOn),
            (&[(Confirmed, 3), (Trial, 1)], 0, 0, Verdict::GoOn),
            (&[(Confirmed, 1), (Skipped, 9)], 0, 0, Verdict::Pass),
            // One failure of ten is just good enough, of nine it is not.
            (&[(Confirmed, 9), (Failed, 1)], 0, 0, Verdict::Pass),
            (&[(Confirmed, 8), (Failed, 1)], 0, 0, threshold),
            (&[(Failed, 1)], 0, 0, threshold),
            (&[(Failed, 1)], 1, 0, Verdict::Pass),
            // Two stop a small phase, once four have ended, or all.
            (
                &[(RolledBack, 1), (Failed, 1), (Trial, 2)],
                0,
                0,
                Verdict::GoOn,
            ),
            (&[(RolledBack, 1), (Failed, 1)], 0, 0, failures),
            (
                &[(RolledBack, 2), (Confirmed, 2), (Waiting, 9)],
                0,
                9,
                failures,
            ),
            (
                &[(RolledBack, 3), (Confirmed, 2), (Waiting, 9)],
                2,
                9,
                Verdict::GoOn,
            ),
            // 5 % of 60 are three.
            (
                &[(RolledBack, 2), (Confirmed, 2), (Waiting, 56)],
                0,
                9,
                Verdict::GoOn,
            ),
            (
                &[(RolledBack, 3), (Confirmed, 2), (Waiting, 55)],
                0,
                9,
                failures,
            ),
        ];
        for (counts, forgiven, ready, want) in cases {
            let tally = tally(counts, *forgiven, *ready);
            assert_eq!(
                phase.judge(&tally),
                *want,
                "{counts:?}, {forgiven} forgiven"
            );
        }
    }
}
