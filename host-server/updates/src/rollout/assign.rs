//! Which release and which phase are a robot's.

use std::collections::{BTreeMap, BTreeSet};

use crawler_protocol::RobotId;

use super::event::Sighting;
use super::names::RolloutId;
use super::plan::{Plan, Replaced, Selection};
use super::rank::rank;
use super::robot::{Reason, RobotRow, UpdateState};

/// The rows of a fleet at the beginning of a rollout.
pub(super) fn assign(plan: &Plan, id: &RolloutId, fleet: &[Sighting]) -> Vec<RobotRow> {
    let fleet: BTreeMap<&RobotId, &Sighting> =
        fleet.iter().map(|seen| (&seen.robot, seen)).collect();
    let mut order: Vec<&RobotId> = fleet
        .values()
        .filter_map(|seen| suited(plan, seen))
        .collect();
    order.sort_by_key(|robot| (rank(id, robot), *robot));
    let place: BTreeMap<&RobotId, usize> = order
        .iter()
        .enumerate()
        .map(|(at, robot)| (*robot, at))
        .collect();
    let select = Select::new(plan);
    let rows = fleet.values().map(|seen| {
        let in_share = |percent: u8| {
            let most = (order.len() * usize::from(percent)).div_ceil(100);
            place.get(&seen.robot).is_some_and(|place| *place < most)
        };
        row(plan, seen, select.phase(seen, in_share))
    });
    rows.collect()
}

/// The row of a robot that turns up later. Shares were counted without it: it belongs to one of 100 %, and to no
/// smaller one. It waits for the phase `current` at least.
pub(super) fn join(plan: &Plan, current: u8, seen: &Sighting) -> RobotRow {
    let phase = Select::new(plan).phase(seen, |percent| percent == 100);
    row(plan, seen, phase.map(|phase| phase.max(current)))
}

fn suited<'a>(plan: &Plan, seen: &'a Sighting) -> Option<&'a RobotId> {
    release(plan, seen).map(|_| &seen.robot)
}

fn release(plan: &Plan, seen: &Sighting) -> Option<u8> {
    let at = suiting(plan, seen).ok()?;
    u8::try_from(at).ok()
}

/// The release that is for a robot, or why there is none.
fn suiting(plan: &Plan, seen: &Sighting) -> Result<usize, Reason> {
    let mut releases = plan.releases.iter();
    let at = releases.position(|release| release.suits(&seen.board, seen.kind));
    match at {
        Some(at) => match plan.replaces() {
            Some(Replaced::Model(_)) if !seen.vision => Err(Reason::NoVision),
            Some(Replaced::Policy) if !seen.policies => Err(Reason::NoPolicies),
            Some(Replaced::Program | Replaced::Model(_) | Replaced::Policy) | None => Ok(at),
        },
        None => Err(Reason::NoRelease),
    }
}

fn row(plan: &Plan, seen: &Sighting, phase: Option<u8>) -> RobotRow {
    let mut row = RobotRow::new(seen.robot.clone());
    row.release = release(plan, seen);
    row.boot = seen.boot;
    row.phase = phase.filter(|_| row.release.is_some());
    if row.phase.is_none() {
        row.state = UpdateState::NotApplicable;
        row.reason = Some(suiting(plan, seen).err().unwrap_or(Reason::NotSelected));
    }
    row
}

/// The phases of a plan, with groups that are looked up.
struct Select<'a> {
    plan: &'a Plan,
    groups: Vec<BTreeSet<&'a RobotId>>,
}

impl<'a> Select<'a> {
    fn new(plan: &'a Plan) -> Self {
        let groups = plan.phases.iter().map(|phase| match &phase.select {
            Selection::Group(robots) => robots.iter().collect(),
            Selection::Share(_) | Selection::Board(_) | Selection::Kind(_) => BTreeSet::new(),
        });
        Self {
            plan,
            groups: groups.collect(),
        }
    }

    /// The first phase that selects a robot.
    fn phase(&self, seen: &Sighting, in_share: impl Fn(u8) -> bool) -> Option<u8> {
        let mut phases = self.plan.phases.iter().zip(&self.groups);
        let at = phases.position(|(phase, group)| match &phase.select {
            Selection::Share(percent) => in_share(*percent),
            Selection::Group(_) => group.contains(&seen.robot),
            Selection::Board(board) => *board == seen.board,
            Selection::Kind(kind) => *kind == seen.kind,
        });
        at.and_then(|at| u8::try_from(at).ok())
    }
}
