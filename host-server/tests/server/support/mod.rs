//! A server on ports of its own, an HTTP client, and a robot made of an MQTT client alone.
#![allow(
    unreachable_pub,
    reason = "what tests share is public to them and nobody else"
)]

pub mod closed;
pub mod log;
pub mod mqtt;
pub mod port;
mod scratch;
pub mod tls;

pub use scratch::Scratch;

use std::cell::RefCell;
use std::time::{Duration, Instant};

use crawler_protocol::{Command, Reason, Response, ResponseStatus, RobotId};
use crawler_server::config::{Layer, Role, Settings};
use crawler_server::server::Server;
use http_body_util::{BodyExt as _, Full};
use hyper::body::Bytes;
use hyper::{HeaderMap, Method, Request, StatusCode};
use hyper_util::rt::TokioIo;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{LastWill, Packet, Publish};
use rumqttc::v5::{AsyncClient, Event, EventLoop, MqttOptions};
use serde_json::Value;
use tokio::sync::mpsc;

/// How long a test waits for something that is to happen, however slow the machine is. Nothing
/// passes because of it: it only ends a wait that is in vain.
pub const LIMIT: Duration = Duration::from_mins(1);

thread_local! {
    /// The last answer over HTTP that this test got: what a wait that is in vain prints.
    static LAST_ANSWER: RefCell<String> = const { RefCell::new(String::new()) };
}

pub struct Fixture {
    pub server: Server,
    pub settings: Settings,
    scratch: Scratch,
}

/// Addresses and a folder that nobody else has, and no accounts.
fn quiet(scratch: &Scratch) -> Layer {
    let any = Some("127.0.0.1:0".parse().expect("address"));
    Layer {
        http: any,
        mqtt: any,
        data: Some(scratch.0.clone()),
        open: Some(true),
        ..Layer::default()
    }
}

/// Options of a server that gets in nobody's way.
pub fn settings(scratch: &Scratch, change: impl FnOnce(&mut Layer)) -> Settings {
    let mut layer = quiet(scratch);
    change(&mut layer);
    Settings::from_layers(Role::Serve, &[layer]).expect("settings")
}

impl Fixture {
    pub async fn start() -> Self {
        Self::start_with(|_| {}).await
    }

    pub async fn start_with(change: impl FnOnce(&mut Layer)) -> Self {
        let scratch = Scratch::new();
        let settings = settings(&scratch, change);
        let server = Server::start(&settings).await.expect("the server starts");
        Self {
            server,
            settings,
            scratch,
        }
    }

    /// A fixture around a server that runs already.
    pub fn of(server: Server, settings: Settings) -> Self {
        Self {
            server,
            settings,
            scratch: Scratch::new(),
        }
    }

    /// A server with an empty world of two robots, which reach the broker over a radio or not.
    pub async fn world(radio: bool) -> Self {
        Self::up("empty", |layer| {
            layer.robots = Some(2);
            layer.radio_proxy = radio.then(|| "127.0.0.1:0".parse().expect("address"));
        })
        .await
    }

    /// A server with a world.
    pub async fn up(scenario: &str, change: impl FnOnce(&mut Layer)) -> Self {
        let scratch = Scratch::new();
        let mut layer = Layer {
            scenario: Some(scenario.to_owned()),
            seed: Some(7),
            ..quiet(&scratch)
        };
        change(&mut layer);
        let settings = Settings::from_layers(Role::Up, &[layer]).expect("settings");
        let server = Server::start(&settings).await.expect("the server starts");
        Self {
            server,
            settings,
            scratch,
        }
    }

    pub async fn stop(self) {
        within("the server stops", self.server.stop()).await;
    }

    pub async fn get(&self, path: &str) -> Answer {
        self.call(Method::GET, path, &[], "").await
    }

    pub async fn post(&self, path: &str, body: &str) -> Answer {
        let json = [("content-type", "application/json")];
        self.call(Method::POST, path, &json, body).await
    }

    pub async fn call(
        &self,
        method: Method,
        path: &str,
        headers: &[(&str, &str)],
        body: impl AsRef<[u8]>,
    ) -> Answer {
        let address = self.server.http();
        let stream = tokio::net::TcpStream::connect(address)
            .await
            .expect("connect");
        let (mut sender, connection) = hyper::client::conn::http1::handshake(TokioIo::new(stream))
            .await
            .expect("handshake");
        tokio::spawn(connection);
        let mut request = Request::builder().method(method).uri(path);
        if !headers.iter().any(|(name, _)| *name == "host") {
            request = request.header("host", address.to_string());
        }
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let request = request
            .body(Full::new(Bytes::copy_from_slice(body.as_ref())))
            .expect("request");
        let response = sender.send_request(request).await.expect("an answer");
        let (parts, body) = response.into_parts();
        let answer = Answer {
            status: parts.status,
            headers: parts.headers,
            body: body.collect().await.expect("a body").to_bytes(),
        };
        let shown = String::from_utf8_lossy(&answer.body);
        LAST_ANSWER.set(format!("{path}: {} {shown}", answer.status));
        answer
    }

    pub async fn robot(&self, id: &str) -> FakeRobot {
        FakeRobot::connect(self.server.mqtt().port, id, id).await
    }

    /// Waits until a robot is online and has told what it is; returns what the server knows.
    ///
    /// A heartbeat (QoS 0) can overtake the status (QoS 1) that was sent before it.
    pub async fn wait_told(&self, id: &str) -> Value {
        self.wait_presence(id, "online").await;
        let path = format!("/api/v1/robots/{id}");
        eventually("told what it is", async || {
            !self.get(&path).await.json()["boot"].is_null()
        })
        .await;
        self.get(&path).await.json()
    }

    /// Waits for a robot's presence.
    pub async fn wait_presence(&self, id: &str, presence: &str) {
        eventually(presence, async || {
            self.get(&format!("/api/v1/robots/{id}")).await.json()["presence"] == presence
        })
        .await;
    }
}

pub struct Answer {
    pub status: StatusCode,
    pub headers: HeaderMap,
    pub body: Bytes,
}

impl Answer {
    pub fn text(&self) -> &str {
        std::str::from_utf8(&self.body).expect("UTF-8")
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    pub fn header(&self, name: &str) -> &str {
        self.headers
            .get(name)
            .map_or("", |value| value.to_str().expect("ASCII"))
    }

    /// Checks that this is a problem document with this status and code.
    #[track_caller]
    pub fn is_problem(&self, status: u16, code: &str) {
        assert_eq!(self.status.as_u16(), status, "{}", self.text());
        assert_eq!(self.header("content-type"), "application/problem+json");
        let problem = self.json();
        assert_eq!(problem["status"], status);
        assert_eq!(problem["code"], code, "{problem}");
        assert_eq!(problem["type"], "about:blank");
        assert!(
            problem["title"].is_string() && problem["detail"].is_string(),
            "{problem}"
        );
        // What is wrong with a release or its gate is no part of a JSON body.
        if (status == 422 || code == "bad_query") && problem["faults"].is_null() {
            let errors = problem["errors"].as_array().expect("the parts");
            let one = |error: &Value| {
                (error["pointer"].is_string() != error["parameter"].is_string())
                    && error["detail"]
                        .as_str()
                        .is_some_and(|text| !text.is_empty())
            };
            assert!(!errors.is_empty() && errors.iter().all(one), "{problem}");
        }
    }
}

/// Waits for the end of what is to happen.
pub async fn within<T>(what: &str, happening: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, happening)
        .await
        .unwrap_or_else(|_| panic!("not within {LIMIT:?}: {what}"))
}

/// Tries until it holds.
pub async fn eventually(what: &str, holds: impl AsyncFnMut() -> bool) {
    eventually_within(LIMIT, what, holds).await;
}

/// The same, of what may take long where the processor is busy.
pub async fn eventually_within(limit: Duration, what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let end = Instant::now() + limit;
    while !holds().await {
        if Instant::now() >= end {
            let last = LAST_ANSWER.take();
            panic!("not within {limit:?}: {what}; the last answer was {last}");
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

pub fn status(robot: &str, online: bool) -> String {
    format!(
        r#"{{"robot":"{robot}","online":{online},"kind":"emulated","firmware":"0.1.0","board":"fake","capabilities":["drive","range"],"boot":{{"count":3,"cause":"power-on"}},"protocol":1}}"#
    )
}

pub fn heartbeat(robot: &str, uptime_ms: u64) -> String {
    format!(r#"{{"robot":"{robot}","seq":1,"timestamp":5,"uptime_ms":{uptime_ms},"state":"IDLE"}}"#)
}

pub fn telemetry(robot: &str, seq: u64) -> String {
    format!(
        r#"{{"robot":"{robot}","seq":{seq},"timestamp":6,"state":"MOVING","behaviour":"wander","pose":{{"x":1.5,"y":-0.25,"theta":0.5,"sigma":0.1}},"range_mm":812,"temperature_c":22.5,"wheels":{{"left":0.5,"right":0.5}},"battery":{{"mv":7610,"percent":71}},"rssi_dbm":-61}}"#
    )
}

/// Connects as `client_id`, however busy the machine is: rumqttc gives up after five seconds.
pub fn mqtt_options(client_id: &str, port: u16) -> MqttOptions {
    let mut options = MqttOptions::new(client_id, "127.0.0.1", port);
    options.set_connection_timeout(LIMIT.as_secs());
    options
}

/// A robot made of an MQTT client alone.
pub struct FakeRobot {
    pub id: String,
    pub client: AsyncClient,
    /// What arrived on the topics it listens to.
    pub inbox: mpsc::Receiver<Publish>,
    task: tokio::task::JoinHandle<()>,
}

impl FakeRobot {
    /// Connects as `client_id` and listens for commands to robot `id`.
    pub async fn connect(port: u16, client_id: &str, id: &str) -> Self {
        let mut options = mqtt_options(client_id, port);
        options.set_last_will(LastWill::new(
            format!("swarm/status/{id}"),
            status(id, false),
            QoS::AtLeastOnce,
            true,
            None,
        ));
        let (client, mut events) = AsyncClient::new(options, 4_096);
        for topic in [
            "command/swarm",
            &format!("command/robot/{id}"),
            "response/swarm",
            "time",
        ] {
            client
                .subscribe(format!("swarm/{topic}"), QoS::AtLeastOnce)
                .await
                .expect("subscribe");
        }
        let mut acknowledged = 0;
        while acknowledged < 4 {
            if let Event::Incoming(Packet::SubAck(_)) = events.poll().await.expect("a broker") {
                acknowledged += 1;
            }
        }
        let (sender, inbox) = mpsc::channel(4_096);
        let task = tokio::spawn(pump(events, sender));
        Self {
            id: id.to_owned(),
            client,
            inbox,
            task,
        }
    }

    pub async fn publish(&self, topic: &str, payload: impl Into<Vec<u8>>) {
        self.send(topic, QoS::AtLeastOnce, false, payload.into())
            .await;
    }

    pub async fn send(&self, topic: &str, qos: QoS, retain: bool, payload: Vec<u8>) {
        self.client
            .publish(topic, qos, retain, payload)
            .await
            .expect("publish");
    }

    /// Says everything a robot says of itself.
    pub async fn introduce(&self) {
        let id = &self.id;
        self.send(
            &format!("swarm/status/{id}"),
            QoS::AtLeastOnce,
            true,
            status(id, true).into(),
        )
        .await;
        self.publish(&format!("swarm/heartbeat/{id}"), heartbeat(id, 1))
            .await;
        self.publish(&format!("swarm/telemetry/{id}"), telemetry(id, 1))
            .await;
    }

    /// The next message on a topic with this ending.
    pub async fn next(&mut self, ending: &str) -> Publish {
        self.next_on(&format!("…{ending}"), |topic| {
            topic.ends_with(ending.as_bytes())
        })
        .await
    }

    /// The next command to the robot or to all.
    pub async fn next_command(&mut self) -> Command {
        let next = self.next_on("swarm/command/…", |topic| {
            topic.starts_with(b"swarm/command/")
        });
        Command::parse(&next.await.payload).expect("a valid command")
    }

    /// The next message on one of these topics. Those before it are passed over.
    async fn next_on(&mut self, what: &str, wanted: impl Fn(&[u8]) -> bool) -> Publish {
        let mut last = None;
        let next = async {
            loop {
                let publish = self.inbox.recv().await.expect("connected");
                if wanted(&publish.topic) {
                    return publish;
                }
                last = Some(publish);
            }
        };
        tokio::time::timeout(LIMIT, next).await.unwrap_or_else(|_| {
            panic!("no message on {what} within {LIMIT:?}; the last was {last:?}")
        })
    }

    pub async fn answer(&self, seq: u64, status: ResponseStatus, reason: Option<Reason>) {
        let response = Response {
            robot: RobotId::new(&self.id).expect("id"),
            seq,
            status,
            reason,
            timestamp: 7,
            source: None,
        };
        let mut buffer = [0; 1024];
        let length = response.to_json(&mut buffer).expect("response");
        let topic = format!("swarm/response/robot/{}", self.id);
        self.publish(&topic, &buffer[..length]).await;
    }

    /// Cuts the connection without a word, so that the will is published.
    pub async fn vanish(self) {
        self.task.abort();
        let _ = self.task.await;
    }
}

async fn pump(mut events: EventLoop, sender: mpsc::Sender<Publish>) {
    while let Ok(event) = events.poll().await {
        if let Event::Incoming(Packet::Publish(publish)) = event
            && sender.send(publish).await.is_err()
        {
            return;
        }
    }
}
