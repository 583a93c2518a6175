//! Calibrations of the fleet's robots.

use std::sync::{Arc, OnceLock};

use crawler_calibrations::ground::{Border, Ground, Region};
use crawler_calibrations::robots::{AROUND_M, Fleet, RobotView, SOURCE};
use crawler_calibrations::{Calibrations, Parts as CalibrationParts};
use crawler_commands::{CommandCenter, Target};
use crawler_fleet::{Fence, FenceKind, Level, Presence, Robot, SharedFleet};
use crawler_protocol::open::Open;
use crawler_protocol::{
    Action, BehaviourName, Capability, Kind, ParameterValue, ParameterValues, RobotId, Source,
};
use crawler_simulations::Simulation;
use crawler_system::clock::unix_ms;
use tokio::runtime::Handle;

use super::StartError;
use super::hub::Hub;
use crate::config::Settings;
use crate::room::room;

/// Where calibrations are kept, in the data directory.
const FOLDER: &str = "calibrations";
/// For a word of driving to reach its robot: afterwards there is another one.
const WORD_MS: u64 = 400;
/// The same for a stop.
const STOP_MS: u64 = 2_000;

/// What calibrations know of the fleet, and tell it.
struct FleetOf {
    fleet: Arc<SharedFleet>,
    commands: Arc<CommandCenter>,
    simulation: Arc<OnceLock<Arc<Simulation>>>,
    source: Source,
    runtime: Handle,
}

/// Calibrations of this server, and those that it has carried out before.
pub(super) fn open(settings: &Settings, hub: &Hub) -> Result<Arc<Calibrations>, StartError> {
    let fleet = Arc::new(FleetOf {
        fleet: Arc::clone(&hub.fleet),
        commands: Arc::clone(&hub.commands),
        simulation: Arc::clone(&hub.simulation),
        source: Source::new(SOURCE).map_err(|_| StartError::Internal("source"))?,
        runtime: Handle::current(),
    });
    Ok(Calibrations::open(CalibrationParts {
        folder: settings.data.join(FOLDER),
        twins: Arc::clone(&hub.twins),
        fleet,
        clock: Arc::new(unix_ms),
    }))
}

impl Fleet for FleetOf {
    fn robot(&self, robot: &RobotId) -> Option<RobotView> {
        self.fleet.lock().get(robot).map(view)
    }

    fn others(&self, robot: &RobotId, at: [f64; 2]) -> Vec<(RobotId, [f64; 2])> {
        let fleet = self.fleet.lock();
        let others = fleet.robots().filter(|other| other.id != *robot);
        let there = others.filter(|other| other.presence != Presence::Offline);
        there
            .filter_map(|other| {
                let pose = other.telemetry.as_ref()?.pose;
                let place = [pose.x, pose.y].map(f64::from);
                let is_near = (place[0] - at[0]).hypot(place[1] - at[1]) < AROUND_M;
                is_near.then(|| (other.id.clone(), place))
            })
            .collect()
    }

    fn ground(&self, robot: &RobotId, at: [f64; 2]) -> Ground {
        let (fences, is_simulated) = {
            let fleet = self.fleet.lock();
            let status = fleet.get(robot).and_then(|known| known.status.as_ref());
            let is_simulated =
                status.is_some_and(|status| status.kind == Open::Known(Kind::Simulated));
            let fences = fleet.fences().iter().map(Arc::clone).map(border);
            (fences.collect(), is_simulated)
        };
        let world = self.simulation.get().filter(|_| is_simulated);
        Ground {
            fences,
            area: None,
            room: world.map(|world| {
                let mut room = room(&world.scene().arena);
                room.solids.retain(|solid| solid.distance(at) < AROUND_M);
                room
            }),
        }
    }

    fn drive(&self, robot: &RobotId, v: f64, w: f64) -> bool {
        let (v, w) = (v as f32, w as f32);
        let source = self.source.clone();
        let asked = self
            .commands
            .ask(source, Action::Drive { v, w }, robot, WORD_MS);
        asked.is_ok()
    }

    fn stop(&self, robot: &RobotId) {
        let source = self.source.clone();
        // Without it the robot stands half a second after its last word.
        if let Err(error) = self.commands.ask(source, Action::Stop, robot, STOP_MS) {
            tracing::warn!(?error, %robot, "a robot is not told to stop");
        }
    }

    fn set_rate(&self, robot: &RobotId, hz: f32) {
        let Some(values) = rate(hz) else {
            return;
        };
        let commands = Arc::clone(&self.commands);
        let (source, robot) = (self.source.clone(), robot.clone());
        self.runtime.spawn(async move {
            let target = Target::Robot(robot.clone());
            let given = commands.give(Some(source), Action::Set(values), target, vec![robot]);
            if let Err(error) = given.await {
                tracing::warn!(?error, "a robot is not told how often to tell telemetry");
            }
        });
    }

    fn tell(&self, robot: &RobotId, is_bad: bool, text: String) {
        let level = if is_bad { Level::Warn } else { Level::Info };
        let mut fleet = self.fleet.lock();
        fleet.events.push(level, Some(robot.clone()), text);
    }
}

/// What a fence encloses.
#[derive(Debug)]
struct Fenced(Arc<Fence>);

impl Region for Fenced {
    fn holds(&self, at: [f64; 2]) -> bool {
        self.0.shape.holds(at)
    }

    fn to_edge(&self, at: [f64; 2]) -> f64 {
        self.0.shape.to_edge(at)
    }
}

fn border(fence: Arc<Fence>) -> Border {
    Border {
        name: fence.name.clone(),
        keeps_in: fence.kind == FenceKind::KeepIn,
        region: Arc::new(Fenced(fence)),
    }
}

/// The parameter that says how often a robot tells telemetry.
fn rate(hz: f32) -> Option<ParameterValues> {
    let mut values = ParameterValues::new();
    let name = "telemetry_hz".try_into().ok()?;
    values.push((name, ParameterValue::Number(hz))).ok()?;
    Some(values)
}

fn view(robot: &Robot) -> RobotView {
    let status = robot.status.as_ref();
    let telemetry = robot.telemetry.as_ref();
    let parameter = |name: &str| {
        let told = robot.parameters.as_ref()?;
        let report = told.values.iter().find(|report| report.name == name)?;
        match report.value {
            ParameterValue::Number(value) => Some(value),
            ParameterValue::Bool(_) | ParameterValue::Text(_) => None,
        }
    };
    let known = |state: Open<_>| match state {
        Open::Known(state) => Some(state),
        Open::Unknown(_) => None,
    };
    RobotView {
        is_online: robot.presence == Presence::Online,
        is_doubled: robot.has_double(),
        drives: status.is_some_and(|status| {
            status
                .capabilities
                .contains(&Open::Known(Capability::Drive))
        }),
        state: robot.state().and_then(known),
        behaviour: telemetry
            .map(|told| told.behaviour)
            .filter(|behaviour| *behaviour != Open::Known(BehaviourName::Manual))
            .map(|behaviour| behaviour.to_string()),
        boot: status.map_or(0, |status| status.boot.count),
        firmware: status.map_or_else(String::new, |status| status.firmware.as_str().to_owned()),
        max_speed: parameter("max_speed"),
        max_turn: parameter("max_turn"),
        telemetry_hz: parameter("telemetry_hz"),
    }
}
