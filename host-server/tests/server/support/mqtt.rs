//! Clients of a closed broker, and the accounts they log in with.

use crawler_access::{Role, Secret, UserName, password};
use crawler_records::{Records, User};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{
    ConnectReturnCode, LastWill, Packet, PubAckReason, Publish, SubscribeReasonCode,
};
use rumqttc::v5::{AsyncClient, ConnectionError, Event, EventLoop, MqttOptions};
use tokio::sync::mpsc;

use crate::support::{Fixture, LIMIT, mqtt_options, within};

pub const PASSWORD: &str = "correct horse";

/// A server that wants names, and the records it reads.
pub struct Closed {
    pub fixture: Fixture,
    pub records: Records,
}

impl Closed {
    pub async fn start() -> Self {
        let fixture = Fixture::start_with(|layer| layer.open = Some(false)).await;
        Self::around(fixture).await
    }

    pub async fn around(fixture: Fixture) -> Self {
        let records = Records::open(&fixture.settings.data)
            .await
            .expect("the records of the server");
        Self { fixture, records }
    }

    /// Makes a credential and returns its secret.
    pub async fn enroll(&self, name: &str) -> String {
        let secret = Secret::generate().expect("randomness");
        self.records
            .credentials()
            .enroll(name, secret.digest(), 1, "test")
            .await
            .expect("enrolled");
        secret.to_string()
    }

    /// Makes an account with [`PASSWORD`].
    pub async fn person(&self, name: &str, role: Role) {
        let user = User {
            name: name.parse::<UserName>().expect("a name"),
            role,
            password: Some(password::Memory::new().hash(PASSWORD).expect("a hash")),
            created: 1,
            disabled: false,
        };
        self.records.users().add(&user).await.expect("added");
    }

    /// Options of a client of this broker.
    pub fn options(&self, client_id: &str, user: &str, secret: &str) -> MqttOptions {
        let mut options = mqtt_options(client_id, self.fixture.server.mqtt().port);
        options.set_clean_start(true).set_credentials(user, secret);
        options
    }

    pub async fn connect(&self, client_id: &str, user: &str, secret: &str) -> Client {
        Client::connect(self.options(client_id, user, secret))
            .await
            .unwrap_or_else(|code| panic!("{user} as {client_id}: {code:?}"))
    }

    /// A robot with a new credential.
    pub async fn robot(&self, id: &str) -> Client {
        let secret = self.enroll(id).await;
        self.connect(id, id, &secret).await
    }

    /// Why a login is refused.
    pub async fn refusal(&self, client_id: &str, user: &str, secret: &str) -> ConnectReturnCode {
        refused(self.options(client_id, user, secret)).await
    }

    /// The value of a metric of the embedded broker.
    pub async fn metric(&self, name: &str) -> f64 {
        let name = format!("terracrawler_embedded_broker_{name} ");
        let answer = self.fixture.get("/metrics").await;
        let text = answer.text();
        let line = text.lines().find_map(|line| line.strip_prefix(&name));
        line.unwrap_or_else(|| panic!("no {name} in\n{text}"))
            .trim()
            .parse()
            .expect("a number")
    }

    /// How often the broker has refused something for this reason.
    pub async fn refusals(&self, reason: &str) -> f64 {
        let name = format!("refusals_total{{reason=\"{reason}\"}}");
        self.metric(&name).await
    }

    pub async fn stop(self) {
        self.records.close().await;
        self.fixture.stop().await;
    }
}

/// A will of one byte.
pub fn will(options: &mut MqttOptions, topic: &str, retain: bool) {
    let will = LastWill::new(topic, "x", QoS::AtLeastOnce, retain, None);
    options.set_last_will(will);
}

/// Why a login with these options is refused.
pub async fn refused(options: MqttOptions) -> ConnectReturnCode {
    match Client::connect(options).await {
        Ok(_) => panic!("let in"),
        Err(code) => code,
    }
}

/// A connected client whose connection is served by a task.
pub struct Client {
    pub sender: AsyncClient,
    packets: mpsc::UnboundedReceiver<Packet>,
    task: tokio::task::JoinHandle<()>,
}

impl Client {
    pub async fn connect(options: MqttOptions) -> Result<Self, ConnectReturnCode> {
        let (client, mut events) = AsyncClient::new(options, 10_000);
        loop {
            match within("an answer to a login", events.poll()).await {
                Ok(Event::Incoming(Packet::ConnAck(_))) => break,
                Ok(_) => {}
                Err(ConnectionError::ConnectionRefused(code)) => return Err(code),
                Err(error) => panic!("{error}"),
            }
        }
        let (outlet, packets) = mpsc::unbounded_channel();
        let task = tokio::spawn(pump(events, outlet));
        Ok(Self {
            sender: client,
            packets,
            task,
        })
    }

    /// What the broker says to a publish with QoS 1.
    pub async fn publish(&mut self, topic: &str, payload: &str) -> PubAckReason {
        self.sender
            .publish(topic, QoS::AtLeastOnce, false, payload.as_bytes().to_vec())
            .await
            .expect("a connection");
        self.acknowledged().await
    }

    /// The same to a retained one.
    pub async fn retain(&mut self, topic: &str, payload: &str) -> PubAckReason {
        self.sender
            .publish(topic, QoS::AtLeastOnce, true, payload.as_bytes().to_vec())
            .await
            .expect("a connection");
        self.acknowledged().await
    }

    async fn acknowledged(&mut self) -> PubAckReason {
        self.wait(|packet| match packet {
            Packet::PubAck(ack) => Some(ack.reason),
            _ => None,
        })
        .await
    }

    /// What the broker says to a subscription.
    pub async fn subscribe(&mut self, filter: &str) -> SubscribeReasonCode {
        self.sender
            .subscribe(filter, QoS::AtLeastOnce)
            .await
            .expect("a connection");
        self.wait(|packet| match packet {
            Packet::SubAck(ack) => ack.return_codes.first().copied(),
            _ => None,
        })
        .await
    }

    /// The next message.
    pub async fn next(&mut self) -> Publish {
        self.wait(|packet| match packet {
            Packet::Publish(publish) => Some(publish),
            _ => None,
        })
        .await
    }

    /// The next message on a topic.
    pub async fn message(&mut self, topic: &str) -> Publish {
        self.wait(|packet| match packet {
            Packet::Publish(publish) if publish.topic == topic.as_bytes() => Some(publish),
            _ => None,
        })
        .await
    }

    async fn wait<T>(&mut self, mut wanted: impl FnMut(Packet) -> Option<T>) -> T {
        let mut last = None;
        let found = async {
            loop {
                let packet = self.packets.recv().await.expect("a connection");
                last = Some(packet.clone());
                if let Some(found) = wanted(packet) {
                    return found;
                }
            }
        };
        tokio::time::timeout(LIMIT, found)
            .await
            .unwrap_or_else(|_| panic!("not within {LIMIT:?}; the last packet was {last:?}"))
    }

    /// Topics of the messages that have arrived and were not asked for.
    pub fn heard(&mut self) -> Vec<String> {
        let mut topics = Vec::new();
        while let Ok(packet) = self.packets.try_recv() {
            if let Packet::Publish(publish) = packet {
                topics.push(String::from_utf8_lossy(&publish.topic).into_owned());
            }
        }
        topics
    }

    /// Whether the session is still served.
    pub fn is_connected(&self) -> bool {
        !self.task.is_finished()
    }

    /// Waits for the end of the session.
    pub async fn ended(&mut self) {
        let ended = within("the session ends", &mut self.task).await;
        ended.expect("no panic");
    }

    /// Cuts the connection without a word, so that the will is published.
    pub async fn vanish(mut self) {
        self.task.abort();
        let _ = (&mut self.task).await;
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn pump(mut events: EventLoop, sender: mpsc::UnboundedSender<Packet>) {
    while let Ok(event) = events.poll().await {
        if let Event::Incoming(packet) = event
            && sender.send(packet).is_err()
        {
            return;
        }
    }
}
