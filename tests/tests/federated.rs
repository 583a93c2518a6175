//! Nodes that learn for a server, each a process of its own, while the server, its broker and nodes are killed.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crawler_tests::engines::Process;
use crawler_tests::{Terracrawler, terracrawler, wait_for_with};
use serde_json::{Value, json};

const ALL: &str = "/api/v1/experiments";
/// For everything that has to happen on a busy machine.
const LIMIT: Duration = Duration::from_mins(10);
/// Rounds of a training.
const ROUNDS: u64 = 40;
const WORLDS: u64 = 2;
const NODES: [&str; 3] = ["attic", "barn", "cellar"];

/// A node with worlds of its own.
fn node(folder: &Path, broker: &str, name: &str, options: &[&str]) -> Process {
    let mut command = Command::new(terracrawler());
    command
        .args(["learn-node", "--broker", broker, "--threads", "1"])
        .args(options);
    Process::start(command, &folder.join(format!("{name}.log")))
}

fn named(folder: &Path, server: &Terracrawler, name: &str) -> Process {
    let broker = format!("mqtt://127.0.0.1:{}", server.mqtt());
    let profile = if name == "cellar" { "mild" } else { "none" };
    node(
        folder,
        &broker,
        name,
        &["--name", name, "--randomisation", profile],
    )
}

/// Makes a training, and says where it is.
fn made(server: &Terracrawler, more: &Value) -> String {
    let mut body = json!({
        "kind": "training", "name": "together", "seed": 7, "steps": ROUNDS * 3 * WORLDS * 384,
        "worlds": WORLDS, "units": 8, "nodes": 3, "quorum": 3, "deadline_s": 5,
    });
    let fields = body.as_object_mut().expect("an object");
    fields.extend(more.as_object().expect("an object").clone());
    let (status, made) = server.post(ALL, &body);
    assert_eq!(status, 201, "{made}");
    assert_eq!(made["seeds"], ROUNDS);
    format!("{ALL}/{}", made["id"].as_str().expect("an id"))
}

/// Waits until a training is as `holds` says, and returns it.
fn wait(server: &Terracrawler, path: &str, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
    let mut seen = Value::Null;
    wait_for_with(what, LIMIT, &mut seen, |seen| {
        *seen = server.get(path).1;
        holds(seen).then(|| seen.clone())
    })
}

fn rounds(seen: &Value) -> u64 {
    seen["done"].as_u64().expect("a number")
}

fn over(server: &Terracrawler, path: &str) -> Value {
    wait(server, path, "it is over", |seen| {
        seen["state"] == "completed"
    })
}

/// A file of a training, as it is on the disk.
fn file(server: &Terracrawler, path: &str, name: &str) -> Vec<u8> {
    let id = path.rsplit('/').next().expect("an id");
    let folder = server.data().join("trainings");
    let mut folders = std::fs::read_dir(folder).expect("a folder").flatten();
    let prefix = format!("{id}-");
    let own = folders.find(|entry| entry.file_name().to_string_lossy().starts_with(&prefix));
    std::fs::read(own.expect("a training").path().join(name)).expect("written")
}

#[test]
fn a_server_that_is_killed_costs_nodes_nothing_and_nodes_that_are_killed_come_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut server = Terracrawler::start(&["serve"]);
    let mut nodes: Vec<Process> = NODES
        .iter()
        .map(|name| named(folder.path(), &server, name))
        .collect();

    // Undisturbed.
    let calm = made(&server, &json!({}));
    let seen = wait(&server, &calm, "nodes have answered", |seen| {
        seen["training"]["nodes"]["last"]
            .as_array()
            .is_some_and(|last| last.len() == 3)
    });
    let told = &seen["training"]["nodes"];
    let names: Vec<&str> = told["last"]
        .as_array()
        .expect("nodes")
        .iter()
        .filter_map(|node| node["node"].as_str())
        .collect();
    assert_eq!(names, NODES);
    assert_eq!(told["last"][0]["decisions"], WORLDS * 384);
    over(&server, &calm);

    // The same, and server and broker are killed on the way: to the same bytes.
    let killed = made(&server, &json!({}));
    for least in [2, 15] {
        wait(&server, &killed, "it learns", |seen| rounds(seen) >= least);
        server.kill();
        server.resume();
    }
    let seen = over(&server, &killed);
    for name in ["policy", "policy.tcpo", "curve.csv", "run.json"] {
        let both = [&calm, &killed].map(|path| file(&server, path, name));
        assert!(both[0] == both[1], "{name} differs: {seen}");
    }
    let curve = String::from_utf8(file(&server, &killed, "curve.csv")).expect("text");
    let steps: Vec<u64> = curve
        .lines()
        .skip(1)
        .filter_map(|line| line.split(',').nth(1)?.parse().ok())
        .collect();
    let wanted: Vec<u64> = (1..=ROUNDS).map(|round| round * 3 * WORLDS * 384).collect();
    assert_eq!(steps, wanted, "no round is lost, and none is there twice");

    // A node is killed and does not come back for a while: the others go on after the deadline.
    let fewer = made(
        &server,
        &json!({ "quorum": 2, "deadline_s": 1, "aggregation": "median" }),
    );
    wait(&server, &fewer, "it learns", |seen| rounds(seen) >= 2);
    nodes[1].kill();
    let two = |seen: &Value| {
        let last = &seen["training"]["nodes"]["last"];
        last.as_array().is_some_and(|last| last.len() == 2)
    };
    wait(&server, &fewer, "two go on", two);
    nodes[1] = named(folder.path(), &server, NODES[1]);
    over(&server, &fewer);
    for (node, name) in nodes.iter_mut().zip(NODES) {
        assert!(node.runs(), "{name} ended:\n{}", node.log());
    }

    // Nodes that come when other runs are over, of which the broker still knows, hear the one that goes on.
    for node in &mut nodes {
        node.end("INT");
    }
    let last = made(&server, &json!({ "deadline_s": 3_600 }));
    wait(&server, &last, "it is announced", |seen| {
        seen["training"]["nodes"]["expected"] == 3
    });
    let nodes = NODES.map(|name| named(folder.path(), &server, name));
    over(&server, &last);
    let log = nodes[0].log();
    assert!(
        log.contains(&format!("round {ROUNDS}: ")) && log.contains("is over"),
        "{log}"
    );
}

#[test]
fn a_node_logs_in_by_its_account_and_by_no_other() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Terracrawler::start_closed(&["serve"]);
    let enrolled = Command::new(terracrawler())
        .args(["robot", "enroll", "--learner", "hall", "--data"])
        .arg(server.data())
        .output()
        .expect("it runs");
    assert!(enrolled.status.success(), "{enrolled:?}");
    let said = String::from_utf8_lossy(&enrolled.stdout).into_owned();
    let secret = said
        .strip_prefix("mqtt://learner-hall:")
        .and_then(|rest| Some(rest.split_once('@')?.0))
        .unwrap_or_else(|| panic!("an address with a secret: {said}"));
    let at = |user: &str, secret: &str| {
        let port = server.mqtt();
        format!("mqtt://{user}:{secret}@127.0.0.1:{port}")
    };
    let mut own = node(
        folder.path(),
        &at("learner-hall", secret),
        "own",
        &["--log", "info"],
    );
    let mut wrong = node(
        folder.path(),
        &at("learner-yard", secret),
        "wrong",
        &["--log", "info"],
    );
    wait_for_with("a stranger is refused", LIMIT, &mut String::new(), |seen| {
        *seen = wrong.log();
        seen.contains("no session for learning").then_some(())
    });
    assert!(wrong.runs(), "it tries again:\n{}", wrong.log());
    wait_for_with("a node is let in", LIMIT, &mut String::new(), |seen| {
        *seen = own.log();
        seen.contains("the session for learning stands")
            .then_some(())
    });
    assert!(own.runs());
}
