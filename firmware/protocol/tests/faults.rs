//! What a robot on a bench reads of what simulators are told.

use crawler_protocol::{DecodeError, FaultCommand, FaultSpec, MAX_MESSAGE, RobotId};
use proptest::prelude::*;

fn read(text: &str) -> Result<Option<FaultCommand>, DecodeError> {
    FaultCommand::from_json(text.as_bytes())
}

#[test]
fn two_commands_are_read_and_others_are_not_judged() {
    let robot = RobotId::new("rover").expect("a name");
    let injected = FaultCommand::Inject {
        robot: robot.clone(),
        fault: FaultSpec::RangerStuck { mm: 300 },
        lasting_ms: None,
    };
    for (text, expected) in [
        (
            r#"{"command":"inject","robot":"rover","fault":{"fault":"ranger-stuck","mm":300}}"#,
            Some(injected),
        ),
        (
            r#"{"robot":"rover","command":"heal"}"#,
            Some(FaultCommand::Heal { robot }),
        ),
        (r#"{"command":"pause"}"#, None),
        (r#"{"steps":-1,"command":"step","steps":2}"#, None),
        (r#"{"command":"Heal","robot":"rover"}"#, None),
        (r#"{"command":"","robot":"rover"}"#, None),
    ] {
        assert_eq!(read(text), Ok(expected), "{text}");
    }
}

#[test]
fn what_is_wrong_with_the_two_is_named() {
    use DecodeError::{
        DuplicateField, Malformed, MissingField, OutOfRange, TooLarge, UnknownField, WrongType,
    };
    for (text, expected) in [
        ("", Malformed),
        (r#"{"command":"pause""#, Malformed),
        ("[]", WrongType),
        (r#"["heal","rover"]"#, WrongType),
        ("{}", MissingField),
        (r#"{"command":7}"#, WrongType),
        (r#"{"command":"pause","command":"heal"}"#, DuplicateField),
        (r#"{"command":"heal"}"#, MissingField),
        (r#"{"command":"heal","robot":"No"}"#, OutOfRange),
        (r#"{"command":"heal","robot":null}"#, WrongType),
        (
            r#"{"command":"heal","robot":"a","robot":"a"}"#,
            DuplicateField,
        ),
        (r#"{"command":"heal","robot":"a","steps":1}"#, UnknownField),
        (
            r#"{"command":"heal","robot":"a","lasting_ms":1}"#,
            UnknownField,
        ),
        (
            r#"{"command":"heal","robot":"a","fault":{"fault":"brown-out"}}"#,
            UnknownField,
        ),
        (r#"{"command":"inject","robot":"a"}"#, MissingField),
        (
            r#"{"command":"inject","fault":{"fault":"brown-out"}}"#,
            MissingField,
        ),
    ] {
        assert_eq!(read(text), Err(expected), "{text}");
    }
    for (more, expected) in [
        (r#""lasting_ms":0"#, OutOfRange),
        (r#""lasting_ms":86400001"#, OutOfRange),
        (r#""lasting_ms":null"#, WrongType),
        (r#""lasting_ms":"1""#, WrongType),
        (r#""item":1"#, UnknownField),
    ] {
        let text =
            format!(r#"{{"command":"inject","robot":"a","fault":{{"fault":"brown-out"}},{more}}}"#);
        assert_eq!(read(&text), Err(expected), "{text}");
    }
    assert_eq!(read(&" ".repeat(MAX_MESSAGE + 1)), Err(TooLarge));
}

proptest! {
    #[test]
    fn what_is_written_is_read(command in crate::common::fault_command(), seed: u64) {
        let mut buf = [0; MAX_MESSAGE];
        let length = command.to_json(&mut buf).expect("every fault fits");
        let json = &buf[..length];
        prop_assert_eq!(&FaultCommand::from_json(json), &Ok(Some(command.clone())));
        let theirs: FaultCommand = serde_json::from_slice(json).expect("others read ours");
        prop_assert_eq!(&theirs, &command);
        let respelled = crate::common::respell(json, seed);
        if respelled.len() <= MAX_MESSAGE {
            let read = FaultCommand::from_json(respelled.as_bytes());
            prop_assert_eq!(read, Ok(Some(command)));
        }
    }
}
