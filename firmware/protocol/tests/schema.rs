//! The schemas that the server serves say what the types do.

use std::collections::BTreeMap;

use crawler_protocol::{Action, Command, MAX_MESSAGE, schemas};
use jsonschema::Validator;
use proptest::prelude::*;
use serde_json::{Value, json};

fn validators() -> BTreeMap<&'static str, Validator> {
    schemas()
        .into_iter()
        .map(|(name, schema)| {
            let schema = Value::from(schema);
            jsonschema::meta::validate(&schema).unwrap_or_else(|error| panic!("{name}: {error}"));
            (name, jsonschema::validator_for(&schema).unwrap())
        })
        .collect()
}

thread_local! {
    // Compiled once: a schema takes longer to compile than a message to check.
    static VALIDATORS: BTreeMap<&'static str, Validator> = validators();
}

fn check(name: &str, json: &[u8]) -> Result<(), String> {
    let value: Value = serde_json::from_slice(json).map_err(|error| error.to_string())?;
    VALIDATORS.with(|all| {
        all[name]
            .validate(&value)
            .map_err(|error| error.to_string())
    })
}

#[test]
fn every_message_has_a_schema_and_its_fields_are_described() {
    let names: Vec<_> = schemas().into_iter().map(|(name, _)| name).collect();
    assert_eq!(
        names,
        [
            "command",
            "command-request",
            "response",
            "swarm-response",
            "status",
            "heartbeat",
            "telemetry",
            "detections",
            "log-record",
            "map-segment",
            "parameters",
            "cell-digest",
            "pose-fix",
            "time",
            "update-command",
            "update-report",
        ]
    );
    for (name, schema) in schemas() {
        let schema = Value::from(schema);
        assert!(schema["description"].is_string(), "{name}");
        if schema.get("oneOf").is_none() {
            assert_eq!(schema["additionalProperties"], false, "{name}");
        }
    }
}

macro_rules! agrees {
    ($($test:ident: $schema:literal;)+) => {
        proptest! {
            #![proptest_config(crawler_properties::cases(64))]
            $(#[test]
            fn $test(message in crate::common::$test()) {
                let mut buf = [0; MAX_MESSAGE];
                if let Ok(length) = message.to_json(&mut buf) {
                    prop_assert_eq!(check($schema, &buf[..length]), Ok(()));
                    // One field more, or one less, is another message.
                    let mut value: Value = serde_json::from_slice(&buf[..length]).unwrap();
                    value["colour"] = json!("red");
                    prop_assert!(check($schema, value.to_string().as_bytes()).is_err());
                }
            })+
        }
    };
}

agrees! {
    command: "command";
    action: "command-request";
    response: "response";
    swarm_response: "swarm-response";
    status: "status";
    heartbeat: "heartbeat";
    telemetry: "telemetry";
    detections: "detections";
    log_record: "log-record";
    map_segment: "map-segment";
    parameters: "parameters";
    cell_digest: "cell-digest";
    pose_fix: "pose-fix";
    time: "time";
    update_command: "update-command";
    update_report: "update-report";
}

/// The command schema and the parser agree on what is a command.
#[test]
fn the_command_schema_is_as_precise_as_the_parser() {
    let parameters = [
        json!(null),
        json!({}),
        json!([]),
        json!({"direction": "forward", "speed": 80, "duration": 2000}),
        json!({"direction": "forward", "speed": 101, "duration": 2000}),
        json!({"direction": "forward", "speed": 80, "duration": 10_001}),
        json!({"direction": "forward", "speed": 80.5, "duration": 1}),
        json!({"direction": "up", "speed": 80, "duration": 1}),
        json!({"direction": "left", "speed": 80}),
        json!({"direction": "left", "speed": "80", "duration": 1}),
        json!({"v": 0.5, "w": -0.5}),
        json!({"v": 0.5, "w": 51}),
        json!({"v": 0.5}),
        json!({"v": 0.5, "w": null}),
        json!({"x": 1, "y": 2}),
        json!({"x": 1, "y": 10_001}),
        json!({"x": 1, "y": 2, "z": 3}),
        json!({"behaviour": "manual"}),
        json!({"behaviour": "manual", "speed": 1}),
        json!({"behaviour": "wander"}),
        json!({"behaviour": "wander", "speed": 100}),
        json!({"behaviour": "wander", "speed": -1}),
        json!({"behaviour": "goto"}),
        json!({"behaviour": "goto", "x": 0, "y": 0}),
        json!({"behaviour": "dance"}),
        json!({"a": 1, "b": true, "c": "text"}),
        json!({"policy": "gather-2"}),
        json!({"policy": "Gather"}),
        json!({"policy": null}),
        json!({"policy": "spread", "speed": 1}),
        json!({"a": [1]}),
        json!({"a": "line\nline"}),
        json!({"A": 1}),
        json!({"a": "x".repeat(65)}),
        json!({"a":1,"b":1,"c":1,"d":1,"e":1,"f":1,"g":1,"h":1,"i":1}),
    ];
    let mut accepted = 0;
    for name in crawler_protocol::CommandName::ALL {
        for parameters in &parameters {
            let request = json!({"command": name.name(), "parameters": parameters});
            let text = request.to_string();
            let parsed = Action::parse(text.as_bytes());
            let valid = check("command-request", text.as_bytes());
            assert_eq!(
                parsed.is_ok(),
                valid.is_ok(),
                "{text}: {parsed:?}, {valid:?}"
            );
            accepted += u32::from(parsed.is_ok());

            let mut command = request;
            command["seq"] = json!(1);
            command["source"] = json!("operator:ada");
            command["timestamp"] = json!(0);
            let text = command.to_string();
            let valid = check("command", text.as_bytes());
            assert_eq!(
                Command::parse(text.as_bytes()).is_ok(),
                valid.is_ok(),
                "{text}"
            );
            for field in ["seq", "source", "timestamp"] {
                let mut less = command.clone();
                less.as_object_mut().unwrap().remove(field);
                assert!(check("command", less.to_string().as_bytes()).is_err());
            }
        }
        let bare = json!({"command": name.name()}).to_string();
        let valid = check("command-request", bare.as_bytes());
        assert_eq!(
            Action::parse(bare.as_bytes()).is_ok(),
            valid.is_ok(),
            "{bare}"
        );
    }
    assert!(accepted > 20, "the table holds commands too");
}

#[test]
fn schemas_refuse_what_the_types_refuse() {
    let good = json!({"robot": "sim-0001", "seq": 1, "status": "completed", "reason": null, "timestamp": 0});
    assert_eq!(check("response", good.to_string().as_bytes()), Ok(()));
    for (field, value) in [
        ("robot", json!("Sim")),
        ("robot", json!("")),
        ("robot", json!("a".repeat(33))),
        ("seq", json!(-1)),
        ("seq", json!(0.5)),
        ("status", json!("done")),
        ("reason", json!("because")),
        ("timestamp", json!(null)),
    ] {
        let mut bad = good.clone();
        bad[field] = value;
        assert!(
            check("response", bad.to_string().as_bytes()).is_err(),
            "{bad}"
        );
    }
}
