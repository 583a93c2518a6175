//! Starting a server, part by part.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crawler_access::Secret;
use crawler_records::EventLevel;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::broker_link::BrokerLink;
use super::calibrations;
use super::clockwork::{Clockwork, Upkeep};
use super::cluster::OwnLease;
use super::entrance::Entrance;
use super::hub::Hub;
use super::ingest::Ingest;
use super::outcome_log::OutcomeLog;
use super::parts::{PATIENCE, Parts, finish};
use super::rollouts::FleetRobots;
use super::storage::{OwnFiles, Storage};
use super::{StartError, endpoints, world};
use crate::addresses::Addresses;
use crate::config::{BrokerUrl, KeyFiles, Role, Settings};
use crawler_broker::BrokerHandle;
use crawler_counterfactuals::{Counterfactuals, Parts as CounterfactualParts};
use crawler_experiments::{self as experiments, Experiments, Tell};
use crawler_federation::{Broker as LearningBroker, LARGEST_PACKET};
use crawler_fleet::bus::{self, Connection, Target};
use crawler_fleet::enforcement::{self, Enforcer, Stops};
use crawler_fleet::{Level, SharedFleet};
use crawler_rollouts::Rollouts;
use crawler_server_tls::Certificates;
use crawler_simulations::{MAX_PACKET, Simulation};
use crawler_system::data::Disk;

/// Packets with what robots say about updates are shorter.
const MAX_REPORT: u32 = 4_096;

/// What is known of a server when all its parts run.
pub(super) struct Started {
    /// The simulation in this process, where there is one.
    pub(super) simulation: Option<Arc<Simulation>>,
    #[cfg(test)]
    pub(super) fleet: Arc<SharedFleet>,
    #[cfg(test)]
    pub(super) records: crawler_records::Records,
    pub(super) http: SocketAddr,
    pub(super) https: bool,
    pub(super) authority: Option<PathBuf>,
    pub(super) mqtt: BrokerUrl,
    /// The code of the first administrator's invitation, where there is none yet.
    pub(super) invitation: Option<Secret>,
}

/// Starts everything that `settings` ask for. Whatever runs when this returns, also with an error, is
/// among `parts`. They end the other way round: what stands last in this list ends first.
pub(super) async fn start(
    settings: &Settings,
    disk: Disk,
    parts: &mut Parts,
) -> Result<Started, StartError> {
    let keys = KeyFiles::list(settings.release_key.as_ref()).map_err(StartError::ReleaseKey)?;
    let own = OwnFiles::open(settings, disk)?;
    let storage = Storage::open(settings, parts).await?;
    let invitation = storage.accounts.invite_first().await?;
    // Bind before anything moves: a port in use must not cost a fleet its broker.
    let entrance = Entrance::open(settings).await?;
    let link = BrokerLink::open(settings, &storage, &entrance, parts).await?;
    let owner = own.owner.clone();
    let (hub, lease) = Hub::open(settings, &storage, own, parts).await?;
    let told = serve_fleet(settings, &storage, &hub, link.broker.as_ref(), lease, parts).await?;
    let calibrations = Arc::clone(&told.calibrations);
    let session = link.session.0.clone();
    connect(&hub, told, link.session, parts)?;
    let rollouts = roll_out(settings, &storage, &hub, &owner, &session, parts)?;
    simulate(settings, &storage, &hub, &link.inside, parts).await?;
    let tasks = TaskTracker::new();
    let experiments = experiment(settings, &storage, &hub, owner, &session, &tasks, parts)?;
    // They end while robots can still be told to stop.
    let own = Arc::clone(&calibrations);
    parts.end_with(async move { own.end().await })?;
    let counterfactuals = Counterfactuals::new(CounterfactualParts {
        history: storage.history.clone(),
        records: storage.records.clone(),
        certificates: super::twins::certificates(&hub.twins),
    });
    let own = Arc::clone(&counterfactuals);
    parts.end_with(async move { own.end() })?;
    let (https, authority) = (entrance.tls.is_some(), entrance.authority());
    let http = entrance.http;
    keep_certificate(entrance.certificates.as_ref(), parts)?;
    let stop = CancellationToken::new();
    let api = crawler_api::Parts {
        records: storage.records.clone(),
        history: storage.history,
        counterfactuals,
        experiments,
        rollouts,
        accounts: storage.accounts,
        audit: storage.audit,
        mqtt: link.mqtt.clone(),
        fleet: Arc::clone(&hub.fleet),
        commands: hub.commands,
        maps: hub.maps,
        twins: hub.twins,
        calibrations,
        bus: hub.bus,
        metrics: storage.metrics,
        feed: hub.feed,
        broker: link.broker,
        simulation: Arc::clone(&hub.simulation),
        membership: hub.membership,
        release_keys: keys.into(),
        readers: entrance.descriptors.readers,
        tasks: tasks.clone(),
        stop: stop.clone(),
    };
    let router = crawler_api::router(api, http, settings.trusted_proxies.clone());
    let most = entrance.descriptors.http;
    let serving = crawler_api::serve(entrance.listener, router, entrance.tls, most, stop.clone());
    let serving = tokio::spawn(serving);
    parts.add(stop, end_requests(tasks, serving))?;
    leave_addresses(settings, http, &link.mqtt, link.plain, parts)?;
    Ok(Started {
        simulation: hub.simulation.get().cloned(),
        #[cfg(test)]
        fleet: hub.fleet,
        #[cfg(test)]
        records: storage.records,
        http,
        https,
        authority,
        mqtt: link.mqtt,
        invitation,
    })
}

/// Starts what follows the fleet: by the clock, over its fences, and together with the other servers. Returns
/// what takes in what robots tell.
async fn serve_fleet(
    settings: &Settings,
    storage: &Storage,
    hub: &Hub,
    broker: Option<&BrokerHandle>,
    lease: Option<OwnLease>,
    parts: &mut Parts,
) -> Result<Arc<Ingest>, StartError> {
    let stops = Arc::new(Stops::default());
    let outcomes = OutcomeLog::new(Arc::clone(&hub.fleet), storage.audit.notes());
    let time_wanted = Arc::new(AtomicBool::new(false));
    let records_changed = Arc::new(Notify::new());
    enforcement::catch_up(storage.records.fences(), &hub.fleet).await;
    let ingest = Arc::new(Ingest {
        name: settings.fleet.clone(),
        fleet: Arc::clone(&hub.fleet),
        commands: Arc::clone(&hub.commands),
        maps: Arc::clone(&hub.maps),
        twins: Arc::clone(&hub.twins),
        calibrations: calibrations::open(settings, hub)?,
        history: storage.history.clone(),
        metrics: Arc::clone(&storage.metrics),
        membership: hub.membership.clone(),
        stops: Arc::clone(&stops),
        outcomes: outcomes.clone(),
        time_wanted: Arc::clone(&time_wanted),
    });
    if let Some(lease) = lease {
        let outcomes = outcomes.clone();
        lease.start(&hub.commands, outcomes, &ingest, &records_changed, parts)?;
    }
    let clockwork = Clockwork {
        fleet: Arc::clone(&hub.fleet),
        commands: Arc::clone(&hub.commands),
        bus: Arc::clone(&hub.bus),
        feed: Arc::clone(&hub.feed),
        metrics: Arc::clone(&storage.metrics),
        audit: Arc::clone(&storage.audit),
        simulation: Arc::clone(&hub.simulation),
        membership: hub.membership.clone(),
        outcomes,
        time_wanted,
    };
    parts.task("what happens by the clock", |stop| clockwork.run(stop))?;
    let upkeep = Upkeep {
        records: storage.records.clone(),
        fleet: Arc::clone(&hub.fleet),
        accounts: Arc::clone(&storage.accounts),
        broker: broker.cloned(),
        records_changed,
    };
    parts.task("the upkeep of the records", |stop| upkeep.run(stop))?;
    let enforcer = Enforcer {
        fleet: Arc::clone(&hub.fleet),
        commands: Arc::clone(&hub.commands),
        audit: storage.audit.notes(),
        stops,
    };
    parts.task("the fences", |stop| enforcer.run(stop))?;
    Ok(ingest)
}

/// Hears the fleet from here on.
fn connect(
    hub: &Hub,
    ingest: Arc<Ingest>,
    (target, connection): (Target, Connection),
    parts: &mut Parts,
) -> Result<(), StartError> {
    let bus = Arc::clone(&hub.bus);
    parts.task("the connection to the broker", |stop| {
        bus::serve(bus, target, connection, ingest, stop)
    })
}

/// Carries rollouts out, over a session with the broker that is not the one of commands.
fn roll_out(
    settings: &Settings,
    storage: &Storage,
    hub: &Hub,
    owner: &str,
    session: &Target,
    parts: &mut Parts,
) -> Result<Arc<Rollouts>, StartError> {
    let tell = tell_in(Arc::clone(&hub.fleet));
    let (rollouts, runner) = Rollouts::new(crawler_rollouts::Parts {
        records: storage.records.clone(),
        server: owner.to_owned(),
        fleet: settings.fleet.clone(),
        robots: Arc::new(FleetRobots(Arc::clone(&hub.fleet))),
        session: session.clone().beside("updates").options(MAX_REPORT),
        lease: crawler_rollouts::LEASE,
        gates: settings.require_gate.into(),
        tell,
    })
    .map_err(|_| StartError::Internal("a name of the server"))?;
    let numbers = Arc::clone(&rollouts);
    storage.metrics.read(move |out| numbers.write_metrics(out));
    parts.task("the rollouts", |stop| runner.run(stop))?;
    Ok(rollouts)
}

/// Sets up the simulated robots of this process, where it is to have some. They reach their broker at
/// `inside`. The connection is served already, so their first words find a listener.
async fn simulate(
    settings: &Settings,
    storage: &Storage,
    hub: &Hub,
    inside: &BrokerUrl,
    parts: &mut Parts,
) -> Result<(), StartError> {
    if settings.role != Role::Up {
        // Another server with the same records may have a world; else there is none.
        if hub.membership.is_none() || storage.records.database().is_none() {
            hub.recorder.record_arena(&serde_json::Value::Null);
        }
        return Ok(());
    }
    let simulation = world::start(settings, inside).await?;
    let simulation = Arc::new(simulation);
    let ending = Arc::clone(&simulation);
    parts.end_with(async move { ending.stop().await })?;
    let (recorder, feed) = (hub.recorder.clone(), Arc::clone(&hub.feed));
    let telling = simulation.tell_arenas(move |arena| {
        recorder.record_arena(&arena);
        feed.set_arena(arena)
    });
    parts.task("what is told of the arena", |stop| async move {
        stop.run_until_cancelled(telling).await;
    })?;
    let _ = hub.simulation.set(Arc::clone(&simulation));
    let target = endpoints::outside(inside)?.named("simulator");
    let (session, fleet) = (target.options(MAX_PACKET), settings.fleet.clone());
    parts.task("the commands to the simulator", |stop| {
        crawler_simulations::listen(simulation, session, fleet, stop)
    })
}

/// Folder with the files of trainings, in the data directory.
const TRAININGS: &str = "trainings";

/// Lets experiments run.
fn experiment(
    settings: &Settings,
    storage: &Storage,
    hub: &Hub,
    owner: String,
    session: &Target,
    tasks: &TaskTracker,
    parts: &mut Parts,
) -> Result<Arc<Experiments>, StartError> {
    let experiments = Arc::new(Experiments::new(
        storage.records.clone(),
        settings.data.join(TRAININGS),
        owner,
        &settings.worker_name(),
        settings.experiment_threads,
        tasks.clone(),
        Some(LearningBroker {
            session: session.clone().beside("learn").options(LARGEST_PACKET),
            fleet: settings.fleet.clone(),
            runtime: tokio::runtime::Handle::current(),
        }),
        tell_of_server(tell_in(Arc::clone(&hub.fleet))),
    ));
    let own = Arc::clone(&experiments);
    parts.task("the experiments", |stop| experiments::keep(own, stop))?;
    let own = Arc::clone(&experiments);
    parts.task("the trainings", |stop| experiments::train(own, stop))?;
    experiments.begin().map_err(StartError::Experiments)?;
    let own = Arc::clone(&experiments);
    parts.end_with(async move { own.end().await })?;
    Ok(experiments)
}

/// Makes the certificate anew before it ends.
fn keep_certificate(
    certificates: Option<&Arc<Certificates>>,
    parts: &mut Parts,
) -> Result<(), StartError> {
    let Some(certificates) = certificates.map(Arc::clone) else {
        return Ok(());
    };
    parts.task("the certificate", |stop| certificates.keep(stop))
}

/// Tells the console at which addresses this server is.
fn leave_addresses(
    settings: &Settings,
    http: SocketAddr,
    mqtt: &BrokerUrl,
    plain: Option<u16>,
    parts: &mut Parts,
) -> Result<(), StartError> {
    match Addresses::bound(settings, http, mqtt, plain).leave(&settings.data) {
        Ok(left) => parts.end_with(async move { drop(left) }),
        Err(error) => {
            tracing::warn!(%error, "the console is not told at which addresses this server is");
            Ok(())
        }
    }
}

/// As `tell` tells what is about no robot.
fn tell_of_server(tell: crawler_rollouts::Tell) -> Tell {
    Box::new(move |level, text| tell(level, None, text))
}

/// Tells those who watch `fleet` what becomes of experiments and rollouts.
fn tell_in(fleet: Arc<SharedFleet>) -> crawler_rollouts::Tell {
    Box::new(move |level, robot, text| {
        let level = match level {
            EventLevel::Info => Level::Info,
            EventLevel::Warn => Level::Warn,
            EventLevel::Error => Level::Error,
        };
        fleet.lock().events.push(level, robot, text);
    })
}

/// Returns when nobody asks for anything any more and what requests have begun is done.
async fn end_requests(tasks: TaskTracker, serving: tokio::task::JoinHandle<()>) {
    finish("the API", serving).await;
    tasks.close();
    if tokio::time::timeout(PATIENCE, tasks.wait()).await.is_err() {
        tracing::warn!("what requests have begun does not end and is left behind");
    }
}
