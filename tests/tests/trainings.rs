//! A training in a server that is killed, against the same training at a console.

use std::process::Command;
use std::time::Duration;

use crawler_tests::{Terracrawler, terracrawler, wait_for, wait_for_with};
use serde_json::{Value, json};

const ALL: &str = "/api/v1/experiments";
/// For everything that has to happen on a busy machine: a training gives way to whatever else wants the processor.
const LIMIT: Duration = Duration::from_mins(10);
const SEED: &str = "7";
const WORLDS: &str = "4";
/// 200 rounds of four worlds, a few seconds.
const STEPS: &str = "307200";
/// The one file of a training that has the time of day in it.
const EVENTS: &str = "events.out.tfevents.terracrawler";

fn number(text: &str) -> u64 {
    text.parse().expect("a number")
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

/// How much each thread of that name gives way to others, as the system has it.
#[cfg(target_os = "linux")]
fn niceness(process: u32, thread: &str) -> Vec<i32> {
    let tasks = std::fs::read_dir(format!("/proc/{process}/task")).expect("our own process");
    let of = |task: std::fs::DirEntry| {
        let stat = std::fs::read_to_string(task.path().join("stat")).ok()?;
        let (head, rest) = stat.rsplit_once(") ")?;
        let is_it = head.split_once('(')?.1 == thread;
        // The 19th of all fields, of which two are behind us.
        let nice = rest.split(' ').nth(16)?.parse().ok()?;
        is_it.then_some(nice)
    };
    tasks.flatten().filter_map(of).collect()
}

#[test]
fn a_training_that_is_killed_comes_to_the_bytes_of_the_console() {
    let folder = tempfile::tempdir().expect("a folder");
    let straight = folder.path().join("straight");
    let output = Command::new(terracrawler())
        .args([
            "train", "--seed", SEED, "--steps", STEPS, "--worlds", WORLDS,
        ])
        .args(["--units", "8", "--threads", "2", "--out"])
        .arg(&straight)
        .output()
        .expect("it runs");
    assert!(output.status.success(), "{output:?}");

    let mut server = Terracrawler::start(&["serve"]);
    let body = json!({
        "kind": "training", "name": "killed", "seed": number(SEED), "steps": number(STEPS),
        "worlds": number(WORLDS), "units": 8,
    });
    let (status, made) = server.post(ALL, &body);
    assert_eq!(status, 201, "{made}");
    assert_eq!(made["seeds"], 200);
    let path = format!("{ALL}/{}", made["id"].as_str().expect("an id"));
    let seen = wait(&server, &path, "a round", |seen| rounds(seen) > 0);
    assert!(rounds(&seen) < 200, "{seen}");
    #[cfg(target_os = "linux")]
    wait_for("it gives way", LIMIT, || {
        let nice = niceness(server.id(), "training");
        (nice == [19]).then_some(())
    });
    let mut killed = 0;
    for least in [1, 32, 95] {
        let seen = wait(&server, &path, "it learns", |seen| rounds(seen) >= least);
        server.kill();
        killed += u32::from(seen["state"] == "running");
        server.resume();
    }
    assert!(killed > 0, "it was over before it could be killed");
    let seen = wait(&server, &path, "it is over", |seen| {
        seen["state"] == "completed"
    });
    let files = seen["training"]["files"].as_array().expect("files");
    assert_eq!(files.len(), 5, "{seen}");
    let mut folders = std::fs::read_dir(server.data().join("trainings")).expect("a folder");
    let trained = folders
        .next()
        .expect("a training")
        .expect("readable")
        .path();
    for file in files {
        let name = file["name"].as_str().expect("a name");
        let read = |folder: &std::path::Path| std::fs::read(folder.join(name)).expect("written");
        let both = [read(&straight), read(&trained)];
        if name == EVENTS {
            // It says when each round was made, and which of them were made again.
            assert!(both.iter().all(|file| !file.is_empty()));
        } else {
            assert!(both[0] == both[1], "{name} differs");
        }
    }

    // The line that it names is the one that was typed above.
    let command = seen["command"].as_str().expect("a command");
    let wanted = format!("--seed {SEED} --steps {STEPS} --worlds {WORLDS} --units 8");
    assert!(command.contains(&wanted), "{command}");
}
