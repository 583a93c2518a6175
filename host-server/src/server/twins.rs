//! The twins of the fleet, on a thread of their own.

use std::sync::Arc;
use std::time::Instant;

use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use super::StartError;
use super::parts::{PATIENCE, Parts};
use super::storage::Storage;
use crate::config::Settings;
use crawler_fleet::{Level, SharedFleet};
use crawler_system::clock;
use crawler_twins::Twins;
use crawler_twins::notice::Notice;

/// Where certificates are, in the data directory.
const FOLDER: &str = "twins";

/// Starts what steps the twins, where there are to be any.
pub(super) fn start(
    settings: &Settings,
    storage: &Storage,
    fleet: &Arc<SharedFleet>,
    parts: &mut Parts,
) -> Result<Arc<Twins>, StartError> {
    let known = Arc::clone(fleet);
    let began = (Instant::now(), clock::unix_ms());
    let folder = settings.data.join(FOLDER);
    let (twins, worker) = Twins::new(settings.twins, folder, began, move |robot| {
        let fleet = known.lock();
        let status = fleet.get(robot)?.status.as_ref()?;
        Some(status.firmware.as_str().to_owned())
    });
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
