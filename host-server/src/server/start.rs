//! Starting a server, part by part.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use crawler_access::Secret;
use crawler_cluster::ClusterError;
use crawler_protocol::Source;
use crawler_records::EventLevel;
use tokio::net::TcpListener;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::clockwork::{Clockwork, Upkeep};
use super::cluster::OwnLease;
use super::endpoints::{self, BrokerEndpoints};
use super::ingest::Ingest;
use super::outcome_log::OutcomeLog;
use super::parts::{PATIENCE, Parts, finish};
use super::stores::Stores;
use super::{StartError, cluster};
use crate::accounts::{Accounts, AuditLog};
use crate::addresses::Addresses;
use crate::broker::EmbeddedBroker;
use crate::bus::{self, Bus};
use crate::clock;
use crate::commands::{CommandCenter, Journal, Outlet, Sequence};
use crate::config::{BrokerUrl, DEFAULT_ROBOTS, EngineUrl, Redis, Role, Settings};
use crate::data::{DataDir, Disk};
use crate::descriptors::Descriptors;
use crate::experiments::{self, Experiments, Tell};
use crate::feed::Feed;
use crate::fences::{self, Enforcer, Stops};
use crate::fleet::{FenceAction, FenceKind, Level, SharedFleet};
use crate::history;
use crate::http;
use crate::metrics::Metrics;
use crate::recorder::Recorder;
use crate::simulation::Simulation;
use crate::simulator;
use crate::tls::{Certificates, Door};

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
/// among `parts`.
pub(super) async fn start(
    settings: &Settings,
    disk: Disk,
    parts: &mut Parts,
) -> Result<Started, StartError> {
    let data = Arc::new(DataDir::open_on(&settings.data, disk)?);
    let journal = Journal::of(&data)?;
    let owner = experiments::owner(&data)?;
    let sequence = Sequence::open(&data, clock::unix_ms())?;
    let (records, history) = history::open(settings).await?;
    let closing = (records.clone(), history.clone());
    parts.end_with(async move {
        let (records, history) = closing;
        history.close().await;
        records.close().await;
    })?;
    let metrics = Arc::new(Metrics::new());
    metrics.expect_fence_crossings(
        &FenceKind::ALL.map(FenceKind::name),
        &FenceAction::ALL.map(FenceAction::name),
    );
    let (audit, writer) = AuditLog::new(records.clone(), Arc::clone(&metrics));
    parts.task("the audit log", |stop| writer.run(stop))?;
    let accounts = Accounts::open(records.clone(), settings.open).await?;
    let invitation = accounts.invite_first().await?;
    let certificates = Certificates::of(&settings.certificates())?;
    let authority = certificates.as_ref().and_then(|own| own.authority());
    let descriptors = Descriptors::of_process(match settings.role {
        Role::Up => settings.robots.unwrap_or(DEFAULT_ROBOTS),
        Role::Serve | Role::Sim => 0,
    });
    // Bind before anything moves: a port in use must not cost a fleet its broker.
    let listener = TcpListener::bind(settings.http)
        .await
        .map_err(|cause| StartError::http(settings.http, cause))?;
    let http = listener
        .local_addr()
        .map_err(|cause| StartError::http(settings.http, cause))?;
    let door = match &certificates {
        Some(certificates) if settings.tls.covers(settings.http) => {
            Some(Door::new(certificates.acceptor(b"http/1.1", None)?))
        }
        _ => None,
    };
    let https = door.is_some();

    let BrokerEndpoints {
        broker,
        tunnel,
        target,
        mqtt,
        plain,
        inside,
    } = endpoints::open(
        settings,
        &records,
        certificates.as_ref(),
        &accounts,
        audit.notes(),
        descriptors,
    )
    .await?;
    let inside = endpoints::for_robots(&inside, broker.as_ref(), settings);
    let handle = broker.as_ref().map(EmbeddedBroker::handle);
    if let Some(broker) = broker {
        broker.note_in(audit.notes());
        parts.end_with(broker.stop())?;
    }
    if let Some(tunnel) = tunnel {
        parts.end_with(tunnel.stop())?;
    }
    let connection = bus::connect(&target, &settings.fleet)
        .await
        .map_err(|reason| StartError::BrokerUnreachable {
            broker: mqtt.to_string(),
            reason,
        })?;

    let bus = Arc::new(Bus::new(settings.fleet.clone(), Arc::clone(&metrics)));
    let outlet: Arc<dyn Outlet> = Arc::clone(&bus) as _;
    let source = Source::new("server").map_err(|_| StartError::Internal("source"))?;
    let commands = CommandCenter::new(outlet, Arc::clone(&metrics), source, sequence);
    let (commands, joined) = match &settings.cache {
        None => (write_down(commands, journal, &data, parts)?, None),
        Some(cache) => {
            let (commands, joined) = join(settings, cache, commands, journal, &data, parts).await?;
            (commands, Some(joined))
        }
    };
    let membership = joined.as_ref().map(|joined| Arc::clone(&joined.membership));
    // Who has records of its own keeps everything in them.
    let shared = records.database().is_some();
    let recorder = Recorder::new(membership.clone().filter(|_| shared));
    let stores = Stores {
        data: settings.data.clone(),
        history: history.clone(),
        recorder: recorder.clone(),
        records: records.clone(),
        membership: membership.clone(),
    };
    metrics.read(move |out| stores.write_metrics(out));
    let writer = recorder.writer(records.clone());
    parts.task("what is recorded", |stop| writer.run(stop))?;
    let audit = Arc::new(audit);
    let accounts = Arc::new(accounts);
    let commands = Arc::new(commands);
    let fleet = Arc::new(SharedFleet::new(settings.fleet.clone()));
    let feed = Arc::new(Feed::new(settings.fleet.clone()));
    let stops = Arc::new(Stops::default());
    let outcomes = OutcomeLog::new(Arc::clone(&fleet), audit.notes());
    let simulation = Arc::new(OnceLock::new());
    let time_wanted = Arc::new(AtomicBool::new(false));
    let records_changed = Arc::new(Notify::new());
    if joined.is_some() {
        fleet.lock().relayed();
    }
    fleet.lock().events.record_in(recorder.clone());
    fences::catch_up(&records, &fleet).await;
    let ingest = Arc::new(Ingest {
        name: settings.fleet.clone(),
        fleet: Arc::clone(&fleet),
        commands: Arc::clone(&commands),
        history: history.clone(),
        metrics: Arc::clone(&metrics),
        membership: membership.clone(),
        stops: Arc::clone(&stops),
        outcomes: outcomes.clone(),
        time_wanted: Arc::clone(&time_wanted),
    });
    if let Some(joined) = joined {
        let outcomes = outcomes.clone();
        joined.start(&commands, outcomes, &ingest, &records_changed, parts)?;
    }
    let clockwork = Clockwork {
        fleet: Arc::clone(&fleet),
        commands: Arc::clone(&commands),
        bus: Arc::clone(&bus),
        feed: Arc::clone(&feed),
        metrics: Arc::clone(&metrics),
        audit: Arc::clone(&audit),
        simulation: Arc::clone(&simulation),
        membership: membership.clone(),
        outcomes,
        time_wanted,
    };
    parts.task("what happens by the clock", |stop| clockwork.run(stop))?;
    let upkeep = Upkeep {
        records: records.clone(),
        fleet: Arc::clone(&fleet),
        accounts: Arc::clone(&accounts),
        broker: handle.clone(),
        records_changed,
    };
    parts.task("the upkeep of the records", |stop| upkeep.run(stop))?;
    let enforcer = Enforcer {
        fleet: Arc::clone(&fleet),
        commands: Arc::clone(&commands),
        audit: audit.notes(),
        stops,
    };
    parts.task("the fences", |stop| enforcer.run(stop))?;
    let served = Arc::clone(&bus);
    parts.task("the connection to the broker", |stop| {
        bus::serve(served, target, connection, ingest, stop)
    })?;
    if settings.role == Role::Up {
        // The connection is served already, so the robots' first words find a listener.
        let world = simulate(settings, &recorder, &feed, &inside, parts).await?;
        let _ = simulation.set(world);
    } else if membership.is_none() || records.database().is_none() {
        // Another server with the same records may have a world; else there is none.
        recorder.record_arena(&serde_json::Value::Null);
    }
    let tasks = TaskTracker::new();
    let experiments = Arc::new(Experiments::new(
        records.clone(),
        owner,
        settings.experiment_threads,
        tasks.clone(),
        tell_in(Arc::clone(&fleet)),
    ));
    experiment(&experiments, parts)?;
    if let Some(certificates) = certificates {
        parts.task("the certificate", |stop| certificates.keep(stop))?;
    }
    let stop = CancellationToken::new();
    let api = http::Parts {
        records: records.clone(),
        history,
        experiments,
        accounts,
        audit,
        mqtt: mqtt.clone(),
        fleet: Arc::clone(&fleet),
        commands,
        bus,
        metrics,
        feed,
        broker: handle,
        simulation: Arc::clone(&simulation),
        membership,
        readers: descriptors.readers,
        tasks: tasks.clone(),
        stop: stop.clone(),
    };
    let router = http::router(api, http, settings.trusted_proxies.clone());
    let serving = http::serve(listener, router, door, descriptors.http, stop.clone());
    let serving = tokio::spawn(serving);
    parts.add(stop, end_requests(tasks, serving))?;
    match Addresses::bound(settings, http, &mqtt, plain).leave(&settings.data) {
        Ok(left) => parts.end_with(async move { drop(left) })?,
        Err(error) => {
            tracing::warn!(%error, "the console is not told at which addresses this server is");
        }
    }
    Ok(Started {
        simulation: simulation.get().cloned(),
        #[cfg(test)]
        fleet,
        #[cfg(test)]
        records,
        http,
        https,
        authority,
        mqtt,
        invitation,
    })
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

/// Sets up the simulated robots of this process, which reach their broker at `inside`.
async fn simulate(
    settings: &Settings,
    recorder: &Recorder,
    feed: &Arc<Feed>,
    inside: &BrokerUrl,
    parts: &mut Parts,
) -> Result<Arc<Simulation>, StartError> {
    let simulation = Simulation::start(settings, inside)
        .await
        .map_err(StartError::Simulation)?;
    let simulation = Arc::new(simulation);
    let ending = Arc::clone(&simulation);
    parts.end_with(async move { ending.stop().await })?;
    let telling = simulation.tell_arenas(recorder.clone(), Arc::clone(feed));
    parts.task("what is told of the arena", |stop| async move {
        stop.run_until_cancelled(telling).await;
    })?;
    let target = endpoints::outside(inside)?.named("simulator");
    let (world, fleet) = (Arc::clone(&simulation), settings.fleet.clone());
    parts.task("the commands to the simulator", |stop| {
        simulator::listen(world, target, fleet, stop)
    })?;
    Ok(simulation)
}

/// Lets experiments run.
fn experiment(experiments: &Arc<Experiments>, parts: &mut Parts) -> Result<(), StartError> {
    let own = Arc::clone(experiments);
    parts.task("the experiments", |stop| experiments::keep(own, stop))?;
    experiments.begin().map_err(StartError::Experiments)?;
    let own = Arc::clone(experiments);
    parts.end_with(async move { own.end().await })
}

/// Tells those who watch `fleet` what becomes of experiments.
fn tell_in(fleet: Arc<SharedFleet>) -> Tell {
    Box::new(move |level, text| {
        let level = match level {
            EventLevel::Info => Level::Info,
            EventLevel::Warn => Level::Warn,
            EventLevel::Error => Level::Error,
        };
        fleet.lock().events.push(level, None, text);
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
