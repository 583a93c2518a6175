//! Rollouts with simulated robots, on servers that are killed in the middle: whoever is there next goes on.

use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use crawler_tests::engines::postgres::Postgres;
use crawler_tests::engines::redis::Redis;
use crawler_tests::{
    Mosquitto, ReservedPort, Simulated, Terracrawler, terracrawler, wait_for_with,
};
use serde_json::{Value, json};
use tempfile::TempDir;

/// For everything that has to happen on a busy machine: half a minute of each trial is real time.
const LIMIT: Duration = Duration::from_mins(5);
const ROBOTS: usize = 3;
/// What the new program tells as its build.
const BUILD: &str = "good-1";

/// A pair of keys, and a release for simulated robots.
struct Release {
    folder: TempDir,
    id: String,
}

impl Release {
    fn make() -> Self {
        let mut release = Self {
            folder: TempDir::new().expect("a folder"),
            id: String::new(),
        };
        release.run("release keygen --out keys");
        let bundle = format!("--version 0.4.0 --build {BUILD} --out good.bundle");
        // Two blocks, each of which takes seconds at the least rate there is.
        release.run(&format!("release bundle {bundle} --size 131072"));
        let sign =
            "release sign --key keys/release-key.pem --image good.bundle --board sim --sequence 1";
        let signed = format!("{sign} --version 0.4.0 --build {BUILD} --out good.release");
        let table = release.run(&signed);
        let id = table.lines().find_map(|line| line.strip_prefix("id "));
        id.expect("an id").trim().clone_into(&mut release.id);
        release
    }

    fn key(&self) -> String {
        let path: PathBuf = self.folder.path().join("keys/release-public.pem");
        path.to_str().expect("UTF-8").to_owned()
    }

    /// Calls the program in the folder of the release, and returns what it prints.
    fn run(&self, line: &str) -> String {
        let mut command = Command::new(terracrawler());
        let output = command
            .args(line.split(' '))
            .current_dir(self.folder.path())
            .output()
            .expect("terracrawler");
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{line}: {error}");
        String::from_utf8(output.stdout).expect("UTF-8")
    }

    /// Adds it where `place` says, and begins a rollout to all robots on a server.
    fn roll_out(&self, place: &str, server: &Terracrawler) {
        let key = self.key();
        self.run(&format!(
            "release add good.release --release-key {key} {place}"
        ));
        let plan = format!(
            "--release {} --share 100 --soak 0 --bytes-per-second 16384",
            self.id
        );
        self.run(&format!("rollout start {plan} --server {}", server.url()));
    }
}

/// Waits until the only rollout is as `holds` says, and returns it.
fn rollout(server: &Terracrawler, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
    let mut last = Value::Null;
    wait_for_with(what, LIMIT, &mut last, |last| {
        let (status, view) = server.try_get("/api/v1/rollouts/1")?;
        *last = view;
        (status == 200 && holds(last)).then(|| last.clone())
    })
}

/// A robot has got a block of the image.
fn under_way(view: &Value) -> bool {
    view["counts"]["bytes"]
        .as_u64()
        .is_some_and(|bytes| bytes > 0)
}

/// A robot has got all of it, and runs it.
fn on_trial(view: &Value) -> bool {
    let robots = &view["counts"]["robots"];
    robots["trial"].is_u64() || robots["confirmed"].is_u64()
}

fn is_done(view: &Value) -> bool {
    assert_ne!(view["state"], "paused", "{view}");
    view["state"] == "done"
}

/// How often something is said in the log of a rollout.
fn said(view: &Value, what: &str) -> usize {
    let log = view["log"].as_array().expect("a log");
    log.iter().filter(|line| line["what"] == what).count()
}

/// Every robot is confirmed, runs the new program, and the audit log is whole.
fn all_are_well(server: &Terracrawler, view: &Value) {
    assert_eq!(
        view["counts"]["robots"],
        json!({ "confirmed": ROBOTS }),
        "{view}"
    );
    assert_eq!(
        (said(view, "started"), said(view, "done")),
        (1, 1),
        "{view}"
    );
    let mut last = Vec::new();
    wait_for_with("all tell the new build", LIMIT, &mut last, |last| {
        *last = server.online();
        let new = last.iter().filter(|robot| robot["build"] == BUILD);
        (new.count() == ROBOTS).then_some(())
    });
    let (_, audit) = server.get("/api/v1/audit/verify");
    assert_eq!(audit["intact"], true, "{audit}");
}

#[test]
fn a_server_that_is_killed_goes_on_where_it_was() {
    let release = Release::make();
    let key = release.key();
    let reserved = ReservedPort::new();
    let _broker = Mosquitto::start(reserved.number());
    let broker = format!("mqtt://127.0.0.1:{}", reserved.number());
    let mut server = Terracrawler::start(&["serve", "--broker", &broker, "--release-key", &key]);
    let robots = ROBOTS.to_string();
    let arguments = [
        "--robots",
        &robots,
        "--scenario",
        "empty",
        "--release-key",
        &key,
    ];
    let _simulated = Simulated::start(reserved.number(), &arguments);
    server.wait_online(ROBOTS, LIMIT);
    let data = server.data();
    release.roll_out(&format!("--data {}", data.display()), &server);
    for (what, holds) in [
        ("a block is there", under_way as fn(&Value) -> bool),
        ("a robot is on trial", on_trial),
    ] {
        rollout(&server, what, holds);
        server.kill();
        server.resume();
    }
    let view = rollout(&server, "it is done", is_done);
    assert_eq!(said(&view, "taken_over"), 2, "{view}");
    all_are_well(&server, &view);
}

#[test]
fn another_server_goes_on_with_what_a_killed_one_was_at() {
    let release = Release::make();
    let key = release.key();
    let database = Postgres::shared();
    let url = database.database();
    let redis = Redis::start();
    let cache = redis.url();
    let reserved = ReservedPort::new();
    let _broker = Mosquitto::start(reserved.number());
    let broker = format!("mqtt://127.0.0.1:{}", reserved.number());
    let arguments = [
        "serve",
        "--broker",
        &broker,
        "--cache",
        &cache,
        "--database",
        &url,
        "--release-key",
        &key,
    ];
    let mut first = Terracrawler::start(&arguments);
    let second = Terracrawler::start(&arguments);
    let robots = ROBOTS.to_string();
    let arguments = [
        "--robots",
        &robots,
        "--scenario",
        "empty",
        "--release-key",
        &key,
    ];
    let _simulated = Simulated::start(reserved.number(), &arguments);
    first.wait_online(ROBOTS, LIMIT);
    second.wait_online(ROBOTS, LIMIT);
    release.roll_out(&format!("--database {url}"), &first);
    let view = rollout(&first, "a block is there", under_way);
    first.kill();
    let owner = view["server"].clone();
    let view = rollout(&second, "it is done", is_done);
    assert_ne!(view["server"], owner);
    assert!(said(&view, "taken_over") >= 1, "{view}");
    all_are_well(&second, &view);
    // The one that was killed leaves it as it is.
    first.resume();
    let (_, here) = first.get("/api/v1/rollouts/1");
    assert_eq!(
        (&here["state"], &here["log"]),
        (&json!("done"), &view["log"])
    );
}
