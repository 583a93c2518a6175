//! The server as a whole: started from settings, stopped in order.

mod ingest;
mod robots;
mod start_error;

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use crawler_protocol::{MAX_MESSAGE, Source, TimeMessage, Topic};
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::broker::EmbeddedBroker;
use crate::bus::{self, Bus, Target};
use crate::clock;
use crate::commands::{CommandCenter, Outlet, Sequence};
use crate::config::{Broker, BrokerUrl, Role, Settings};
use crate::data::DataDir;
use crate::feed::{self, Feed, Numbers};
use crate::fleet::SharedFleet;
use crate::http::{self, App};
use crate::metrics::Metrics;
use crate::simulation::Simulation;
use crate::simulator;

pub use robots::Robots;
pub use start_error::StartError;

const TIME_EVERY: Duration = Duration::from_secs(5);
/// A robot that has just come online takes no motion command before it knows the time. One message
/// serves all that come within this time.
const TIME_AGAIN: Duration = Duration::from_millis(200);
/// For each part of stopping.
const PATIENCE: Duration = Duration::from_secs(5);

/// A running server. Dropping it without [`Server::stop`] leaves its tasks to the runtime.
pub struct Server {
    app: Arc<App>,
    http: SocketAddr,
    mqtt: BrokerUrl,
    broker: Option<EmbeddedBroker>,
    stop_http: CancellationToken,
    stop_bus: CancellationToken,
    http_task: JoinHandle<()>,
    bus_task: JoinHandle<()>,
    heart_task: JoinHandle<()>,
}

impl Server {
    /// Starts everything `settings` ask for and returns when it is ready: data directory, broker,
    /// connection to it, simulated robots, API.
    ///
    /// # Errors
    /// [`StartError`] names what cannot be had. Whatever had been started by then is stopped.
    pub async fn start(settings: &Settings) -> Result<Self, StartError> {
        let data = DataDir::open(&settings.data)?;
        let sequence = Sequence::open(data, clock::unix_ms())?;
        // Bind before anything moves: a port in use must not cost a fleet its broker.
        let listener = TcpListener::bind(settings.http)
            .await
            .map_err(|cause| StartError::http(settings.http, cause))?;
        let http = listener
            .local_addr()
            .map_err(|cause| StartError::http(settings.http, cause))?;

        let (broker, target, mqtt) = open_broker(settings).await?;
        let metrics = Arc::new(Metrics::new());
        let connection = bus::connect(&target, &settings.fleet)
            .await
            .map_err(|reason| StartError::BrokerUnreachable {
                broker: mqtt.to_string(),
                reason,
            })?;

        let bus = Arc::new(Bus::new(settings.fleet.clone(), Arc::clone(&metrics)));
        let outlet: Arc<dyn Outlet> = Arc::clone(&bus) as _;
        let source = Source::new("server").map_err(|_| StartError::Internal("source"))?;
        let app = Arc::new(App {
            fleet: SharedFleet::new(settings.fleet.clone()),
            commands: CommandCenter::new(outlet, Arc::clone(&metrics), source, sequence),
            bus: Arc::clone(&bus),
            metrics,
            feed: Feed::new(settings.fleet.clone()),
            guard: broker.as_ref().map(EmbeddedBroker::counters),
            simulation: OnceLock::new(),
            time_wanted: AtomicBool::new(false),
            readers: Arc::new(Semaphore::new(http::MAX_READERS)),
            stop: CancellationToken::new(),
        });

        let stop_bus = CancellationToken::new();
        let stop_http = CancellationToken::new();
        let bus_task = bus::start(
            bus,
            target,
            connection,
            ingest::Ingest::new(Arc::clone(&app)),
            stop_bus.clone(),
        );
        let heart_task = tokio::spawn(heart(Arc::clone(&app), stop_bus.clone()));
        if settings.role == Role::Up {
            // The connection is served already, so the robots' first words find a listener.
            match Simulation::start(settings, &mqtt).await {
                Ok(simulation) => {
                    app.feed.set_arena(simulation.arena());
                    let simulation = Arc::new(simulation);
                    let _ = app.simulation.set(Arc::clone(&simulation));
                    tokio::spawn(simulator::listen(
                        simulation,
                        outside(&mqtt)?.named("simulator"),
                        settings.fleet.clone(),
                        stop_bus.clone(),
                    ));
                }
                Err(reason) => {
                    stop_bus.cancel();
                    return Err(StartError::Simulation(reason));
                }
            }
        }
        let http_task = tokio::spawn(http::serve(
            listener,
            http::router(Arc::clone(&app), http),
            stop_http.clone(),
        ));
        Ok(Self {
            app,
            http,
            mqtt,
            broker,
            stop_http,
            stop_bus,
            http_task,
            bus_task,
            heart_task,
        })
    }

    /// Where API and control room are.
    #[must_use]
    pub const fn http(&self) -> SocketAddr {
        self.http
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

    /// Stops in order: robots of this process, readers and requests, connection to the broker,
    /// broker. Takes at most a few times five seconds.
    pub async fn stop(self) {
        if let Some(simulation) = self.app.simulation.get() {
            simulation.stop().await;
        }
        self.app.stop.cancel();
        self.stop_http.cancel();
        finish("the API", self.http_task).await;
        self.stop_bus.cancel();
        finish("the connection to the broker", self.bus_task).await;
        finish("the clockwork", self.heart_task).await;
        if let Some(broker) = self.broker {
            broker.stop().await;
        }
    }
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

async fn open_broker(
    settings: &Settings,
) -> Result<(Option<EmbeddedBroker>, Target, BrokerUrl), StartError> {
    match &settings.broker {
        Broker::Embedded(listen) => {
            let broker = EmbeddedBroker::start(*listen, &settings.fleet)
                .await
                .map_err(|cause| StartError::mqtt(*listen, cause))?;
            let address = broker.address();
            let credentials = broker.credentials();
            // Where it listens on every address, loopback is one of them.
            let ip = match address.ip() {
                ip if !ip.is_unspecified() => ip,
                std::net::IpAddr::V4(_) => std::net::Ipv4Addr::LOCALHOST.into(),
                std::net::IpAddr::V6(_) => std::net::Ipv6Addr::LOCALHOST.into(),
            };
            let url = BrokerUrl {
                host: ip.to_string(),
                port: address.port(),
                credentials: None,
            };
            let target = Target {
                host: bracketed(&url.host),
                port: url.port,
                client_id: credentials.user.clone(),
                credentials: Some((credentials.user, credentials.password)),
            };
            Ok((Some(broker), target, url))
        }
        Broker::Outside(url) => Ok((None, outside(url)?, url.clone())),
    }
}

/// A session of our own with an outside broker.
fn outside(url: &BrokerUrl) -> Result<Target, StartError> {
    let mut id = [0_u8; 8];
    getrandom::fill(&mut id).map_err(|_| StartError::Internal("no randomness"))?;
    Ok(Target {
        host: bracketed(&url.host),
        port: url.port,
        client_id: format!("server-{}", crate::hex(&id)),
        credentials: url.credentials.clone(),
    })
}

/// The client joins host and port with a colon, so an IPv6 address needs its brackets.
fn bracketed(host: &str) -> String {
    if host.contains(':') {
        format!("[{host}]")
    } else {
        host.to_owned()
    }
}

/// What happens by the clock: the feed, overdue answers, the time for robots.
async fn heart(app: Arc<App>, stop: CancellationToken) {
    let mut tick = tokio::time::interval(feed::INTERVAL);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let mut time_sent: Option<Instant> = None;
    loop {
        tokio::select! {
            () = stop.cancelled() => return,
            _ = tick.tick() => {}
        }
        let now = Instant::now();
        app.feed.tick(&app.fleet, now, || Numbers {
            messages_in: app.metrics.messages_in_total(),
            commands: app.commands.totals(),
            real_time_factor: app
                .simulation
                .get()
                .map(|world| world.numbers().real_time_factor),
        });
        for command in app.commands.sweep(now) {
            ingest::tell(&app, &command);
        }
        let wait = if app.time_wanted.load(Ordering::Relaxed) {
            TIME_AGAIN
        } else {
            TIME_EVERY
        };
        let due = time_sent.is_none_or(|at| now.saturating_duration_since(at) >= wait);
        // After a reconnect the first message goes out with the next tick.
        if !app.bus.is_up() {
            time_sent = None;
        } else if due {
            time_sent = Some(now);
            app.time_wanted.store(false, Ordering::Relaxed);
            publish_time(&app.bus);
        }
    }
}

fn publish_time(bus: &Bus) {
    let message = TimeMessage {
        timestamp: clock::unix_ms(),
    };
    let mut buffer = [0; MAX_MESSAGE];
    match message.to_json(&mut buffer) {
        Ok(length) => {
            let payload = buffer.get(..length).unwrap_or_default();
            if let Err(error) = bus.publish(&Topic::Time, payload) {
                tracing::debug!(?error, "the time did not go out");
            }
        }
        Err(error) => tracing::error!(?error, "the time cannot be written"),
    }
}
