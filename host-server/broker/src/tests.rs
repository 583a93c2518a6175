//! What only the server does to its broker: ending sessions, asking how a link is.

mod learners;
mod updates;

use std::time::Duration;

use crawler_access::{Role, UserName, password};
use crawler_records::{Records, User};
use rmqtt::types::{ClientId, Id};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{
    ConnectProperties, ConnectReturnCode, LastWill, Packet, PubAckReason,
};
use rumqttc::v5::{AsyncClient, ConnectionError, Event, MqttOptions};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::*;

const PASSWORD: &str = "correct horse";
/// How long a test waits for something that is to happen, however slow the machine is.
const LIMIT: Duration = Duration::from_mins(1);

/// Waits for the end of what is to happen.
async fn within<T>(what: &str, happening: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, happening)
        .await
        .unwrap_or_else(|_| panic!("not within {LIMIT:?}: {what}"))
}

struct Bench {
    broker: EmbeddedBroker,
    records: Records,
    port: u16,
}

impl Bench {
    async fn new() -> Self {
        let records = Records::in_memory().await.expect("records");
        let fleet = Fleet::new("swarm").expect("a fleet");
        let metrics = Arc::new(crawler_metrics::Metrics::new());
        let (audit, writer) = crawler_records::audit_log::AuditLog::new(records.clone(), metrics);
        tokio::spawn(writer.run(CancellationToken::new()));
        let accounts = Arc::new(RecordAccounts::new(
            records.clone(),
            Arc::new(crawler_passwords::Failures::default()),
            crawler_passwords::Hashing::new(Duration::from_mins(1)),
            audit.notes(),
        ));
        let limits = crawler_system::descriptors::Descriptors::MOST.into();
        let broker = EmbeddedBroker::start(&fleet, accounts, limits)
            .await
            .expect("a broker");
        let any = "127.0.0.1:0".parse().expect("an address");
        let port = broker.listen(any, None).await.expect("a port").port();
        Self {
            broker,
            records,
            port,
        }
    }

    async fn enroll(&self, name: &str) -> String {
        let secret = Secret::generate().expect("randomness");
        let enrolled = self
            .records
            .credentials()
            .enroll(name, secret.digest(), 1, "test");
        enrolled.await.expect("enrolled");
        secret.to_string()
    }

    fn options(&self, client_id: &str, user: &str, secret: &str) -> MqttOptions {
        let mut options = MqttOptions::new(client_id, "127.0.0.1", self.port);
        options
            .set_keep_alive(Duration::from_secs(5))
            .set_clean_start(true)
            .set_credentials(user, secret);
        options
    }

    async fn connect(
        &self,
        client_id: &str,
        user: &str,
        secret: &str,
    ) -> Result<Client, ConnectReturnCode> {
        Client::connect(self.options(client_id, user, secret)).await
    }
}

struct Client {
    sender: AsyncClient,
    /// What the broker says to publishes with QoS 1.
    acknowledged: mpsc::UnboundedReceiver<PubAckReason>,
    /// Runs until the session ends.
    task: JoinHandle<()>,
}

impl Client {
    async fn connect(options: MqttOptions) -> Result<Self, ConnectReturnCode> {
        let (client, mut events) = AsyncClient::new(options, 1_000);
        loop {
            match within("an answer to a login", events.poll()).await {
                Ok(Event::Incoming(Packet::ConnAck(_))) => break,
                Ok(_) => {}
                Err(ConnectionError::ConnectionRefused(code)) => return Err(code),
                Err(error) => panic!("{error}"),
            }
        }
        let (acknowledge, acknowledged) = mpsc::unbounded_channel();
        let task = tokio::spawn(async move {
            while let Ok(event) = events.poll().await {
                if let Event::Incoming(Packet::PubAck(ack)) = event {
                    // Most tests do not ask.
                    let _ = acknowledge.send(ack.reason);
                }
            }
        });
        Ok(Self {
            sender: client,
            acknowledged,
            task,
        })
    }

    /// Waits until its session ends.
    async fn ends(&mut self) {
        let ended = within("the session ends", &mut self.task).await;
        ended.expect("no panic");
    }

    /// Wants its session to be there, and heard on `topic`: whoever is dropped is neither from that
    /// moment on.
    async fn is_heard(&mut self, topic: &str) {
        let sent = self
            .sender
            .publish(topic, QoS::AtLeastOnce, false, "still here");
        sent.await.expect("a connection");
        let reason = within("an acknowledgement", self.acknowledged.recv()).await;
        let heard = [PubAckReason::Success, PubAckReason::NoMatchingSubscribers];
        assert!(
            reason.is_some_and(|reason| heard.contains(&reason)),
            "{reason:?}"
        );
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.task.abort();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_robot_is_gone_and_the_fleet_learns_of_it() {
    let bench = Bench::new().await;
    let handle = bench.broker.handle();
    let server = bench.broker.server().clone();
    let password = server.password.to_string();
    let options = bench.options(&server.user, &server.user, &password);
    let (listener, mut heard) = AsyncClient::new(options, 10);
    listener
        .try_subscribe("swarm/#", QoS::AtLeastOnce)
        .expect("room");
    while !matches!(
        within("a subscription", heard.poll())
            .await
            .expect("the server"),
        Event::Incoming(Packet::SubAck(_))
    ) {}

    let secret = bench.enroll("rover-1").await;
    let mut options = bench.options("rover-1", "rover-1", &secret);
    let will = LastWill::new("swarm/status/rover-1", "gone", QoS::AtLeastOnce, true, None);
    options.set_last_will(will);
    let mut robot = Client::connect(options).await.expect("let in");
    let other = bench.enroll("rover-2").await;
    let mut other = bench
        .connect("rover-2", "rover-2", &other)
        .await
        .expect("let in");

    let revoked = bench.records.credentials().revoke("rover-1", 2).await;
    revoked.expect("revoked");
    handle.drop_client(Kind::Machine, "rover-1").await;
    robot.ends().await;
    // The fleet learns that it is gone.
    loop {
        let event = within("the will", heard.poll()).await;
        if let Event::Incoming(Packet::Publish(publish)) = event.expect("the server") {
            assert_eq!(publish.payload, "gone");
            break;
        }
    }
    other.is_heard("swarm/heartbeat/rover-2").await;
    let again = bench.connect("rover-1", "rover-1", &secret).await;
    assert_eq!(again.err(), Some(ConnectReturnCode::BadUserNamePassword));
    assert_eq!(handle.counters.dropped.load(Ordering::Relaxed), 1);

    // With a new secret it is welcome at once, and the old one stays worth nothing.
    let new = bench.enroll("rover-1").await;
    handle.drop_client(Kind::Machine, "rover-1").await;
    let again = bench.connect("rover-1", "rover-1", &new).await;
    assert!(again.is_ok());
    let old = bench.connect("rover-1", "rover-1", &secret).await;
    assert_eq!(old.err(), Some(ConnectReturnCode::BadUserNamePassword));
    bench.broker.stop().await;
    // Of no effect, and no hang.
    handle.drop_client(Kind::Machine, "rover-1").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulator_goes_with_all_its_robots_and_a_person_with_all_sessions() {
    let bench = Bench::new().await;
    let lab = bench.enroll("simulator-lab").await;
    let user = User {
        name: "ada".parse::<UserName>().expect("a name"),
        role: Role::Operator,
        password: Some(password::Memory::new().hash(PASSWORD).expect("a hash")),
        created: 1,
        disabled: false,
    };
    bench.records.users().add(&user).await.expect("added");
    let mut all = Vec::new();
    for (client_id, name, secret) in [
        ("sim-0001", "simulator-lab", lab.as_str()),
        ("sim-0002", "simulator-lab", &lab),
        ("simulator-x", "simulator-lab", &lab),
        ("laptop", "ada", PASSWORD),
        ("desk", "ada", PASSWORD),
    ] {
        let client = bench.connect(client_id, name, secret).await;
        all.push(client.expect("let in"));
    }
    let handle = bench.broker.handle();
    handle.drop_client(Kind::Machine, "sim-0001").await;
    // Its name is the simulator's.
    all[0].is_heard("swarm/heartbeat/sim-0001").await;
    handle.drop_client(Kind::Machine, "simulator-lab").await;
    for client in &mut all[..3] {
        client.ends().await;
    }
    all[3].is_heard("swarm/command/swarm").await;
    handle.drop_client(Kind::Person, "ada").await;
    for client in &mut all[3..] {
        client.ends().await;
    }
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_waits_for_its_client_goes_too() {
    let bench = Bench::new().await;
    let handle = bench.broker.handle();
    let secret = bench.enroll("rover-1").await;
    let stay = |secret: &str| {
        let mut options = bench.options("rover-1", "rover-1", secret);
        let mut properties = ConnectProperties::new();
        properties.session_expiry_interval = Some(600);
        options
            .set_clean_start(false)
            .set_connect_properties(properties);
        options
    };
    let present = async |secret: &str| {
        let (client, mut events) = AsyncClient::new(stay(secret), 10);
        let present = loop {
            let event = within("an answer to a login", events.poll()).await;
            if let Event::Incoming(Packet::ConnAck(ack)) = event.expect("let in") {
                break ack.session_present;
            }
        };
        drop((client, events));
        let id = Id::from(handle.context.node.id(), ClientId::from("rover-1"));
        within("the broker notices that it is away", async {
            let connected = async || {
                let broker = handle.context.extends.shared().await;
                broker.entry(id.clone()).is_connected().await
            };
            while connected().await {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        })
        .await;
        present
    };
    assert!(!present(&secret).await);
    assert!(present(&secret).await, "it waits");
    let again = bench.enroll("rover-1").await;
    handle.drop_client(Kind::Machine, "rover-1").await;
    assert!(!present(&again).await);
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_floods_shows_and_can_be_dropped_meanwhile() {
    let bench = Bench::new().await;
    let handle = bench.broker.handle();
    let secret = bench.enroll("rover-1").await;
    let mut robot = bench
        .connect("rover-1", "rover-1", &secret)
        .await
        .expect("let in");
    let id = RobotId::new("rover-1").expect("an id");
    assert_eq!(handle.link(&id), None);
    let sender = robot.sender.clone();
    let flood = tokio::spawn(async move {
        let topic = "swarm/telemetry/rover-1";
        while sender
            .publish(topic, QoS::AtMostOnce, false, "{}")
            .await
            .is_ok()
        {}
    });
    within("throttled", async {
        while handle.link(&id) != Some(LinkState::Throttled) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    })
    .await;
    let revoked = bench.records.credentials().revoke("rover-1", 2).await;
    revoked.expect("revoked");
    handle.drop_client(Kind::Machine, "rover-1").await;
    // Also in the middle of a flood.
    robot.ends().await;
    flood.abort();
    bench.broker.stop().await;
}
