//! A trained policy on its way to the emulated board: command line, server, broker, boot stage, flash and program are real.

use std::fs;
use std::process::Command;
use std::time::Duration;

use crawler_hil::BrokerUrl;
use crawler_hil::emulator::{self, Options};
use crawler_image_format::pem;
use crawler_tests::{Terracrawler, root, terracrawler, wait_for_with};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::board::Board;
use super::{JOINS, command, knows_the_time, machine, one, robot};

/// For a whole update, on a busy machine.
const UPDATES: Duration = Duration::from_mins(5);
const ROBOT: &str = "virt-01";

/// Calls the program in a folder, and returns what it prints.
fn run(folder: &TempDir, line: &str) -> String {
    let output = Command::new(terracrawler())
        .args(line.split(' '))
        .current_dir(folder.path())
        .output()
        .expect("terracrawler");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{line}: {error}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// What it comes to that the robot is to drive by the policy of this name, and stands again.
fn behaves(server: &Terracrawler, policy: &str) -> Value {
    let path = format!("/api/v1/robots/{ROBOT}/commands");
    let parameters = json!({"behaviour": "policy", "policy": policy});
    let behave = json!({"command": "behave", "parameters": parameters});
    let counts = command(server, &path, &behave);
    let stopped = command(server, &path, &json!({"command": "stop"}));
    assert!(one("completed")(&stopped), "{stopped}");
    counts
}

#[test]
fn a_trained_policy_reaches_the_board_and_is_there_after_its_power_was_off() {
    let _machine = machine();
    let folder = TempDir::new().expect("a folder");
    run(&folder, "release keygen --out keys");
    let trained = root().join("firmware/app/policies/spread.tcpo");
    fs::copy(trained, folder.path().join("apart.tcpo")).expect("a policy");
    let sign = "release sign --key keys/release-key.pem --image apart.tcpo --kind policy --name apart --board virt \
                --version 1 --sequence 1 --out apart.release";
    let table = run(&folder, sign);
    let id = table.lines().find_map(|line| line.strip_prefix("id "));
    let id = id.expect("an id").trim().to_owned();
    let key = folder.path().join("keys/release-public.pem");
    let points = pem::public_keys(&fs::read_to_string(&key).expect("a key")).expect("a key in PEM");
    let key = key.to_str().expect("UTF-8").to_owned();

    let server = Terracrawler::start(&["serve", "--release-key", &key]);
    let image = emulator::image().unwrap_or_else(|error| panic!("{error}"));
    let broker = BrokerUrl::loopback(server.mqtt());
    let mut options = Options::new(image, ROBOT.parse().expect("an id"), broker);
    options.release_keys = points;
    let mut board = Board::start_with(options);
    server.wait_online(1, JOINS);
    knows_the_time(&server, ROBOT);
    assert!(
        one("rejected")(&behaves(&server, "apart")),
        "it is not there yet"
    );

    let data = server.data();
    let add = format!(
        "release add apart.release --release-key {key} --data {}",
        data.display()
    );
    run(&folder, &add);
    let url = server.url();
    let plan = format!("--release {id} --share 100 --soak 0 --override-gate emulated");
    run(&folder, &format!("rollout start {plan} --server {url}"));
    let mut last = Value::Null;
    wait_for_with("it is done", UPDATES, &mut last, |last| {
        *last = server.try_get("/api/v1/rollouts/1")?.1;
        assert_ne!(last["state"], "paused", "{last}");
        (last["state"] == "done").then_some(())
    });
    assert_eq!(last["counts"]["robots"], json!({"confirmed": 1}), "{last}");

    for off in [false, true] {
        if off {
            board.power_cycle().expect("it starts again");
            let mut last = Value::Null;
            wait_for_with("the second start", JOINS, &mut last, |last| {
                *last = robot(&server, ROBOT);
                (last["presence"] == "online" && last["boot"]["count"] == 2).then_some(())
            });
            knows_the_time(&server, ROBOT);
        }
        let mut last = Value::Null;
        wait_for_with("the robot tells its policy", JOINS, &mut last, |last| {
            *last = robot(&server, ROBOT);
            last["models"]["apart"].is_string().then_some(())
        });
        let can = last["capabilities"].as_array().expect("a list");
        assert!(can.contains(&json!("policies")), "{last}");
        for (name, outcome) in [
            ("apart", "completed"),
            ("spread", "completed"),
            ("other", "rejected"),
        ] {
            let counts = behaves(&server, name);
            assert!(
                one(outcome)(&counts),
                "{name} after power off, {off}: {counts}"
            );
        }
    }
}
