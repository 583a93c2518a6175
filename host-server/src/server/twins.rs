//! The twins of the fleet, on a thread of their own.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Instant;

use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use super::StartError;
use super::parts::{PATIENCE, Parts};
use super::storage::Storage;
use crate::config::Settings;
use crate::room::room;
use crawler_counterfactuals::Certificates;
use crawler_fleet::{Level, SharedFleet};
use crawler_protocol::open::Open;
use crawler_protocol::{Kind, RobotId};
use crawler_sim::world::Arena;
use crawler_simulations::Simulation;
use crawler_system::clock;
use crawler_twins::notice::Notice;
use crawler_twins::{Fleet, Room, Twins};

/// Where certificates are, in the data directory.
const FOLDER: &str = "twins";

/// What twins are told of robots.
struct Known {
    fleet: Arc<SharedFleet>,
    simulation: Arc<OnceLock<Arc<Simulation>>>,
    /// That of the arena as it was last.
    room: Mutex<Option<(Arc<Arena>, Arc<Room>)>>,
}

impl Fleet for Known {
    fn program(&self, robot: &RobotId) -> Option<String> {
        let fleet = self.fleet.lock();
        let status = fleet.get(robot)?.status.as_ref()?;
        Some(status.firmware.as_str().to_owned())
    }

    fn rooms(&self, robots: &[RobotId]) -> Vec<Option<Arc<Room>>> {
        let Some(simulation) = self.simulation.get() else {
            return vec![None; robots.len()];
        };
        let room = self.room_of(simulation.scene().arena);
        let fleet = self.fleet.lock();
        let is_simulated = |robot: &RobotId| {
            let status = fleet.get(robot).and_then(|known| known.status.as_ref());
            status.is_some_and(|status| status.kind == Open::Known(Kind::Simulated))
        };
        let rooms = robots
            .iter()
            .map(|robot| is_simulated(robot).then(|| Arc::clone(&room)));
        rooms.collect()
    }
}

impl Known {
    /// The room of the arena, which is another one after each change.
    fn room_of(&self, arena: Arc<Arena>) -> Arc<Room> {
        let mut known = self.room.lock().unwrap_or_else(PoisonError::into_inner);
        match &*known {
            Some((of, room)) if Arc::ptr_eq(of, &arena) => Arc::clone(room),
            _ => {
                let room = Arc::new(room(&arena));
                *known = Some((arena, Arc::clone(&room)));
                room
            }
        }
    }
}

/// Starts what steps the twins, where there are to be any.
pub(super) fn start(
    settings: &Settings,
    storage: &Storage,
    fleet: &Arc<SharedFleet>,
    simulation: &Arc<OnceLock<Arc<Simulation>>>,
    parts: &mut Parts,
) -> Result<Arc<Twins>, StartError> {
    let known = Known {
        fleet: Arc::clone(fleet),
        simulation: Arc::clone(simulation),
        room: Mutex::default(),
    };
    let began = (Instant::now(), clock::unix_ms());
    let folder = settings.data.join(FOLDER);
    let (twins, worker) = Twins::new(settings.twins, folder, began, known);
    if !twins.are_on() {
        return Ok(twins);
    }
    let numbers = Arc::clone(&twins);
    storage.metrics.read(move |out| numbers.write_metrics(out));
    let stop = CancellationToken::new();
    let (ends, ended) = oneshot::channel();
    let (stopped, fleet) = (stop.clone(), Arc::clone(fleet));
    let run = move || {
        worker.run(
            || stopped.is_cancelled(),
            clock::unix_ms,
            |notices| tell(&fleet, notices),
        );
        // Nobody waits any more where this fails.
        let _ = ends.send(());
    };
    let thread = std::thread::Builder::new().name("twins".to_owned());
    thread.spawn(run).map_err(StartError::Twins)?;
    parts.add(stop, async move {
        if tokio::time::timeout(PATIENCE, ended).await.is_err() {
            tracing::warn!("the twins do not stop and are left behind");
        }
    })?;
    Ok(twins)
}

/// The certificates that twins go by.
pub(super) fn certificates(twins: &Arc<Twins>) -> Arc<Certificates> {
    let twins = Arc::clone(twins);
    Arc::new(move |robot| {
        let found = twins.certificate(robot, clock::unix_ms())?;
        found.certificate.filter(|_| found.refusal.is_none())
    })
}

/// Makes events of what twins found. Every server of the fleet finds it out by itself.
fn tell(fleet: &SharedFleet, notices: Vec<Notice>) {
    let mut fleet = fleet.lock();
    for Notice {
        robot,
        is_bad,
        text,
    } in notices
    {
        let level = if is_bad { Level::Warn } else { Level::Info };
        fleet.events.heard(level, robot, text);
    }
}
