//! What robots and servers of every version of the protocol have said is read by this build.
//!
//! `hal-sim/tests/golden.rs` writes the file of a version; it never changes from then on.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use crawler_protocol::open::{self, Read, Report};
use crawler_protocol::{
    BehaviourName, CellDigest, Command, CommandName, Detections, Fleet, PROTOCOL_VERSION,
    ParametersMessage, PoseFix, ResponseStatus, RobotState, TelemetryEncoding, TimeMessage, Topic,
};
use serde_json::Value;

/// A message, and what it came on.
struct Golden {
    topic: Topic,
    payload: Vec<u8>,
    content_type: Option<String>,
}

fn golden(version: u8) -> Vec<Golden> {
    let path = format!("golden/protocol-{version}.jsonl");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let lines = text.lines().map(|line| {
        let line: Value = serde_json::from_str(line).expect("a line of JSON");
        let payload = match (line["text"].as_str(), line["hex"].as_str()) {
            (Some(text), None) => text.as_bytes().to_vec(),
            (None, Some(hex)) => hex
                .as_bytes()
                .chunks(2)
                .map(|pair| u8::from_str_radix(core::str::from_utf8(pair).unwrap(), 16).unwrap())
                .collect(),
            _ => panic!("neither text nor bytes: {line}"),
        };
        let topic = line["topic"].as_str().expect("a topic");
        Golden {
            topic: Topic::parse(&Fleet::default(), topic).expect(topic),
            payload,
            content_type: line["content_type"].as_str().map(str::to_owned),
        }
    });
    lines.collect()
}

/// Reads what a robot said; a later build knows everything that an earlier one could say.
fn known<T: Report>(payload: &[u8]) -> T {
    let read: Read<T> = open::read(payload)
        .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(payload)));
    assert!(read.unknown.is_none(), "{:?}", read.unknown);
    read.message
}

#[test]
fn messages_of_every_version_are_read() {
    for version in 1..=PROTOCOL_VERSION {
        let (mut commands, mut answered) = (BTreeSet::new(), BTreeSet::new());
        let (mut states, mut behaviours) = (BTreeSet::new(), BTreeSet::new());
        let (mut encodings, mut kinds) = (BTreeSet::new(), BTreeSet::new());
        let mut given = None;
        for Golden {
            topic,
            payload,
            content_type,
        } in golden(version)
        {
            let kind = match topic {
                Topic::CommandRobot(_) => {
                    let command = Command::parse(&payload);
                    if let Ok(command) = &command {
                        commands.insert(command.action.name());
                    }
                    given = Some(command.map(|command| command.action.name()));
                    "command"
                }
                Topic::Response(_) => {
                    let answer: open::Response = known(&payload);
                    let status = answer.status.known().expect("a status");
                    match given.as_ref().expect("an answer follows a command") {
                        Ok(name) if status != ResponseStatus::Rejected => {
                            answered.insert(*name);
                        }
                        Ok(_) => {}
                        // What a robot of today refuses is refused as it was then.
                        Err(error) => assert_eq!(answer.reason, Some(error.reason.into())),
                    }
                    "response"
                }
                Topic::Status(_) => {
                    let status: open::StatusMessage = known(&payload);
                    assert_eq!(status.protocol, version);
                    "status"
                }
                Topic::Heartbeat(_) => {
                    let _: open::Heartbeat = known(&payload);
                    "heartbeat"
                }
                Topic::Telemetry(_) => {
                    let how = TelemetryEncoding::of(content_type.as_deref()).expect("a type");
                    encodings.insert(how.content_type());
                    for sample in how.open_samples(&payload) {
                        let Read { message, unknown } = sample.expect("a sample");
                        assert!(unknown.is_none());
                        states.insert(message.state.known().expect("a state"));
                        behaviours.insert(message.behaviour.known().expect("a behaviour"));
                    }
                    "telemetry"
                }
                Topic::Vision(_) => {
                    let _: Detections = known(&payload);
                    "vision"
                }
                Topic::Logs(_) => {
                    let _: open::LogRecord = known(&payload);
                    "logs"
                }
                Topic::Parameters(_) => {
                    let message: ParametersMessage = known(&payload);
                    assert!(!message.values.is_empty());
                    "parameters"
                }
                Topic::Time => {
                    TimeMessage::from_json(&payload).expect("the time");
                    "time"
                }
                Topic::Cell { .. } => {
                    CellDigest::from_json(&payload).expect("a digest");
                    "cell"
                }
                Topic::Pose(_) => {
                    PoseFix::from_json(&payload).expect("a fix");
                    "pose"
                }
                other => panic!("{other:?} is not among the golden messages"),
            };
            kinds.insert(kind);
        }
        let expected = [
            "cell",
            "command",
            "heartbeat",
            "logs",
            "parameters",
            "pose",
            "response",
            "status",
            "telemetry",
            "time",
            "vision",
        ];
        assert_eq!(kinds, BTreeSet::from(expected), "version {version}");
        assert_eq!(encodings.len(), TelemetryEncoding::ALL.len());
        if version == 1 {
            let all: BTreeSet<_> = CommandName::ALL.iter().map(|name| name.name()).collect();
            assert_eq!(commands, all);
            assert_eq!(answered, all);
            // Nobody could be updated then.
            assert_eq!(states.len(), RobotState::ALL.len() - 1);
            assert!(behaviours.len() >= 6, "{behaviours:?}");
            assert!(behaviours.contains(&BehaviourName::Wander));
        }
    }
}
