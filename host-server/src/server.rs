//! The server as a whole: started from settings, stopped in order.

mod cells;
mod clockwork;
mod cluster;
mod ingest;
mod robots;
#[cfg(test)]
mod slow_disk_tests;
mod start_error;
mod watch;
mod ways;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use crawler_access::Secret;
use crawler_cluster::ClusterError;
use crawler_protocol::Source;
use tokio::net::TcpListener;
use tokio::sync::{Notify, Semaphore};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::accounts::{Accounts, Trail};
use crate::addresses::{ADDRESSES_FILE, Addresses};
use crate::broker::EmbeddedBroker;
use crate::bus::{self, Bus};
use crate::clock;
use crate::commands::{CommandCenter, Journal, Outlet, Sequence};
use crate::config::{BrokerUrl, DEFAULT_ROBOTS, Role, Settings};
use crate::data::{DataDir, Disk};
use crate::descriptors::Descriptors;
use crate::experiments::{self, Experiments};
use crate::feed::Feed;
use crate::fences;
use crate::fleet::SharedFleet;
use crate::history;
use crate::http::{self, App};
use crate::metrics::Metrics;
use crate::recorder::Recorder;
use crate::simulation::Simulation;
use crate::simulator;
use crate::tls::{Certificates, Door, Tunnel};
use ways::Ways;

pub use robots::Robots;
pub use start_error::StartError;
pub(crate) use ways::{open_tunnel, outside};

/// For each part of stopping.
const PATIENCE: Duration = Duration::from_secs(5);

/// A running server. Dropping it without [`Server::stop`] leaves its tasks to the runtime.
pub struct Server {
    app: Arc<App>,
    http: SocketAddr,
    https: bool,
    authority: Option<PathBuf>,
    mqtt: BrokerUrl,
    invitation: Option<String>,
    broker: Option<EmbeddedBroker>,
    _tunnel: Option<Tunnel>,
    /// What the console reads to find this server.
    addresses: PathBuf,
    stop_http: CancellationToken,
    stop_bus: CancellationToken,
    stop_trail: CancellationToken,
    http_task: JoinHandle<()>,
    bus_task: JoinHandle<()>,
    heart_task: JoinHandle<()>,
    trail_task: JoinHandle<()>,
    experiments_task: JoinHandle<()>,
    recorder_task: JoinHandle<()>,
    cluster_task: Option<JoinHandle<()>>,
}

impl Server {
    /// Starts everything `settings` ask for and returns when it is ready: data directory, broker,
    /// connection to it, simulated robots, API.
    ///
    /// # Errors
    /// [`StartError`] names what cannot be had. Whatever had been started by then is stopped.
    pub async fn start(settings: &Settings) -> Result<Self, StartError> {
        Self::start_on(settings, Disk::default()).await
    }

    /// The same on a disk that may be a test's.
    async fn start_on(settings: &Settings, disk: Disk) -> Result<Self, StartError> {
        let data = Arc::new(DataDir::open_on(&settings.data, disk)?);
        let mut journal = Journal::of(&data)?;
        let name = data.file(cluster::NAME);
        let owner = experiments::owner(&data)?;
        let sequence = Sequence::open(&data, clock::unix_ms())?;
        let (records, history) = history::open(settings).await?;
        let accounts = Accounts::open(records.clone(), settings.open).await?;
        let invitation = accounts.invite_first().await?;
        let certificates = Certificates::of(settings)?;
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

        let Ways {
            broker,
            tunnel,
            target,
            mqtt,
            plain,
            inside,
        } = ways::open(
            settings,
            &records,
            certificates.as_ref(),
            accounts.failures(),
            descriptors,
        )
        .await?;
        let metrics = Arc::new(Metrics::new());
        metrics.watch_data(&settings.data);
        metrics.watch_records(&records);
        metrics.watch_history(&history);
        let connection = bus::connect(&target, &settings.fleet)
            .await
            .map_err(|reason| StartError::BrokerUnreachable {
                broker: mqtt.to_string(),
                reason,
            })?;

        let bus = Arc::new(Bus::new(settings.fleet.clone(), Arc::clone(&metrics)));
        let outlet: Arc<dyn Outlet> = Arc::clone(&bus) as _;
        let source = Source::new("server").map_err(|_| StartError::Internal("source"))?;
        let stop_trail = CancellationToken::new();
        let (trail, trail_task) =
            Trail::new(records.clone(), Arc::clone(&metrics), stop_trail.clone());
        if let Some(broker) = &broker {
            broker.note_in(trail.notes());
        }
        let commands = CommandCenter::new(outlet, Arc::clone(&metrics), source, sequence);
        let (commands, membership) = match &settings.cache {
            None => (commands.with_journal(journal, &data, Instant::now())?, None),
            Some(cache) => {
                let fleet = &settings.fleet;
                let joined = cluster::join(cache, fleet, name, &mut journal).await?;
                let lost = |error: ClusterError| StartError::Cache {
                    cache: cache.to_string(),
                    reason: error.to_string(),
                };
                let shared = joined.share(commands, &mut journal).await;
                let (commands, mine) = shared.map_err(lost)?;
                let commands = commands.with_journal(journal, &data, Instant::now())?;
                joined.go_on(&commands, mine).await.map_err(lost)?;
                metrics.watch_cluster(&joined.together);
                (commands, Some(joined))
            }
        };
        let together = membership
            .as_ref()
            .map(|joined| Arc::clone(&joined.together));
        // Who has records of its own keeps everything in them.
        let shared = records.database().is_some();
        let recorder = Recorder::new(together.clone().filter(|_| shared));
        metrics.watch_recorder(&recorder);
        let recorder_task = recorder.start(records.clone(), stop_trail.clone());
        let app = Arc::new(App {
            records,
            history,
            experiments: Experiments::new(settings, owner),
            recorder,
            accounts,
            trail,
            mqtt: mqtt.clone(),
            rates: http::Rates::new(),
            fleet: SharedFleet::new(settings.fleet.clone()),
            commands,
            bus: Arc::clone(&bus),
            metrics,
            feed: Feed::new(settings.fleet.clone()),
            broker: broker.as_ref().map(EmbeddedBroker::handle),
            simulation: OnceLock::new(),
            drawing: Arc::new(Semaphore::new(1)),
            time_wanted: AtomicBool::new(false),
            requests: http::RequestIds::new(),
            readers: Arc::new(Semaphore::new(descriptors.readers)),
            stop: CancellationToken::new(),
            together,
            records_changed: Notify::new(),
            fence_stops: fences::Stops::default(),
        });
        if membership.is_some() {
            app.fleet.lock().relayed();
        }
        app.fleet.lock().events.record_in(app.recorder.clone());
        fences::catch_up(&app).await;

        let stop_bus = CancellationToken::new();
        let stop_http = CancellationToken::new();
        let ingest = ingest::Ingest::new(Arc::clone(&app), settings.fleet.clone());
        let cluster_task = membership.map(|joined| joined.start(&app, &ingest, &stop_bus));
        let bus_task = bus::start(bus, target, connection, ingest, stop_bus.clone());
        tokio::spawn(clockwork::upkeep(Arc::clone(&app), stop_bus.clone()));
        tokio::spawn(fences::enforce(Arc::clone(&app), stop_bus.clone()));
        let heart_task = tokio::spawn(clockwork::heart(Arc::clone(&app), stop_bus.clone()));
        if settings.role == Role::Up {
            // The connection is served already, so the robots' first words find a listener.
            let inside = ways::for_robots(&inside, broker.as_ref(), settings);
            match Simulation::start(settings, &inside).await {
                Ok(simulation) => {
                    simulation.tell_arenas(&app, stop_bus.clone());
                    let simulation = Arc::new(simulation);
                    let _ = app.simulation.set(Arc::clone(&simulation));
                    tokio::spawn(simulator::listen(
                        simulation,
                        ways::outside(&inside)?.named("simulator"),
                        settings.fleet.clone(),
                        stop_bus.clone(),
                    ));
                }
                Err(reason) => {
                    stop_bus.cancel();
                    return Err(StartError::Simulation(reason));
                }
            }
        } else if app.together.is_none() || app.records.database().is_none() {
            // Another server with the same records may have a world; else there is none.
            app.recorder.record_arena(&serde_json::Value::Null);
        }
        let door = match &certificates {
            Some(certificates) if settings.tls.covers(settings.http) => {
                Some(Door::new(certificates.acceptor(b"http/1.1", None)?))
            }
            _ => None,
        };
        let https = door.is_some();
        let experiments_task = app.experiments.begin(&app).map_err(|error| {
            stop_bus.cancel();
            StartError::Experiments(error)
        })?;
        let http_task = tokio::spawn(http::serve(
            listener,
            http::router(Arc::clone(&app), http, settings.trusted_proxies.clone()),
            door,
            descriptors.http,
            stop_http.clone(),
        ));
        if let Err(error) = Addresses::bound(settings, http, &mqtt, plain).leave(&settings.data) {
            tracing::warn!(%error, "the console is not told at which addresses this server is");
        }
        let authority = certificates.as_ref().and_then(|own| own.authority());
        if let Some(certificates) = certificates {
            tokio::spawn(certificates.keep(stop_bus.clone()));
        }
        Ok(Self {
            app,
            http,
            https,
            authority,
            mqtt,
            invitation: invitation.map(|code| link(http, https, &code)),
            broker,
            _tunnel: tunnel,
            addresses: settings.data.join(ADDRESSES_FILE),
            stop_http,
            stop_bus,
            stop_trail,
            http_task,
            bus_task,
            heart_task,
            trail_task,
            experiments_task,
            recorder_task,
            cluster_task,
        })
    }

    /// Where API and control room are.
    #[must_use]
    pub const fn http(&self) -> SocketAddr {
        self.http
    }

    /// Whether API and control room are reached over TLS alone.
    #[must_use]
    pub const fn https(&self) -> bool {
        self.https
    }

    /// The certificate that clients pin, when the server has an authority of its own.
    #[must_use]
    pub fn authority(&self) -> Option<&Path> {
        self.authority.as_deref()
    }

    /// How many robots are simulated in this process.
    #[must_use]
    pub fn simulated(&self) -> u64 {
        self.app
            .simulation
            .get()
            .map_or(0, |world| world.numbers().robots)
    }

    /// Where the fleet's broker is.
    #[must_use]
    pub const fn mqtt(&self) -> &BrokerUrl {
        &self.mqtt
    }

    /// Where the first administrator makes an account: an address that is good once, and for a day.
    /// `None` on an open server, and where there is an administrator.
    #[must_use]
    pub fn invitation(&self) -> Option<&str> {
        self.invitation.as_deref()
    }

    /// Stops in order: experiments, robots of this process, readers and requests, connection to the broker,
    /// broker. Takes at most a few times five seconds.
    pub async fn stop(self) {
        self.app.experiments.stop().await;
        // Where it is missing, there is nothing to take away.
        let _ = std::fs::remove_file(&self.addresses);
        if let Some(simulation) = self.app.simulation.get() {
            simulation.stop().await;
        }
        self.app.stop.cancel();
        self.stop_http.cancel();
        finish("the API", self.http_task).await;
        finish("the experiments", self.experiments_task).await;
        self.stop_bus.cancel();
        finish("the connection to the broker", self.bus_task).await;
        finish("the clockwork", self.heart_task).await;
        if let Some(task) = self.cluster_task {
            finish("what other servers are told", task).await;
        }
        if let Some(broker) = self.broker {
            broker.stop().await;
        }
        let written = self.app.commands.close();
        if tokio::time::timeout(PATIENCE, written).await.is_err() {
            tracing::warn!("commands on their way are not written down and are left to the disk");
        }
        self.stop_trail.cancel();
        finish("the audit log", self.trail_task).await;
        finish("what is recorded", self.recorder_task).await;
        self.app.history.close().await;
        self.app.records.close().await;
    }
}

/// The address at which the invitation `code` is taken, on this machine.
fn link(http: SocketAddr, https: bool, code: &Secret) -> String {
    let host = if http.ip().is_unspecified() {
        format!("localhost:{}", http.port())
    } else {
        http.to_string()
    };
    let scheme = if https { "https" } else { "http" };
    format!("{scheme}://{host}/#invite={code}")
}

async fn finish(what: &str, mut task: JoinHandle<()>) {
    match tokio::time::timeout(PATIENCE, &mut task).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::error!(%error, "{what} ended badly"),
        Err(_) => {
            tracing::warn!("{what} does not stop and is left behind");
            task.abort();
        }
    }
}
