//! The server's own MQTT session, with its own broker or any other.
//!
//! One task owns the connection and hands every message to the fleet as it arrives. When it
//! cannot keep up, its TCP window fills and the broker's bounded queue for it takes the strain;
//! nothing queues up here.
//!
//! A lost connection is replaced by an entirely new client: commands of the old one would be out of
//! date, and the client library can lock up when a session ends with a publish under way.

use std::error::Error;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crawler_protocol::{Fleet, Qos, Topic, TopicFilter};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{
    ConnectReturnCode, Filter, Packet, PublishProperties, SubscribeReasonCode,
};
use rumqttc::v5::{AsyncClient, ClientError, ConnectionError, Event, EventLoop, MqttOptions};
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use crate::Incoming;
use crawler_commands::{Outlet, PublishError};
use crawler_delivery::Ms;
use crawler_metrics::{Dropped, Metrics};
use crawler_system::address::BrokerUrl;

/// The shortest the library allows; it finds a silent broker within twice that.
const KEEP_ALIVE: Duration = Duration::from_secs(5);
/// A ping is due every [`KEEP_ALIVE`], so a connection with nothing to tell for so long is stuck,
/// for instance in a write that the broker does not read.
const STUCK: Duration = Duration::from_secs(16);
/// For connecting and subscribing.
const SETUP: Duration = Duration::from_secs(5);
const FIRST_PAUSE: Duration = Duration::from_millis(200);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// Publishes waiting for the connection. Beyond it [`Bus::publish`] refuses.
const OUTGOING: usize = 4_096;
/// Above what the embedded broker lets pass.
const MAX_PACKET: u32 = 512 * 1024;
/// Status and parameters of the largest fleet.
const MAX_EARLY: usize = 40_000;
/// What is not retained and waits longer in a broker is of no use to anybody.
const MESSAGE_EXPIRY: Duration = Duration::from_mins(1);

/// Of what comes under it each message goes to one of the servers (MQTT 5, 4.8.2).
const SHARED: &str = "$share/terracrawler/";

const FILTERS: [TopicFilter; 9] = [
    TopicFilter::Status,
    TopicFilter::Heartbeat,
    TopicFilter::Telemetry,
    TopicFilter::Vision,
    TopicFilter::Responses,
    TopicFilter::Parameters,
    TopicFilter::Logs,
    TopicFilter::Map,
    TopicFilter::Image,
];

/// Where the broker is and who we are to it.
#[derive(Clone)]
pub struct Target {
    /// Name or address, an IPv6 address in brackets.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// How we are called there.
    pub client_id: String,
    /// User name and password.
    pub credentials: Option<(String, String)>,
    /// Whether other servers take part of what robots say all the time, and tell it.
    pub shared: bool,
    /// Whether it is heard where trackers see robots.
    pub fixes: bool,
}

impl Target {
    /// A session of our own with an outside broker.
    ///
    /// # Errors
    /// What the machine says that has no randomness for a name.
    pub fn outside(url: &BrokerUrl) -> Result<Self, getrandom::Error> {
        let mut id = [0_u8; 8];
        getrandom::fill(&mut id)?;
        Ok(Self {
            host: bracketed(&url.host),
            port: url.port,
            client_id: format!("server-{}", crawler_system::text::hex(&id)),
            credentials: url.credentials.clone(),
            shared: false,
            fixes: false,
        })
    }

    /// The same broker for another session of ours, of the server with its simulator for instance.
    #[must_use]
    pub fn named(mut self, what: &str) -> Self {
        self.client_id = self.client_id.replacen("server", what, 1);
        self
    }

    /// The same broker for a session of ours beside this one, which waits for nothing that this one sends.
    #[must_use]
    pub fn beside(mut self, what: &str) -> Self {
        self.client_id = format!("{}-{what}", self.client_id);
        self
    }

    /// The options of a session that remembers nothing and takes packets of at most `max_packet` bytes.
    pub fn options(&self, max_packet: u32) -> MqttOptions {
        let mut options = MqttOptions::new(&self.client_id, &self.host, self.port);
        options
            .set_keep_alive(KEEP_ALIVE)
            .set_clean_start(true)
            .set_max_packet_size(Some(max_packet));
        if let Some((user, password)) = &self.credentials {
            options.set_credentials(user, password);
        }
        options
    }
}

/// The client joins host and port with a colon, so an IPv6 address needs its brackets.
#[must_use]
pub fn bracketed(host: &str) -> String {
    if host.contains(':') {
        format!("[{host}]")
    } else {
        host.to_owned()
    }
}

/// Who gets what arrives.
pub trait Receiver: Send + Sync + 'static {
    /// One message. Called from the task that owns the connection: must not block.
    fn message(&self, message: &Incoming<'_>);
    /// The connection came up (`true`) or was lost.
    fn connection(&self, up: bool, text: &str);
}

/// The sending side, shared by everybody who publishes.
pub struct Bus {
    fleet: Fleet,
    client: Mutex<Option<AsyncClient>>,
    up: AtomicBool,
    metrics: Arc<Metrics>,
}

/// A connection that is set up and not yet served.
pub struct Connection {
    client: AsyncClient,
    events: EventLoop,
    /// What arrived while subscribing.
    early: Vec<Event>,
}

impl Bus {
    /// The sending side for `fleet`, without a connection.
    pub fn new(fleet: Fleet, metrics: Arc<Metrics>) -> Self {
        Self {
            fleet,
            client: Mutex::new(None),
            up: AtomicBool::new(false),
            metrics,
        }
    }

    /// Whether messages go out and come in.
    pub fn is_up(&self) -> bool {
        self.up.load(Ordering::Relaxed)
    }

    /// Hands one message to the connection, with the quality of service of its topic.
    ///
    /// Messages go out in the order of these calls.
    ///
    /// # Errors
    /// [`PublishError`]; the message has not gone out then.
    pub fn publish(&self, topic: &Topic, payload: &[u8]) -> Result<(), PublishError> {
        self.publish_within(topic, payload, MESSAGE_EXPIRY)
    }

    /// As [`Bus::publish`]; the broker throws the message away when it cannot hand it on `within`
    /// that time, of which brokers know whole seconds.
    ///
    /// # Errors
    /// [`PublishError`]; the message has not gone out then.
    pub fn publish_within(
        &self,
        topic: &Topic,
        payload: &[u8],
        within: Duration,
    ) -> Result<(), PublishError> {
        let expiry = u32::try_from(within.as_millis().div_ceil(1_000)).unwrap_or(u32::MAX);
        let client = self.client.lock().unwrap_or_else(PoisonError::into_inner);
        let client = client.as_ref().ok_or(PublishError::NotConnected)?;
        let properties = PublishProperties {
            message_expiry_interval: (!topic.retained()).then_some(expiry),
            ..PublishProperties::default()
        };
        client
            .try_publish_with_properties(
                topic.render(&self.fleet).as_str(),
                quality(topic.qos()),
                topic.retained(),
                payload.to_vec(),
                properties,
            )
            .map_err(|_| {
                self.metrics.dropped(Dropped::OutboxFull);
                PublishError::Full
            })?;
        self.metrics.message_out(topic);
        Ok(())
    }

    fn set(&self, client: Option<AsyncClient>) {
        self.up.store(client.is_some(), Ordering::Relaxed);
        self.metrics.broker_connected(client.is_some());
        *self.client.lock().unwrap_or_else(PoisonError::into_inner) = client;
    }
}

impl Outlet for Bus {
    fn is_up(&self) -> bool {
        Self::is_up(self)
    }

    fn publish(&self, topic: &Topic, payload: &[u8], within_ms: Ms) -> Result<(), PublishError> {
        self.publish_within(topic, payload, Duration::from_millis(within_ms))
    }
}

const fn quality(qos: Qos) -> QoS {
    match qos {
        Qos::AtMostOnce => QoS::AtMostOnce,
        Qos::AtLeastOnce => QoS::AtLeastOnce,
    }
}

/// Why a broker cannot be used.
#[derive(Debug)]
#[non_exhaustive]
pub enum BrokerError {
    /// It cannot be reached, or does not speak MQTT 5.
    Connection(Box<ConnectionError>),
    /// It refuses user name or password.
    Credentials,
    /// It refuses us for another reason.
    Refused(ConnectReturnCode),
    /// It does not answer in the time that the client library gives it.
    Silent,
    /// Nor was all of it done in time.
    TimedOut,
    /// The client takes no requests.
    Client(Box<ClientError>),
    /// It refuses what we subscribe to.
    Subscriptions,
    /// It sends and sends, and never says that we have subscribed.
    Unacknowledged,
}

impl From<ConnectionError> for BrokerError {
    fn from(error: ConnectionError) -> Self {
        match error {
            ConnectionError::ConnectionRefused(ConnectReturnCode::BadUserNamePassword) => {
                Self::Credentials
            }
            ConnectionError::ConnectionRefused(code) => Self::Refused(code),
            ConnectionError::Timeout(_) => Self::Silent,
            error => Self::Connection(Box::new(error)),
        }
    }
}

impl From<ClientError> for BrokerError {
    fn from(error: ClientError) -> Self {
        Self::Client(Box::new(error))
    }
}

impl fmt::Display for BrokerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Connection(error) => match &**error {
                ConnectionError::Io(error) => error.fmt(f),
                error => error.fmt(f),
            },
            Self::Credentials => f.write_str("the broker refuses user name or password"),
            Self::Refused(code) => write!(f, "the broker refuses us: {code:?}"),
            Self::Silent => f.write_str("no answer in time"),
            Self::TimedOut => write!(f, "no answer within {} s", SETUP.as_secs()),
            Self::Client(error) => error.fmt(f),
            Self::Subscriptions => f.write_str("the broker refuses our subscriptions"),
            Self::Unacknowledged => {
                f.write_str("the broker sends without acknowledging our subscriptions")
            }
        }
    }
}

impl Error for BrokerError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::Connection(error) => Some(&**error),
            Self::Client(error) => Some(&**error),
            Self::Credentials
            | Self::Refused(_)
            | Self::Silent
            | Self::TimedOut
            | Self::Subscriptions
            | Self::Unacknowledged => None,
        }
    }
}

/// Connects and subscribes once.
///
/// # Errors
/// [`BrokerError`]
pub async fn connect(target: &Target, fleet: &Fleet) -> Result<Connection, BrokerError> {
    match tokio::time::timeout(SETUP, set_up(target, fleet)).await {
        Ok(result) => result,
        Err(_) => Err(BrokerError::TimedOut),
    }
}

/// Whether the broker lets us in: connects, and leaves again.
///
/// # Errors
/// [`BrokerError`]
pub async fn probe(target: &Target) -> Result<(), BrokerError> {
    let (client, mut events) = AsyncClient::new(target.options(MAX_PACKET), OUTGOING);
    let probing = async {
        loop {
            match events.poll().await? {
                Event::Incoming(Packet::ConnAck(_)) => {
                    client.try_disconnect()?;
                }
                Event::Outgoing(rumqttc::Outgoing::Disconnect) => return Ok(()),
                _ => {}
            }
        }
    };
    match tokio::time::timeout(SETUP, probing).await {
        Ok(result) => result,
        Err(_) => Err(BrokerError::TimedOut),
    }
}

async fn set_up(target: &Target, fleet: &Fleet) -> Result<Connection, BrokerError> {
    let mut options = target.options(MAX_PACKET);
    let mut network = rumqttc::NetworkOptions::new();
    network.set_tcp_nodelay(true);
    options.set_network_options(network);

    let (client, mut events) = AsyncClient::new(options, OUTGOING);
    let fixes = target.fixes.then_some(TopicFilter::Pose);
    let filters = FILTERS.into_iter().chain(fixes).map(|filter| {
        let text = filter.render(fleet).as_str().to_owned();
        let text = match filter {
            TopicFilter::Heartbeat
            | TopicFilter::Telemetry
            | TopicFilter::Vision
            | TopicFilter::Logs
            | TopicFilter::Image
                if target.shared =>
            {
                format!("{SHARED}{text}")
            }
            _ => text,
        };
        Filter::new(text, quality(filter.qos()))
    });
    let filters: Vec<Filter> = filters.collect();
    let mut early = Vec::new();
    loop {
        match events.poll().await? {
            Event::Incoming(Packet::ConnAck(_)) => client.try_subscribe_many(filters.clone())?,
            Event::Incoming(Packet::SubAck(ack)) => {
                let refused = ack
                    .return_codes
                    .iter()
                    .any(|code| !matches!(code, SubscribeReasonCode::Success(_)));
                if refused {
                    return Err(BrokerError::Subscriptions);
                }
                return Ok(Connection {
                    client,
                    events,
                    early,
                });
            }
            // Retained messages may overtake the acknowledgement.
            event @ Event::Incoming(Packet::Publish(_)) => {
                if early.len() == MAX_EARLY {
                    return Err(BrokerError::Unacknowledged);
                }
                early.push(event);
            }
            _ => {}
        }
    }
}

/// What serves `connection`, and when it is lost new ones, until `stop`. `bus` is up when this returns.
pub fn serve(
    bus: Arc<Bus>,
    target: Target,
    connection: Connection,
    receiver: Arc<dyn Receiver>,
    stop: CancellationToken,
) -> impl Future<Output = ()> + Send {
    // Here and not in the task: whoever has a started server may publish at once.
    bus.set(Some(connection.client.clone()));
    run(bus, target, connection, receiver, stop)
}

async fn run(
    bus: Arc<Bus>,
    target: Target,
    connection: Connection,
    receiver: Arc<dyn Receiver>,
    stop: CancellationToken,
) {
    let mut next = Some(connection);
    let mut pause = FIRST_PAUSE;
    while !stop.is_cancelled() {
        let connection = if let Some(connection) = next.take() {
            Ok(connection)
        } else {
            tokio::select! {
                () = stop.cancelled() => return,
                connected = connect(&target, &bus.fleet) => connected
                    .inspect(|connection| bus.set(Some(connection.client.clone()))),
            }
        };
        match connection {
            Ok(connection) => {
                pause = FIRST_PAUSE;
                receiver.connection(true, "connected to the broker");
                // A task of its own: should the client library panic over what a broker sends, that
                // costs the connection and not the server.
                let session = serve_one(connection, Arc::clone(&receiver), stop.clone());
                let session = AbortOnDropHandle::new(tokio::spawn(session));
                let reason = match session.await {
                    Ok(reason) => reason,
                    Err(error) => format!("the MQTT client failed: {error}"),
                };
                bus.set(None);
                if !stop.is_cancelled() {
                    bus.metrics.broker_lost();
                    tracing::error!(reason, "lost the broker, trying again");
                    receiver.connection(false, &reason);
                }
            }
            Err(error) => tracing::warn!(
                reason = error.to_string(),
                "the broker cannot be reached, trying again"
            ),
        }
        tokio::select! {
            () = stop.cancelled() => {}
            () = tokio::time::sleep(jitter(pause)) => {}
        }
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
}

/// Half to all of `pause`, so that several servers do not return in step.
fn jitter(pause: Duration) -> Duration {
    let mut byte = [0_u8];
    // Without randomness the full pause is right as well.
    let share = match getrandom::fill(&mut byte) {
        Ok(()) => f64::from(byte[0]) / 255.0,
        Err(_) => 1.0,
    };
    pause.mul_f64(0.5 + share / 2.0)
}

/// Serves one connection to its end and says why it ended.
async fn serve_one(
    mut connection: Connection,
    receiver: Arc<dyn Receiver>,
    stop: CancellationToken,
) -> String {
    for event in std::mem::take(&mut connection.early) {
        deliver(receiver.as_ref(), &event);
    }
    let events = &mut connection.events;
    loop {
        tokio::select! {
            biased;
            () = stop.cancelled() => break,
            polled = tokio::time::timeout(STUCK, events.poll()) => match polled {
                Ok(Ok(Event::Incoming(Packet::Disconnect(packet)))) => {
                    return format!("the broker ended the session: {:?}", packet.reason_code);
                }
                Ok(Ok(event)) => deliver(receiver.as_ref(), &event),
                Ok(Err(error)) => return BrokerError::from(error).to_string(),
                Err(_) => return "the connection is stuck".into(),
            },
        }
    }
    // What was handed over before goes out before the DISCONNECT does.
    let farewell = async {
        if connection.client.try_disconnect().is_ok() {
            while let Ok(event) = events.poll().await {
                if event == Event::Outgoing(rumqttc::Outgoing::Disconnect) {
                    break;
                }
            }
        }
    };
    let _ = tokio::time::timeout(Duration::from_secs(1), farewell).await;
    "stopped".into()
}

fn deliver(receiver: &dyn Receiver, event: &Event) {
    if let Event::Incoming(Packet::Publish(publish)) = event {
        let properties = publish.properties.as_ref();
        receiver.message(&Incoming {
            topic: &publish.topic,
            payload: &publish.payload,
            retained: publish.retain,
            content_type: properties.and_then(|properties| properties.content_type.as_deref()),
            properties: properties.map_or(&[], |properties| &properties.user_properties),
        });
    }
}
