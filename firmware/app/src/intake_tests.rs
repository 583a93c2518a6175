//! The door: nothing old, repeated or overtaken gets through, except a halt, which always does.

use crawler_protocol::{Fleet, Kind, MAX_MESSAGE, RobotId, Source};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::format;
use std::string::String;
use std::vec::Vec;

use super::*;
use crate::order::Order;
use crate::outbox::ADMIT_LIMIT;
use crate::{Config, Geometry};

type TestRobot = Robot<NoopRawMutex>;

/// Unix ms at the robot's boot.
const EPOCH_MS: u64 = 1_800_000_000_000;

fn unsynchronised() -> TestRobot {
    Robot::new(Config {
        id: RobotId::new("sim-0001").expect("an id"),
        fleet: Fleet::new("swarm").expect("a fleet"),
        broker_host: heapless::String::new(),
        broker_port: 1883,
        kind: Kind::Simulated,
        board: "sim",
        firmware: "0.1.0",
        build: None,
        geometry: Geometry::default(),
        credentials: None,
        camera: false,
        eyes: None,
        faults: false,
    })
}

fn robot() -> TestRobot {
    let robot = unsynchronised();
    robot.observe_time(EPOCH_MS, Instant::BOOT);
    robot
}

fn at(ms: u64) -> Instant {
    Instant::from_millis(ms)
}

fn json(name: &str, parameters: &str, timestamp: u64, seq: u64, source: &str) -> String {
    format!(
        "{{\"command\":\"{name}\",\"parameters\":{{{parameters}}},\"timestamp\":{timestamp},\
         \"seq\":{seq},\"source\":\"{source}\"}}"
    )
}

const DRIVE: &str = r#""v":0.2,"w":0.0"#;

/// Submits a `drive` of `operator:ada` given at `given`, arriving at `now`; ms since boot.
fn drive(robot: &TestRobot, seq: u64, given: u64, now: u64) {
    let text = json("drive", DRIVE, EPOCH_MS + given, seq, "operator:ada");
    robot.submit(text.as_bytes(), at(now));
}

fn answers(robot: &TestRobot) -> Vec<(u64, ResponseStatus, Option<Reason>)> {
    core::iter::from_fn(|| {
        let (ticket, answer) = robot.outbox.next_answer()?;
        robot.outbox.delivered(ticket);
        Some((answer.seq, answer.status, answer.reason))
    })
    .collect()
}

/// Whether there is a `set`; it is then taken.
fn waits_for_store(robot: &TestRobot) -> bool {
    embassy_futures::poll_once(robot.store_handle().next_set()).is_ready()
}

fn order(robot: &TestRobot) -> Option<Order> {
    robot.control_handle().take_order()
}

#[test]
fn a_fresh_motion_command_gets_through_once() {
    let robot = robot();
    drive(&robot, 1, 5_000, 5_000);
    assert_eq!(order(&robot).expect("an order").sender.seq, 1);
    drive(&robot, 1, 5_000, 5_010);
    assert!(order(&robot).is_none());
    assert!(answers(&robot).is_empty(), "the answer is still to come");
    let ada = Source::new("operator:ada").expect("a source");
    robot.respond(&ada, 1, ResponseStatus::Completed, None, at(5_020));
    drive(&robot, 1, 5_000, 9_000);
    let completed = (1, ResponseStatus::Completed, None);
    // Delivered once for the command; the repetition found the same answer still waiting.
    assert_eq!(answers(&robot), [completed]);
    drive(&robot, 1, 5_000, 9_000);
    assert_eq!(answers(&robot), [completed]);
    drive(&robot, 0, 9_000, 9_000);
    assert_eq!(answers(&robot), [(0, ResponseStatus::Stale, None)]);
    assert!(order(&robot).is_none());
}

#[test]
fn motion_expires_after_two_seconds_to_the_millisecond() {
    for (age, passes) in [(0, true), (2_000, true), (2_001, false), (60_000, false)] {
        let robot = robot();
        drive(&robot, 1, 100_000, 100_000 + age);
        assert_eq!(order(&robot).is_some(), passes, "age {age}");
        if !passes {
            assert_eq!(answers(&robot), [(1, ResponseStatus::Expired, None)]);
        }
    }
}

#[test]
fn motion_from_the_future_is_refused_beyond_the_tolerance() {
    for (ahead, passes) in [(2_000, true), (2_001, false), (u64::MAX / 4, false)] {
        let robot = robot();
        drive(&robot, 1, 100_000 + ahead, 100_000);
        assert_eq!(order(&robot).is_some(), passes, "ahead {ahead}");
        if !passes {
            let refused = (1, ResponseStatus::Rejected, Some(Reason::OutOfRange));
            assert_eq!(answers(&robot), [refused]);
        }
    }
}

#[test]
fn without_a_clock_nothing_moves_and_everything_else_works() {
    let robot = unsynchronised();
    drive(&robot, 1, 5_000, 5_000);
    let refused = (1, ResponseStatus::Rejected, Some(Reason::NoClock));
    assert_eq!(answers(&robot), [refused]);
    assert!(order(&robot).is_none());
    let identify = json("identify", "", 0, 2, "operator:ada");
    robot.submit(identify.as_bytes(), at(5_000));
    assert!(order(&robot).is_some());
    let stop = json("stop", "", 0, 3, "operator:ada");
    robot.submit(stop.as_bytes(), at(5_000));
    assert!(robot.control_handle().take_halt().is_some());
    // A clock that was not heard for long is no clock.
    robot.observe_time(EPOCH_MS + 6_000, at(6_000));
    drive(&robot, 4, 4_000_000, 4_000_000);
    let refused = (4, ResponseStatus::Rejected, Some(Reason::NoClock));
    assert_eq!(answers(&robot), [refused]);
}

#[test]
fn every_motion_command_is_subject_to_the_clock_and_no_other() {
    let all = [
        (
            "move",
            r#""direction":"left","speed":50,"duration":100"#,
            true,
        ),
        ("drive", DRIVE, true),
        ("scan", "", true),
        ("goto", r#""x":1.0,"y":1.0"#, true),
        ("behave", r#""behaviour":"wander""#, true),
        ("reset", "", false),
        ("identify", "", false),
        ("set", r#""telemetry_hz":2"#, false),
        ("reboot", "", false),
    ];
    for (name, parameters, expires) in all {
        let robot = robot();
        let text = json(name, parameters, EPOCH_MS, 1, "operator:ada");
        robot.submit(text.as_bytes(), at(60_000));
        let through = order(&robot).is_some() || waits_for_store(&robot);
        assert_eq!(through, !expires, "{name}");
    }
}

#[test]
fn a_halt_overtakes_what_its_source_sent_before() {
    let robot = robot();
    let stop = json("stop", "", EPOCH_MS + 1_000, 10, "operator:ada");
    robot.submit(stop.as_bytes(), at(1_000));
    drive(&robot, 9, 999, 1_001);
    assert!(
        order(&robot).is_none(),
        "sent before the stop, arrived after it"
    );
    assert_eq!(answers(&robot), [(9, ResponseStatus::Stale, None)]);
}

#[test]
fn a_halt_takes_back_motion_that_waits_and_the_sender_is_told() {
    let robot = robot();
    drive(&robot, 1, 1_000, 1_000);
    let estop = json("estop", "", 0, 7, "operator:bob");
    robot.submit(estop.as_bytes(), at(1_000));
    assert!(order(&robot).is_none());
    assert!(
        robot
            .control_handle()
            .take_halt()
            .expect("a halt")
            .emergency
    );
    let interrupted = (1, ResponseStatus::Failed, Some(Reason::Interrupted));
    assert_eq!(answers(&robot), [interrupted]);
}

#[test]
fn too_many_commands_are_refused_as_busy_and_stop_still_works() {
    let robot = robot();
    for seq in 1..=30 {
        drive(&robot, seq, 1_000, 1_000);
    }
    let busy = answers(&robot);
    let all_busy = busy.iter().all(|(_, status, reason)| {
        (*status, *reason) == (ResponseStatus::Rejected, Some(Reason::Busy))
    });
    assert!(all_busy && !busy.is_empty(), "{busy:?}");
    assert!(busy.len() <= ADMIT_LIMIT);
    let stop = json("stop", "", EPOCH_MS + 1_000, 31, "operator:ada");
    robot.submit(stop.as_bytes(), at(1_000));
    assert!(robot.control_handle().take_halt().is_some());
    assert!(order(&robot).is_none());
}

#[test]
fn a_robot_whose_answers_do_not_get_out_refuses_new_commands_and_obeys_stop() {
    let robot = robot();
    let ada = Source::new("operator:ada").expect("a source");
    let mut refused = None;
    for seq in 1..40 {
        let identify = json("identify", "", 0, seq, "operator:ada");
        // Refusals are answered at a limited rate.
        let now = at(seq * 1_000);
        robot.submit(identify.as_bytes(), now);
        if order(&robot).is_none() {
            refused = Some(seq);
            break;
        }
        robot.respond(&ada, seq, ResponseStatus::Completed, None, now);
    }
    let refused = refused.expect("at some point there is no room");
    assert_eq!(robot.outbox.pending() as u64, refused);
    let last = answers(&robot).pop();
    let busy = (refused, ResponseStatus::Rejected, Some(Reason::Busy));
    assert_eq!(last, Some(busy));
}

#[test]
fn an_unreadable_command_is_refused_with_its_reason_when_its_number_is_readable() {
    let cases: [(String, Option<Reason>); 5] = [
        (json("explode", "", 1, 4, "a"), Some(Reason::UnknownCommand)),
        (
            json("drive", r#""v":"fast","w":0"#, 1, 4, "a"),
            Some(Reason::WrongType),
        ),
        (
            json("drive", r#""v":1e9,"w":0"#, 1, 4, "a"),
            Some(Reason::OutOfRange),
        ),
        (
            json("stop", r#""now":true"#, 1, 4, "a"),
            Some(Reason::UnknownField),
        ),
        (String::from("{\"command\":"), None),
    ];
    for (text, reason) in cases {
        let robot = robot();
        robot.submit(text.as_bytes(), at(1_000));
        let expected: Vec<_> = reason
            .map(|reason| (4, ResponseStatus::Rejected, Some(reason)))
            .into_iter()
            .collect();
        assert_eq!(answers(&robot), expected, "{text}");
        let record = robot.outbox.next_log(0, at(1_000)).expect("a log record");
        assert_eq!(record.event, "command-refused");
        assert!(order(&robot).is_none() && robot.control_handle().take_halt().is_none());
    }
}

#[test]
fn refusals_are_rationed_and_the_ration_comes_back() {
    let robot = robot();
    let refuse = |count: u64, now: u64| {
        for seq in 0..count {
            let text = json("explode", "", 1, now * 1_000 + seq, "a");
            robot.submit(text.as_bytes(), at(now));
        }
        let given = answers(&robot).len();
        let logged = core::iter::from_fn(|| robot.outbox.next_log(0, at(now))).count();
        (given, logged)
    };
    let (given, logged) = refuse(500, 10_000);
    assert_eq!(given, ANSWER_RATE as usize);
    // The rationed records, and one that tells what was withheld.
    assert_eq!(logged, LOG_RATE as usize + 1);
    assert_eq!(refuse(500, 10_000).0, 0);
    assert_eq!(refuse(500, 10_500).0, ANSWER_RATE as usize / 2);
}

#[test]
fn oversized_messages_are_refused_by_name() {
    let robot = robot();
    let mut text = json("stop", "", 1, 1, "a");
    text.extend(core::iter::repeat_n(' ', MAX_MESSAGE));
    robot.submit(text.as_bytes(), at(0));
    assert!(robot.control_handle().take_halt().is_none());
    let (_, answer) = robot.outbox.next_answer().expect("an answer");
    assert_eq!((answer.seq, answer.status), (1, ResponseStatus::Rejected));
    assert_eq!(answer.reason, Some(Reason::TooLarge));
    let record = robot.outbox.next_log(0, at(1_000)).expect("a log record");
    assert!(record.text.contains("too_large"), "{}", record.text);
}

#[derive(Debug, Clone)]
struct Delivery {
    sender: usize,
    /// Which of the sender's commands so far, from the latest; 0 gives a new one.
    back: usize,
    kind: u8,
    /// Time that passes before, in ms.
    pause: u64,
    /// Whether control takes what waits.
    control_runs: bool,
}

fn deliveries() -> impl Strategy<Value = Vec<Delivery>> {
    let delivery = (
        0_usize..12,
        prop_oneof![2 => Just(0_usize), 3 => 1_usize..8],
        0_u8..6,
        prop_oneof![5 => 0_u64..50, 1 => 0_u64..4_000],
        any::<bool>(),
    )
        .prop_map(|(sender, back, kind, pause, control_runs)| Delivery {
            sender,
            back,
            kind,
            pause,
            control_runs,
        });
    proptest::collection::vec(delivery, 1..250)
}

proptest! {
    /// Up to twelve sources, more than the ledger remembers; a network that repeats, delays and
    /// reorders. What reaches control is new, in order and in time; halts always reach it.
    #[test]
    fn no_stale_replayed_or_late_command_reaches_control(deliveries in deliveries()) {
        let robot = robot();
        let mut now = 10_000;
        let mut sent: BTreeMap<usize, Vec<(u64, u64, u8)>> = BTreeMap::new();
        let mut last: BTreeMap<String, u64> = BTreeMap::new();
        for delivery in deliveries {
            now += delivery.pause;
            let history = sent.entry(delivery.sender).or_default();
            if delivery.back == 0 || delivery.back > history.len() {
                history.push((history.len() as u64 + 1, now, delivery.kind));
            }
            let index = history.len() - delivery.back.clamp(1, history.len());
            let (seq, given, kind) = history[index];
            // Time messages arrive too.
            robot.observe_time(EPOCH_MS + now, at(now));
            let (name, parameters) = match kind {
                0 => ("stop", ""),
                1 => ("estop", ""),
                2 => ("scan", ""),
                3 => ("reset", ""),
                4 => ("identify", ""),
                _ => ("drive", DRIVE),
            };
            let source = format!("sender-{}", delivery.sender);
            let waiting_before = robot.orders_waiting();
            let text = json(name, parameters, EPOCH_MS + given, seq, &source);
            robot.submit(text.as_bytes(), at(now));
            if kind < 2 {
                let halt = robot.control_handle().take_halt().expect("a halt always reaches control");
                prop_assert!(kind == 0 || halt.emergency);
                if let Some(latest) = last.get_mut(&source) {
                    *latest = seq.max(*latest);
                } else {
                    last.insert(source, seq);
                }
            } else if robot.orders_waiting() > waiting_before {
                let motion = kind == 2 || kind == 5;
                prop_assert!(!motion || now - given <= EXPIRY.as_millis(), "late");
                let earlier = last.insert(source.clone(), seq);
                prop_assert!(earlier.is_none_or(|earlier| seq > earlier), "{source} {seq}");
            }
            if delivery.control_runs {
                while let Some(order) = order(&robot) {
                    let sender = order.sender;
                    let done = ResponseStatus::Completed;
                    robot.respond(&sender.source, sender.seq, done, None, at(now));
                }
                answers(&robot);
            }
        }
    }

    #[test]
    fn no_bytes_make_intake_panic(
        payloads in proptest::collection::vec(
            proptest::collection::vec(any::<u8>(), 0..1_200),
            0..20,
        ),
        nows in proptest::collection::vec(any::<u64>(), 20),
    ) {
        let robot = robot();
        for (payload, now) in payloads.iter().zip(nows) {
            robot.submit(payload, Instant::from_micros(now));
        }
        prop_assert!(robot.orders_waiting() == 0);
    }
}
