//! The whole server on a disk that is slow or full. There is one thread for everything: whatever waits for
//! the disk on it holds up all that is asked here.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use http_body_util::{BodyExt as _, Full};
use hyper::body::Bytes;
use hyper::{Method, Request};
use hyper_util::rt::TokioIo;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{AsyncClient, Event, MqttOptions};
use serde_json::Value;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::*;
use crate::config::{Layer, Role};

use crawler_system::data::test_disk::{LIMIT, TestDisk};

const COMMANDS: &str = "/api/v1/robots/a/commands";
const SET: &str = r#"{"command":"set","parameters":{"safe_distance_mm":420}}"#;
const MOVE: &str =
    r#"{"command":"move","parameters":{"direction":"forward","speed":50,"duration":500}}"#;

struct Scene {
    server: Server,
    disk: TestDisk,
    folder: PathBuf,
    robot: AsyncClient,
    /// Payloads of the commands that the robot has got.
    inbox: mpsc::UnboundedReceiver<Bytes>,
}

async fn within<T>(what: &str, happening: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, happening)
        .await
        .unwrap_or_else(|_| panic!("not within {LIMIT:?}: {what}"))
}

/// One request on a connection of its own.
async fn call(http: SocketAddr, method: Method, path: &str, body: &str) -> (u16, String) {
    let stream = tokio::net::TcpStream::connect(http).await.expect("connect");
    let (mut sender, connection) = hyper::client::conn::http1::handshake(TokioIo::new(stream))
        .await
        .expect("handshake");
    tokio::spawn(connection);
    let request = Request::builder()
        .method(method)
        .uri(path)
        .header("host", http.to_string())
        .header("content-type", "application/json")
        .body(Full::new(Bytes::copy_from_slice(body.as_bytes())))
        .expect("request");
    let response = sender.send_request(request).await.expect("an answer");
    let status = response.status().as_u16();
    let body = response.into_body().collect().await.expect("a body");
    (
        status,
        String::from_utf8_lossy(&body.to_bytes()).into_owned(),
    )
}

impl Scene {
    /// A server and a robot that has told its status.
    async fn new(name: &str) -> Self {
        let name = format!("crawler-server-disk-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let _ = std::fs::remove_dir_all(&folder);
        let any = Some("127.0.0.1:0".parse().expect("address"));
        let layer = Layer {
            http: any,
            mqtt: any,
            data: Some(folder.clone()),
            open: Some(true),
            ..Layer::default()
        };
        let settings = Settings::from_layers(Role::Serve, &[layer]).expect("settings");
        let disk = TestDisk::default();
        let server = Server::start_on(&settings, disk.handle(), Parts::default()).await;
        let server = server.expect("the server starts");
        let options = MqttOptions::new("a", "127.0.0.1", server.mqtt().port);
        let (robot, mut events) = AsyncClient::new(options, 100);
        let (sender, inbox) = mpsc::unbounded_channel();
        for topic in ["swarm/command/robot/a", "swarm/command/swarm"] {
            let subscribed = robot.subscribe(topic, QoS::AtLeastOnce).await;
            subscribed.expect("subscribe");
        }
        tokio::spawn(async move {
            while let Ok(event) = events.poll().await {
                if let Event::Incoming(Packet::Publish(publish)) = event {
                    let _ = sender.send(Bytes::from(publish.payload.to_vec()));
                }
            }
        });
        let scene = Self {
            server,
            disk,
            folder,
            robot,
            inbox,
        };
        scene.say("status", r#"{"robot":"a","online":true,"kind":"emulated","firmware":"0.1.0","board":"fake","capabilities":["drive","range"],"boot":{"count":3,"cause":"power-on"},"protocol":1}"#).await;
        scene
            .eventually("online", "/api/v1/robots/a", |known| {
                known["presence"] == "online" && !known["boot"].is_null()
            })
            .await;
        scene
    }

    async fn say(&self, kind: &str, payload: &str) {
        let topic = format!("swarm/{kind}/a");
        let said = self
            .robot
            .publish(topic, QoS::AtLeastOnce, false, payload.to_owned());
        said.await.expect("publish");
    }

    async fn get(&self, path: &str) -> (u16, String) {
        within(path, call(self.server.http(), Method::GET, path, "")).await
    }

    async fn give(&self, body: &str) -> (u16, String) {
        let given = call(self.server.http(), Method::POST, COMMANDS, body);
        within(body, given).await
    }

    async fn eventually(&self, what: &str, path: &str, holds: impl Fn(&Value) -> bool) {
        let end = Instant::now() + LIMIT;
        loop {
            let (status, body) = self.get(path).await;
            if serde_json::from_str(&body).is_ok_and(|body| holds(&body)) {
                return;
            }
            assert!(
                Instant::now() < end,
                "not within {LIMIT:?}: {what}; the last answer was {status} {body}"
            );
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// The next command that the robot gets.
    async fn next(&mut self) -> Value {
        let next = within("a command", self.inbox.recv()).await;
        serde_json::from_slice(&next.expect("connected")).expect("JSON")
    }

    /// The robot has done a command.
    async fn complete(&self, command: &Value) {
        let seq = &command["seq"];
        self.say(
            "response/robot",
            &format!(
                r#"{{"robot":"a","seq":{seq},"status":"completed","reason":null,"timestamp":7}}"#
            ),
        )
        .await;
    }

    async fn stop(self) {
        self.disk.release();
        within("the server stops", self.server.stop()).await;
        let _ = std::fs::remove_dir_all(self.folder);
    }
}

#[tokio::test]
async fn a_slow_disk_delays_those_who_must_wait_for_it_and_nobody_else() {
    let mut scene = Scene::new("slow").await;
    scene.disk.hold();
    let http = scene.server.http();
    let setting = tokio::spawn(call(http, Method::POST, COMMANDS, SET));
    let set = scene.next().await;
    assert_eq!(set["command"], "set");

    let (status, _) = scene.get("/healthz").await;
    assert_eq!(status, 200);
    let (status, body) = scene.give(r#"{"command":"stop"}"#).await;
    assert_eq!(status, 202, "{body}");
    let stop = scene.next().await;
    assert_eq!(stop["command"], "stop");
    scene.complete(&set).await;
    scene.complete(&stop).await;
    scene.say("telemetry", r#"{"robot":"a","seq":1,"timestamp":6,"state":"MOVING","behaviour":"wander","pose":{"x":1.5,"y":-0.25,"theta":0.5,"sigma":0.1},"range_mm":812,"temperature_c":22.5,"wheels":{"left":0.5,"right":0.5},"battery":{"mv":7610,"percent":71},"rssi_dbm":-61}"#).await;
    scene
        .eventually("telemetry is taken in", "/api/v1/robots/a", |known| {
            known["state"] == "MOVING"
        })
        .await;
    scene
        .eventually("answers are taken in", "/api/v1/commands", |list| {
            let done = list["commands"].as_array().expect("a list").iter();
            done.filter(|known| known["status"] == "completed").count() == 2
        })
        .await;
    let (status, body) = scene.give(MOVE).await;
    assert_eq!(status, 202, "{body}");
    assert_eq!(scene.next().await["command"], "move");
    let (status, body) = scene.give(r#"{"command":"estop"}"#).await;
    assert_eq!(status, 202, "{body}");

    assert!(!setting.is_finished(), "nobody is told yet");
    scene.disk.release();
    let (status, body) = within("the setting", setting).await.expect("answered");
    assert_eq!(status, 202, "{body}");
    let text = std::fs::read_to_string(scene.folder.join("commands")).expect("a file");
    let id = serde_json::from_str::<Value>(&body).expect("JSON")["id"].clone();
    let id = id.as_str().expect("an id");
    assert!(text.contains(id), "{id} is not in {text}");
    scene.stop().await;
}

#[tokio::test]
async fn a_full_disk_is_told_and_stops_go_all_the_same() {
    let mut scene = Scene::new("full").await;
    let (status, body) = scene.get("/readyz").await;
    assert_eq!(status, 200, "{body}");
    scene.disk.set_full(true);
    // The first finds out, after it has gone.
    for (code, text) in [("sent_not_written", SET), ("not_written", SET)] {
        let (status, body) = scene.give(text).await;
        let problem: Value = serde_json::from_str(&body).expect("JSON");
        assert_eq!((status, &problem["code"]), (503, &Value::from(code)));
    }
    let (status, body) = scene.get("/readyz").await;
    let ready: Value = serde_json::from_str(&body).expect("JSON");
    assert_eq!((status, &ready["journal"]), (503, &Value::Bool(false)));
    let (_, metrics) = scene.get("/metrics").await;
    assert!(
        metrics.contains("terracrawler_command_journal_up 0\n"),
        "{metrics}"
    );
    let failures = metrics
        .lines()
        .find_map(|line| line.strip_prefix("terracrawler_command_journal_failures_total "));
    let failures = failures.and_then(|count| count.parse().ok());
    assert!(failures >= Some(1), "{failures:?}");
    let fleet = Arc::clone(&scene.server.fleet);
    let told = |level, text| {
        let events = fleet.lock();
        let told = |event: &crawler_fleet::Event| (event.level, &event.text[..]) == (level, text);
        events.events.newest(100).any(told)
    };
    let cannot = "commands cannot be written down: only halts and motion are taken";
    within("an event", async {
        while !told(crawler_fleet::Level::Error, cannot) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    })
    .await;

    let (status, body) = scene.give(r#"{"command":"stop"}"#).await;
    assert_eq!(status, 202, "{body}");
    let mut got = Vec::new();
    while got.last() != Some(&Value::from("stop")) {
        got.push(scene.next().await["command"].clone());
    }
    assert_eq!(got, ["set", "stop"], "and not what was refused");

    scene.disk.set_full(false);
    scene
        .eventually("ready", "/readyz", |ready| ready["ready"] == true)
        .await;
    let (status, body) = scene.give(SET).await;
    assert_eq!(status, 202, "{body}");
    let (_, metrics) = scene.get("/metrics").await;
    assert!(
        metrics.contains("terracrawler_command_journal_up 1\n"),
        "{metrics}"
    );
    within("another event", async {
        while !told(
            crawler_fleet::Level::Info,
            "commands can be written down again",
        ) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    })
    .await;
    scene.stop().await;
}

/// Entries of the audit log that wait to be written before anybody asks for anything. More than come to
/// their turn while a request is answered.
const CROWD: usize = 20_000;

/// Keeps the records so busy that whoever waits for them waits for [`CROWD`] others. Returns what is written
/// so far, and the tasks.
async fn crowd(scene: &Scene) -> (Arc<AtomicUsize>, JoinSet<()>) {
    let (begun, written) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    let mut tasks = JoinSet::new();
    for _ in 0..CROWD {
        let records = scene.server.records.clone();
        let (begun, written) = (Arc::clone(&begun), Arc::clone(&written));
        tasks.spawn(async move {
            let entry = crawler_records::Entry {
                at: 1,
                who: "crowd".to_owned(),
                from: String::new(),
                action: "test".to_owned(),
                target: String::new(),
                detail: Value::Null,
                outcome: "ok".to_owned(),
            };
            begun.fetch_add(1, Ordering::Relaxed);
            while records.audit().append(entry.clone()).await.is_ok() {
                written.fetch_add(1, Ordering::Relaxed);
            }
        });
    }
    within("all of them wait", async {
        while begun.load(Ordering::Relaxed) < CROWD {
            tokio::task::yield_now().await;
        }
    })
    .await;
    (written, tasks)
}

async fn is_audited(scene: &Scene, command: &str) {
    let what = format!("{command} is in the audit log");
    scene
        .eventually(&what, "/api/v1/audit?limit=1000&who=anonymous", |page| {
            let entries = page["entries"].as_array().expect("entries").iter();
            let given = entries.filter(|entry| entry["action"] == "command.send");
            given
                .filter(|entry| entry["detail"]["request"]["command"] == command)
                .any(|entry| entry["outcome"] == "ok")
        })
        .await;
}

#[tokio::test]
async fn who_stops_or_steers_a_robot_does_not_wait_for_the_audit_log() {
    let scene = Scene::new("audit").await;
    let (written, mut crowd) = crowd(&scene).await;
    for command in [MOVE, r#"{"command":"stop"}"#, r#"{"command":"estop"}"#] {
        let before = written.load(Ordering::Relaxed);
        let (status, body) = scene.give(command).await;
        assert_eq!(status, 202, "{body}");
        let waited = written.load(Ordering::Relaxed) - before;
        assert!(waited < CROWD / 2, "{command} waited for {waited} others");
    }
    crowd.shutdown().await;
    for command in ["move", "stop", "estop"] {
        is_audited(&scene, command).await;
    }
    scene.stop().await;
}

#[tokio::test]
async fn who_hangs_up_has_given_the_command_and_the_audit_log_says_so() {
    let mut scene = Scene::new("hung-up").await;
    scene.disk.hold();
    let http = scene.server.http();
    let setting = tokio::spawn(call(http, Method::POST, COMMANDS, SET));
    assert_eq!(scene.next().await["command"], "set");
    setting.abort();
    let hung_up = setting.await;
    assert!(hung_up.is_err_and(|error| error.is_cancelled()));
    // The server has seen the end of that connection when it answers another.
    assert_eq!(scene.get("/healthz").await.0, 200);
    scene.disk.release();
    is_audited(&scene, "set").await;
    scene.stop().await;
}
