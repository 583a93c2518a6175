//! Experiments that several servers and workers share, in one database: whoever runs their trials, they come to the
//! same.

use std::process::Command;
use std::time::Duration;

use crawler_tests::engines::Process;
use crawler_tests::engines::postgres::Postgres;
use crawler_tests::{Terracrawler, terracrawler, wait_for, wait_for_with};
use serde_json::{Value, json};
use tempfile::TempDir;

const ALL: &str = "/api/v1/experiments";
/// For everything that has to happen on a busy machine, with leases that have to end.
const LIMIT: Duration = Duration::from_mins(3);

/// A `terracrawler worker` of one thread.
struct Worker {
    process: Process,
    folder: TempDir,
}

impl Worker {
    fn start(database: &str, name: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("worker.toml");
        std::fs::write(&file, format!("worker_name = \"{name}\"\n")).expect("a file");
        let mut command = Command::new(terracrawler());
        command
            .args(["worker", "--threads", "1", "--config"])
            .arg(&file)
            .env("TERRACRAWLER_DATABASE", database);
        let process = Process::start(command, &folder.path().join("log"));
        Self { process, folder }
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    /// Ends it in order, and waits for that.
    fn end(mut self) {
        self.process.end("TERM");
        let log = self.log();
        assert!(log.contains("stopped"), "{log}");
    }
}

fn server(database: &str, name: &str) -> Terracrawler {
    let arguments = ["serve", "--database", database, "--worker-name", name];
    Terracrawler::start(&[&arguments[..], &["--experiment-threads", "1"]].concat())
}

/// A trial takes a few milliseconds: two robots that stand about for two seconds.
fn short(seeds: u32) -> Value {
    json!({
        "name": "short", "scenario": "simple-navigation", "robots": 2, "seeds": seeds, "first_seed": 40,
        "set": ["duration_s=2.0"], "randomisation": "mild", "thresholds": ["uptime>=0.1"],
    })
}

/// Nobody sees the end of this one.
fn endless(seeds: u32) -> Value {
    json!({
        "name": "long", "scenario": "empty", "robots": 1, "seeds": seeds, "set": ["duration_s=2419200.0"],
    })
}

fn made(server: &Terracrawler, body: &Value) -> String {
    let (status, made) = server.post(ALL, body);
    assert_eq!(status, 201, "{made}");
    format!("{ALL}/{}", made["id"].as_str().expect("an id"))
}

fn act(server: &Terracrawler, path: &str, action: &str) -> (u16, Value) {
    server.post(&format!("{path}/{action}"), &json!({}))
}

/// Waits until an experiment is as `holds` says, and returns it.
fn wait(server: &Terracrawler, path: &str, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
    let mut last = Value::Null;
    wait_for_with(what, LIMIT, &mut last, |last| {
        let (status, view) = server.try_get(path)?;
        *last = view;
        (status == 200 && holds(last)).then(|| last.clone())
    })
}

fn completed(server: &Terracrawler, path: &str) -> Value {
    wait(server, path, "it is complete", |view| {
        view["state"] == "completed"
    })
}

/// The names of those who work on it.
fn workers(view: &Value) -> Vec<String> {
    let list = view["workers"].as_array().expect("workers");
    let name = |worker: &Value| worker["name"].as_str().expect("a name").to_owned();
    list.iter().map(name).collect()
}

fn wait_workers(server: &Terracrawler, path: &str, wanted: &[&str]) -> Value {
    let what = format!("{wanted:?} are at work");
    wait(server, path, &what, |view| {
        let mut there = workers(view);
        there.sort_unstable();
        there == wanted
    })
}

/// What an experiment came to, to the last byte: its numbers and every trial.
fn outcome(server: &Terracrawler, path: &str) -> String {
    let (_, view) = server.get(path);
    let (status, page) = server.get(&format!("{path}/metrics?limit=5000"));
    assert_eq!(status, 200, "{page}");
    let (summary, verdict, build) = (&view["summary"], &view["verdict"], &view["build"]);
    json!({ "summary": summary, "verdict": verdict, "build": build, "trials": page }).to_string()
}

/// What a server comes to that is alone, with its records in a file.
fn alone(body: &Value) -> String {
    let server = Terracrawler::start(&["serve"]);
    let path = made(&server, body);
    completed(&server, &path);
    outcome(&server, &path)
}

#[test]
fn two_servers_and_two_workers_come_to_what_one_comes_to() {
    let postgres = Postgres::shared();
    let url = postgres.database();
    let (one, two) = (server(&url, "one"), server(&url, "two"));
    let (three, four) = (Worker::start(&url, "three"), Worker::start(&url, "four"));

    // All four are at it, and everybody shows that.
    let path = made(&one, &endless(8));
    let all = ["four", "one", "three", "two"];
    wait_workers(&one, &path, &all);
    wait_workers(&two, &path, &all);
    let metrics = two.get("/metrics").1;
    let text = metrics.as_str().expect("text");
    assert!(text.contains("terracrawler_experiment_workers 4"), "{text}");
    // Any server steers it, and whoever works on it stops.
    let (status, paused) = act(&two, &path, "pause");
    assert_eq!(
        (status, &paused["state"]),
        (200, &json!("paused")),
        "{paused}"
    );
    wait_workers(&one, &path, &[]);
    assert_eq!(act(&one, &path, "resume").0, 200);
    wait_workers(&two, &path, &all);
    assert_eq!(act(&two, &path, "stop").0, 200);
    wait_workers(&one, &path, &[]);
    assert_eq!(act(&one, &path, "stop").0, 409);
    let left = postgres.sql(&url, "SELECT count(*) FROM experiment_part");
    assert_eq!(left, "0");

    let body = short(300);
    let path = made(&two, &body);
    completed(&one, &path);
    assert_eq!(outcome(&one, &path), alone(&body));
    assert_eq!(outcome(&two, &path), outcome(&one, &path));
    three.end();
    four.end();
}

#[test]
fn a_worker_that_is_killed_costs_its_lease_and_one_that_is_stopped_nothing() {
    let postgres = Postgres::shared();
    let url = postgres.database();
    let server = server(&url, "server");
    let mut killed = Worker::start(&url, "killed");
    let path = made(&server, &endless(2));
    wait_workers(&server, &path, &["killed", "server"]);
    killed.process.kill();
    let next = Worker::start(&url, "next");
    wait_workers(&server, &path, &["next", "server"]);
    let lost = postgres.sql(&url, "SELECT sum(lost) FROM experiment_part");
    assert_eq!(lost, "1");
    next.end();
    // What it had is free when it has ended.
    let free = "SELECT count(*) FROM experiment_part WHERE worker IS NULL AND lost <= 1";
    assert_eq!(postgres.sql(&url, free), "1");
    assert_eq!(act(&server, &path, "stop").0, 200);
}

#[test]
fn another_server_counts_what_a_killed_one_had_counted() {
    let postgres = Postgres::shared();
    let url = postgres.database();
    let (mut one, two) = (server(&url, "one"), server(&url, "two"));
    let body = short(400);
    let path = made(&one, &body);
    one.kill();
    completed(&two, &path);
    one.resume();
    assert_eq!(outcome(&one, &path), outcome(&two, &path));
    assert_eq!(outcome(&two, &path), alone(&body));
}

#[test]
fn a_database_that_is_away_for_a_while_costs_time_and_nothing_else() {
    let mut postgres = Postgres::start();
    let url = postgres.database();
    let server = server(&url, "server");
    let worker = Worker::start(&url, "worker");
    let body = short(2_000);
    let path = made(&server, &body);
    wait(&server, &path, "something is counted", |view| {
        view["done"].as_u64() > Some(0)
    });
    postgres.kill();
    wait_for("the server tells", LIMIT, || {
        (server.get("/readyz").1["database"] == false).then_some(())
    });
    wait_for("the worker notices", LIMIT, || {
        worker.log().contains("wait for the records").then_some(())
    });
    postgres.resume();
    completed(&server, &path);
    assert_eq!(outcome(&server, &path), alone(&body));
    worker.end();
}

#[test]
fn another_build_is_refused_with_a_word() {
    let postgres = Postgres::shared();
    let url = postgres.database();
    let server = server(&url, "server");
    let worker = Worker::start(&url, "worker");
    let path = made(&server, &endless(2));
    wait_workers(&server, &path, &["server", "worker"]);
    postgres.sql(&url, "UPDATE experiment SET build = '0.0.1 (other)'");
    assert_eq!(act(&server, &path, "pause").0, 200);
    wait_workers(&server, &path, &[]);
    // Nothing is done of it yet: it is begun anew by the build that is asked.
    assert_eq!(act(&server, &path, "resume").0, 200);
    let view = wait_workers(&server, &path, &["server", "worker"]);
    assert_ne!(view["build"], "0.0.1 (other)");

    // One that another build has begun, and a server of that runs.
    assert_eq!(act(&server, &path, "pause").0, 200);
    wait_workers(&server, &path, &[]);
    let other = "UPDATE experiment SET build = '0.0.1 (other)', done = 1";
    postgres.sql(&url, other);
    let (status, refused) = act(&server, &path, "resume");
    assert_eq!((status, &refused["code"]), (409, &json!("other_build")));
    postgres.sql(&url, "UPDATE experiment SET state = 'running'");
    let view = wait(&server, &path, "it waits", |view| view["waiting"] == true);
    let reason = view["reason"].as_str().expect("a reason");
    assert!(reason.contains("0.0.1 (other)"), "{reason}");
    wait_for("the worker says so", LIMIT, || {
        let log = worker.log();
        let refuses = "refuses an experiment of another build";
        (log.contains(refuses) && log.contains("0.0.1 (other)")).then_some(())
    });
    assert_eq!(workers(&server.get(&path).1), [] as [String; 0]);
    assert_eq!(act(&server, &path, "stop").0, 200);
    worker.end();
}

#[test]
fn a_worker_without_a_server_to_work_for_says_so() {
    let postgres = Postgres::shared();
    let empty = postgres.database();
    for (arguments, says) in [
        (&["worker"][..], "a worker shares the `database`"),
        (&["worker", "--database", &empty], "holds no records"),
        (
            &["worker", "--database", &empty, "--name", "a b"],
            "must be 1 to 64",
        ),
    ] {
        let mut command = Command::new(terracrawler());
        let output = command
            .args(arguments)
            .env_remove("TERRACRAWLER_DATABASE")
            .output()
            .expect("terracrawler");
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && text.contains(says), "{text}");
    }
}
