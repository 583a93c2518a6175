//! The contract as users know it: its own examples, its topics, its names, its limit of size.

use std::collections::BTreeSet;

use crawler_protocol::{
    Action, Battery, BehaviourName, Boot, BootCause, Capability, CellDigest, Command, DecodeError,
    Detection, Detections, Direction, EncodeError, Fleet, Heartbeat, IdError, Kind, Level,
    LogRecord, MAX_DETECTIONS, MAX_MESSAGE, MAX_NEIGHBOURS, MAX_PARAMETERS, Neighbour, Outcomes,
    PROTOCOL_VERSION, ParameterReport, ParameterValue, ParametersMessage, Pose, PoseFix, Qos,
    Reason, Response, ResponseStatus, RobotId, RobotState, Source, StatusMessage, SwarmResponse,
    Telemetry, TimeMessage, Topic, TopicError, TopicFilter, Wheels,
};

const COMMAND: &str = r#"{"command": "move", "parameters": {"direction": "forward", "speed": 80, "duration": 2000}, "timestamp": 1648372964000, "seq": 17, "source": "operator:ada"}"#;
const RESPONSE: &str = r#"{"robot": "sim-0001", "seq": 17, "status": "completed", "reason": null, "timestamp": 1648372966004}"#;
const TELEMETRY: &str = r#"{"robot": "sim-0001", "seq": 901, "timestamp": 1648372966004, "state": "MOVING", "behaviour": "manual", "pose": {"x": 1.204, "y": -0.310, "theta": 1.571, "sigma": 0.08},
 "range_mm": 812, "temperature_c": 22.5, "wheels": {"left": 0.60, "right": 0.60}, "battery": {"mv": 7610, "percent": 71}, "rssi_dbm": -61}"#;
const STATUS: &str = r#"{"robot": "sim-0001", "online": true, "kind": "simulated", "firmware": "0.3.0", "board": "sim", "capabilities": ["drive", "range", "camera"], "boot": {"count": 3, "cause": "power-on"}, "protocol": 1}"#;

fn robot() -> RobotId {
    RobotId::new("sim-0001").unwrap()
}

/// Our JSON and the example are the same but for white space and trailing zeros.
fn same(ours: &[u8], example: &str) {
    let ours: serde_json::Value = serde_json::from_slice(ours).unwrap();
    let example: serde_json::Value = serde_json::from_str(example).unwrap();
    assert_eq!(ours, example);
}

#[test]
fn the_examples_of_the_contract_are_read_and_written() {
    let mut buf = [0; MAX_MESSAGE];

    let command = Command {
        action: Action::Move {
            direction: Direction::Forward,
            speed: 80,
            duration_ms: 2000,
        },
        timestamp: 1_648_372_964_000,
        seq: 17,
        source: Source::new("operator:ada").unwrap(),
    };
    assert_eq!(Command::parse(COMMAND.as_bytes()), Ok(command.clone()));
    let length = command.to_json(&mut buf).unwrap();
    same(&buf[..length], COMMAND);

    let response = Response {
        robot: robot(),
        seq: 17,
        status: ResponseStatus::Completed,
        reason: None,
        timestamp: 1_648_372_966_004,
    };
    assert_eq!(
        Response::from_json(RESPONSE.as_bytes()),
        Ok(response.clone())
    );
    let length = response.to_json(&mut buf).unwrap();
    same(&buf[..length], RESPONSE);

    let telemetry = Telemetry {
        robot: robot(),
        seq: 901,
        timestamp: 1_648_372_966_004,
        state: RobotState::Moving,
        behaviour: BehaviourName::Manual,
        pose: Pose {
            x: 1.204,
            y: -0.310,
            theta: 1.571,
            sigma: 0.08,
        },
        range_mm: Some(812),
        temperature_c: Some(22.5),
        wheels: Wheels {
            left: 0.6,
            right: 0.6,
        },
        battery: Battery {
            mv: 7610,
            percent: 71,
        },
        rssi_dbm: Some(-61),
    };
    assert_eq!(
        Telemetry::from_json(TELEMETRY.as_bytes()),
        Ok(telemetry.clone())
    );
    let length = telemetry.to_json(&mut buf).unwrap();
    same(&buf[..length], TELEMETRY);

    let status = StatusMessage {
        robot: robot(),
        online: true,
        kind: Kind::Simulated,
        firmware: "0.3.0".try_into().unwrap(),
        board: "sim".try_into().unwrap(),
        capabilities: Capability::ALL.iter().copied().collect(),
        boot: Boot {
            count: 3,
            cause: BootCause::PowerOn,
        },
        protocol: PROTOCOL_VERSION,
    };
    assert_eq!(
        StatusMessage::from_json(STATUS.as_bytes()),
        Ok(status.clone())
    );
    let length = status.to_json(&mut buf).unwrap();
    same(&buf[..length], STATUS);
}

/// Topic, text after the fleet, QoS 1, retained; as the table of the contract has them.
fn topics(id: &RobotId) -> Vec<(Topic, String, bool, bool)> {
    let id = || id.clone();
    vec![
        (Topic::CommandSwarm, "command/swarm".into(), true, false),
        (
            Topic::CommandRobot(id()),
            format!("command/robot/{}", id()),
            true,
            false,
        ),
        (
            Topic::CommandExperiment,
            "command/experiment".into(),
            true,
            false,
        ),
        (
            Topic::Response(id()),
            format!("response/robot/{}", id()),
            true,
            false,
        ),
        (Topic::ResponseSwarm, "response/swarm".into(), true, false),
        (Topic::Status(id()), format!("status/{}", id()), true, true),
        (
            Topic::Heartbeat(id()),
            format!("heartbeat/{}", id()),
            false,
            false,
        ),
        (
            Topic::Telemetry(id()),
            format!("telemetry/{}", id()),
            false,
            false,
        ),
        (
            Topic::Vision(id()),
            format!("vision/{}", id()),
            false,
            false,
        ),
        (Topic::Image(id()), format!("image/{}", id()), true, false),
        (Topic::Logs(id()), format!("logs/{}", id()), false, false),
        (
            Topic::Parameters(id()),
            format!("parameters/{}", id()),
            true,
            true,
        ),
        (Topic::Pose(id()), format!("pose/{}", id()), false, false),
        (Topic::Time, "time".into(), false, false),
        (Topic::Ota(id()), format!("ota/{}", id()), true, false),
        (
            Topic::SimulatorCommand,
            "simulator/command".into(),
            true,
            false,
        ),
        (
            Topic::SimulatorExperiment,
            "simulator/experiment".into(),
            true,
            false,
        ),
        (
            Topic::Cell { x: -3, y: 12 },
            "cell/-3/12".into(),
            false,
            false,
        ),
    ]
}

#[test]
fn topics_are_those_of_the_table() {
    let long = "a".repeat(32);
    for fleet in ["swarm", "a", long.as_str()] {
        let fleet = Fleet::new(fleet).unwrap();
        for id in ["sim-0001", "-", long.as_str()] {
            let id = RobotId::new(id).unwrap();
            for (topic, levels, acknowledged, retained) in topics(&id) {
                let text = format!("{fleet}/{levels}");
                assert_eq!(topic.render(&fleet).as_str(), text);
                assert_eq!(Topic::parse(&fleet, &text), Ok(topic.clone()));
                assert_eq!(topic.qos() == Qos::AtLeastOnce, acknowledged, "{text}");
                assert_eq!(topic.retained(), retained, "{text}");
                assert_eq!(
                    topic.robot().is_some(),
                    text.ends_with(id.as_str()),
                    "{text}"
                );
            }
        }
    }
    assert_eq!(Fleet::default().as_str(), "swarm");
}

#[test]
fn every_cell_has_one_topic() {
    let fleet = Fleet::default();
    for x in i16::MIN..=i16::MAX {
        let topic = Topic::Cell { x, y: !x };
        let text = topic.render(&fleet);
        assert_eq!(text.as_str(), format!("swarm/cell/{x}/{}", !x));
        assert_eq!(Topic::parse(&fleet, &text), Ok(topic));
    }
}

#[test]
fn what_is_no_topic_says_why() {
    let fleet = Fleet::default();
    let long = format!("swarm/status/{}", "a".repeat(33));
    for (text, error) in [
        ("", TopicError::OtherFleet),
        ("swarm", TopicError::OtherFleet),
        ("herd/time", TopicError::OtherFleet),
        ("swarmtime", TopicError::OtherFleet),
        ("/swarm/time", TopicError::OtherFleet),
        ("swarm/", TopicError::Unknown),
        ("swarm/time/", TopicError::Unknown),
        ("swarm/Time", TopicError::Unknown),
        ("swarm//time", TopicError::Unknown),
        ("swarm/status", TopicError::Unknown),
        ("swarm/status/a/b", TopicError::Unknown),
        ("swarm/command/robot", TopicError::Unknown),
        ("swarm/command/robot/a/b", TopicError::Unknown),
        ("swarm/simulator/other", TopicError::Unknown),
        ("swarm/status/", TopicError::Robot),
        ("swarm/status/+", TopicError::Robot),
        ("swarm/status/#", TopicError::Robot),
        ("swarm/status/Robot", TopicError::Robot),
        ("swarm/status/ä", TopicError::Robot),
        ("swarm/status/a\0", TopicError::Robot),
        (long.as_str(), TopicError::Robot),
        ("swarm/cell/+/+", TopicError::Cell),
        ("swarm/cell//1", TopicError::Cell),
        ("swarm/cell/01/1", TopicError::Cell),
        ("swarm/cell/-0/1", TopicError::Cell),
        ("swarm/cell/+1/1", TopicError::Cell),
        ("swarm/cell/1.0/1", TopicError::Cell),
        ("swarm/cell/32768/1", TopicError::Cell),
    ] {
        assert_eq!(Topic::parse(&fleet, text), Err(error), "{text}");
    }
}

/// Whether an MQTT filter selects a topic, by the rules of MQTT 5 section 4.7.
fn selects(filter: &str, topic: &str) -> bool {
    let (mut filter, mut topic) = (filter.split('/'), topic.split('/'));
    loop {
        match (filter.next(), topic.next()) {
            (Some("#"), _) | (None, None) => return true,
            (Some("+"), Some(_)) => {}
            (Some(wanted), Some(level)) if wanted == level => {}
            _ => return false,
        }
    }
}

#[test]
fn every_topic_has_exactly_one_filter_and_it_selects_as_mqtt_does() {
    let fleet = Fleet::new("herd").unwrap();
    for (topic, ..) in topics(&robot()) {
        let matching: Vec<_> = TopicFilter::ALL
            .iter()
            .filter(|filter| filter.matches(&topic))
            .collect();
        assert_eq!(matching.len(), 1, "{topic:?}");
        assert_eq!(matching[0].qos(), topic.qos(), "{topic:?}");
        for filter in TopicFilter::ALL {
            assert_eq!(
                selects(&filter.render(&fleet), &topic.render(&fleet)),
                filter.matches(&topic),
                "{filter:?} {topic:?}"
            );
        }
    }
}

#[test]
fn names_are_what_they_must_be() {
    assert_eq!(RobotId::new(""), Err(IdError::Empty));
    assert_eq!(RobotId::new(&"a".repeat(33)), Err(IdError::TooLong));
    for byte in 0..=u8::MAX {
        let text = String::from(char::from(byte));
        let id = matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-');
        let source = matches!(byte, 0x20..=0x7e) && !matches!(byte, b'"' | b'\\');
        assert_eq!(RobotId::new(&text).is_ok(), id, "{byte}");
        assert_eq!(Fleet::new(&text).is_ok(), id, "{byte}");
        assert_eq!(Source::new(&text).is_ok(), source, "{byte}");
    }
    assert_eq!(Source::new(&"a".repeat(49)), Err(IdError::TooLong));
}

/// The names of an enum, as serde writes them, are those it says it has, and all different.
fn words<T: serde::Serialize + serde::de::DeserializeOwned + PartialEq + std::fmt::Debug>(
    all: &[T],
    name: impl Fn(&T) -> &'static str,
    expected: &[&str],
) {
    let names: Vec<_> = all.iter().map(&name).collect();
    assert_eq!(names, expected);
    assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len());
    for word in all {
        assert_eq!(serde_json::to_value(word).unwrap(), name(word));
        assert_eq!(
            &serde_json::from_value::<T>(name(word).into()).unwrap(),
            word
        );
    }
}

#[test]
fn words_on_the_wire_are_stable() {
    words(
        &ResponseStatus::ALL,
        |w| w.name(),
        &[
            "accepted",
            "completed",
            "rejected",
            "expired",
            "stale",
            "failed",
        ],
    );
    words(
        &Reason::ALL,
        |w| w.name(),
        &[
            "malformed",
            "too_large",
            "unknown_command",
            "unknown_field",
            "duplicate_field",
            "missing_field",
            "wrong_type",
            "out_of_range",
            "unknown_behaviour",
            "unknown_parameter",
            "read_only",
            "unsupported",
            "no_clock",
            "estopped",
            "busy",
            "no_range",
            "low_battery",
            "blocked",
            "interrupted",
            "link_lost",
            "timeout",
            "storage_failed",
            "fault",
        ],
    );
    words(
        RobotState::ALL,
        |w| w.name(),
        &[
            "INITIALIZING",
            "IDLE",
            "MOVING",
            "SCANNING",
            "CAUTION",
            "AVOIDING",
            "UPDATING",
            "ERROR",
        ],
    );
    words(
        BehaviourName::ALL,
        |w| w.name(),
        &[
            "manual",
            "wander",
            "goto",
            "disperse",
            "gather",
            "flock",
            "formation",
            "policy",
        ],
    );
    words(
        Kind::ALL,
        |w| w.name(),
        &["simulated", "emulated", "physical"],
    );
    words(Capability::ALL, |w| w.name(), &["drive", "range", "camera"]);
    words(
        Direction::ALL,
        |w| w.name(),
        &["forward", "backward", "left", "right"],
    );
    words(
        Level::ALL,
        |w| w.name(),
        &["error", "warn", "info", "debug"],
    );
    words(
        crawler_protocol::CommandName::ALL,
        |w| w.name(),
        &[
            "move", "drive", "stop", "estop", "reset", "scan", "capture", "behave", "goto", "set",
            "identify", "reboot",
        ],
    );
    words(
        BootCause::ALL,
        |w| w.name(),
        &[
            "power-on",
            "software",
            "watchdog",
            "brown-out",
            "panic",
            "external",
        ],
    );
}

/// The finite number with the longest spelling.
const LONG: f32 = -1.175_494_4e-38;

fn widest_robot() -> RobotId {
    RobotId::new(&"a".repeat(32)).unwrap()
}

/// What needs most bytes on the wire for its bytes here.
fn quotes<const N: usize>() -> heapless::String<N> {
    heapless::String::try_from("\"".repeat(N).as_str()).unwrap()
}

fn nulls<const N: usize>() -> heapless::String<N> {
    heapless::String::try_from("\0".repeat(N).as_str()).unwrap()
}

#[test]
fn the_longest_message_of_every_kind_fits() {
    let mut buf = [0; MAX_MESSAGE];
    assert_eq!(serde_json::to_string(&LONG).unwrap().len(), 14);
    let (robot, pose) = (
        widest_robot(),
        Pose {
            x: LONG,
            y: LONG,
            theta: LONG,
            sigma: LONG,
        },
    );

    let telemetry = Telemetry {
        robot: robot.clone(),
        seq: u64::MAX,
        timestamp: u64::MAX,
        state: RobotState::Initializing,
        behaviour: BehaviourName::Formation,
        pose,
        range_mm: Some(u16::MAX),
        temperature_c: Some(LONG),
        wheels: Wheels {
            left: LONG,
            right: LONG,
        },
        battery: Battery {
            mv: u16::MAX,
            percent: 100,
        },
        rssi_dbm: Some(i8::MIN),
    };
    assert!(telemetry.to_json(&mut buf).unwrap() <= 512);

    let status = StatusMessage {
        robot: robot.clone(),
        online: false,
        kind: Kind::Simulated,
        firmware: nulls(),
        board: nulls(),
        capabilities: [Capability::Camera; 8].into_iter().collect(),
        boot: Boot {
            count: u32::MAX,
            cause: BootCause::BrownOut,
        },
        protocol: u8::MAX,
    };
    status.to_json(&mut buf).unwrap();

    let response = Response {
        robot: robot.clone(),
        seq: u64::MAX,
        status: ResponseStatus::Completed,
        reason: Some(Reason::UnknownBehaviour),
        timestamp: u64::MAX,
    };
    response.to_json(&mut buf).unwrap();

    let m = u32::MAX;
    let swarm = SwarmResponse {
        source: Source::new(&"~".repeat(48)).unwrap(),
        seq: u64::MAX,
        command: crawler_protocol::CommandName::Identify,
        robots: m,
        outcomes: Outcomes {
            accepted: m,
            completed: m,
            rejected: m,
            expired: m,
            stale: m,
            failed: m,
            unanswered: m,
        },
        timestamp: u64::MAX,
    };
    swarm.to_json(&mut buf).unwrap();

    let heartbeat = Heartbeat {
        robot: robot.clone(),
        seq: u64::MAX,
        timestamp: u64::MAX,
        uptime_ms: u64::MAX,
        state: RobotState::Initializing,
    };
    heartbeat.to_json(&mut buf).unwrap();

    // A log line has no control characters left, so quotation marks are the worst.
    let log = LogRecord {
        robot: robot.clone(),
        seq: u64::MAX,
        timestamp: u64::MAX,
        level: Level::Error,
        event: quotes(),
        text: quotes(),
    };
    log.to_json(&mut buf).unwrap();
    let controls = LogRecord {
        event: nulls(),
        text: nulls(),
        ..log
    };
    let length = controls.to_json(&mut buf).unwrap();
    let read = LogRecord::from_json(&buf[..length]).unwrap();
    assert_eq!(read.text.as_str(), " ".repeat(160));

    let object = Detection {
        class: quotes(),
        x: LONG,
        y: LONG,
        margin: u8::MAX,
    };
    let detections = Detections {
        robot: robot.clone(),
        seq: u64::MAX,
        timestamp: u64::MAX,
        frame: u32::MAX,
        objects: (0..MAX_DETECTIONS).map(|_| object.clone()).collect(),
    };
    detections.to_json(&mut buf).unwrap();

    PoseFix {
        robot,
        timestamp: u64::MAX,
        pose,
    }
    .to_json(&mut buf)
    .unwrap();
    TimeMessage {
        timestamp: u64::MAX,
    }
    .to_json(&mut buf)
    .unwrap();
}

fn report(at: usize, value: ParameterValue) -> ParameterReport {
    ParameterReport {
        name: format!("{at:a>24}").as_str().try_into().unwrap(),
        default: Some(value.clone()),
        value,
        min: Some(LONG),
        max: Some(LONG),
        unit: Some(quotes()),
    }
}

#[test]
fn parameters_that_do_not_fit_lose_detail_but_no_value() {
    let mut buf = [0; MAX_MESSAGE];
    let mut widest = ParametersMessage {
        robot: widest_robot(),
        values: (1..MAX_PARAMETERS)
            .map(|at| report(at, ParameterValue::Number(LONG)))
            .collect(),
    };
    widest
        .values
        .push(report(0, ParameterValue::Text(quotes())))
        .unwrap();
    let length = widest.to_json(&mut buf).expect("the longest message fits");
    let read = ParametersMessage::from_json(&buf[..length]).unwrap();
    assert_eq!(read.values.len(), MAX_PARAMETERS);
    for (read, told) in read.values.iter().zip(&widest.values) {
        assert_eq!((&read.name, &read.value), (&told.name, &told.value));
    }

    // One less detail after the other goes, and no more than needed.
    let mut last = (4, 4);
    for count in 1..=MAX_PARAMETERS {
        let message = ParametersMessage {
            robot: widest_robot(),
            values: (0..count)
                .map(|at| report(at, ParameterValue::Number(LONG)))
                .collect(),
        };
        let length = message.to_json(&mut buf).unwrap();
        let read = ParametersMessage::from_json(&buf[..length]).unwrap();
        let first = &read.values[0];
        let details = (
            usize::from(first.unit.is_some())
                + usize::from(first.default.is_some())
                + usize::from(first.min.is_some())
                + usize::from(first.max.is_some()),
            usize::from(first.min.is_some()) * 4,
        );
        assert!(details <= last, "{count} parameters");
        if count == 1 {
            assert_eq!(read, message);
        }
        last = details;
    }
    assert_eq!(last.0, 0, "the longest message has values alone");
}

#[test]
fn a_digest_that_is_full_tells_how_many_there_are() {
    let mut buf = [0; MAX_MESSAGE];
    let neighbour = Neighbour {
        id: widest_robot(),
        x: LONG,
        y: LONG,
        theta: LONG,
        v: LONG,
        w: LONG,
    };
    let digest = CellDigest {
        x: i16::MIN,
        y: i16::MIN,
        timestamp: u64::MAX,
        count: 40,
        robots: (0..MAX_NEIGHBOURS).map(|_| neighbour.clone()).collect(),
    };
    let length = digest.to_json(&mut buf).unwrap();
    let read = CellDigest::from_json(&buf[..length]).unwrap();
    assert!(
        (5..MAX_NEIGHBOURS).contains(&read.robots.len()),
        "{}",
        read.robots.len()
    );
    assert_eq!(read.count, 40);
    // What a cell usually holds fits as a whole.
    let usual = Neighbour {
        id: robot(),
        x: -12.345,
        y: 12.345,
        theta: -1.234,
        v: 0.123,
        w: -0.123,
    };
    let digest = CellDigest {
        robots: (0..10).map(|_| usual.clone()).collect(),
        ..digest
    };
    let length = digest.to_json(&mut buf).unwrap();
    assert_eq!(CellDigest::from_json(&buf[..length]), Ok(digest));
}

#[test]
fn a_number_that_is_none_never_leaves() {
    let mut buf = [0; MAX_MESSAGE];
    let whole = Telemetry::from_json(TELEMETRY.as_bytes()).unwrap();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut told = whole.clone();
        told.temperature_c = Some(bad);
        let length = told.to_json(&mut buf).unwrap();
        assert_eq!(
            Telemetry::from_json(&buf[..length]).unwrap().temperature_c,
            None
        );

        let spoil: [fn(&mut Telemetry) -> &mut f32; 6] = [
            |t| &mut t.pose.x,
            |t| &mut t.pose.y,
            |t| &mut t.pose.theta,
            |t| &mut t.pose.sigma,
            |t| &mut t.wheels.left,
            |t| &mut t.wheels.right,
        ];
        for field in spoil {
            let mut told = whole.clone();
            *field(&mut told) = bad;
            assert_eq!(told.to_json(&mut buf), Err(EncodeError::NotFinite));
            assert!(
                serde_json::to_vec(&told).is_err(),
                "nor through another writer"
            );
        }
        let mut fix = PoseFix {
            robot: robot(),
            timestamp: 1,
            pose: Pose::default(),
        };
        fix.pose.y = bad;
        assert_eq!(fix.to_json(&mut buf), Err(EncodeError::NotFinite));
    }
}

#[test]
fn a_buffer_too_small_is_an_error_at_every_size() {
    let telemetry = Telemetry::from_json(TELEMETRY.as_bytes()).unwrap();
    let mut buf = [0; MAX_MESSAGE];
    let length = telemetry.to_json(&mut buf).unwrap();
    for size in 0..length {
        assert_eq!(
            telemetry.to_json(&mut buf[..size]),
            Err(EncodeError::TooLarge),
            "{size}"
        );
    }
    assert_eq!(telemetry.to_json(&mut buf[..length]), Ok(length));
}

#[test]
fn a_message_is_read_strictly() {
    use DecodeError as Error;
    let table = [
        (r#"{"timestamp":1}"#, Ok(TimeMessage { timestamp: 1 })),
        (
            r#" {"\u0074imestamp" : 18446744073709551615 } "#,
            Ok(TimeMessage {
                timestamp: u64::MAX,
            }),
        ),
        (
            r#"{"timestamp":18446744073709551616}"#,
            Err(Error::OutOfRange),
        ),
        (r#"{"timestamp":-1}"#, Err(Error::OutOfRange)),
        (r#"{"timestamp":1.0}"#, Err(Error::WrongType)),
        (r#"{"timestamp":"1"}"#, Err(Error::WrongType)),
        (r#"{"timestamp":null}"#, Err(Error::WrongType)),
        (r#"{"timestamp":[1]}"#, Err(Error::WrongType)),
        (r#"{"timestamp":1,"zone":"UTC"}"#, Err(Error::UnknownField)),
        (
            r#"{"timestamp":1,"timestamp":1}"#,
            Err(Error::DuplicateField),
        ),
        ("{}", Err(Error::MissingField)),
        ("null", Err(Error::WrongType)),
        ("17", Err(Error::WrongType)),
        ("", Err(Error::Malformed)),
        (r#"{"timestamp":1}}"#, Err(Error::Malformed)),
        // Syntax comes before meaning.
        (r#"{"timestamp":"1","zone":tru}"#, Err(Error::Malformed)),
    ];
    for (json, result) in table {
        assert_eq!(TimeMessage::from_json(json.as_bytes()), result, "{json}");
    }
    assert_eq!(
        TimeMessage::from_json(b"{\"timestamp\":1\xff}"),
        Err(Error::Malformed)
    );
    assert_eq!(
        TimeMessage::from_json(&[b' '; MAX_MESSAGE + 1]),
        Err(Error::TooLarge)
    );

    let table = [
        (RESPONSE.replace("completed", "done"), Error::OutOfRange),
        (RESPONSE.replace("\"completed\"", "1"), Error::WrongType),
        (
            RESPONSE.replace("\"completed\"", "{\"completed\":null}"),
            Error::WrongType,
        ),
        (RESPONSE.replace("null", "\"because\""), Error::OutOfRange),
        (RESPONSE.replace("sim-0001", "Sim"), Error::OutOfRange),
        (RESPONSE.replace("sim-0001", "\\u00e4"), Error::OutOfRange),
        (RESPONSE.replace("\"sim-0001\"", "1"), Error::WrongType),
    ];
    for (json, error) in table {
        assert_eq!(Response::from_json(json.as_bytes()), Err(error), "{json}");
    }
    let table = [
        (TELEMETRY.replace("71", "101"), Error::OutOfRange),
        (TELEMETRY.replace("71", "256"), Error::OutOfRange),
        (TELEMETRY.replace("-61", "-129"), Error::OutOfRange),
        (TELEMETRY.replace("812", "65536"), Error::OutOfRange),
        (TELEMETRY.replace("1.204", "1e39"), Error::OutOfRange),
        (TELEMETRY.replace("1.204", "\"1\""), Error::WrongType),
        (TELEMETRY.replace("22.5", "-1e400"), Error::OutOfRange),
        (
            TELEMETRY.replace("\"sigma\"", "\"sigmas\""),
            Error::UnknownField,
        ),
    ];
    for (json, error) in table {
        assert_eq!(Telemetry::from_json(json.as_bytes()), Err(error), "{json}");
    }
    let many = STATUS.replace(
        "[\"drive\"",
        &format!("[{}\"drive\"", "\"range\",".repeat(6)),
    );
    assert_eq!(
        StatusMessage::from_json(many.as_bytes()),
        Err(Error::OutOfRange)
    );
    let long = STATUS.replace("0.3.0", &"9".repeat(33));
    assert_eq!(
        StatusMessage::from_json(long.as_bytes()),
        Err(Error::OutOfRange)
    );
}

#[test]
fn outcomes_count_every_status() {
    let mut outcomes = Outcomes::default();
    for (times, status) in ResponseStatus::ALL.into_iter().enumerate() {
        for _ in 0..=times {
            outcomes.add(status);
        }
    }
    let counts = ResponseStatus::ALL.map(|status| outcomes.get(status));
    assert_eq!(counts, [1, 2, 3, 4, 5, 6]);
    assert_eq!(outcomes.unanswered, 0);
}
