//! What servers and robots say to each other about updates.

use crawler_protocol::open::{self, Open, Read, Unknown, Update};
use crawler_protocol::{
    BuildId, DecodeError, IdError, MAX_BUILD, MAX_MESSAGE, MAX_REASON_CODE, ReasonCode, ReleaseId,
    ReleaseIdError, RobotId, UpdateCommand, UpdateDelta, UpdateName, UpdateOutcome, UpdatePart,
    UpdateReport, UpdateStage,
};
use proptest::prelude::*;
use serde_json::{Value, json};

const RELEASE: ReleaseId = ReleaseId::new([0x9f, 0x2c, 0x1a, 0xb0, 0x34, 0xd5, 0xe6, 0xf7]);

fn robot() -> RobotId {
    RobotId::new("sim-0001").unwrap()
}

fn build(text: &str) -> BuildId {
    BuildId::new(text).unwrap()
}

fn command(text: &str) -> Result<Option<UpdateCommand>, DecodeError> {
    UpdateCommand::from_json(text.as_bytes())
}

fn report(text: &str) -> Result<Update, DecodeError> {
    open::update(text.as_bytes())
}

fn text(message: &UpdateReport) -> String {
    let mut buf = [0; MAX_MESSAGE];
    let length = message.to_json(&mut buf).expect("every one fits");
    String::from_utf8(buf[..length].to_vec()).expect("JSON")
}

#[test]
fn a_release_has_one_spelling_and_a_tag() {
    assert_eq!(RELEASE.to_string(), "9f2c1ab034d5e6f7");
    assert_eq!(RELEASE.tag(), 0xb01a_2c9f);
    assert_eq!("9f2c1ab034d5e6f7".parse(), Ok(RELEASE));
    for wrong in [
        "",
        "9f2c1ab034d5e6f",
        "9f2c1ab034d5e6f70",
        "9F2C1AB034D5E6F7",
        "9f2c1ab034d5e6g7",
        "+f2c1ab034d5e6f7",
        " 9f2c1ab034d5e6f",
        "9f2c1ab034d5e6é",
    ] {
        assert_eq!(wrong.parse::<ReleaseId>(), Err(ReleaseIdError), "{wrong:?}");
    }
}

#[test]
fn builds_and_reasons_are_bounded() {
    for (text, expected) in [
        ("", Err(IdError::Empty)),
        ("0.4.0+a_B-9", Ok(())),
        ("a b", Err(IdError::Alphabet)),
        ("a\"", Err(IdError::Alphabet)),
        ("ä", Err(IdError::Alphabet)),
        (&"a".repeat(MAX_BUILD), Ok(())),
        (&"a".repeat(MAX_BUILD + 1), Err(IdError::TooLong)),
    ] {
        assert_eq!(BuildId::new(text).map(drop), expected, "{text}");
    }
    assert!(ReasonCode::new(&"a".repeat(MAX_REASON_CODE)).is_ok());
    let long = ReasonCode::new(&"a".repeat(MAX_REASON_CODE + 1));
    assert_eq!(long, Err(IdError::TooLong));
}

#[test]
fn a_program_that_is_no_image_goes_by_its_version() {
    let build = |version| BuildId::development(version).as_str().to_owned();
    assert_eq!(build("0.3.0"), "0.3.0+dev");
    assert_eq!(build("0.3.0 (ä)\n"), "0.3.0+dev");
    assert_eq!(build(""), "+dev");
    let long = build(&"9".repeat(MAX_BUILD));
    assert!(long.len() == MAX_BUILD && long.ends_with("9+dev"), "{long}");
    assert_eq!(BuildId::new(&long).map(|name| name.to_string()), Ok(long));
}

#[test]
fn commands_are_what_the_contract_says() {
    let delta = UpdateDelta {
        base: build("0.3.0+1f"),
        bytes: 41_984,
    };
    let release = RELEASE;
    for (json, message) in [
        (
            r#"{"update":"offer","release":"9f2c1ab034d5e6f7"}"#,
            UpdateCommand::Offer {
                release,
                delta: None,
            },
        ),
        (
            r#"{"update":"offer","release":"9f2c1ab034d5e6f7","delta":{"base":"0.3.0+1f","bytes":41984}}"#,
            UpdateCommand::Offer {
                release,
                delta: Some(delta),
            },
        ),
        (
            r#"{"update":"confirm","release":"9f2c1ab034d5e6f7"}"#,
            UpdateCommand::Confirm { release },
        ),
        (
            r#"{"update":"cancel","release":"9f2c1ab034d5e6f7"}"#,
            UpdateCommand::Cancel { release },
        ),
    ] {
        let mut buf = [0; MAX_MESSAGE];
        let length = message.to_json(&mut buf).expect("it fits");
        assert_eq!(core::str::from_utf8(&buf[..length]), Ok(json));
        assert_eq!(message.release(), RELEASE);
        assert_eq!(command(json), Ok(Some(message)), "{json}");
        // To a server it is one of its own.
        assert_eq!(report(json), Ok(Update::Command), "{json}");
    }
}

#[test]
fn a_robot_is_strict_about_commands_and_passes_over_its_own() {
    use DecodeError::{
        DuplicateField, Malformed, MissingField, OutOfRange, TooLarge, UnknownField, WrongType,
    };
    for (text, expected) in [
        ("", Malformed),
        ("[]", WrongType),
        ("{}", MissingField),
        (r#"{"update":7}"#, WrongType),
        (r#"{"update":"erase"}"#, OutOfRange),
        (r#"{"update":"Offer"}"#, OutOfRange),
        (r#"{"update":"offer","update":"cancel"}"#, DuplicateField),
        (r#"{"update":"offer"}"#, MissingField),
        (r#"{"release":"9f2c1ab034d5e6f7"}"#, MissingField),
        (
            r#"{"update":"offer","release":"9f2c1ab034d5e6f"}"#,
            OutOfRange,
        ),
        (r#"{"update":"offer","release":7}"#, WrongType),
        (
            r#"{"update":"cancel","release":"9f2c1ab034d5e6f7","delta":{"base":"a","bytes":1}}"#,
            UnknownField,
        ),
        (
            r#"{"update":"offer","release":"9f2c1ab034d5e6f7","delta":{"base":"a"}}"#,
            MissingField,
        ),
        (
            r#"{"update":"offer","release":"9f2c1ab034d5e6f7","delta":{"base":"a","bytes":-1}}"#,
            OutOfRange,
        ),
        (
            r#"{"update":"offer","release":"9f2c1ab034d5e6f7","force":true}"#,
            UnknownField,
        ),
    ] {
        assert_eq!(command(text), Err(expected), "{text}");
    }
    assert_eq!(command(&" ".repeat(MAX_MESSAGE + 1)), Err(TooLarge));
    // A chunk is no JSON.
    assert_eq!(command("\u{1}\u{0}{}"), Err(Malformed));
    // Whatever stands beside them.
    for own in ["have", "want", "progress", "outcome"] {
        let text = format!(r#"{{"robot":[7],"update":"{own}"}}"#);
        assert_eq!(command(&text), Ok(None), "{text}");
    }
}

#[test]
fn reports_are_what_the_contract_says() {
    let (robot, release) = (robot(), RELEASE);
    let reason = |text: &str| Some(ReasonCode::new(text).unwrap());
    for (json, message) in [
        (
            r#"{"update":"have","robot":"sim-0001","build":"b","sequence":7,"floor":5}"#,
            UpdateReport::Have {
                robot: robot.clone(),
                build: build("b"),
                sequence: 7,
                floor: 5,
                release: None,
                bytes: None,
            },
        ),
        (
            r#"{"update":"have","robot":"sim-0001","build":"b","sequence":7,"floor":5,"release":"9f2c1ab034d5e6f7","bytes":65536}"#,
            UpdateReport::Have {
                robot: robot.clone(),
                build: build("b"),
                sequence: 7,
                floor: 5,
                release: Some(release),
                bytes: Some(65_536),
            },
        ),
        (
            r#"{"update":"want","robot":"sim-0001","tag":2954505375,"part":"image","first":16,"missing":65535}"#,
            UpdateReport::Want {
                robot: robot.clone(),
                tag: release.tag(),
                part: UpdatePart::Image,
                first: 16,
                missing: u16::MAX,
            },
        ),
        (
            r#"{"update":"progress","robot":"sim-0001","release":"9f2c1ab034d5e6f7","state":"deferred","reason":"low_battery","bytes":0}"#,
            UpdateReport::Progress {
                robot: robot.clone(),
                release,
                state: UpdateStage::Deferred,
                reason: reason("low_battery"),
                bytes: 0,
                build: None,
            },
        ),
        (
            r#"{"update":"outcome","robot":"sim-0001","release":"9f2c1ab034d5e6f7","outcome":"rolled_back","reason":null,"build":"b","lasting":false}"#,
            UpdateReport::Outcome {
                robot,
                release,
                outcome: UpdateOutcome::RolledBack,
                reason: None,
                build: Some(build("b")),
                lasting: Some(false),
            },
        ),
    ] {
        assert_eq!(text(&message), json);
        assert_eq!(message.robot().as_str(), "sim-0001");
        let Ok(Update::Report(Read {
            message: read,
            unknown,
        })) = report(json)
        else {
            panic!("{json}: {:?}", report(json));
        };
        assert!(unknown.is_none());
        assert_eq!(text(&strict(&read)), json);
    }
}

/// The same with words that are known.
fn strict(read: &open::UpdateReport) -> UpdateReport {
    match read.clone() {
        open::UpdateReport::Have {
            robot,
            build,
            sequence,
            floor,
            release,
            bytes,
        } => UpdateReport::Have {
            robot,
            build,
            sequence,
            floor,
            release,
            bytes,
        },
        open::UpdateReport::Want {
            robot,
            tag,
            part,
            first,
            missing,
        } => UpdateReport::Want {
            robot,
            tag,
            part: part.known().expect("a part"),
            first,
            missing,
        },
        open::UpdateReport::Progress {
            robot,
            release,
            state,
            reason,
            bytes,
            build,
        } => UpdateReport::Progress {
            robot,
            release,
            state: state.known().expect("a state"),
            reason,
            bytes,
            build,
        },
        open::UpdateReport::Outcome {
            robot,
            release,
            outcome,
            reason,
            build,
            lasting,
        } => UpdateReport::Outcome {
            robot,
            release,
            outcome: outcome.known().expect("an outcome"),
            reason,
            build,
            lasting,
        },
    }
}

#[test]
fn the_longest_of_each_fits() {
    let robot = RobotId::new(&"a".repeat(32)).unwrap();
    let build = build(&"a".repeat(MAX_BUILD));
    let reason = Some(ReasonCode::new(&"a".repeat(MAX_REASON_CODE)).unwrap());
    let most = u32::MAX;
    for report in [
        UpdateReport::Have {
            robot: robot.clone(),
            build: build.clone(),
            sequence: most,
            floor: most,
            release: Some(RELEASE),
            bytes: Some(most),
        },
        UpdateReport::Want {
            robot: robot.clone(),
            tag: most,
            part: UpdatePart::Manifest,
            first: most,
            missing: u16::MAX,
        },
        UpdateReport::Progress {
            robot: robot.clone(),
            release: RELEASE,
            state: UpdateStage::Preparing,
            reason: reason.clone(),
            bytes: most,
            build: Some(build.clone()),
        },
        UpdateReport::Outcome {
            robot,
            release: RELEASE,
            outcome: UpdateOutcome::RolledBack,
            reason,
            build: Some(build.clone()),
            lasting: Some(false),
        },
    ] {
        // The names have no character that needs an escape, so a robot has room enough with a quarter.
        let length = text(&report).len();
        assert!(length <= 320, "{length}");
    }
    let offer = UpdateCommand::Offer {
        release: RELEASE,
        delta: Some(UpdateDelta {
            base: build,
            bytes: most,
        }),
    };
    assert!(offer.to_json(&mut [0; 192]).is_ok());
}

#[test]
fn a_server_understands_robots_that_are_newer() {
    let wish = report(r#"{"update":"wish","robot":"a","for":["rain"]}"#);
    let Ok(Update::Unknown(word)) = wish else {
        panic!("{wish:?}");
    };
    assert_eq!(word.as_str(), "wish");

    let later = r#"{"heat":{"c":900},"update":"outcome","robot":"a","release":"9f2c1ab034d5e6f7","outcome":"melted","reason":null,"tag":7}"#;
    let Ok(Update::Report(Read { message, unknown })) = report(later) else {
        panic!("{:?}", report(later));
    };
    // `tag` is a field of another kind of message.
    assert_eq!(
        unknown,
        Unknown {
            fields: 2,
            words: 1
        }
    );
    let open::UpdateReport::Outcome { outcome, .. } = message else {
        panic!("{message:?}");
    };
    assert_eq!(outcome.name(), "melted");

    for (text, expected) in [
        (
            r#"{"update":"have","robot":"a"}"#,
            DecodeError::MissingField,
        ),
        (r#"{"update":7}"#, DecodeError::WrongType),
        (r#"{"robot":"a"}"#, DecodeError::MissingField),
        (
            r#"{"update":"want","robot":"a","tag":1,"part":"image","first":0,"missing":65536}"#,
            DecodeError::OutOfRange,
        ),
        (
            r#"{"update":"want","robot":"a","tag":1,"part":"image","first":0,"missing":1,"tag":1}"#,
            DecodeError::DuplicateField,
        ),
        (
            r#"{"update":"want","robot":"A","tag":1,"part":"image","first":0,"missing":1}"#,
            DecodeError::OutOfRange,
        ),
    ] {
        assert_eq!(report(text), Err(expected), "{text}");
    }
}

#[test]
fn every_kind_has_one_direction() {
    for name in UpdateName::ALL {
        let text = format!(r#"{{"update":"{name}","release":"9f2c1ab034d5e6f7"}}"#);
        let of_server = matches!(command(&text), Ok(Some(_)));
        assert_eq!(of_server, report(&text) == Ok(Update::Command), "{text}");
        assert_eq!(of_server, !matches!(command(&text), Ok(None)), "{text}");
    }
}

proptest! {
    #[test]
    fn any_command_is_read_as_it_was_written(message in crate::common::update_command(), seed: u64) {
        let mut buf = [0; MAX_MESSAGE];
        let length = message.to_json(&mut buf).expect("every one fits");
        let json = &buf[..length];
        prop_assert_eq!(&UpdateCommand::from_json(json), &Ok(Some(message.clone())));
        let theirs: Value = serde_json::from_slice(json).expect("others read ours");
        let theirs = theirs.to_string();
        prop_assert_eq!(&UpdateCommand::from_json(theirs.as_bytes()), &Ok(Some(message.clone())));
        let respelled = crate::common::respell(json, seed);
        prop_assert_eq!(UpdateCommand::from_json(respelled.as_bytes()), Ok(Some(message)));
    }

    #[test]
    fn any_report_is_read_as_it_was_written(message in crate::common::update_report(), seed: u64) {
        let json = text(&message);
        prop_assert_eq!(command(&json), Ok(None));
        for json in [json.clone(), crate::common::respell(json.as_bytes(), seed)] {
            let Ok(Update::Report(Read { message: read, unknown })) = report(&json) else {
                panic!("{json}: {:?}", report(&json));
            };
            prop_assert!(unknown.is_none());
            prop_assert_eq!(&strict(&read), &message);
        }
        // Fields and words of a later version cost nothing of what is known.
        let mut value: Value = serde_json::from_str(&json).expect("JSON");
        value["aa"] = json!({ "x": [1, { "y": null }] });
        value["zz"] = json!("new");
        let word = ["part", "state", "outcome"].into_iter().find(|word| value.get(word).is_some());
        if let Some(word) = word {
            value[word] = json!("later");
        }
        let Ok(Update::Report(Read { message: read, unknown })) = report(&value.to_string()) else {
            panic!("{value}");
        };
        prop_assert_eq!(unknown, Unknown { fields: 2, words: u32::from(word.is_some()) });
        prop_assert_eq!(read.robot(), message.robot());
        if let open::UpdateReport::Progress { state, bytes, .. } = read {
            prop_assert!(matches!(state, Open::Unknown(_)));
            prop_assert_eq!(Some(u64::from(bytes)), value["bytes"].as_u64());
        }
    }

    #[test]
    fn any_release_is_spelled_and_read(bytes: [u8; 8]) {
        let release = ReleaseId::new(bytes);
        let text = release.to_string();
        prop_assert_eq!(text.parse(), Ok(release));
        prop_assert_eq!(text, format!("{:016x}", u64::from_be_bytes(bytes)));
        prop_assert_eq!(release.bytes(), bytes);
    }
}
