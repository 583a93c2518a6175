//! The embedded MQTT 5 broker, for a fleet that fits on one machine.
//!
//! The server speaks to it through the same client it would use for any other broker. The broker
//! has a runtime of its own: stopping it ends every session with it, and a busy broker does not
//! delay the API.
//!
//! What protects it from its clients: the sizes and counts below, a budget of messages per client
//! (see [`guard`]), retained messages only where the contract has them, and a send time-out that
//! ends a session whose reader has stalled.

mod guard;
mod retain;
mod sharing;

use std::net::SocketAddr;
use std::num::NonZeroU16;
use std::sync::Arc;
use std::time::Duration;

use crawler_protocol::Fleet;
use rmqtt::context::ServerContext;
use rmqtt::hook::Type;
use rmqtt::net::Builder;
use rmqtt::server::MqttServer;

pub(crate) use guard::GuardCounters;

/// Largest packet the broker takes: an image with its topic and properties.
const MAX_PACKET: u32 = 256 * 1024;
/// Sessions at a time, robots and others together.
const MAX_CONNECTIONS: usize = 25_000;
/// Messages waiting for the server's own session. At 10,000 robots a burst of every robot's
/// retained messages and a second of telemetry fit several times over.
const SERVER_QUEUE: usize = 200_000;
/// Messages waiting for any other session. Holds the retained messages of 10,000 robots.
const CLIENT_QUEUE: usize = 25_000;
/// QoS 1 messages under way to one client.
const MAX_INFLIGHT: NonZeroU16 = NonZeroU16::new(1_000).unwrap();
/// A reader that takes nothing for so long loses its session.
const SEND_TIMEOUT: Duration = Duration::from_secs(2);
const WORKERS: usize = 2;

/// Name and secret by which the broker knows the server's own session.
#[derive(Clone)]
pub(crate) struct Credentials {
    pub(crate) user: String,
    pub(crate) password: String,
}

/// The broker, until it is stopped or dropped.
pub(crate) struct EmbeddedBroker {
    runtime: Option<tokio::runtime::Runtime>,
    address: SocketAddr,
    credentials: Credentials,
    counters: Arc<GuardCounters>,
}

impl EmbeddedBroker {
    /// Binds `listen` and serves it.
    ///
    /// # Errors
    /// What the operating system says when the address cannot be bound.
    pub(crate) async fn start(listen: SocketAddr, fleet: &Fleet) -> std::io::Result<Self> {
        let credentials = Credentials {
            user: format!("server-{}", random_hex()?),
            password: random_hex()?,
        };
        let counters = Arc::new(GuardCounters::default());
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(WORKERS)
            .thread_name("broker")
            .enable_all()
            .build()?;
        let setup = serve(
            listen,
            fleet.clone(),
            credentials.clone(),
            Arc::clone(&counters),
        );
        // The broker's tasks belong to the runtime that is current while it is set up.
        let bound = match runtime.spawn(setup).await {
            Ok(result) => result,
            Err(error) => Err(std::io::Error::other(error)),
        };
        match bound {
            Ok(address) => Ok(Self {
                runtime: Some(runtime),
                address,
                credentials,
                counters,
            }),
            Err(error) => {
                runtime.shutdown_background();
                Err(error)
            }
        }
    }

    /// The address it listens at, with the port chosen by the system when none was asked for.
    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }

    pub(crate) fn credentials(&self) -> Credentials {
        self.credentials.clone()
    }

    pub(crate) fn counters(&self) -> Arc<GuardCounters> {
        Arc::clone(&self.counters)
    }

    /// Ends every session and frees the port.
    pub(crate) async fn stop(mut self) {
        if let Some(runtime) = self.runtime.take() {
            let stopped = tokio::task::spawn_blocking(move || {
                runtime.shutdown_timeout(Duration::from_secs(2));
            });
            if let Err(error) = stopped.await {
                tracing::error!(%error, "the broker did not stop in order");
            }
        }
    }
}

impl Drop for EmbeddedBroker {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

fn random_hex() -> std::io::Result<String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(std::io::Error::other)?;
    Ok(crate::hex(&bytes))
}

async fn serve(
    listen: SocketAddr,
    fleet: Fleet,
    credentials: Credentials,
    counters: Arc<GuardCounters>,
) -> std::io::Result<SocketAddr> {
    let listener = Builder::new()
        .name("fleet")
        .laddr(listen)
        // A restarted server gets its port back while old connections linger.
        .reuseaddr(Some(true))
        .nodelay(true)
        .allow_anonymous(false)
        .max_connections(MAX_CONNECTIONS)
        .max_packet_size(MAX_PACKET)
        .max_clientid_len(128)
        .max_topic_levels(8)
        .max_subscriptions(256)
        .max_inflight(MAX_INFLIGHT)
        .max_mqueue_len(CLIENT_QUEUE)
        .send_timeout(SEND_TIMEOUT)
        .handshake_timeout(Duration::from_secs(10))
        .max_session_expiry_interval(Duration::from_hours(1))
        .bind()
        .and_then(rmqtt::net::Listener::tcp)
        .map_err(io_error)?;
    let address = listener.local_addr().map_err(io_error)?;

    let context = ServerContext::new()
        // The load average of a laptop that compiles is no reason to refuse a robot.
        .busy_check_enable(false)
        .mqtt_max_sessions(MAX_CONNECTIONS as isize)
        .build()
        .await;
    *context.extends.retain_mut().await = Box::new(retain::Retained::new(Arc::clone(&counters)));
    *context.extends.shared_subscription_mut().await = Box::new(sharing::RoundRobin::default());
    *context.extends.fitter_mgr_mut().await = Box::new(sharing::QueueSizes::new(
        credentials.user.clone(),
        SERVER_QUEUE,
    ));

    let register = context.extends.hook_mgr().register();
    let guard = guard::Guard::new(fleet, credentials, counters);
    for hook in [
        Type::ClientAuthenticate,
        Type::MessagePublishCheckAcl,
        Type::ClientDisconnected,
    ] {
        register.add(hook, Box::new(guard.clone())).await;
    }
    register.start().await;

    // `run`, not `start`: the latter ends the process when something goes wrong.
    tokio::spawn(async move {
        if let Err(error) = MqttServer::new(context)
            .listener_by_id(listener, address.port())
            .build()
            .run()
            .await
        {
            tracing::error!(%error, "the embedded broker ended");
        }
    });
    Ok(address)
}

/// The broker's errors are opaque; what the system said is inside when binding failed.
fn io_error(error: rmqtt::Error) -> std::io::Error {
    match error.downcast::<std::io::Error>() {
        Ok(error) => error,
        Err(error) => std::io::Error::other(error.to_string()),
    }
}
