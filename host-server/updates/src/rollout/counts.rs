//! How far a rollout is, in numbers, for the API and the page.

use std::collections::BTreeMap;

use serde::Serialize;
use utoipa::ToSchema;

use super::engine::Rollout;
use super::event::Now;
use super::judge::Tally;
use super::progress::{PhaseState, RolloutState};
use super::robot::UpdateState;

/// A phase in numbers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = RolloutPhaseCounts)]
pub struct PhaseCounts {
    /// Where it stands.
    pub state: PhaseState,
    /// Its robots by state; those that no robot is in are left out.
    #[schema(value_type = BTreeMap<String, u32>)]
    pub robots: BTreeMap<UpdateState, u32>,
    /// Failures that count, and at how many of them the rollout stops by itself.
    pub failures: u32,
    /// See [`PhaseCounts::failures`].
    pub most_failures: u32,
    /// Robots that came to an end per hour, since the phase began.
    pub ended_per_hour: u32,
    /// Seconds until the last robot that can be reached is done, as it went so far. None before the first robot
    /// is done, and when nobody is left.
    pub left_s: Option<u64>,
}

/// A rollout in numbers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = RolloutCounts)]
pub struct Counts {
    /// Where it stands.
    pub state: RolloutState,
    /// The phase that is served, from 0.
    pub phase: u8,
    /// Its phases.
    pub phases: Vec<PhaseCounts>,
    /// All robots by state; those that no robot is in are left out.
    #[schema(value_type = BTreeMap<String, u32>)]
    pub robots: BTreeMap<UpdateState, u32>,
    /// Bytes of images that robots have.
    pub bytes: u64,
    /// Seconds since it began.
    pub elapsed_s: u64,
}

impl Rollout {
    /// Counts.
    #[must_use]
    pub fn counts(&self, now: Now) -> Counts {
        let document = &self.document;
        let at = self.now_ms(now);
        let tallies = self.roster.tallies();
        let phases = tallies
            .iter()
            .zip(&document.phases)
            .zip(&document.plan.phases);
        let phases = phases.map(|((tally, &state), planned)| {
            let time_ms = match state {
                PhaseState::Pending => 0,
                PhaseState::Active { since_ms } | PhaseState::Soaking { since_ms, .. } => {
                    at.saturating_sub(since_ms)
                }
                PhaseState::Passed { since_ms, at_ms } => at_ms.saturating_sub(since_ms),
            };
            PhaseCounts {
                state,
                robots: by_state(|state| tally.count(state)),
                failures: tally.failures(),
                most_failures: planned.most_failures(tally.members()),
                ended_per_hour: per_hour(u64::from(tally.ended()), time_ms),
                left_s: left_s(tally, time_ms),
            }
        });
        let phases = phases.collect();
        let robots = by_state(|state| {
            let counted: u32 = tallies.iter().map(|tally| tally.count(state)).sum();
            match state {
                UpdateState::NotApplicable => self.roster.not_applicable(),
                _ => counted,
            }
        });
        Counts {
            state: document.state,
            phase: document.phase,
            phases,
            robots,
            bytes: tallies.iter().map(Tally::bytes).sum(),
            elapsed_s: at / 1_000,
        }
    }
}

fn by_state(count: impl Fn(UpdateState) -> u32) -> BTreeMap<UpdateState, u32> {
    let counted = UpdateState::ALL.map(|state| (state, count(state)));
    counted
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .collect()
}

fn per_hour(ended: u64, time_ms: u64) -> u32 {
    let hour = ended.saturating_mul(3_600_000);
    u32::try_from(hour / time_ms.max(1)).unwrap_or(u32::MAX)
}

fn left_s(tally: &Tally, time_ms: u64) -> Option<u64> {
    let left = u64::from(tally.ready() + tally.sum(UpdateState::is_in_flight));
    let ended = u64::from(tally.ended());
    if left == 0 || ended == 0 {
        return None;
    }
    Some(time_ms.saturating_mul(left) / ended / 1_000)
}
