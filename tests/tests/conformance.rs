//! Simulated robots pass the conformance suite, and robots that misbehave do not.

mod impostor;

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use crawler_hil::BrokerUrl;
use crawler_hil::suite::{self, BenchError, Options, Outcome, Report, Target};
use crawler_protocol::{Fleet, RobotId};
use crawler_tests::{Mosquitto, ReservedPort, Simulated, Subscription, Terracrawler};
use impostor::{Impostor, Lie};

/// For robots to be online, on a busy machine.
const LIMIT: Duration = Duration::from_mins(2);
/// Suites that run at a time: they sleep most of the time, and the robots are in real time.
const AT_ONCE: usize = 4;

fn target(port: u16, fleet: &str, robot: &str) -> Target {
    Target {
        broker: BrokerUrl::loopback(port),
        fleet: Fleet::new(fleet).expect("a fleet"),
        robot: RobotId::new(robot).expect("an id"),
    }
}

/// Runs the suite on a thread of its own.
fn run(target: &Target, only: &[&str]) -> Result<Report, BenchError> {
    let options = Options {
        no_motion: false,
        only: only.iter().map(|name| (*name).to_owned()).collect(),
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    runtime.block_on(suite::run(target, &options, |_| {}))
}

/// The report, where everything passed but `may_skip`.
fn passes(target: &Target, may_skip: &[&str]) {
    let report = run(target, &[]).expect("a robot");
    println!("{report}");
    for case in &report.cases {
        let fine = match case.outcome {
            Outcome::Passed => true,
            Outcome::Skipped(_) => may_skip.contains(&case.name),
            Outcome::Failed(_) => false,
        };
        assert!(fine, "{}: {case}\n{report}", target.robot);
    }
    assert_eq!(report.cases.len(), suite::CASES.len());
}

/// Waits until `count` robots of `fleet` are online, by their status.
fn wait_online(port: u16, fleet: &str, count: usize) {
    let mut online = BTreeMap::new();
    let mut statuses = Subscription::start(port, &format!("{fleet}/status/+"));
    statuses.wait(&format!("{count} robots are online"), |topic, status| {
        online.insert(topic.to_owned(), status.contains(r#""online":true"#));
        (online.values().filter(|online| **online).count() == count).then_some(())
    });
}

#[test]
fn robots_of_a_server_pass_side_by_side() {
    let server = Terracrawler::start(&["up", "--robots", "3", "--scenario", "empty"]);
    server.wait_online(3, LIMIT);
    std::thread::scope(|scope| {
        for number in 1..=3 {
            let target = target(server.mqtt(), "swarm", &format!("sim-{number:04}"));
            // The server is never silent for long, and the three are not alone.
            scope.spawn(move || {
                passes(
                    &target,
                    &["no-clock", "swarm-stop", "fault", "fault-refused"],
                );
            });
        }
    });
}

#[test]
fn a_robot_alone_on_an_outside_broker_passes_everything() {
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let _broker = Mosquitto::start(port);
    let _robot = Simulated::start(port, &["--robots", "1", "--scenario", "empty"]);
    wait_online(port, "swarm", 1);
    passes(
        &target(port, "swarm", "sim-0001"),
        &["fault", "fault-refused"],
    );
}

#[test]
fn what_cannot_be_tested_is_said_in_one_line() {
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let error = run(&target(port, "swarm", "sim-0001"), &[]).expect_err("no broker");
    assert!(matches!(error, BenchError::Unreachable(..)), "{error}");

    let _broker = Mosquitto::start(port);
    let error = run(&target(port, "swarm", "sim-0001"), &[]).expect_err("no robots");
    assert!(error.to_string().contains("knows none"), "{error}");

    let robots = Simulated::start(port, &["--robots", "2", "--scenario", "empty"]);
    wait_online(port, "swarm", 2);
    let error = run(&target(port, "swarm", "nobody"), &[]).expect_err("no such robot");
    let told = error.to_string();
    assert!(told.contains("sim-0001, sim-0002"), "{told}");
    let error = run(&target(port, "swarm", "sim-0001"), &["x"]).expect_err("no such case");
    assert!(error.to_string().contains("'x'"), "{error}");

    // A power cut: what is left of the robots is their last will.
    drop(robots);
    let mut statuses = Subscription::start(port, "swarm/status/sim-0001");
    statuses.wait("the last will", |_, status| {
        status.contains(r#""online":false"#).then_some(())
    });
    let error = run(&target(port, "swarm", "sim-0001"), &[]).expect_err("offline");
    assert_eq!(error, BenchError::Offline("sim-0001".into()));
}

/// A lie, and the cases that must notice it.
const LIES: &[(Lie, &[&str])] = &[
    (Lie::OldProtocol, &["status"]),
    (Lie::EveryOtherHeartbeat, &["heartbeat"]),
    (Lie::WrongTime, &["clock"]),
    (Lie::UnknownField, &["contract"]),
    (Lie::TooLong, &["contract"]),
    (
        Lie::YesToEverything,
        &["unknown-command", "wrong-type", "oversized"],
    ),
    (Lie::NoRefusals, &["unknown-field"]),
    (Lie::EmptyMap, &["map"]),
    (Lie::ForgetsSettings, &["set"]),
    (Lie::CarriesOutTwice, &["repeated", "not-again"]),
    (Lie::NoAge, &["expired", "late-move"]),
    (Lie::PowerOnAlways, &["reboot"]),
    (Lie::NumbWheels, &["turn"]),
    (Lie::SwappedWheels, &["turn"]),
    (Lie::DeafToStop, &["stop", "late-stop-moving"]),
    (Lie::SoftEstop, &["estop"]),
    (Lie::Runaway, &["drive-failsafe"]),
];

#[test]
fn robots_that_misbehave_do_not_pass() {
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let _broker = Mosquitto::start(port);
    let count = (LIES.len() + 2).to_string();
    let robots = [
        "--robots",
        &count,
        "--scenario",
        "empty",
        "--fleet",
        "honest",
    ];
    let _robots = Simulated::start(port, &robots);
    wait_online(port, "honest", LIES.len() + 2);
    // The honest one shows that it is the lie that fails, not the man in the middle. It takes longest.
    let honest = [Lie::None, Lie::Newer].map(|lie| (lie, &[][..]));
    let all = honest.into_iter().chain(LIES.iter().copied());
    let left: Mutex<VecDeque<_>> = Mutex::new(all.enumerate().collect());
    let next = || {
        left.lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop_front()
    };
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some((number, (lie, noticed))) = next() {
                    let fleet = format!("lie-{number}");
                    let robot = format!("sim-{:04}", number + 1);
                    let _impostor = Impostor::start(port, "honest", &fleet, &robot, lie);
                    wait_online(port, &fleet, 1);
                    notice(lie, noticed, &target(port, &fleet, &robot));
                }
            });
        }
    });
}

fn notice(lie: Lie, noticed: &[&str], target: &Target) {
    let mut cases: Vec<&str> = match lie {
        Lie::None | Lie::Newer => LIES.iter().flat_map(|(_, cases)| *cases).copied().collect(),
        _ => noticed.to_vec(),
    };
    // Something has to be said for the contract to be judged by it.
    cases.push("flood");
    cases.push("contract");
    let report = run(target, &cases).expect("a robot");
    println!("{lie:?}\n{report}");
    let expected = noticed.iter().map(|name| (*name, true));
    let is_honest = matches!(lie, Lie::None | Lie::Newer);
    let honest = is_honest.then_some(cases.iter().map(|name| (*name, false)));
    for (name, fails) in expected.chain(honest.into_iter().flatten()) {
        let outcome = report.outcome(name).expect("it was asked for");
        let failed = matches!(outcome, Outcome::Failed(_));
        assert_eq!(failed, fails, "{lie:?}: {name}: {outcome:?}");
    }
}

/// A robot that cannot be brought to rest is not put through the cases.
#[test]
fn a_restless_robot_is_left_alone() {
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let _broker = Mosquitto::start(port);
    let arguments = ["--robots", "1", "--scenario", "empty", "--fleet", "honest"];
    let _robot = Simulated::start(port, &arguments);
    wait_online(port, "honest", 1);
    let _impostor = Impostor::start(port, "honest", "lie", "sim-0001", Lie::NeverRests);
    wait_online(port, "lie", 1);
    let error = run(&target(port, "lie", "sim-0001"), &["status"]).expect_err("restless");
    assert!(matches!(error, BenchError::Restless(..)), "{error}");
}
