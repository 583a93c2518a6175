//! What robots and servers of every version of the protocol have said is read by this build.
//!
//! `hal-sim/tests/golden.rs` writes the file of a version; it never changes from then on. Messages about
//! updates, missions, maps and comparisons of policies, which came later than the rest of version 1, are in files of their own.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use crawler_protocol::open::{self, Read, Report, Update};
use crawler_protocol::{
    Action, BehaviourName, CellDigest, Command, CommandName, Detections, Fleet, MapSegment,
    PROTOCOL_VERSION, ParametersMessage, PoseFix, Reason, ResponseStatus, RobotState, Shadow,
    TelemetryEncoding, TimeMessage, Topic, UpdateCommand, UpdateOutcome, UpdatePart, UpdateStage,
};
use serde_json::Value;

/// A message, and what it came on.
struct Golden {
    topic: Topic,
    payload: Vec<u8>,
    content_type: Option<String>,
}

fn golden(file: &str) -> Vec<Golden> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("golden")
        .join(file);
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
        } in golden(&format!("protocol-{version}.jsonl"))
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
            // Nobody could ask for a map then, nor for a comparison of policies.
            let later = [CommandName::ReportMap, CommandName::Shadow];
            let first = CommandName::ALL.iter();
            let first = first.filter(|name| !later.contains(name));
            let all: BTreeSet<_> = first.map(|name| name.name()).collect();
            assert_eq!(commands, all);
            assert_eq!(answered, all);
            // Nobody could be updated then.
            assert_eq!(states.len(), RobotState::ALL.len() - 1);
            assert!(behaviours.len() >= 6, "{behaviours:?}");
            assert!(behaviours.contains(&BehaviourName::Wander));
        }
    }
}

/// Missions, and what robots say on them, came later than the rest of version 1.
#[test]
fn messages_about_missions_are_read() {
    let (mut told, mut said) = (BTreeSet::new(), BTreeSet::new());
    for Golden {
        topic,
        payload,
        content_type,
    } in golden("missions-1.jsonl")
    {
        match topic {
            Topic::CommandRobot(_) => match Command::parse(&payload).expect("a command").action {
                Action::Behave(spec) => assert!(told.insert(spec.behaviour())),
                other => panic!("{other:?}"),
            },
            Topic::Telemetry(_) => {
                let how = TelemetryEncoding::of(content_type.as_deref()).expect("a type");
                for sample in how.open_samples(&payload) {
                    let Read { message, unknown } = sample.expect("a sample");
                    assert!(unknown.is_none());
                    let says = message.says.expect("says something");
                    let kinds = BehaviourName::ALL.iter();
                    said.extend(kinds.filter(|kind| says.by(**kind).is_some()));
                }
            }
            Topic::Cell { .. } => {
                let digest = CellDigest::from_json(&payload).expect("a digest");
                let says = digest.robots[0].says.expect("says something");
                assert!(says.by(BehaviourName::Allocate).is_some());
            }
            other => panic!("{other:?}"),
        }
    }
    let missions = [
        BehaviourName::Follow,
        BehaviourName::Patrol,
        BehaviourName::Consensus,
        BehaviourName::Allocate,
        BehaviourName::Cover,
        BehaviourName::Formation,
    ];
    assert_eq!(told, BTreeSet::from(missions));
    assert_eq!(said, BTreeSet::from(missions));
}

/// Maps came later than the rest of version 1.
#[test]
fn messages_about_maps_are_read() {
    let (mut asked, mut row, mut ends) = (0, 0, Vec::new());
    for Golden { topic, payload, .. } in golden("map-1.jsonl") {
        match topic {
            Topic::CommandRobot(_) => {
                let command = Command::parse(&payload).expect("a command");
                assert_eq!(command.action, Action::ReportMap);
                asked = command.seq;
            }
            Topic::Map(_) => {
                let segment: MapSegment = known(&payload);
                assert!(segment.is_consistent());
                assert_eq!((segment.seq, usize::from(segment.row)), (asked, row));
                assert_eq!(segment.goal.is_some(), row == 0);
                row += segment.row_count();
                assert_eq!(segment.is_last(), row == 80);
            }
            Topic::Response(_) => {
                let answer: open::Response = known(&payload);
                assert_eq!(answer.seq, asked);
                ends.push((answer.status, answer.reason));
            }
            other => panic!("{other:?}"),
        }
    }
    let none = Some(Reason::NoMap.into());
    let ends_then = [
        (ResponseStatus::Completed.into(), None),
        (ResponseStatus::Failed.into(), none),
    ];
    assert_eq!(ends, ends_then);
}

/// Comparisons of policies came later than the rest of version 1.
#[test]
fn messages_about_comparisons_of_policies_are_read() {
    let (mut asked, mut answers, mut compared) = (None, Vec::new(), Vec::new());
    for Golden { topic, payload, .. } in golden("shadow-1.jsonl") {
        match topic {
            Topic::CommandRobot(_) => {
                let command = Command::parse(&payload).expect("a command");
                let Action::Shadow { policy } = command.action else {
                    panic!("{command:?}");
                };
                asked = Some((command.seq, policy));
            }
            Topic::Response(_) => {
                let answer: open::Response = known(&payload);
                let (seq, policy) = asked.clone().expect("a command before");
                assert_eq!(answer.seq, seq);
                answers.push((policy.is_some(), answer.status, answer.reason));
            }
            Topic::Heartbeat(_) => {
                let beat: open::Heartbeat = known(&payload);
                if let Some(told) = &beat.shadow {
                    let (_, policy) = asked.clone().expect("a command before");
                    assert_eq!(Some(&told.policy), policy.as_ref());
                }
                let counts = |told: Shadow| {
                    [
                        told.decisions,
                        told.agreed,
                        told.vetoes,
                        told.driving_vetoes,
                    ]
                };
                compared.push(beat.shadow.map(counts));
            }
            other => panic!("{other:?}"),
        }
    }
    let completed = |begun| (begun, ResponseStatus::Completed.into(), None);
    let none = Some(Reason::NoPolicy.into());
    let refused = (true, ResponseStatus::Rejected.into(), none);
    assert_eq!(answers, [refused, completed(true), completed(false)]);
    assert_eq!(compared, [Some([0; 4]), Some([412, 391, 12, 9]), None]);
}

/// Messages about updates came later than the rest of version 1. Both sides read each other's.
#[test]
fn messages_about_updates_are_read() {
    let (mut told, mut said) = (BTreeSet::new(), BTreeSet::new());
    for Golden { topic, payload, .. } in golden("updates-1.jsonl") {
        assert!(matches!(topic, Topic::Ota(_)), "{topic:?}");
        let text = String::from_utf8_lossy(&payload);
        match open::update(&payload).unwrap_or_else(|error| panic!("{error}: {text}")) {
            Update::Command => {
                let command = UpdateCommand::from_json(&payload).expect(&text);
                let (kind, delta) = match command.expect(&text) {
                    UpdateCommand::Offer { delta, .. } => ("offer", delta.is_some()),
                    UpdateCommand::Confirm { .. } => ("confirm", false),
                    UpdateCommand::Cancel { .. } => ("cancel", false),
                };
                told.insert((kind, delta));
            }
            Update::Report(Read { message, unknown }) => {
                assert!(unknown.is_none(), "{text}");
                assert_eq!(Some(message.robot()), topic.robot());
                assert_eq!(UpdateCommand::from_json(&payload), Ok(None));
                said.insert(match message {
                    open::UpdateReport::Have { release, .. } => {
                        format!("have {}", release.is_some())
                    }
                    open::UpdateReport::Want { part, .. } => format!("want {part}"),
                    open::UpdateReport::Progress { state, .. } => format!("progress {state}"),
                    open::UpdateReport::Outcome { outcome, .. } => format!("outcome {outcome}"),
                });
            }
            Update::Unknown(word) => panic!("{word:?}: {text}"),
        }
    }
    let kinds = [
        ("offer", false),
        ("offer", true),
        ("confirm", false),
        ("cancel", false),
    ];
    assert_eq!(told, BTreeSet::from(kinds));
    let parts = UpdatePart::ALL.iter().map(|word| format!("want {word}"));
    let stages = UpdateStage::ALL.iter();
    let outcomes = UpdateOutcome::ALL.iter();
    let all = ["have false", "have true"].map(str::to_owned).into_iter();
    let all = all.chain(parts);
    let all = all.chain(stages.map(|word| format!("progress {word}")));
    let all = all.chain(outcomes.map(|word| format!("outcome {word}")));
    assert_eq!(said, all.collect());
}
