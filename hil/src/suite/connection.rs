//! The suite's own MQTT session. A task of its own serves it, so that nothing a case does or
//! leaves undone costs a byte of the stream.

use std::fmt;
use std::time::Duration;

use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{
    ConnectReturnCode, Filter, Packet, PubAckReason, SubscribeReasonCode,
};
use rumqttc::v5::{AsyncClient, ClientError, ConnectionError, Event, EventLoop, MqttOptions};
use tokio::sync::mpsc;
use tokio::time::Instant;

use super::BenchError;
use crate::BrokerUrl;

const KEEP_ALIVE: Duration = Duration::from_secs(5);
/// For connecting and subscribing.
const SETUP: Duration = Duration::from_secs(10);
/// Publishes waiting to leave.
const OUTGOING: usize = 256;
/// Arrivals waiting to be looked at; beyond it the broker has to wait.
const INCOMING: usize = 4_096;
/// Images included.
const MAX_PACKET: u32 = 512 * 1024;

/// What the session brings.
#[derive(Debug)]
pub(super) enum Arrival {
    /// A message.
    Message {
        topic: String,
        payload: Vec<u8>,
        /// Whether it was there before we asked.
        retained: bool,
        at: Instant,
    },
    /// The broker has one of our QoS 1 messages and refused to pass it on.
    Refused,
    /// The session is over.
    Lost(String),
}

/// A session with the broker; ends when dropped.
pub(super) struct Connection {
    client: AsyncClient,
    arrivals: mpsc::Receiver<Arrival>,
    task: tokio::task::JoinHandle<()>,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Connection {
    /// Connects and subscribes.
    ///
    /// # Errors
    /// [`BenchError::Unreachable`] or [`BenchError::Refused`].
    pub(super) async fn open(
        broker: &BrokerUrl,
        client_id: &str,
        filters: Vec<(String, QoS)>,
    ) -> Result<Self, BenchError> {
        let mut options = MqttOptions::new(client_id, &broker.host, broker.port);
        options
            .set_keep_alive(KEEP_ALIVE)
            .set_clean_start(true)
            .set_max_packet_size(Some(MAX_PACKET));
        if let Some((user, password)) = &broker.credentials {
            options.set_credentials(user, password);
        }
        let mut network = rumqttc::NetworkOptions::new();
        network.set_tcp_nodelay(true);
        options.set_network_options(network);
        let (client, mut events) = AsyncClient::new(options, OUTGOING);
        let unreachable = |text: String| BenchError::Unreachable(broker.to_string(), text);
        let early = match tokio::time::timeout(SETUP, set_up(&client, &mut events, filters)).await {
            Ok(Ok(early)) => early,
            Ok(Err(Refusal::Refused(text))) => {
                return Err(BenchError::Refused(broker.to_string(), text));
            }
            Ok(Err(Refusal::Unreachable(text))) => return Err(unreachable(text)),
            Err(_) => {
                let text = format!("no MQTT 5 answer within {} s", SETUP.as_secs());
                return Err(unreachable(text));
            }
        };
        let (sender, arrivals) = mpsc::channel(INCOMING);
        let task = tokio::spawn(serve(events, early, sender));
        Ok(Self {
            client,
            arrivals,
            task,
        })
    }

    /// Hands a message to the session.
    ///
    /// # Errors
    /// [`NotSent`] when too much is waiting or the session is over.
    pub(super) fn publish(
        &self,
        topic: &str,
        at_least_once: bool,
        payload: Vec<u8>,
    ) -> Result<(), NotSent> {
        let quality = if at_least_once {
            QoS::AtLeastOnce
        } else {
            QoS::AtMostOnce
        };
        let sent = self.client.try_publish(topic, quality, false, payload);
        sent.map_err(|error| NotSent(Box::new(error)))
    }

    /// The next arrival; none when `until` passes first.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(super) async fn next(&mut self, until: Instant) -> Option<Arrival> {
        match tokio::time::timeout_at(until, self.arrivals.recv()).await {
            Ok(Some(arrival)) => Some(arrival),
            Ok(None) => Some(Arrival::Lost("the MQTT client failed".into())),
            Err(_) => None,
        }
    }

    /// An arrival that is already there.
    pub(super) fn waiting(&mut self) -> Option<Arrival> {
        self.arrivals.try_recv().ok()
    }

    /// Lets what was handed over leave, then says goodbye.
    pub(super) async fn close(mut self) {
        let farewell = async {
            if self.client.try_disconnect().is_ok() {
                while self.arrivals.recv().await.is_some() {}
            }
        };
        // Whoever does not take the goodbye is left.
        let _ = tokio::time::timeout(Duration::from_secs(2), farewell).await;
    }
}

/// Why a message does not leave.
pub(super) struct NotSent(Box<ClientError>);

impl fmt::Display for NotSent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a message cannot be sent: {}", self.0)
    }
}

enum Refusal {
    Refused(String),
    Unreachable(String),
}

async fn set_up(
    client: &AsyncClient,
    events: &mut EventLoop,
    filters: Vec<(String, QoS)>,
) -> Result<Vec<Event>, Refusal> {
    let filters: Vec<Filter> = filters
        .into_iter()
        .map(|(filter, quality)| Filter::new(filter, quality))
        .collect();
    let mut early = Vec::new();
    loop {
        match events.poll().await.map_err(|error| refusal(&error))? {
            Event::Incoming(Packet::ConnAck(_)) => client
                .try_subscribe_many(filters.clone())
                .map_err(|error| Refusal::Unreachable(error.to_string()))?,
            Event::Incoming(Packet::SubAck(ack)) => {
                let granted = |code| matches!(code, &SubscribeReasonCode::Success(_));
                if ack.return_codes.iter().all(granted) {
                    return Ok(early);
                }
                return Err(Refusal::Refused("it refuses our subscriptions".into()));
            }
            // Retained messages may overtake the acknowledgement.
            event @ Event::Incoming(Packet::Publish(_)) if early.len() < INCOMING => {
                early.push(event);
            }
            _ => {}
        }
    }
}

fn refusal(error: &ConnectionError) -> Refusal {
    match error {
        ConnectionError::ConnectionRefused(
            ConnectReturnCode::BadUserNamePassword | ConnectReturnCode::NotAuthorized,
        ) => Refusal::Refused("it refuses user name or password".into()),
        ConnectionError::ConnectionRefused(code) => {
            Refusal::Refused(format!("it refuses us: {code:?}"))
        }
        ConnectionError::Io(error) => Refusal::Unreachable(error.to_string()),
        error => Refusal::Unreachable(error.to_string()),
    }
}

/// Serves the session to its end.
async fn serve(mut events: EventLoop, early: Vec<Event>, sender: mpsc::Sender<Arrival>) {
    for event in early {
        if let Some(arrival) = arrival(event)
            && sender.send(arrival).await.is_err()
        {
            return;
        }
    }
    loop {
        let arrival = match events.poll().await {
            Ok(Event::Incoming(Packet::Disconnect(packet))) => {
                Some(Arrival::Lost(format!("{:?}", packet.reason_code)))
            }
            Ok(Event::Outgoing(rumqttc::Outgoing::Disconnect)) => return,
            Ok(event) => arrival(event),
            Err(error) => Some(Arrival::Lost(error.to_string())),
        };
        let Some(arrival) = arrival else { continue };
        let over = matches!(arrival, Arrival::Lost(_));
        if sender.send(arrival).await.is_err() || over {
            return;
        }
    }
}

fn arrival(event: Event) -> Option<Arrival> {
    match event {
        Event::Incoming(Packet::Publish(publish)) => Some(Arrival::Message {
            topic: String::from_utf8_lossy(&publish.topic).into_owned(),
            payload: publish.payload.to_vec(),
            retained: publish.retain,
            at: Instant::now(),
        }),
        Event::Incoming(Packet::PubAck(ack)) => match ack.reason {
            PubAckReason::Success | PubAckReason::NoMatchingSubscribers => None,
            _ => Some(Arrival::Refused),
        },
        _ => None,
    }
}
