//! What travels while all is well.

use std::vec::Vec;

use crawler_hal::{Clock, Duration};
use crawler_protocol::{
    BuildId, Detections, Heartbeat, LogRecord, MAX_PARAMETERS, ParametersMessage, ResponseStatus,
    StatusMessage, Telemetry,
};

use super::harness::{EPOCH_MS, run};
use super::wire::{command, field, packet};
use crate::link::KEEP_ALIVE;
use crate::order::Task;
use crate::parameters::{PARAMETER_COUNT, TABLE};
use crate::perception::LinkHealth;
use crate::vision::{Class, Lens, Spot, View};

#[test]
fn connect_says_who_comes_and_leaves_a_will() {
    run(async |broker| {
        let mut peer = broker.peer().await;
        let (connect, filters) = peer.accept(false).await;
        assert_eq!(connect.client_id, "sim-0001");
        assert_eq!(
            u64::from(connect.keep_alive_s) * 1_000,
            KEEP_ALIVE.as_millis()
        );
        assert!(connect.clean, "nothing is left over from another boot");
        assert_eq!(connect.will_topic, "swarm/status/sim-0001");
        assert_eq!((connect.will_qos, connect.will_retained), (1, true));
        assert_eq!(field(&connect.will, "online"), "false");
        assert_eq!(field(&connect.will, "robot"), "sim-0001");
        // Options: QoS in the lowest bits, 0x20 = no retained messages.
        let expected = [
            "swarm/command/robot/sim-0001 0x21",
            "swarm/command/swarm 0x21",
            "swarm/command/experiment 0x21",
            "swarm/time 0x20",
            "swarm/pose/sim-0001 0x20",
        ];
        assert_eq!(filters, expected);
    });
}

#[test]
fn status_and_parameters_are_retained_once_commands_can_arrive() {
    run(async |broker| {
        let mut peer = broker.peer().await;
        assert_eq!(broker.health(), LinkHealth::Absent);
        peer.accept(false).await;
        let status = peer.publish("swarm/status/").await;
        assert_eq!(broker.health(), LinkHealth::Up);
        assert_eq!(status.topic, "swarm/status/sim-0001");
        assert_eq!((status.qos, status.retained), (1, true));
        let status = StatusMessage::from_json(&status.payload).expect("a status");
        assert!(status.online);
        assert_eq!(status.build, Some(BuildId::development("0.1.0")));
        let parameters = peer.publish("swarm/parameters/").await;
        assert_eq!((parameters.qos, parameters.retained), (1, true));
        let message = ParametersMessage::from_json(&parameters.payload).expect("parameters");
        assert_eq!(message.values.len(), PARAMETER_COUNT);
        broker.robot.store_handle().tell_parameters();
        peer.publish("swarm/parameters/").await;
    });
}

#[test]
fn every_parameter_fits_one_message() {
    const { assert!(PARAMETER_COUNT <= MAX_PARAMETERS) }
    // What `MAX_PARAMETERS` asks of their names.
    let letters: usize = TABLE.iter().map(|definition| definition.name.len()).sum();
    assert!(letters <= 17 * PARAMETER_COUNT, "{letters}");
}

#[test]
fn a_new_boot_record_is_told() {
    run(async |broker| {
        let peer = broker.connected().await;
        let status = peer.publish("swarm/status/").await;
        assert_eq!(status.json()["boot"]["count"], 0);
        broker.robot.store_handle().set_boot_count(7);
        let status = peer.publish("swarm/status/").await;
        assert_eq!(status.json()["boot"]["count"], 7);
    });
}

#[test]
fn what_was_seen_is_told_once_unless_it_is_old() {
    run(async |broker| {
        let peer = broker.connected().await;
        broker.sleep(Duration::from_millis(100)).await;
        let robot = broker.robot;
        let spot = Spot {
            class: Class::Robot,
            x: 0.25,
            y: 0.5,
            margin: 9,
        };
        let spots = [spot].into_iter().collect();
        let view = |frame| {
            let taken = (frame, broker.clock.now(), 0.0);
            View::new(&spots, &Lens::default(), 1.0, taken)
        };
        for (seq, frame) in [(0, 7), (1, 9)] {
            let at = EPOCH_MS + broker.clock.now().as_millis();
            assert!(robot.camera_handle().show(&view(frame), None));
            robot.outbox.nudge();
            let message = peer.publish("swarm/vision/").await;
            assert_eq!(message.topic, "swarm/vision/sim-0001");
            assert_eq!((message.qos, message.retained), (0, false));
            let told = Detections::from_json(&message.payload).expect("detections");
            assert_eq!((told.seq, told.frame, told.timestamp), (seq, frame, at));
            let [object] = &told.objects[..] else {
                panic!("{told:?}")
            };
            assert_eq!((object.class.as_str(), object.margin), ("robot", 9));
            assert_eq!((object.x, object.y), (0.25, 0.5));
            assert!((object.bearing - 0.281).abs() < 1e-3, "{}", object.bearing);
        }
        let old = view(10);
        let all = peer.publishes_for(Duration::from_secs(3)).await;
        assert!(robot.camera_handle().show(&old, None));
        robot.outbox.nudge();
        let later = peer.publishes_for(Duration::from_secs(3)).await;
        let mut all = all.iter().chain(&later);
        assert!(!all.any(|p| p.topic.starts_with("swarm/vision/")));
    });
}

#[test]
fn heartbeat_every_second_and_telemetry_five_times() {
    run(async |broker| {
        let peer = broker.connected().await;
        peer.publish("swarm/heartbeat/").await;
        let all = peer.publishes_for(Duration::from_secs(10)).await;
        let of = |prefix: &str| -> Vec<_> {
            all.iter().filter(|p| p.topic.starts_with(prefix)).collect()
        };
        let (beats, telemetry) = (of("swarm/heartbeat/"), of("swarm/telemetry/"));
        assert!((9..=10).contains(&beats.len()), "{} beats", beats.len());
        assert!((49..=51).contains(&telemetry.len()), "{}", telemetry.len());
        assert!(
            beats
                .iter()
                .chain(&telemetry)
                .all(|p| p.qos == 0 && !p.retained)
        );
        let beat = Heartbeat::from_json(&beats[0].payload).expect("a heartbeat");
        assert_eq!(beat.timestamp, EPOCH_MS + beat.uptime_ms);
        let seqs: Vec<_> = telemetry
            .iter()
            .map(|p| Telemetry::from_json(&p.payload).expect("telemetry").seq)
            .collect();
        assert!(
            seqs.windows(2).all(|pair| pair[1] == pair[0] + 1),
            "{seqs:?}"
        );
    });
}

#[test]
fn an_outside_reference_reaches_control() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.deliver_time();
        broker.sleep(Duration::from_millis(100)).await;
        let fix = |id: &str, age: u64| {
            let seen = EPOCH_MS + broker.clock.now().as_millis() - age;
            std::format!(
                r#"{{"robot":"{id}","timestamp":{seen},"pose":{{"x":1.5,"y":-2.5,"theta":0.5,"sigma":0.02}}}}"#
            )
        };
        // On a topic of another robot, about another robot, too old.
        peer.deliver("swarm/pose/sim-0002", fix("sim-0002", 0).as_bytes());
        peer.deliver("swarm/pose/sim-0001", fix("sim-0002", 0).as_bytes());
        peer.deliver("swarm/pose/sim-0001", fix("sim-0001", 1_500).as_bytes());
        broker.sleep(Duration::from_millis(10)).await;
        assert_eq!(broker.robot.control_handle().take_fix(), None);
        assert_eq!(broker.robot.refused_fixes(), 2);
        peer.deliver("swarm/pose/sim-0001", fix("sim-0001", 50).as_bytes());
        broker.sleep(Duration::from_millis(10)).await;
        let fix = broker.robot.control_handle().take_fix().expect("a fix");
        assert_eq!((fix.pose.x, fix.pose.y), (1.5, -2.5));
        let age = broker.clock.now() - fix.seen;
        assert!((50..=70).contains(&age.as_millis()), "{age:?}");
    });
}

#[test]
fn a_command_reaches_control_and_its_answers_come_back_in_order() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.command(
            17,
            "move",
            r#""direction":"forward","speed":80,"duration":2000"#,
        );
        broker.sleep(Duration::from_millis(10)).await;
        let order = broker
            .robot
            .control_handle()
            .take_order()
            .expect("an order");
        assert!(matches!(
            order.task,
            Task::Move {
                speed: 80,
                duration_ms: 2000,
                ..
            }
        ));
        let sender = order.sender;
        for status in [ResponseStatus::Accepted, ResponseStatus::Completed] {
            let now = broker.clock.now();
            broker
                .robot
                .respond(&sender.source, sender.seq, status, None, now);
        }
        for expected in ["accepted", "completed"] {
            let response = peer.publish("swarm/response/robot/sim-0001").await;
            assert_eq!((response.qos, response.retained), (1, false));
            assert_eq!(response.json()["seq"], 17);
            assert_eq!(field(&response.json(), "status"), expected);
            assert_eq!(field(&response.json(), "source"), "operator:ada");
        }
        broker.sleep(Duration::from_millis(10)).await;
        assert_eq!(broker.robot.outbox.pending(), 0);
    });
}

#[test]
fn commands_to_the_swarm_count_and_commands_to_others_do_not() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        let now = EPOCH_MS + broker.clock.now().as_millis();
        let other = "swarm/command/robot/sim-0002";
        peer.deliver(other, command("scan", "", now, 1).as_bytes());
        peer.deliver(
            "swarm/command/swarm",
            command("scan", "", now, 2).as_bytes(),
        );
        peer.deliver(
            "swarm/command/experiment",
            command("scan", "", now, 3).as_bytes(),
        );
        broker.sleep(Duration::from_millis(10)).await;
        let seqs: Vec<u64> = core::iter::from_fn(|| broker.robot.control_handle().take_order())
            .map(|order| order.sender.seq)
            .collect();
        assert_eq!(seqs, [2, 3]);
    });
}

#[test]
fn a_message_with_every_property_is_read_like_one_without() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        let now = EPOCH_MS + broker.clock.now().as_millis();
        let mut body = Vec::new();
        body.extend(b"\x00\x13swarm/command/swarm\x00\x09");
        // Payload format, expiry, content type, response topic, correlation data, user property.
        let properties: &[u8] = b"\x01\x01\x02\x00\x00\x00\x3c\x03\x00\x04json\x08\x00\x03a/b\
            \x09\x00\x02\xff\xfe\x26\x00\x01k\x00\x01v";
        body.push(properties.len() as u8);
        body.extend(properties);
        body.extend(command("stop", "", now, 5).as_bytes());
        peer.send(&packet(0x32, &body));
        broker.sleep(Duration::from_millis(10)).await;
        let halt = broker
            .robot
            .control_handle()
            .take_halt()
            .expect("the robot was told to stop");
        assert_eq!(halt.senders[0].seq, 5);
        peer.command(6, "identify", "");
        broker.sleep(Duration::from_millis(10)).await;
        assert!(broker.robot.control_handle().take_order().is_some());
    });
}

#[test]
fn what_cannot_be_read_is_rejected_and_the_session_goes_on() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        let topic = "swarm/command/swarm";
        peer.deliver(topic, b"\xff\x00 not json");
        let long = std::vec![b'x'; 1_100];
        peer.deliver(topic, &long);
        let unknown = command("explode", "", EPOCH_MS, 9);
        peer.deliver(topic, unknown.as_bytes());
        let all = peer.publishes_for(Duration::from_secs(1)).await;
        let first = |prefix: &str| all.iter().find(|p| p.topic.starts_with(prefix));
        let response = first("swarm/response/").expect("an answer").json();
        assert_eq!(response["seq"], 9);
        assert_eq!(field(&response, "status"), "rejected");
        assert_eq!(field(&response, "reason"), "unknown_command");
        // The robot has not met who sent it, and remembers nobody for what it cannot read.
        assert!(response.get("source").is_none());
        let record = first("swarm/logs/").expect("a log record");
        let record = LogRecord::from_json(&record.payload).expect("a log record");
        assert_eq!(record.event.as_str(), "command-refused");
        assert_eq!(broker.attempts().len(), 1);
    });
}

#[test]
fn a_flood_of_nonsense_starves_neither_heartbeat_nor_stop() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        for seq in 0..2_000 {
            let nonsense = command("explode", "", EPOCH_MS, seq);
            peer.deliver("swarm/command/swarm", nonsense.as_bytes());
        }
        peer.command(1, "stop", "");
        let all = peer.publishes_for(Duration::from_secs(3)).await;
        let count = |prefix: &str| all.iter().filter(|p| p.topic.starts_with(prefix)).count();
        assert!(broker.robot.control_handle().take_halt().is_some());
        assert!(count("swarm/heartbeat/") >= 2);
        let answers = count("swarm/response/");
        assert!((1..=80).contains(&answers), "{answers} answers");
        assert!(count("swarm/logs/") <= 20);
        assert!(count("swarm/telemetry/") >= 10);
    });
}
