//! The robots of the fleet, as rollouts see them.

use std::sync::Arc;

use crawler_fleet::{Presence, Robot, SharedFleet};
use crawler_protocol::open::Open;
use crawler_protocol::{Capability, RobotState};
use crawler_rollouts::{RobotView, Robots};
use crawler_updates::rollout::Busy;

/// Below so many percent a robot is not offered anything: what an update takes of a battery is less.
const LOW_PERCENT: u8 = 20;

/// What is known of the fleet.
pub(super) struct FleetRobots(pub(super) Arc<SharedFleet>);

impl Robots for FleetRobots {
    fn each(&self, show: &mut dyn FnMut(RobotView<'_>)) {
        let fleet = self.0.lock();
        for view in fleet.robots().filter_map(view) {
            show(view);
        }
    }
}

/// A robot whose status is known. One that has said nothing since this server runs, and has time left to do so, is not
/// shown: it is neither there nor gone.
fn view(robot: &Robot) -> Option<RobotView<'_>> {
    let status = robot.status.as_ref()?;
    let gone = robot.presence == Presence::Offline;
    if robot.last_seen.is_none() && !gone {
        return None;
    }
    Some(RobotView {
        robot: &robot.id,
        board: &status.board,
        kind: status.kind.known()?,
        vision: status.capabilities.contains(&Capability::Vision.into()),
        policies: status.capabilities.contains(&Capability::Policies.into()),
        // Programs from before there were builds tell their version alone.
        build: match &status.build {
            Some(build) => build.as_str(),
            None => &status.firmware,
        },
        models: &status.models,
        boot: status.boot.count,
        online: !gone,
        busy: busy(robot),
    })
}

/// Why a robot is not offered anything just now. Whatever else it has against that it says itself.
fn busy(robot: &Robot) -> Option<Busy> {
    use RobotState::{Avoiding, Caution, Error, Idle, Initializing, Moving, Scanning, Updating};
    match robot.state() {
        Some(Open::Known(Moving | Scanning | Caution | Avoiding)) => return Some(Busy::Driving),
        Some(Open::Known(Initializing | Idle | Updating | Error) | Open::Unknown(_)) | None => {}
    }
    let telemetry = robot.telemetry.as_ref()?;
    (telemetry.battery.percent < LOW_PERCENT).then_some(Busy::LowBattery)
}
