//! The embedded MQTT 5 broker, for a fleet that fits on one machine.
//!
//! The server speaks to it through the same client it would use for any other broker. The broker
//! has a runtime of its own: stopping it ends every session with it, and a busy broker does not
//! delay the API.
//!
//! What protects it from its clients, from the outside in:
//!
//! - the edge: connections from outside come in there, have to say in time who they are, and make room for
//!   others; what the library gets wrong of their bytes is put right;
//! - [`Accounts`]: names and passwords;
//! - the guard: a table of what each may publish and subscribe, and the routes, which leave out what that
//!   withholds from wide filters;
//! - a budget of messages per client;
//! - the sizes and counts below, retained messages only where the contract has them, and a send time-out that
//!   ends a session whose reader has stalled.
//!
//! Reading order: `edge`; `accounts`, `guard` and `clients`; `routes`, `retain` and `sharing`; `counters` and
//! `numbers`.

mod accounts;
mod clients;
mod counters;
mod edge;
mod guard;
mod numbers;
mod retain;
mod routes;
mod sharing;
#[cfg(test)]
mod tests;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::num::NonZeroU16;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crawler_access::Secret;
use crawler_protocol::{Fleet, RobotId};
use crawler_system::text::hex;
use rmqtt::context::ServerContext;
use rmqtt::hook::Type;
use rmqtt::net::Builder;
use rmqtt::router::DefaultRouter;
use rmqtt::server::MqttServer;
use tokio::io::DuplexStream;

pub use accounts::{Accounts, Kind, Login, Open, RecordAccounts, Refusal, Who};
pub use clients::LinkState;
use counters::GuardCounters;
pub use edge::{Limits, Times};
use numbers::Load;

use clients::Clients;
use crawler_records::audit_log::Notes;
use crawler_server_tls::TlsHandshake;
use crawler_system::places::{Place, Places};
use edge::Edge;

/// Largest packet the broker takes: an image with its topic and properties.
pub const LARGEST_PACKET: u32 = 256 * 1024;
/// Connections at a time, robots and others together. How many sessions there may be is a matter of
/// [`Limits`].
const MAX_CONNECTIONS: usize = 25_000;
/// Messages waiting for the server's own session. At 10,000 robots a burst of every robot's
/// retained messages and a second of telemetry fit several times over.
const SERVER_QUEUE: usize = 200_000;
/// Messages waiting for any other session. Holds the retained messages of 10,000 robots.
const CLIENT_QUEUE: usize = 25_000;
/// QoS 1 messages under way to one client.
const MAX_INFLIGHT: NonZeroU16 = NonZeroU16::new(1_000).unwrap();
/// Clients over `WebSockets` at a time, and of those the clients at one address.
const MAX_SOCKETS: usize = 4_096;
const MAX_SOCKETS_OF_ONE: usize = 128;
/// A reader that takes nothing for so long loses its session.
const SEND_TIMEOUT: Duration = Duration::from_secs(2);
const WORKERS: usize = 2;

/// Name and secret that are good until the broker ends.
#[derive(Clone)]
pub struct Credentials {
    /// The user name.
    pub user: String,
    /// The secret.
    pub password: Secret,
}

impl Credentials {
    fn new(prefix: &str) -> std::io::Result<Self> {
        let mut bytes = [0_u8; 8];
        getrandom::fill(&mut bytes).map_err(std::io::Error::other)?;
        Ok(Self {
            // Short enough for a robot, which takes 32 bytes.
            user: format!("{prefix}{}", hex(&bytes)),
            password: Secret::generate().map_err(std::io::Error::other)?,
        })
    }
}

/// The broker, until it is stopped or dropped.
pub struct EmbeddedBroker {
    runtime: Option<tokio::runtime::Runtime>,
    address: SocketAddr,
    server: Credentials,
    simulator: Credentials,
    handle: BrokerHandle,
}

/// What others ask of the embedded broker. Of no effect once that has stopped.
#[derive(Clone)]
pub struct BrokerHandle {
    clients: Arc<Clients>,
    counters: Arc<GuardCounters>,
    context: ServerContext,
    runtime: tokio::runtime::Handle,
    edge: Arc<Edge>,
    sockets: Arc<Places>,
}

impl BrokerHandle {
    /// What it holds at this moment.
    async fn load(&self) -> Load {
        Load::of(&self.context).await
    }

    /// Tasks of its runtime that have not ended.
    pub fn tasks(&self) -> usize {
        self.runtime.metrics().num_alive_tasks()
    }

    /// How the link to a robot is, when it is not well.
    pub fn link(&self, robot: &RobotId) -> Option<LinkState> {
        self.clients.link(robot, Instant::now())
    }

    /// A place for a client over a WebSocket; `None` when there is none left for its address.
    pub fn place(&self, from: IpAddr) -> Option<Place> {
        self.sockets.take(from)
    }

    /// A connection to the broker for somebody at `origin`, under whose address it counts. Who carries it
    /// closes it when the client is silent.
    pub fn enter(&self, origin: SocketAddr) -> DuplexStream {
        self.edge.enter(origin, &self.runtime)
    }

    /// Ends every session of a name: a robot, simulator or learner whose credential was revoked or replaced,
    /// a person whose role has changed. From now on none of them is heard, and a login that is under
    /// way comes to nothing. Who else has that name stays. Change the records first.
    pub async fn drop_client(&self, kind: Kind, name: &str) {
        let mut ended = self.clients.expel(kind, name, Instant::now());
        let clients = Arc::clone(&self.clients);
        let (context, name) = (self.context.clone(), name.to_owned());
        let counters = Arc::clone(&self.counters);
        // In the broker's own runtime, so that nothing of it outlives it. One after the other: a
        // name has one session, but for simulators.
        let ending = self.runtime.spawn(async move {
            // A session whose client is away keeps its subscriptions for whoever comes back to it.
            let mut away = guard::sessions_of(&context, &name).await;
            away.retain(|client| clients.kind(client) == Some(kind));
            ended.extend(away);
            ended.sort();
            ended.dedup();
            let count = ended.len() as u64;
            counters.dropped.fetch_add(count, Ordering::Relaxed);
            for client in ended {
                guard::end_session(&context, &client).await;
            }
        });
        if let Err(error) = ending.await {
            tracing::debug!(%error, "the broker ends all sessions itself");
        }
    }
}

impl EmbeddedBroker {
    /// Starts it, for this process alone; [`listen`](Self::listen) lets others in, as many as `limits`
    /// say.
    ///
    /// # Errors
    /// What the operating system says when no port is to be had on loopback.
    pub async fn start(
        fleet: &Fleet,
        accounts: Arc<dyn Accounts>,
        limits: Limits,
    ) -> std::io::Result<Self> {
        let server = Credentials::new("server-")?;
        let simulator = Credentials::new(accounts::SIMULATOR)?;
        let counters = Arc::new(GuardCounters::default());
        let clients = Arc::new(Clients::new(fleet.clone()));
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(WORKERS)
            .thread_name("broker")
            .enable_all()
            .build()?;
        let setup = serve(Setup {
            fleet: fleet.clone(),
            sessions: limits.sessions,
            server: server.clone(),
            simulator: simulator.clone(),
            accounts,
            clients: Arc::clone(&clients),
            counters: Arc::clone(&counters),
        });
        // The broker's tasks belong to the runtime that is current while it is set up.
        let bound = match runtime.spawn(setup).await {
            Ok(result) => result,
            Err(error) => Err(std::io::Error::other(error)),
        };
        match bound {
            Ok((address, context)) => Ok(Self {
                address,
                server,
                simulator,
                handle: BrokerHandle {
                    edge: Edge::new(
                        address,
                        limits,
                        Arc::clone(clients.peers()),
                        Arc::clone(&counters),
                    ),
                    clients,
                    counters,
                    context,
                    runtime: runtime.handle().clone(),
                    sockets: Places::new(MAX_SOCKETS, MAX_SOCKETS_OF_ONE),
                },
                runtime: Some(runtime),
            }),
            Err(error) => {
                end(runtime).await;
                Err(error)
            }
        }
    }

    /// Where this process finds it.
    pub const fn inside(&self) -> SocketAddr {
        self.address
    }

    /// For the server's own sessions, which may do everything. A client id is the user name, alone or followed by
    /// a hyphen and more.
    pub const fn server(&self) -> &Credentials {
        &self.server
    }

    /// For a simulation in this process.
    pub const fn simulator(&self) -> &Credentials {
        &self.simulator
    }

    /// Has clients that are cut off noted in the audit log.
    pub fn note_in(&self, notes: Notes) {
        // Set once, when the server starts.
        let _ = self.handle.counters.notes.set(notes);
    }

    /// What others ask of it.
    pub fn handle(&self) -> BrokerHandle {
        self.handle.clone()
    }

    /// Lets clients in at `listen`, through TLS when there is one. Returns the address it listens at,
    /// with the port chosen by the system when none was asked for.
    ///
    /// # Errors
    /// What the operating system says when the address cannot be bound.
    pub async fn listen(
        &self,
        listen: SocketAddr,
        tls: Option<TlsHandshake>,
    ) -> std::io::Result<SocketAddr> {
        let BrokerHandle { edge, runtime, .. } = &self.handle;
        edge.listen(listen, tls, runtime).await
    }

    /// Ends every session and frees the ports.
    pub async fn stop(mut self) {
        if let Some(runtime) = self.runtime.take() {
            end(runtime).await;
        }
    }
}

/// Ends every task of the broker, and its threads.
async fn end(runtime: tokio::runtime::Runtime) {
    let stopped = tokio::task::spawn_blocking(move || {
        runtime.shutdown_timeout(Duration::from_secs(2));
    });
    if let Err(error) = stopped.await {
        tracing::error!(%error, "the broker did not stop in order");
    }
}

impl Drop for EmbeddedBroker {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// What the broker is made from.
struct Setup {
    fleet: Fleet,
    sessions: usize,
    server: Credentials,
    simulator: Credentials,
    accounts: Arc<dyn Accounts>,
    clients: Arc<Clients>,
    counters: Arc<GuardCounters>,
}

async fn serve(setup: Setup) -> std::io::Result<(SocketAddr, ServerContext)> {
    let Setup {
        fleet,
        sessions,
        server,
        simulator,
        accounts,
        clients,
        counters,
    } = setup;
    let listener = Builder::new()
        .name("fleet")
        .laddr(SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 0))
        .nodelay(true)
        .allow_anonymous(false)
        .max_connections(MAX_CONNECTIONS)
        .max_packet_size(LARGEST_PACKET)
        .max_clientid_len(128)
        .max_topic_levels(8)
        .max_subscriptions(256)
        .max_inflight(MAX_INFLIGHT)
        .max_mqueue_len(CLIENT_QUEUE)
        .send_timeout(SEND_TIMEOUT)
        // The library would give those without an expiry one of its own: five bytes of each.
        .message_expiry_interval(Duration::ZERO)
        .handshake_timeout(Duration::from_secs(10))
        .max_session_expiry_interval(Duration::from_hours(1))
        .bind()
        .and_then(rmqtt::net::Listener::tcp)
        .map_err(io_error)?;
    let address = listener.local_addr().map_err(io_error)?;

    let context = ServerContext::new()
        // The load average of a laptop that compiles is no reason to refuse a robot.
        .busy_check_enable(false)
        .mqtt_max_sessions(isize::try_from(sessions).unwrap_or(isize::MAX))
        .build()
        .await;
    let library = DefaultRouter::new(Some(context.clone()));
    *context.extends.router_mut().await =
        Box::new(routes::Routes::new(library, Arc::clone(&clients)));
    *context.extends.retain_mut().await = Box::new(retain::Retained::new(Arc::clone(&counters)));
    *context.extends.shared_subscription_mut().await = Box::new(sharing::RoundRobin::default());
    *context.extends.fitter_mgr_mut().await =
        Box::new(sharing::QueueSizes::new(server.user.clone(), SERVER_QUEUE));

    let register = context.extends.hook_mgr().register();
    let guard = guard::Guard::new(
        fleet,
        [&server, &simulator],
        accounts,
        clients,
        counters,
        context.clone(),
    );
    for hook in [
        Type::ClientAuthenticate,
        Type::ClientConnected,
        Type::MessagePublishCheckAcl,
        Type::ClientSubscribeCheckAcl,
        Type::ClientDisconnected,
    ] {
        register.add(hook, Box::new(guard.clone())).await;
    }
    register.start().await;

    // `run`, not `start`: the latter ends the process when something goes wrong.
    let running = context.clone();
    tokio::spawn(async move {
        if let Err(error) = MqttServer::new(running)
            .listener_by_id(listener, address.port())
            .build()
            .run()
            .await
        {
            tracing::error!(%error, "the embedded broker ended");
        }
    });
    Ok((address, context))
}

/// The broker's errors are opaque; what the system said is inside when binding failed.
fn io_error(error: rmqtt::Error) -> std::io::Error {
    match error.downcast::<std::io::Error>() {
        Ok(error) => error,
        Err(error) => std::io::Error::other(error.to_string()),
    }
}
