//! The contract as users know it: its own examples, its words, and how strictly it is read.

use std::collections::BTreeSet;

use crawler_protocol::{
    Action, Battery, BehaviourName, Boot, BootCause, BuildId, Capability, Command, DecodeError,
    Direction, EncodeError, Kind, Level, MAX_MESSAGE, MAX_PANIC, ModelName, Models, Outcomes,
    PROTOCOL_VERSION, Pose, PoseFix, Reason, Response, ResponseStatus, RobotId, RobotState, Source,
    StatusMessage, Telemetry, TimeMessage, Wheels,
};
use proptest::prelude::*;

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
        source: None,
    };
    assert_eq!(
        Response::from_json(RESPONSE.as_bytes()),
        Ok(response.clone())
    );
    let length = response.to_json(&mut buf).unwrap();
    same(&buf[..length], RESPONSE);
    let mut newer = response;
    newer.source = Some(Source::new("operator:ada").unwrap());
    let length = newer.to_json(&mut buf).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&buf[..length]).unwrap();
    assert_eq!(json["source"], "operator:ada");
    assert_eq!(Response::from_json(&buf[..length]), Ok(newer));

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
        says: None,
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
        capabilities: [Capability::Drive, Capability::Range, Capability::Camera]
            .into_iter()
            .collect(),
        boot: Boot {
            count: 3,
            cause: BootCause::PowerOn,
            panic: None,
        },
        protocol: PROTOCOL_VERSION,
        build: None,
        models: Models::new(),
    };
    assert_eq!(
        StatusMessage::from_json(STATUS.as_bytes()),
        Ok(status.clone())
    );
    let length = status.to_json(&mut buf).unwrap();
    same(&buf[..length], STATUS);

    // What robots have told since there are updates.
    let mut newer = status.clone();
    newer.build = Some(BuildId::new("9f2c1ab034d5e6f7").unwrap());
    let detector = ModelName::new("detector").unwrap();
    let model = BuildId::new("00112233445566778899aabbccddeeff").unwrap();
    newer.models.insert(detector, model).unwrap();
    let length = newer.to_json(&mut buf).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&buf[..length]).unwrap();
    assert_eq!(json["build"], "9f2c1ab034d5e6f7");
    assert_eq!(
        json["models"],
        serde_json::json!({ "detector": "00112233445566778899aabbccddeeff" })
    );
    assert_eq!(StatusMessage::from_json(&buf[..length]), Ok(newer));

    let mut panicked = status;
    panicked.boot.cause = BootCause::Panic;
    panicked.boot.panic = Some("src/wheel.rs:12: a \"wheel\"\nfell off".try_into().unwrap());
    let length = panicked.to_json(&mut buf).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&buf[..length]).unwrap();
    assert_eq!(
        json["boot"],
        serde_json::json!({
            "count": 3, "cause": "panic", "panic": "src/wheel.rs:12: a \"wheel\" fell off"
        })
    );
    let read = StatusMessage::from_json(&buf[..length]).unwrap();
    assert_eq!(read.boot.panic.as_deref(), json["boot"]["panic"].as_str());
}

/// A status whose `boot` has this `panic`.
fn status_with(panic: &str) -> Vec<u8> {
    let mut json: serde_json::Value = serde_json::from_str(STATUS).unwrap();
    json["boot"]["panic"] = panic.into();
    json.to_string().into_bytes()
}

proptest! {
    #[test]
    fn any_text_of_a_panic_survives_and_a_longer_one_is_refused(
        text in prop_oneof![r"\PC{0,48}", ".{0,96}", "[\"\\\\\u{1}é]{0,96}"],
    ) {
        let read = StatusMessage::from_json(&status_with(&text));
        if text.len() > MAX_PANIC {
            prop_assert!(read.is_err());
        } else {
            let read = read.unwrap();
            prop_assert_eq!(read.boot.panic.as_deref(), Some(text.as_str()));
            let mut buf = [0; MAX_MESSAGE];
            let length = read.to_json(&mut buf).unwrap();
            let again = StatusMessage::from_json(&buf[..length]).unwrap();
            let one_line: String = text
                .chars()
                .map(|c| if c.is_control() { ' ' } else { c })
                .collect();
            prop_assert_eq!(again.boot.panic.as_deref(), Some(one_line.as_str()));
        }
    }
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
            "unreachable",
            "interrupted",
            "link_lost",
            "timeout",
            "storage_failed",
            "fault",
            "no_policy",
            "bad_policy",
            "other_observation",
            "no_map",
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
            "follow",
            "patrol",
            "consensus",
            "allocate",
            "cover",
        ],
    );
    words(
        Kind::ALL,
        |w| w.name(),
        &["simulated", "emulated", "physical"],
    );
    words(
        Capability::ALL,
        |w| w.name(),
        &[
            "drive", "range", "camera", "vision", "faults", "missions", "map", "policies",
        ],
    );
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
            "move",
            "drive",
            "stop",
            "estop",
            "reset",
            "scan",
            "capture",
            "report_map",
            "behave",
            "goto",
            "set",
            "identify",
            "reboot",
            "shadow",
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
