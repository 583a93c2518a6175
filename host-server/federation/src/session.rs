//! A session with the broker that hears one filter, and says one thing until it is another.

use std::fmt;
use std::time::Duration;

use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Filter, Packet, PublishProperties, SubscribeReasonCode};
use rumqttc::v5::{AsyncClient, ClientError, ConnectionError, Event, EventLoop, MqttOptions};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crawler_federated::message::LONGEST;

/// Messages that wait for the connection.
const OUTGOING: usize = 16;
/// For connecting and subscribing.
const SETUP: Duration = Duration::from_secs(5);
/// A connection with nothing to tell for so long is stuck: pings are due more often.
const STUCK: Duration = Duration::from_secs(16);
const KEEP_ALIVE: Duration = Duration::from_secs(5);
const FIRST_PAUSE: Duration = Duration::from_millis(200);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// For the last word to arrive.
const FAREWELL: Duration = Duration::from_secs(1);
/// The longest message, with its topic and properties, in bytes.
pub const LARGEST_PACKET: u32 = LONGEST as u32 + 1_024;

/// What is said.
#[derive(Debug, Clone)]
pub(crate) struct Saying {
    pub(crate) topic: String,
    pub(crate) payload: Vec<u8>,
    pub(crate) retain: bool,
    /// After so many seconds the broker need not have it any more.
    pub(crate) expires_s: Option<u32>,
}

/// Why there is no session with the broker.
enum SessionError {
    /// The broker cannot be reached, or lets nobody in.
    Connection(Box<ConnectionError>),
    /// The client takes no requests.
    Client(Box<ClientError>),
    /// The broker refuses what we subscribe to.
    Subscription,
}

impl fmt::Display for SessionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Connection(error) => error.fmt(f),
            Self::Client(error) => error.fmt(f),
            Self::Subscription => f.write_str("the broker refuses the subscription"),
        }
    }
}

/// Keeps a session until `stop`, hands what comes under `filter` to `heard`, topic and payload, and says what is to be `said`, once more with
/// each new connection. What is said last is waited for, for a second.
pub(crate) async fn keep(
    options: MqttOptions,
    filter: String,
    mut said: watch::Receiver<Option<Saying>>,
    mut heard: impl FnMut(&str, &[u8]) + Send,
    stop: CancellationToken,
) {
    let mut pause = FIRST_PAUSE;
    let mut away = false;
    loop {
        let connected = tokio::select! {
            () = stop.cancelled() => return,
            connected = tokio::time::timeout(SETUP, connect(&options, &filter, &mut heard)) => connected,
        };
        let reason = match connected {
            Ok(Ok((client, mut events))) => {
                pause = FIRST_PAUSE;
                away = false;
                tracing::info!("the session for learning stands");
                let ended = tokio::select! {
                    biased;
                    () = stop.cancelled() => None,
                    reason = serve(&mut events, &mut heard) => Some(reason),
                    () = speak(&client, &mut said) => None,
                };
                match ended {
                    Some(reason) => reason,
                    None => return leave(&client, events, &mut said).await,
                }
            }
            Ok(Err(error)) => error.to_string(),
            Err(_) => "no answer in time".to_owned(),
        };
        if !std::mem::replace(&mut away, true) {
            tracing::warn!(
                reason,
                "no session for learning with the broker; trying again"
            );
        }
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(pause) => {}
        }
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
}

async fn connect(
    options: &MqttOptions,
    filter: &str,
    heard: &mut impl FnMut(&str, &[u8]),
) -> Result<(AsyncClient, EventLoop), SessionError> {
    let lost = |error| SessionError::Connection(Box::new(error));
    let refused = |error| SessionError::Client(Box::new(error));
    let mut options = options.clone();
    let mut network = rumqttc::NetworkOptions::new();
    network.set_tcp_nodelay(true);
    options
        .set_network_options(network)
        .set_keep_alive(KEEP_ALIVE)
        .set_clean_start(true)
        .set_max_packet_size(Some(LARGEST_PACKET));
    let (client, mut events) = AsyncClient::new(options, OUTGOING);
    let mut filter = Filter::new(filter, QoS::AtLeastOnce);
    filter.nolocal = true;
    let mut subscribed = false;
    loop {
        match events.poll().await.map_err(lost)? {
            Event::Incoming(Packet::ConnAck(_)) if !subscribed => {
                client
                    .try_subscribe_many([filter.clone()])
                    .map_err(refused)?;
                subscribed = true;
            }
            Event::Incoming(Packet::SubAck(ack)) => {
                let taken = |code| matches!(code, &SubscribeReasonCode::Success(_));
                if ack.return_codes.iter().all(taken) {
                    return Ok((client, events));
                }
                return Err(SessionError::Subscription);
            }
            // What is retained may come before the acknowledgement.
            event => hand_on(&event, heard),
        }
    }
}

fn hand_on(event: &Event, heard: &mut impl FnMut(&str, &[u8])) {
    if let Event::Incoming(Packet::Publish(publish)) = event
        && let Ok(topic) = std::str::from_utf8(&publish.topic)
    {
        heard(topic, &publish.payload);
    }
}

/// Hands on what comes until the session ends, and says why it did.
async fn serve(events: &mut EventLoop, heard: &mut impl FnMut(&str, &[u8])) -> String {
    loop {
        match tokio::time::timeout(STUCK, events.poll()).await {
            Ok(Ok(Event::Incoming(Packet::Disconnect(packet)))) => {
                return format!("the broker ended the session: {:?}", packet.reason_code);
            }
            Ok(Ok(event)) => hand_on(&event, heard),
            Ok(Err(error)) => return error.to_string(),
            Err(_) => return "the connection is stuck".to_owned(),
        }
    }
}

/// Says what there is to say, and whatever is to be said then. Ends when nobody can say anything any more.
async fn speak(client: &AsyncClient, said: &mut watch::Receiver<Option<Saying>>) {
    said.mark_changed();
    while said.changed().await.is_ok() {
        say(client, said).await;
    }
}

async fn say(client: &AsyncClient, said: &mut watch::Receiver<Option<Saying>>) {
    let saying = said.borrow_and_update().clone();
    if let Some(Saying {
        topic,
        payload,
        retain,
        expires_s,
    }) = saying
    {
        let properties = PublishProperties {
            message_expiry_interval: expires_s,
            ..PublishProperties::default()
        };
        // A session that is over has nobody to say it to; the next one says it.
        let _ = client
            .publish_with_properties(topic, QoS::AtLeastOnce, retain, payload, properties)
            .await;
    }
}

/// Has the last word arrive, and says goodbye.
async fn leave(
    client: &AsyncClient,
    mut events: EventLoop,
    said: &mut watch::Receiver<Option<Saying>>,
) {
    let farewell = async {
        if said.has_changed().unwrap_or(true) && said.borrow().is_some() {
            say(client, said).await;
            while let Ok(event) = events.poll().await {
                if matches!(event, Event::Incoming(Packet::PubAck(_))) {
                    break;
                }
            }
        }
        if client.try_disconnect().is_ok() {
            while let Ok(event) = events.poll().await {
                if event == Event::Outgoing(rumqttc::Outgoing::Disconnect) {
                    break;
                }
            }
        }
    };
    let _ = tokio::time::timeout(FAREWELL, farewell).await;
}
