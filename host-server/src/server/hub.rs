//! What the parts of a running server share of its fleet.

use std::sync::{Arc, OnceLock};
use std::time::Instant;

use crawler_cluster::ClusterError;
use crawler_protocol::{Action, Source};

use super::StartError;
use super::cluster::{self, OwnLease};
use super::parts::{PATIENCE, Parts};
use super::storage::{OwnFiles, Storage};
use super::stores::Stores;
use super::twins;
use crate::config::{EngineUrl, Redis, Settings};
use crawler_cluster::ClusterMembership;
use crawler_commands::{CommandCenter, Journal, Outlet};
use crawler_fleet::SharedFleet;
use crawler_fleet::bus::Bus;
use crawler_fleet::feed::Feed;
use crawler_fleet::maps::{self, Maps};
use crawler_fleet::recorder::Recorder;
use crawler_simulations::Simulation;
use crawler_system::data::DataDir;
use crawler_twins::Twins;

/// What is known of the fleet and told to it, which the parts of a running server share.
pub(super) struct Hub {
    pub(super) fleet: Arc<SharedFleet>,
    pub(super) feed: Arc<Feed>,
    pub(super) bus: Arc<Bus>,
    pub(super) commands: Arc<CommandCenter>,
    pub(super) maps: Arc<Maps>,
    pub(super) twins: Arc<Twins>,
    pub(super) recorder: Recorder,
    /// The other servers, where there may be any.
    pub(super) membership: Option<Arc<ClusterMembership>>,
    /// The simulation in this process, once there is one.
    pub(super) simulation: Arc<OnceLock<Arc<Simulation>>>,
}

impl Hub {
    pub(super) async fn open(
        settings: &Settings,
        storage: &Storage,
        own: OwnFiles,
        parts: &mut Parts,
    ) -> Result<(Self, Option<OwnLease>), StartError> {
        let metrics = &storage.metrics;
        let bus = Arc::new(Bus::new(settings.fleet.clone(), Arc::clone(metrics)));
        let outlet: Arc<dyn Outlet> = Arc::clone(&bus) as _;
        let source = Source::new("server").map_err(|_| StartError::Internal("source"))?;
        let commands = CommandCenter::new(outlet, Arc::clone(metrics), source, own.sequence);
        let (journal, data) = (own.journal, own.data);
        let (commands, lease) = match &settings.cache {
            None => (write_down(commands, journal, &data, parts)?, None),
            Some(cache) => {
                let (commands, lease) =
                    join(settings, cache, commands, journal, &data, parts).await?;
                (commands, Some(lease))
            }
        };
        let membership = lease.as_ref().map(|lease| Arc::clone(&lease.membership));
        // Who has records of its own keeps everything in them.
        let shared = storage.records.database().is_some();
        let recorder = Recorder::new(membership.clone().filter(|_| shared));
        let stores = Stores {
            data: settings.data.clone(),
            history: storage.history.clone(),
            recorder: recorder.clone(),
            records: storage.records.clone(),
            membership: membership.clone(),
        };
        metrics.read(move |out| stores.write_metrics(out));
        let writer = recorder.writer(storage.records.clone());
        parts.task("what is recorded", |stop| writer.run(stop))?;
        let fleet = Arc::new(SharedFleet::new(settings.fleet.clone()));
        if lease.is_some() {
            fleet.lock().relayed();
        }
        fleet.lock().events.record_in(recorder.clone());
        let commands = Arc::new(commands);
        let simulation = Arc::new(OnceLock::new());
        let twins = twins::start(settings, storage, &fleet, &simulation, parts)?;
        let hub = Self {
            fleet,
            feed: Arc::new(Feed::new(settings.fleet.clone())),
            bus,
            maps: Arc::new(maps_by(&commands)?),
            twins,
            commands,
            recorder,
            membership,
            simulation,
        };
        Ok((hub, lease))
    }
}

/// Maps that robots are asked for under a source of their own: other commands are in nobody's way.
fn maps_by(commands: &Arc<CommandCenter>) -> Result<Maps, StartError> {
    let source = Source::new("map").map_err(|_| StartError::Internal("source"))?;
    let commands = Arc::clone(commands);
    let within = maps::PATIENCE.as_millis() as u64;
    Ok(Maps::new(move |robot| {
        commands.ask(source.clone(), Action::ReportMap, robot, within)
    }))
}

/// Has commands written down.
fn write_down(
    commands: CommandCenter,
    journal: Journal,
    data: &Arc<DataDir>,
    parts: &mut Parts,
) -> Result<CommandCenter, StartError> {
    let commands = commands.with_journal(journal, data, Instant::now())?;
    let written = commands.close();
    parts.end_with(async move {
        if tokio::time::timeout(PATIENCE, written).await.is_err() {
            tracing::warn!("commands on their way are not written down and are left to the disk");
        }
    })?;
    Ok(commands)
}

/// Joins the other servers.
async fn join(
    settings: &Settings,
    cache: &EngineUrl<Redis>,
    commands: CommandCenter,
    mut journal: Journal,
    data: &Arc<DataDir>,
    parts: &mut Parts,
) -> Result<(CommandCenter, OwnLease), StartError> {
    let name = data.file(cluster::NAME);
    let joined = cluster::join(cache, &settings.fleet, name, &mut journal).await?;
    parts.end_with(cluster::leave(Arc::clone(&joined.membership)))?;
    let lost = |error: ClusterError| StartError::Cache {
        cache: cache.to_string(),
        reason: error.to_string(),
    };
    let (commands, mine) = joined.share(commands, &mut journal).await.map_err(lost)?;
    let commands = write_down(commands, journal, data, parts)?;
    joined.go_on(&commands, mine).await.map_err(lost)?;
    Ok((commands, joined))
}
