//! Updates go between the server and one robot, past everybody else.

use crawler_protocol::MAX_OTA;
use rumqttc::v5::EventLoop;
use rumqttc::v5::mqttbytes::v5::{Publish, SubscribeReasonCode};

use super::*;

/// A client whose packets are looked at one after the other.
pub(super) struct Listener {
    pub(super) sender: AsyncClient,
    events: EventLoop,
    /// What has arrived while something else was waited for.
    heard: Vec<Publish>,
}

impl Listener {
    pub(super) async fn connect(options: MqttOptions) -> Self {
        let (sender, events) = AsyncClient::new(options, 100);
        let mut listener = Self {
            sender,
            events,
            heard: Vec::new(),
        };
        listener
            .wait("let in", |packet| {
                matches!(packet, Packet::ConnAck(_)).then_some(())
            })
            .await;
        listener
    }

    pub(super) async fn wait<T>(&mut self, what: &str, wanted: impl Fn(&Packet) -> Option<T>) -> T {
        loop {
            let event = within(what, self.events.poll()).await;
            let Event::Incoming(packet) = event.expect("a session") else {
                continue;
            };
            let found = wanted(&packet);
            if let Packet::Publish(publish) = packet {
                self.heard.push(publish);
            }
            if let Some(found) = found {
                return found;
            }
        }
    }

    pub(super) async fn subscribe(&mut self, filter: &str) -> bool {
        let asked = self.sender.subscribe(filter, QoS::AtLeastOnce).await;
        asked.expect("a session");
        let code = self.wait("a subscription", |packet| match packet {
            Packet::SubAck(ack) => ack.return_codes.first().copied(),
            _ => None,
        });
        matches!(code.await, SubscribeReasonCode::Success(_))
    }

    pub(super) async fn publish(&mut self, topic: &str, payload: &[u8]) -> PubAckReason {
        let sent = self
            .sender
            .publish(topic, QoS::AtLeastOnce, false, payload.to_vec());
        sent.await.expect("a session");
        self.wait("an acknowledgement", |packet| match packet {
            Packet::PubAck(ack) => Some(ack.reason),
            _ => None,
        })
        .await
    }

    /// The first message on `topic`.
    pub(super) async fn message(&mut self, topic: &str) -> Publish {
        let on = |publish: &Publish| publish.topic == topic.as_bytes();
        if let Some(place) = self.heard.iter().position(on) {
            return self.heard.remove(place);
        }
        let found = self.wait(topic, |packet| match packet {
            Packet::Publish(publish) if on(publish) => Some(publish.clone()),
            _ => None,
        });
        let found = found.await;
        // `wait` keeps what it hears.
        self.heard.pop();
        found
    }

    /// Topics of everything up to the first message on `topic`.
    async fn topics_until(&mut self, topic: &str) -> Vec<String> {
        let text = |publish: &Publish| String::from_utf8_lossy(&publish.topic).into_owned();
        if !self.heard.iter().any(|publish| text(publish) == topic) {
            self.wait(topic, |packet| match packet {
                Packet::Publish(publish) if text(publish) == topic => Some(()),
                _ => None,
            })
            .await;
        }
        self.heard.drain(..).map(|publish| text(&publish)).collect()
    }
}

impl Bench {
    pub(super) async fn person(&self, name: &str, role: Role) {
        let user = User {
            name: name.parse::<UserName>().expect("a name"),
            role,
            password: Some(password::Memory::new().hash(PASSWORD).expect("a hash")),
            created: 1,
            disabled: false,
        };
        self.records.users().add(&user).await.expect("added");
    }

    async fn robot(&self, id: &str) -> Listener {
        let secret = self.enroll(id).await;
        Listener::connect(self.options(id, id, &secret)).await
    }

    /// A session of the server, beside others.
    async fn server(&self, client_id: &str) -> Listener {
        let Credentials { user, password } = self.broker.server();
        Listener::connect(self.options(client_id, user, &password.to_string())).await
    }
}

const OWN: &str = "swarm/ota/rover-1";
const AFTER: &str = "swarm/response/robot/rover-1";

#[tokio::test(flavor = "multi_thread")]
async fn only_the_server_and_the_robot_are_told() {
    let bench = Bench::new().await;
    for (name, role) in [("ada", Role::Viewer), ("bob", Role::Admin)] {
        bench.person(name, role).await;
    }
    let user = bench.broker.server().user.clone();
    let mut server = bench.server(&format!("{user}-updates")).await;
    assert!(server.subscribe("swarm/ota/+").await);
    let mut robot = bench.robot("rover-1").await;
    assert!(robot.subscribe(OWN).await);
    let mut other = bench.robot("rover-2").await;
    for filter in [OWN, "swarm/ota/+", "swarm/ota/#"] {
        assert!(!other.subscribe(filter).await, "{filter}");
    }
    assert_eq!(other.publish(OWN, b"{}").await, PubAckReason::NotAuthorized);
    let mut people = Vec::new();
    for name in ["ada", "bob"] {
        let options = bench.options(name, name, PASSWORD);
        let mut person = Listener::connect(options).await;
        for filter in [OWN, "swarm/ota/+", "swarm/ota/#"] {
            assert!(!person.subscribe(filter).await, "{filter}");
        }
        // All of them still work, and bring everything else.
        for filter in ["swarm/#", "swarm/+/rover-1"] {
            assert!(person.subscribe(filter).await, "{filter}");
        }
        let refused = person.publish(OWN, b"{}").await;
        assert_eq!(refused, PubAckReason::NotAuthorized);
        people.push(person);
    }

    let largest = [b'x'; MAX_OTA + 1];
    let taken = robot.publish(OWN, &largest[..MAX_OTA]).await;
    assert_eq!(taken, PubAckReason::Success);
    let refused = robot.publish(OWN, &largest).await;
    assert_eq!(refused, PubAckReason::QuotaExceeded);
    let handle = bench.broker.handle();
    assert_eq!(handle.counters.oversize.load(Ordering::Relaxed), 1);
    assert_eq!(server.topics_until(OWN).await, [OWN]);
    robot.heard.clear();
    server.publish(OWN, b"{}").await;
    assert_eq!(robot.topics_until(OWN).await, [OWN]);
    // Nor does it get out with its retained flag on.
    let retained = robot
        .sender
        .publish(OWN, QoS::AtLeastOnce, true, "{}")
        .await;
    retained.expect("a session");
    robot.publish(AFTER, b"{}").await;
    for mut person in people {
        let heard = person.topics_until(AFTER).await;
        assert!(heard.iter().all(|topic| topic == AFTER), "{heard:?}");
    }
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_of_it_waits_for_people_who_are_away() {
    let bench = Bench::new().await;
    bench.person("ada", Role::Viewer).await;
    let options = || {
        let mut options = bench.options("laptop", "ada", PASSWORD);
        let mut properties = ConnectProperties::new();
        properties.session_expiry_interval = Some(600);
        options
            .set_clean_start(false)
            .set_connect_properties(properties);
        options
    };
    let mut ada = Listener::connect(options()).await;
    assert!(ada.subscribe("swarm/#").await);
    drop(ada);
    let mut robot = bench.robot("rover-1").await;
    robot.publish(OWN, b"{}").await;
    robot.publish(AFTER, b"{}").await;
    let mut ada = Listener::connect(options()).await;
    assert_eq!(ada.topics_until(AFTER).await, [AFTER]);
    bench.broker.stop().await;
}

/// The server may have several sessions, so that a stop does not wait in the queue of an image. Nobody else has
/// its secret.
#[tokio::test(flavor = "multi_thread")]
async fn the_server_has_sessions_beside_each_other() {
    let bench = Bench::new().await;
    let Credentials { user, password } = bench.broker.server().clone();
    let mut first = bench.server(&user).await;
    let mut second = bench.server(&format!("{user}-updates")).await;
    for session in [&mut first, &mut second] {
        assert!(session.subscribe("swarm/ota/+").await);
    }
    first.publish("swarm/ota/rover-1", b"{}").await;
    second.publish("swarm/command/swarm", b"{}").await;
    assert_eq!(second.topics_until("swarm/ota/rover-1").await.len(), 1);
    let secret = password.to_string();
    for client_id in ["updates", "server-0", &format!("{user}0")] {
        let refused = bench.connect(client_id, &user, &secret).await;
        assert_eq!(refused.err(), Some(ConnectReturnCode::NotAuthorized));
    }
    bench.broker.stop().await;
}
