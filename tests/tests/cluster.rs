//! Several servers of one fleet behind one address: whichever is killed, nothing that was accepted
//! is lost, and whoever watched goes on watching.

mod balancer;
mod reader;

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use crawler_tests::engines::postgres::Postgres;
use crawler_tests::engines::redis::Redis;
use crawler_tests::measure::{metrics, sum};
use crawler_tests::{
    Mosquitto, ReservedPort, Simulated, Subscription, Terracrawler, publish, wait_for,
    wait_for_with,
};
use serde_json::{Value, json};

use balancer::LoadBalancer;
use reader::Reader;

/// For everything that has to happen on a busy machine.
const LIMIT: Duration = Duration::from_mins(3);
/// How many robots there are, unless the environment says otherwise.
const ROBOTS: usize = 100;
/// Commands that are accepted before a server is killed.
const COMMANDS: usize = 60;

fn robots() -> usize {
    std::env::var("CLUSTER_ROBOTS").map_or(ROBOTS, |text| text.parse().expect("a number"))
}

fn call(port: u16, body: &Value, path: &str) -> Option<(u16, Value)> {
    let agent: ureq::Agent = ureq::Agent::config_builder()
        .timeout_global(Some(Duration::from_mins(1)))
        .http_status_as_error(false)
        .build()
        .into();
    let mut answer = agent
        .post(format!("http://127.0.0.1:{port}{path}"))
        .send_json(body)
        .ok()?;
    let text = answer.body_mut().read_to_string().ok()?;
    Some((
        answer.status().as_u16(),
        serde_json::from_str(&text).unwrap_or_default(),
    ))
}

/// Somebody who gives commands to one robot after the other, and notes which were accepted.
struct Operator {
    accepted: Arc<Mutex<Vec<String>>>,
    /// Commands of which nobody knows whether they were.
    unknown: Arc<AtomicUsize>,
    stop: Arc<AtomicBool>,
    task: Option<thread::JoinHandle<()>>,
}

impl Operator {
    fn start(port: u16, robots: usize) -> Self {
        let operator = Self {
            accepted: Arc::default(),
            unknown: Arc::default(),
            stop: Arc::default(),
            task: None,
        };
        let accepted = Arc::clone(&operator.accepted);
        let unknown = Arc::clone(&operator.unknown);
        let stop = Arc::clone(&operator.stop);
        let task = thread::spawn(move || {
            let mut number = 0;
            while !stop.load(Ordering::Relaxed) {
                let robot = number % robots + 1;
                number += 1;
                let path = format!("/api/v1/robots/sim-{robot:04}/commands");
                match call(port, &json!({"command": "identify"}), &path) {
                    Some((202, body)) => {
                        let id = body["id"].as_str().expect("an id").to_owned();
                        accepted.lock().expect("lock").push(id);
                    }
                    Some((503 | 404, _)) => {}
                    Some((status, body)) => panic!("{status}: {body}"),
                    None => {
                        unknown.fetch_add(1, Ordering::Relaxed);
                    }
                }
                // A robot is asked again when what it was asked before is settled.
                thread::sleep(Duration::from_millis(50));
            }
        });
        Self {
            task: Some(task),
            ..operator
        }
    }

    fn accepted(&self) -> Vec<String> {
        self.accepted.lock().expect("lock").clone()
    }

    fn wait_more(&self, count: usize) {
        let before = self.accepted().len();
        wait_for("commands are accepted", LIMIT, || {
            (self.accepted().len() >= before + count).then_some(())
        });
    }

    fn end(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.task.take().expect("once").join().expect("no panic");
    }
}

/// Waits until every command that was accepted has come to its end, as `server` tells it.
fn settled(server: &Terracrawler, accepted: &[String]) -> Vec<Value> {
    let settle = |id: &String| {
        wait_for(&format!("command {id} comes to its end"), LIMIT, || {
            let (status, command) = server.get(&format!("/api/v1/commands/{id}"));
            assert!(status == 200 || status == 503, "{id} is lost: {command}");
            let open = ["pending", "accepted"];
            let text = command["status"].as_str().unwrap_or("pending");
            (!open.contains(&text)).then_some(command)
        })
    };
    accepted.iter().map(settle).collect()
}

#[test]
fn whichever_server_is_killed_nothing_accepted_is_lost() {
    let robots = robots();
    let redis = Redis::start();
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let _broker = Mosquitto::start(port);
    let broker = format!("mqtt://127.0.0.1:{port}");
    let cache = redis.url();
    let arguments = ["serve", "--broker", &broker, "--cache", &cache];
    let mut first = Terracrawler::start(&arguments);
    let mut second = Terracrawler::start(&arguments);
    let balancer = LoadBalancer::open(vec![first.http(), second.http()]);
    let _simulated = Simulated::start(port, &["--robots", &robots.to_string()]);
    // Each hears half of what robots say, and tells the other.
    first.wait_online(robots, LIMIT);
    second.wait_online(robots, LIMIT);
    // Two of them, so that each server has one.
    let readers = [
        Reader::start(balancer.port()),
        Reader::start(balancer.port()),
    ];
    let all_see_all = || {
        let mut online = Vec::new();
        wait_for_with("all readers see all robots", LIMIT, &mut online, |online| {
            let seen = |reader: &Reader| reader.seen.online.load(Ordering::Relaxed);
            *online = readers.iter().map(seen).collect();
            online.iter().all(|online| *online == robots).then_some(())
        });
    };
    all_see_all();

    let mut operator = Operator::start(balancer.port(), robots);
    operator.wait_more(COMMANDS);
    first.kill();
    operator.wait_more(COMMANDS);
    all_see_all();
    settled(&second, &operator.accepted());

    first.resume();
    first.wait_online(robots, LIMIT);
    operator.wait_more(COMMANDS);
    second.kill();
    operator.wait_more(COMMANDS);
    all_see_all();
    operator.end();
    let accepted = operator.accepted();
    let commands = settled(&first, &accepted);
    assert!(
        readers
            .iter()
            .all(|reader| reader.seen.connections.load(Ordering::Relaxed) >= 1)
    );
    let connections: u64 = readers
        .iter()
        .map(|reader| reader.seen.connections.load(Ordering::Relaxed))
        .sum();
    assert!(connections >= 3, "a reader came back: {connections}");

    // Each was carried out once: no two went under one number, and what was accepted was done.
    let unique: BTreeSet<&String> = accepted.iter().collect();
    assert_eq!(unique.len(), accepted.len(), "a number twice");
    let completed = commands
        .iter()
        .filter(|command| command["status"] == "completed")
        .count();
    let unknown = operator.unknown.load(Ordering::Relaxed);
    println!(
        "{robots} robots: {completed} of {} accepted completed, {unknown} unknown",
        accepted.len()
    );
    let others: Vec<&Value> = commands
        .iter()
        .filter(|command| command["status"] != "completed")
        .collect();
    assert!(others.len() <= accepted.len() / 50, "{others:?}");
}

/// What a robot that is an MQTT client alone says of itself.
fn status(online: bool, starts: u32) -> String {
    json!({
        "robot": "rover-1",
        "online": online,
        "kind": "physical",
        "firmware": "0.1.0",
        "board": "test",
        "capabilities": [],
        "boot": {"count": starts, "cause": "power-on"},
        "protocol": 1,
    })
    .to_string()
}

fn adopted(server: &Terracrawler) {
    wait_for("the other server has taken over", LIMIT, || {
        let metrics = server.get("/metrics").1;
        let text = metrics.as_str().expect("text");
        (!text.contains("terracrawler_cluster_adopted_total 0")).then_some(())
    });
}

#[test]
fn a_server_that_hung_does_not_send_what_another_has_taken_over() {
    let redis = Redis::start();
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let _broker = Mosquitto::start(port);
    let broker = format!("mqtt://127.0.0.1:{port}");
    let cache = redis.url();
    let arguments = ["serve", "--broker", &broker, "--cache", &cache];
    let first = Terracrawler::start(&arguments);
    let second = Terracrawler::start(&arguments);
    publish(port, "swarm/status/rover-1", &status(false, 1));
    let path = "/api/v1/robots/rover-1/commands";
    let set = json!({"command": "set", "parameters": {"safe_distance_mm": 420}});
    let setting = wait_for("a robot that is away is known", LIMIT, || {
        let (status, body) = first.post(path, &set);
        (status == 202).then(|| body["id"].as_str().expect("an id").to_owned())
    });

    signal(&first, "STOP");
    adopted(&second);
    let mut heard = Subscription::start(port, "swarm/command/robot/rover-1");
    // It has started anew, so the setting goes under a new number.
    publish(port, "swarm/status/rover-1", &status(true, 2));
    let setting_at = format!("/api/v1/commands/{setting}");
    wait_for("the setting goes", LIMIT, || {
        let (_, command) = second.get(&setting_at);
        let seq = command["seq"].to_string();
        (seq != setting).then_some(())
    });
    signal(&first, "CONT");
    // It is whole again, and knows what became of its command from the others.
    let mut last = (0, Value::Null);
    wait_for_with("it is ready", LIMIT, &mut last, |last| {
        *last = first.get("/readyz");
        (last.0 == 200).then_some(())
    });
    assert_eq!(first.get(&setting_at).0, 200);
    // What it had to say it has said before what it says now.
    let (code, marker) = first.post(path, &json!({"command": "identify"}));
    assert_eq!(code, 202, "{marker}");
    let mut settings = BTreeSet::new();
    heard.wait("the command after it", |_, text| {
        let command: Value = serde_json::from_str(text).expect("a command");
        if command["command"] == "set" {
            settings.insert((command["source"].to_string(), command["seq"].to_string()));
        }
        (command["command"] == "identify").then_some(())
    });
    assert_eq!(
        settings.len(),
        1,
        "one number, from one source: {settings:?}"
    );
}

fn signal(server: &Terracrawler, name: &str) {
    let sent = std::process::Command::new("kill")
        .args([&format!("-{name}"), &server.id().to_string()])
        .status();
    assert!(sent.expect("kill").success());
}

#[test]
fn without_redis_nothing_is_accepted_that_could_be_lost() {
    let mut redis = Redis::start();
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let _broker = Mosquitto::start(port);
    let broker = format!("mqtt://127.0.0.1:{port}");
    let cache = redis.url();
    let arguments = ["serve", "--broker", &broker, "--cache", &cache];
    let first = Terracrawler::start(&arguments);
    let second = Terracrawler::start(&arguments);
    let _simulated = Simulated::start(port, &["--robots", "4"]);
    first.wait_online(4, LIMIT);
    second.wait_online(4, LIMIT);
    let path = "/api/v1/robots/sim-0001/commands";
    let identify = json!({"command": "identify"});
    // What one server accepts, the other knows.
    let (code, given) = first.post(path, &identify);
    assert_eq!(code, 202, "{given}");
    let id = given["id"].as_str().expect("an id").to_owned();
    wait_for("the other server tells its end", LIMIT, || {
        let (_, command) = second.get(&format!("/api/v1/commands/{id}"));
        (command["status"] == "completed").then_some(())
    });
    // A setting for a robot that is away waits, whatever becomes of Redis.
    publish(port, "swarm/status/rover-1", &status(false, 1));
    let held = wait_for("a robot that is away is known", LIMIT, || {
        let set = json!({"command": "set", "parameters": {"safe_distance_mm": 420}});
        let (status, body) = first.post("/api/v1/robots/rover-1/commands", &set);
        (status == 202).then(|| body["id"].as_str().expect("an id").to_owned())
    });

    redis.kill();
    wait_for("the server says that it is not whole", LIMIT, || {
        let (status, body) = first.get("/readyz");
        (status == 503 && body["cache"] == false).then_some(())
    });
    let (status, body) = first.post(path, &identify);
    assert_eq!((status, &body["code"]), (503, &json!("not_shared")));
    // A halt goes, and the answer says what it is worth.
    let (status, body) = first.post(path, &json!({"command": "stop"}));
    assert_eq!((status, &body["code"]), (503, &json!("sent_not_shared")));
    assert_eq!(first.get("/api/v1/robots").0, 200);

    // It comes back with nothing in it: what is owed is told again.
    redis.forget();
    redis.resume();
    for server in [&first, &second] {
        wait_for("commands are accepted again", LIMIT, || {
            let (status, body) = server.post(path, &identify);
            assert!(status == 202 || status == 503, "{body}");
            (status == 202).then_some(())
        });
    }
    let held = format!("/api/v1/commands/{held}");
    wait_for("the other server knows of it again", LIMIT, || {
        let (_, command) = second.get(&held);
        (command["status"] == "pending").then_some(())
    });
    // And its owner goes: the other takes it over.
    let (status, log) = first.interrupt();
    assert!(status.success(), "{log}");
    adopted(&second);
    assert_eq!(second.get(&held).1["status"], "pending");
}

#[test]
fn a_fence_is_watched_by_whichever_server_hears_the_robot() {
    let database = Postgres::shared();
    let url = database.database();
    let redis = Redis::start();
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let _broker = Mosquitto::start(port);
    let broker = format!("mqtt://127.0.0.1:{port}");
    let cache = redis.url();
    let arguments = [
        "serve",
        "--broker",
        &broker,
        "--cache",
        &cache,
        "--database",
        &url,
    ];
    let first = Terracrawler::start(&arguments);
    let second = Terracrawler::start(&arguments);
    publish(port, "swarm/status/rover-1", &status(true, 1));
    let mut time = 1_000_000;
    let mut stand = |x: f64| {
        time += 200;
        let pose = json!({"x": x, "y": 0.0, "theta": 0.0, "sigma": 0.1});
        let told = json!({
            "robot": "rover-1", "seq": 1, "timestamp": time, "state": "IDLE",
            "behaviour": "manual", "pose": pose, "range_mm": null, "temperature_c": null,
            "wheels": {"left": 0.0, "right": 0.0}, "battery": {"mv": 7610, "percent": 71},
            "rssi_dbm": null,
        });
        publish(port, "swarm/telemetry/rover-1", &told.to_string());
    };
    let fence = json!({"name": "yard", "kind": "keep_in", "action": "stop",
        "corners": [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]});
    let (code, made) = first.post("/api/v1/fences", &fence);
    assert_eq!(code, 201, "{made}");
    assert_eq!(second.get("/api/v1/fences").1["fences"][0], made);
    let servers = [&first, &second];
    let mut all_say = |x: f64, name: &Value| {
        wait_for(&format!("both servers say {name}"), LIMIT, || {
            stand(x);
            thread::sleep(Duration::from_millis(200));
            let says = |server: &&Terracrawler| {
                let (status, robot) = server.get("/api/v1/robots/rover-1");
                status == 200 && robot["fence"] == *name
            };
            servers.iter().all(says).then_some(())
        });
    };
    let crossings = || {
        let name = r#"terracrawler_fence_crossings_total{kind="keep_in",action="stop"}"#;
        let counts = servers.map(|server| sum(&metrics(server), name));
        counts.iter().sum::<f64>()
    };
    let stops = || {
        let count = |server: &Terracrawler| {
            let (_, commands) = server.get("/api/v1/commands?robot=rover-1");
            let commands = commands["commands"].as_array().expect("a list").clone();
            let stop = |command: &Value| command["source"] == "fence";
            commands.into_iter().filter(stop).count()
        };
        servers.map(count).iter().sum::<usize>()
    };
    all_say(0.0, &Value::Null);
    assert_eq!((crossings(), stops()), (0.0, 0));
    all_say(5.0, &json!("yard"));
    let crossed = crossings();
    // Twice at most: the second may have heard the robot before it heard of the fence.
    assert!((1.0..=2.0).contains(&crossed), "{crossed}");
    let stopped = wait_for("each crossing is answered", LIMIT, || {
        Some(stops()).filter(|stops| *stops as f64 >= crossed)
    });
    for _ in 0..10 {
        all_say(5.0, &json!("yard"));
    }
    assert_eq!((crossings(), stops()), (crossed, stopped));
    assert_eq!(stopped as f64, crossed);
    all_say(0.0, &Value::Null);
    assert_eq!((crossings(), stops()), (crossed, stopped));
}
