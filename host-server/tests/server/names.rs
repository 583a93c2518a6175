//! A person and a robot may have one name: what becomes of one is nothing to the other, whichever came
//! first.

use crate::support::closed::{ADMIN, PASSWORD};
use crate::support::mqtt::{Client, Closed};
use crate::support::{Fixture, within};
use crawler_access::Role;
use hyper::Method;
use rumqttc::v5::mqttbytes::v5::{ConnectProperties, Packet, PubAckReason};
use rumqttc::v5::{AsyncClient, Event, MqttOptions};
use serde_json::{Value, json};

const NAME: &str = "rover-1";
const USER: &str = "/api/v1/users/rover-1";
const CREDENTIAL: &str = "/api/v1/robots/rover-1/credential";

/// Who of the two is made first.
#[derive(Debug, Clone, Copy)]
enum First {
    Person,
    Robot,
}

/// A person and a robot of one name on a server of their own, both connected to its broker.
struct Both {
    closed: Closed,
    admin: String,
    person: Client,
    robot: Client,
}

impl Both {
    async fn of(first: First) -> Self {
        let fixture = Fixture::closed().await;
        let admin = fixture.login(ADMIN).await.token;
        let closed = Closed::around(fixture).await;
        let body = json!({ "name": NAME, "role": "operator", "password": PASSWORD }).to_string();
        let person = ask(&closed, &admin, Method::POST, "/api/v1/users", &body);
        let robot = ask(&closed, &admin, Method::POST, CREDENTIAL, "");
        let made = match first {
            First::Person => {
                person.await;
                robot.await
            }
            First::Robot => {
                let made = robot.await;
                person.await;
                made
            }
        };
        let secret = made["secret"].as_str().expect("a secret");
        let robot = closed.connect(NAME, NAME, secret).await;
        let person = closed.connect("laptop", NAME, PASSWORD).await;
        Self {
            closed,
            admin,
            person,
            robot,
        }
    }

    async fn ask(&self, method: Method, path: &str, body: &str) {
        ask(&self.closed, &self.admin, method, path, body).await;
    }
}

async fn ask(closed: &Closed, token: &str, method: Method, path: &str, body: &str) -> Value {
    let answer = closed.fixture.call_as(token, method, path, body).await;
    assert!(answer.status.is_success(), "{}", answer.text());
    if answer.body.is_empty() {
        return Value::Null;
    }
    answer.json()
}

/// Whether the broker lets somebody publish.
async fn is_heard(client: &mut Client, topic: &str, when: &str) {
    assert!(client.is_connected(), "{when}");
    let heard = client.publish(topic, "{}").await;
    assert_ne!(heard, PubAckReason::NotAuthorized, "{when}");
}

/// What becomes of a person's account.
#[derive(Debug, Clone, Copy)]
enum OfPerson {
    Password,
    Role,
    Gone,
    LockedByConsole,
}

async fn a_person_changes(first: First) {
    use OfPerson::{Gone, LockedByConsole, Password, Role};
    for change in [Password, Role, Gone, LockedByConsole] {
        let mut both = Both::of(first).await;
        match change {
            Password => {
                let login = both.closed.fixture.try_login(NAME, PASSWORD).await.json();
                let token = login["token"].as_str().expect("a token");
                let body = json!({ "old": PASSWORD, "new": "another one entirely" }).to_string();
                let path = "/api/v1/session/password";
                ask(&both.closed, token, Method::PUT, path, &body).await;
            }
            Role => both.ask(Method::PATCH, USER, r#"{"role":"viewer"}"#).await,
            Gone => both.ask(Method::DELETE, USER, "").await,
            LockedByConsole => {
                let name = NAME.parse().expect("a name");
                let locked = both
                    .closed
                    .records
                    .users()
                    .set_disabled(&name, true, 2)
                    .await;
                locked.expect("locked");
            }
        }
        both.person.ended().await;
        let when = format!("{first:?} first, {change:?}");
        is_heard(&mut both.robot, "swarm/heartbeat/rover-1", &when).await;
        both.closed.stop().await;
    }
}

/// What becomes of a robot's secret.
#[derive(Debug, Clone, Copy)]
enum OfRobot {
    Renewed,
    Revoked,
    RevokedByConsole,
}

async fn a_robot_changes(first: First) {
    use OfRobot::{Renewed, Revoked, RevokedByConsole};
    for change in [Renewed, Revoked, RevokedByConsole] {
        let mut both = Both::of(first).await;
        match change {
            Renewed => both.ask(Method::POST, CREDENTIAL, "").await,
            Revoked => both.ask(Method::DELETE, CREDENTIAL, "").await,
            RevokedByConsole => {
                let revoked = both.closed.records.credentials().revoke(NAME, 2).await;
                revoked.expect("revoked");
            }
        }
        both.robot.ended().await;
        let when = format!("{first:?} first, {change:?}");
        is_heard(&mut both.person, "swarm/command/swarm", &when).await;
        both.closed.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_person_with_the_name_of_a_robot_does_not_end_its_session() {
    Box::pin(a_person_changes(First::Robot)).await;
    Box::pin(a_person_changes(First::Person)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_with_the_name_of_a_person_does_not_end_theirs() {
    Box::pin(a_robot_changes(First::Robot)).await;
    Box::pin(a_robot_changes(First::Person)).await;
}

/// A client whose session outlives its connection.
fn staying(closed: &Closed, secret: &str) -> MqttOptions {
    let mut options = closed.options(NAME, NAME, secret);
    let mut properties = ConnectProperties::new();
    properties.session_expiry_interval = Some(600);
    options
        .set_clean_start(false)
        .set_connect_properties(properties);
    options
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_does_not_get_the_session_of_a_person() {
    let closed = Closed::start().await;
    closed.person(NAME, Role::Operator).await;
    let session = staying(&closed, crate::support::mqtt::PASSWORD);
    let mut person = Client::connect(session).await.expect("let in");
    person.subscribe("swarm/#").await;
    person.vanish().await;
    let secret = closed.enroll(NAME).await;
    let (_client, mut events) = AsyncClient::new(staying(&closed, &secret), 10);
    let present = within("an answer to a login", async {
        loop {
            if let Event::Incoming(Packet::ConnAck(ack)) = events.poll().await.expect("let in") {
                return ack.session_present;
            }
        }
    })
    .await;
    assert!(!present, "it has the person's subscriptions");
    closed.stop().await;
}
