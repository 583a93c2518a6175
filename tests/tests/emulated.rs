//! Robots on the emulated board, against the real server: the program as it is flashed, over a
//! real network, with a cable that can be pulled.
//!
//! Boards run in real time, so one test with boards runs at a time.

mod board;
mod driving;
mod policies;
mod tls;
mod update_server;
mod updates;

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use board::{Board, listen, suite_on};
use crawler_hil::BrokerUrl;
use crawler_hil::suite::{ANSWER, Bench, BenchError, Failure, REST, Word, is_standing};
use crawler_protocol::open::{Open, Response};
use crawler_protocol::{BehaviourName, BootCause, Reason, ResponseStatus, RobotState};
use crawler_tests::{Mosquitto, ReservedPort, Terracrawler, wait_for, wait_for_with};
use serde_json::{Value, json};

/// To boot, get an address, and be seen by the server; and for all else, on a busy machine.
const JOINS: Duration = Duration::from_mins(2);

fn serve() -> Terracrawler {
    Terracrawler::start(&["serve"])
}

fn robot(server: &Terracrawler, id: &str) -> Value {
    server.get(&format!("/api/v1/robots/{id}")).1
}

/// Sends a command over HTTP and waits for what it comes to.
fn command(server: &Terracrawler, path: &str, body: &Value) -> Value {
    let (status, accepted) = server.post(path, body);
    assert_eq!(status, 202, "{body}: {accepted}");
    let path = format!(
        "/api/v1/commands/{}",
        accepted["id"].as_str().expect("an id")
    );
    let mut last = Value::Null;
    wait_for_with("every robot's final answer", JOINS, &mut last, |last| {
        *last = server.get(&path).1;
        let counts = last["counts"].clone();
        let open = |name| counts[name].as_u64().unwrap_or_default();
        (open("pending") + open("accepted") == 0).then_some(counts)
    })
}

/// Waits until the robot has heard the server's clock: before that, motion is refused.
fn knows_the_time(server: &Terracrawler, id: &str) {
    let what = format!("{id} knows the time");
    let mut last = Value::Null;
    wait_for_with(&what, JOINS, &mut last, |last| {
        *last = robot(server, id);
        (last["timestamp"].as_u64()? > 0).then_some(())
    });
}

/// This machine, for one test at a time: boards run in real time, and those that wait for a processor
/// miss what their bodies tell them.
fn machine() -> MutexGuard<'static, ()> {
    static MACHINE: Mutex<()> = Mutex::new(());
    MACHINE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn one(outcome: &str) -> impl Fn(&Value) -> bool {
    move |counts| counts[outcome] == 1
}

#[test]
fn one_robot_joins_obeys_and_passes_the_suite() {
    let _machine = machine();
    let server = serve();
    let board = Board::start("virt-01", server.mqtt(), &["bench=1"]);
    server.wait_online(1, JOINS);
    knows_the_time(&server, "virt-01");
    let seen = robot(&server, "virt-01");
    assert_eq!(
        (&seen["kind"], &seen["board"]),
        (&json!("emulated"), &json!("virt"))
    );
    assert_eq!(seen["boot"], json!({"count": 1, "cause": "power-on"}));

    let orders = "/api/v1/robots/virt-01/commands";
    let turn = json!({"command": "move",
        "parameters": {"direction": "left", "speed": 40, "duration": 500}});
    let counts = command(&server, orders, &turn);
    assert!(one("completed")(&counts), "{counts}");
    let fly = json!({"command": "capture"});
    let counts = command(&server, orders, &fly);
    assert!(one("rejected")(&counts), "{counts}");

    let wander = json!({"command": "behave", "parameters": {"behaviour": "wander"}});
    let counts = command(&server, orders, &wander);
    assert!(one("completed")(&counts), "{counts}");
    let mut poses = Vec::new();
    wait_for("it wanders somewhere", JOINS, || {
        let seen = robot(&server, "virt-01");
        if seen["behaviour"] != "wander" {
            return None;
        }
        poses.push([seen["pose"]["x"].as_f64()?, seen["pose"]["y"].as_f64()?]);
        let far = |pose: &[f64; 2]| (pose[0] - poses[0][0]).hypot(pose[1] - poses[0][1]) > 0.3;
        poses.iter().any(far).then_some(())
    });
    // The rest is said by the suite, which the simulated robots pass too.
    suite_on("virt-01", server.mqtt(), &[], &["no-clock"]);
    assert!(board.wait_line("reset, as asked for", JOINS).is_some());
    let used = stacks_used(&board).map(|bytes| bytes.to_string());
    // `cargo xtask size` holds it against the budget.
    let note = crawler_hil::emulator::image().expect("it ran");
    std::fs::write(note.with_extension("stack"), used.join(" ")).expect("a note beside it");
}

/// The most that tasks and control ever used of their stacks, as the board on a bench reports it every ten seconds.
fn stacks_used(board: &Board) -> [u64; 2] {
    let mut seen = board.logged();
    let until = Instant::now() + Duration::from_mins(4);
    while Instant::now() < until {
        let lines = board.lines_after(seen, until);
        seen += lines.len() as u64;
        let report = lines
            .iter()
            .find_map(|line| line.text.strip_prefix("stack: "));
        if let Some(report) = report {
            let numbers = report.split(' ').filter_map(|word| word.parse().ok());
            let numbers: Vec<u64> = numbers.collect();
            return numbers.try_into().expect("two numbers of bytes");
        }
    }
    panic!("the board reports no stack")
}

#[test]
fn four_robots_join_pass_and_stop_together() {
    let _machine = machine();
    let server = serve();
    let names = ["virt-01", "virt-02", "virt-03", "virt-04"];
    let _boards = names.map(|name| Board::start(name, server.mqtt(), &[]));
    server.wait_online(4, JOINS);
    for name in names {
        knows_the_time(&server, name);
        assert_eq!(robot(&server, name)["kind"], "emulated");
    }
    let cases = [
        "status",
        "heartbeat",
        "identify",
        "unknown-command",
        "flood",
        "set",
        "turn",
        "stop",
        "estop",
        "drive-failsafe",
        "contract",
    ];
    std::thread::scope(|scope| {
        for name in names {
            let mqtt = server.mqtt();
            scope.spawn(move || suite_on(name, mqtt, &cases, &[]));
        }
    });
    let everyone = "/api/v1/swarm/commands";
    let wander = json!({"command": "behave", "parameters": {"behaviour": "wander"}});
    assert_eq!(command(&server, everyone, &wander)["completed"], 4);
    wait_for("all four drive", JOINS, || {
        let standing = json!({"left": 0.0, "right": 0.0});
        let drives = |robot: &Value| robot["behaviour"] == "wander" && robot["wheels"] != standing;
        (server.online().iter().filter(|robot| drives(robot)).count() == 4).then_some(())
    });
    assert_eq!(
        command(&server, everyone, &json!({"command": "stop"}))["completed"],
        4
    );
    wait_for("all four stand", JOINS, || {
        let standing = |robot: &&Value| robot["state"] == "IDLE";
        (server.online().iter().filter(standing).count() == 4).then_some(())
    });
}

/// Sends a command as a controller of its own. In what order a broker hands over what it had under
/// way and what came later is its own affair, and of one controller only the newest command counts.
fn alone(bench: &mut Bench, source: &str, body: &Value) -> Result<u64, Failure> {
    let (seq, mut command) = bench.envelope(body.clone());
    command["source"] = format!("test:{source}").into();
    bench.send_bytes(command.to_string().into_bytes())?;
    Ok(seq)
}

/// Commands sent while the cable is pulled, and answers given meanwhile, arrive; nothing twice
/// that differs, nothing that was never asked for.
#[test]
fn a_lost_link_loses_no_command_and_no_answer() {
    let _machine = machine();
    let server = serve();
    let mut board = Board::start("virt-01", server.mqtt(), &[]);
    server.wait_online(1, JOINS);
    let mut answers: BTreeMap<u64, Vec<Response>> = BTreeMap::new();
    let mut expected: BTreeMap<u64, (ResponseStatus, Option<Reason>)> = BTreeMap::new();
    listen("virt-01", server.mqtt(), async |bench| {
        bench.meet().await.expect("a robot");
        bench
            .wait("the clock", ANSWER, |message| match &message.word {
                Word::Heartbeat(beat) => (beat.timestamp > 0).then_some(()),
                _ => None,
            })
            .await?;
        // Under way when the link goes: its end is answered with nobody to hear it.
        let identify = json!({"command": "identify"});
        let turning = json!({"command": "move",
            "parameters": {"direction": "left", "speed": 40, "duration": 10_000}});
        let under_way = alone(bench, "before", &turning)?;
        bench
            .until("it turns", ANSWER, |telemetry| !is_standing(telemetry))
            .await?;
        let uptime = bench
            .wait("a heartbeat", ANSWER, |message| match &message.word {
                Word::Heartbeat(beat) => Some(beat.uptime_ms),
                _ => None,
            })
            .await?;

        board.set_link(false).expect("the cable is pulled");
        let pulled = Instant::now();
        let completed = (ResponseStatus::Completed, None);
        expected.insert(alone(bench, "a", &identify)?, completed);
        let late = alone(bench, "b", &turning)?;
        expected.insert(late, (ResponseStatus::Expired, None));
        expected.insert(alone(bench, "c", &json!({"command": "stop"}))?, completed);
        bench
            .wait("the last will", JOINS, |message| match &message.word {
                Word::Status(status) => (!status.online).then_some(()),
                _ => None,
            })
            .await?;
        wait_for("the server knows", JOINS, || {
            (robot(&server, "virt-01")["presence"] == "offline").then_some(())
        });
        // Also what comes after everybody knows, within the minute that the session is kept.
        expected.insert(alone(bench, "d", &identify)?, completed);
        while pulled.elapsed() < Duration::from_secs(12) {
            bench.listen(Duration::from_millis(500)).await?;
        }
        board.set_link(true).expect("the cable is plugged in");
        let beat = bench
            .wait("the robot is back", JOINS, |message| match &message.word {
                Word::Heartbeat(beat) => Some(beat.clone()),
                _ => None,
            })
            .await?;
        assert!(beat.uptime_ms > uptime, "it went on meanwhile");
        for seq in expected.keys().copied().chain([under_way]) {
            answers
                .entry(seq)
                .or_default()
                .push(bench.outcome(seq, ANSWER).await?);
        }
        // The late move moved nothing.
        bench.rests(REST).await?;
        let heard = bench.listen(Duration::from_secs(2)).await?;
        for message in heard {
            if let Word::Response(response) = message.word {
                answers.entry(response.seq).or_default().push(response);
            }
        }
        // Its own end, or the end of the link, whichever came first.
        let end = &answers[&under_way][0];
        let ended = told(end);
        assert!(
            ended == (ResponseStatus::Completed, None)
                || ended == (ResponseStatus::Failed, Some(Reason::LinkLost)),
            "{end:?}"
        );
        expected.insert(under_way, ended);
        Ok(())
    });
    for (seq, given) in &answers {
        let (status, reason) = expected.get(seq).unwrap_or_else(|| {
            panic!("an answer to {seq}, which nobody asked: {given:?}");
        });
        for answer in given {
            assert_eq!(told(answer), (*status, *reason), "{given:?}");
        }
    }
    assert_eq!(answers.len(), expected.len());
    let seen = robot(&server, "virt-01");
    assert_eq!(
        (&seen["presence"], &seen["boot"]["count"]),
        (&json!("online"), &json!(1))
    );
}

/// What an answer says, in words that this build knows.
fn told(answer: &Response) -> (ResponseStatus, Option<Reason>) {
    let status = answer.status.known().expect("a known status");
    let reason = answer.reason.map(Open::known);
    (status, reason.map(|reason| reason.expect("a known reason")))
}

#[test]
fn a_power_cut_keeps_parameters_and_counts_the_boot() {
    let _machine = machine();
    let server = serve();
    let mut board = Board::start("virt-01", server.mqtt(), &[]);
    server.wait_online(1, JOINS);
    let set = json!({"command": "set", "parameters": {"name": "kept", "max_speed": 0.25}});
    let counts = command(&server, "/api/v1/robots/virt-01/commands", &set);
    assert!(one("completed")(&counts), "{counts}");

    let boots = |count: u32, cause: &str| {
        let expected = json!({"count": count, "cause": cause});
        wait_for(&format!("boot {count} by {cause}"), JOINS, || {
            let seen = robot(&server, "virt-01");
            (seen["presence"] == "online" && seen["boot"] == expected).then_some(())
        });
        let (_, parameters) = server.get("/api/v1/robots/virt-01/parameters");
        let parameters = parameters["parameters"].as_array().expect("a list").clone();
        let value = |name: &str| {
            let found = parameters.iter().find(|report| report["name"] == name);
            found.expect(name)["value"].clone()
        };
        assert_eq!(
            (value("name"), value("max_speed")),
            (json!("kept"), json!(0.25))
        );
    };
    board.power_cycle().expect("it starts again");
    boots(2, "power-on");
    board.reset().expect("it is reset");
    boots(3, "external");
    let reboot = json!({"command": "reboot"});
    let counts = command(&server, "/api/v1/robots/virt-01/commands", &reboot);
    assert!(one("completed")(&counts), "{counts}");
    boots(4, "software");
}

/// What each fault of the body leads to, as the robot tells it.
#[test]
fn faults_lead_to_the_stated_state_and_record() {
    let _machine = machine();
    let server = serve();
    let start = |id: &str, fault: &str| Board::start(id, server.mqtt(), &[fault]);
    let boards = [
        start("absent", "fault=ranger-dead"),
        start("stuck", "fault=line-stuck"),
        start("noise", "fault=flash-noise"),
        start("refuses", "fault=flash-refuses"),
        start("panics", "fault=panic@3"),
        start("hangs", "fault=hang@3"),
    ];
    server.wait_online(boards.len(), JOINS);
    for id in ["absent", "stuck"] {
        wait_for(&format!("{id} is in ERROR"), JOINS, || {
            let seen = robot(&server, id);
            (seen["state"] == "ERROR" && seen["range_mm"].is_null()).then_some(())
        });
        let orders = format!("/api/v1/robots/{id}/commands");
        let go = json!({"command": "behave", "parameters": {"behaviour": "wander"}});
        let counts = command(&server, &orders, &go);
        assert!(one("rejected")(&counts), "{id}: {counts}");
        logs(&server, id, "fault");
    }
    // Noise in flash is no robot's end: it starts anew, counts, and keeps what it is told next.
    wait_for("noise starts anew", JOINS, || {
        let seen = robot(&server, "noise");
        (seen["state"] == "IDLE" && seen["boot"]["count"] == 1).then_some(())
    });
    let set = json!({"command": "set", "parameters": {"name": "found"}});
    let counts = command(&server, "/api/v1/robots/noise/commands", &set);
    assert!(one("completed")(&counts), "{counts}");

    logs(&server, "refuses", "flash");
    let set = json!({"command": "set", "parameters": {"name": "lost"}});
    let counts = command(&server, "/api/v1/robots/refuses/commands", &set);
    assert!(counts["rejected"] == 1 || counts["failed"] == 1, "{counts}");
    assert_eq!(robot(&server, "refuses")["boot"]["count"], 0);

    wait_for("the panic is reported", JOINS, || {
        let boot = robot(&server, "panics")["boot"].clone();
        let text = boot["panic"].as_str().unwrap_or_default().to_owned();
        (boot["cause"] == "panic" && text.contains("as asked for")).then_some(())
    });
    wait_for("the watchdog's bite is reported", JOINS, || {
        let boot = robot(&server, "hangs")["boot"].clone();
        (boot["cause"] == "watchdog" && boot["count"] == 2).then_some(())
    });
}

/// Waits until the robot has logged `event`.
fn logs(server: &Terracrawler, id: &str, event: &str) {
    let mut last = Value::Null;
    wait_for_with(&format!("{id} logs {event}"), JOINS, &mut last, |last| {
        *last = server.get(&format!("/api/v1/robots/{id}/logs")).1;
        last.to_string()
            .contains(&format!(r#""event":"{event}""#))
            .then_some(())
    });
}

#[test]
fn a_broker_that_refuses_credentials_is_said_and_the_right_ones_work() {
    let _machine = machine();
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let _broker = Mosquitto::start_guarded(port, &[("robots", "right")]);
    let url = |password: &str| -> BrokerUrl {
        let url = format!("mqtt://robots:{password}@127.0.0.1:{port}");
        url.parse().expect("an address")
    };
    let wrong = Board::start_at("wrong", url("false"), &[]);
    let _right = Board::start_at("right", url("right"), &[]);
    let refused = wrong.wait_line("broker-credentials", JOINS);
    assert!(refused.is_some(), "the refusal is logged");
    board::listen_at("right", url("right"), async |bench| {
        bench
            .wait("it joins", JOINS, |message| match &message.word {
                Word::Status(status) => (status.online).then_some(status.boot.cause),
                _ => None,
            })
            .await
            .map(|cause| assert_eq!(cause, BootCause::PowerOn))?;
        let told = bench.until("telemetry", ANSWER, |_| true).await?;
        assert_ne!(told.state, RobotState::Error);
        assert_eq!(told.behaviour, BehaviourName::Manual);
        Ok(())
    });
    // The suite says in one line that the other one is not there.
    board::listen_at("wrong", url("right"), async |bench| {
        let error = bench.meet().await.expect_err("it never got in");
        assert!(matches!(error, BenchError::Unknown(..)), "{error}");
        Ok(())
    });
    board::refused_at(url("false"));
}
