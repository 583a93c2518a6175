//! Commands to a simulated world: what is one, and what is refused and why.

use crawler_protocol::{DecodeError, FaultCommand, FaultName, FaultSpec, LinkCut, MAX_MESSAGE};
use crawler_sim_protocol::{Dropped, Obstacle, SimulatorCommand, SimulatorCommandName};

fn read(text: &str) -> Result<SimulatorCommand, DecodeError> {
    SimulatorCommand::from_json(text.as_bytes())
}

/// One command of every name, as short as it can be.
const SHORTEST: [&str; 15] = [
    r#"{"command":"pause"}"#,
    r#"{"command":"resume"}"#,
    r#"{"command":"step","steps":1}"#,
    r#"{"command":"speed","factor":2}"#,
    r#"{"command":"reset"}"#,
    r#"{"command":"add"}"#,
    r#"{"command":"remove","robot":"sim-0001"}"#,
    r#"{"command":"snapshot","name":"before"}"#,
    r#"{"command":"restore","name":"before"}"#,
    r#"{"command":"inject","robot":"sim-0001","fault":{"fault":"ranger-dead"}}"#,
    r#"{"command":"heal","robot":"sim-0001"}"#,
    r#"{"command":"load","scenario":"empty"}"#,
    r#"{"command":"drop","obstacle":{"shape":"circle","x":1,"y":2,"r":0.5}}"#,
    r#"{"command":"take","item":3}"#,
    r#"{"command":"forget","name":"before"}"#,
];

#[test]
fn every_name_is_a_command() {
    for (text, name) in SHORTEST.iter().zip(SimulatorCommandName::ALL) {
        assert_eq!(
            read(text).map(|command| command.name()),
            Ok(*name),
            "{text}"
        );
    }
    assert_eq!(SHORTEST.len(), SimulatorCommandName::ALL.len());
}

#[test]
fn no_field_may_be_missing_null_or_of_another_command() {
    for text in SHORTEST {
        let end = text.len() - 1;
        for field in [
            r#""steps":1"#,
            r#""factor":2"#,
            r#""seed":7"#,
            r#""pose":{"x":0,"y":0,"theta":0}"#,
            r#""robot":"sim-0001""#,
            r#""name":"before""#,
            r#""fault":{"fault":"ranger-dead"}"#,
            r#""lasting_ms":1"#,
            r#""scenario":"empty""#,
            r#""robots":2"#,
            r#""obstacle":{"shape":"circle","x":1,"y":2,"r":0.5}"#,
            r#""object":{"shape":"ball","x":1,"y":2,"size":0.5,"colour":"red"}"#,
            r#""item":3"#,
        ] {
            let name = &field[..field.find(':').unwrap()];
            let more = format!("{},{field}}}", &text[..end]);
            let optional = matches!(
                (read(text).unwrap().name(), name),
                (
                    SimulatorCommandName::Reset | SimulatorCommandName::Load,
                    r#""seed""#
                ) | (SimulatorCommandName::Load, r#""robots""#)
                    | (SimulatorCommandName::Add, r#""pose""#)
                    | (SimulatorCommandName::Inject, r#""lasting_ms""#)
            );
            let expected = if text.contains(field) {
                Some(DecodeError::DuplicateField)
            } else if optional {
                None
            } else {
                let twice = text.matches(&format!("{name}:")).count() > 0;
                Some(if twice {
                    DecodeError::DuplicateField
                } else {
                    DecodeError::UnknownField
                })
            };
            assert_eq!(read(&more).err(), expected, "{more}");
            let null = format!("{},{name}:null}}", &text[..end]);
            assert!(read(&null).is_err(), "{null}");
        }
        // Nothing can be left out.
        if let Some(comma) = text.find(',') {
            let less = format!("{}}}", &text[..comma]);
            assert_eq!(read(&less), Err(DecodeError::MissingField), "{less}");
        }
    }
}

#[test]
fn numbers_out_of_range_and_other_types_are_refused() {
    use DecodeError::{Malformed, MissingField, OutOfRange, TooLarge, UnknownField, WrongType};
    for (text, expected) in [
        ("", Malformed),
        ("[]", WrongType),
        (r#"["pause"]"#, WrongType),
        ("{}", MissingField),
        (r#"{"command":"dance"}"#, OutOfRange),
        (r#"{"command":1}"#, WrongType),
        (r#"{"command":"pause","colour":1}"#, UnknownField),
        (r#"{"command":"step","steps":0}"#, OutOfRange),
        (r#"{"command":"step","steps":1000001}"#, OutOfRange),
        (r#"{"command":"step","steps":1.5}"#, WrongType),
        (r#"{"command":"speed","factor":0}"#, OutOfRange),
        (r#"{"command":"speed","factor":-1}"#, OutOfRange),
        (r#"{"command":"speed","factor":1e9}"#, OutOfRange),
        (r#"{"command":"speed","factor":1e99}"#, OutOfRange),
        (r#"{"command":"speed","factor":"2"}"#, WrongType),
        (r#"{"command":"reset","seed":-1}"#, OutOfRange),
        (r#"{"command":"add","pose":{"x":1,"y":2}}"#, MissingField),
        (
            r#"{"command":"add","pose":{"x":10001,"y":2,"theta":0}}"#,
            OutOfRange,
        ),
        (
            r#"{"command":"add","pose":{"x":1,"y":2,"theta":8}}"#,
            OutOfRange,
        ),
        (r#"{"command":"remove","robot":"No"}"#, OutOfRange),
        (r#"{"command":"snapshot","name":"../up"}"#, OutOfRange),
        (r#"{"command":"snapshot","name":""}"#, OutOfRange),
        (r#"{"command":"load","scenario":"../../etc"}"#, OutOfRange),
        (
            r#"{"command":"load","scenario":"empty","robots":0}"#,
            OutOfRange,
        ),
        (
            r#"{"command":"load","scenario":"empty","robots":65536}"#,
            OutOfRange,
        ),
        (r#"{"command":"take","item":-1}"#, OutOfRange),
        (r#"{"command":"take","item":4294967296}"#, OutOfRange),
        (r#"{"command":"drop"}"#, MissingField),
        (r#"{"command":"drop","obstacle":"box"}"#, WrongType),
    ] {
        assert_eq!(read(text), Err(expected), "{text}");
    }
    let long = " ".repeat(MAX_MESSAGE + 1);
    assert_eq!(read(&long), Err(TooLarge));
    for (fault, expected) in [
        (r#""ranger-dead""#, WrongType),
        ("{}", MissingField),
        (r#"{"fault":"rust"}"#, OutOfRange),
        (r#"{"fault":"ranger-dead","mm":1}"#, UnknownField),
        (r#"{"fault":"ranger-stuck"}"#, MissingField),
        (r#"{"fault":"ranger-stuck","mm":65536}"#, OutOfRange),
        (r#"{"fault":"ranger-stuck","mm":-1}"#, OutOfRange),
        (r#"{"fault":"ranger-noisy","mm":1001}"#, OutOfRange),
        (r#"{"fault":"line-noise","flips":1.1}"#, OutOfRange),
        (r#"{"fault":"line-noise","flips":null}"#, WrongType),
        (r#"{"fault":"motor-weak","wheel":"left"}"#, MissingField),
        (
            r#"{"fault":"motor-weak","wheel":"middle","strength":0.5}"#,
            OutOfRange,
        ),
        (
            r#"{"fault":"motor-weak","wheel":"left","strength":-0.5}"#,
            OutOfRange,
        ),
        (r#"{"fault":"link-loss","how":"scissors"}"#, OutOfRange),
        (r#"{"fault":"hostile-packets","per_s":0}"#, OutOfRange),
        (r#"{"fault":"hostile-packets","per_s":201}"#, OutOfRange),
        (r#"{"fault":"clock-step","ms":315360000001}"#, OutOfRange),
        (r#"{"fault":"battery-sag","ohm":1000.5}"#, OutOfRange),
        (r#"{"fault":"battery-at","charge":2}"#, OutOfRange),
        (
            r#"{"fault":"flash-power-cut","after_bytes":4294967296}"#,
            OutOfRange,
        ),
    ] {
        let text = format!(r#"{{"command":"inject","robot":"sim-0001","fault":{fault}}}"#);
        assert_eq!(read(&text), Err(expected), "{text}");
    }
    for ms in ["0", "86400001"] {
        let text = format!(
            r#"{{"command":"inject","robot":"sim-0001","fault":{{"fault":"brown-out"}},"lasting_ms":{ms}}}"#
        );
        assert_eq!(read(&text), Err(OutOfRange), "{text}");
    }
}

#[test]
fn a_link_is_lost_by_its_radio_unless_told_otherwise() {
    for (fault, how) in [
        (r#"{"fault":"link-loss"}"#, LinkCut::Radio),
        (
            r#"{"fault":"link-loss","how":"password"}"#,
            LinkCut::Password,
        ),
    ] {
        let text = format!(r#"{{"command":"inject","robot":"rover","fault":{fault}}}"#);
        let Ok(SimulatorCommand::Fault(FaultCommand::Inject {
            fault,
            lasting_ms: None,
            ..
        })) = read(&text)
        else {
            panic!("{text}");
        };
        assert_eq!(fault, FaultSpec::LinkLoss { how });
        assert_eq!(fault.name(), FaultName::LinkLoss);
    }
}

#[test]
fn what_is_dropped_is_whole_and_of_its_kind() {
    use DecodeError::{DuplicateField, MissingField, OutOfRange, UnknownField, WrongType};
    let drop = |kind: &str, fields: &str| {
        let at = r#""x":1,"y":-2"#;
        read(&format!(
            r#"{{"command":"drop","{kind}":{{{at},{fields}}}}}"#
        ))
    };
    for (kind, fields) in [
        ("obstacle", r#""shape":"circle","r":0.01"#),
        ("obstacle", r#""shape":"box","w":1,"h":500,"theta":7"#),
        ("object", r#""shape":"cone","size":0.3,"colour":"purple""#),
        ("object", r#""shape":"box","size":0.3,"colour":"black""#),
    ] {
        assert!(drop(kind, fields).is_ok(), "{kind} {fields}");
    }
    // A turn that is not told is none.
    assert_eq!(
        drop("obstacle", r#""shape":"box","w":1,"h":2"#),
        Ok(SimulatorCommand::Drop {
            what: Dropped::Obstacle(Obstacle::Box {
                x: 1.0,
                y: -2.0,
                w: 1.0,
                h: 2.0,
                theta: 0.0
            })
        })
    );
    for (kind, fields, expected) in [
        ("obstacle", r#""shape":"circle""#, MissingField),
        ("obstacle", r#""shape":"box","w":1"#, MissingField),
        ("obstacle", r#""r":1"#, MissingField),
        ("obstacle", r#""shape":"pyramid","r":1"#, OutOfRange),
        ("obstacle", r#""shape":"ball","r":1"#, OutOfRange),
        ("obstacle", r#""shape":"circle","r":0"#, OutOfRange),
        ("obstacle", r#""shape":"circle","r":-1"#, OutOfRange),
        ("obstacle", r#""shape":"circle","r":501"#, OutOfRange),
        ("obstacle", r#""shape":"circle","r":1e99"#, OutOfRange),
        ("obstacle", r#""shape":"circle","r":"1""#, WrongType),
        ("obstacle", r#""shape":"circle","r":null"#, WrongType),
        (
            "obstacle",
            r#""shape":"circle","r":1,"r":1"#,
            DuplicateField,
        ),
        (
            "obstacle",
            r#""shape":"circle","r":1,"x":1"#,
            DuplicateField,
        ),
        ("obstacle", r#""shape":"circle","r":1,"w":1"#, UnknownField),
        (
            "obstacle",
            r#""shape":"circle","r":1,"colour":"red""#,
            UnknownField,
        ),
        (
            "obstacle",
            r#""shape":"box","w":1,"h":1,"theta":8"#,
            OutOfRange,
        ),
        ("object", r#""shape":"ball","size":1"#, MissingField),
        (
            "object",
            r#""shape":"circle","size":1,"colour":"red""#,
            OutOfRange,
        ),
        (
            "object",
            r#""shape":"ball","size":1,"colour":"mauve""#,
            OutOfRange,
        ),
        (
            "object",
            r#""shape":"ball","size":0.001,"colour":"red""#,
            OutOfRange,
        ),
        (
            "object",
            r#""shape":"ball","size":1,"colour":"red","theta":1"#,
            UnknownField,
        ),
    ] {
        assert_eq!(drop(kind, fields), Err(expected), "{kind} {fields}");
    }
    let far = r#"{"command":"drop","obstacle":{"shape":"circle","x":10001,"y":0,"r":1}}"#;
    assert_eq!(read(far), Err(OutOfRange));
}

/// A robot obeys a part of what a simulator does, read and refused in the same way.
#[test]
fn robots_and_simulators_read_the_same_faults() {
    for text in SHORTEST {
        let told = FaultCommand::from_json(text.as_bytes()).expect(text);
        let expected = match read(text).expect(text) {
            SimulatorCommand::Fault(fault) => Some(fault),
            _ => None,
        };
        assert_eq!(told, expected, "{text}");
    }
    let end = r#","robot":"a","fault":{"fault":"brown-out"}}"#;
    for text in [
        r#"{"command":"heal"}"#.to_owned(),
        r#"{"command":"heal","robot":"No"}"#.to_owned(),
        r#"{"command":"heal","robot":null}"#.to_owned(),
        r#"{"command":"heal","robot":"a","robot":"a"}"#.to_owned(),
        r#"{"command":"heal","robot":"a","steps":1}"#.to_owned(),
        r#"{"command":"heal","robot":"a","colour":1}"#.to_owned(),
        format!(r#"{{"command":"heal"{end}"#),
        r#"{"command":"inject","robot":"a"}"#.to_owned(),
        format!(r#"{{"command":"inject","lasting_ms":0{end}"#),
        format!(r#"{{"command":"inject","lasting_ms":null{end}"#),
        format!(r#"{{"command":"inject","item":1{end}"#),
        r#"{"command":"inject","robot":"a","fault":{"fault":"rust"}}"#.to_owned(),
    ] {
        let refused = read(&text).expect_err(&text);
        let told = FaultCommand::from_json(text.as_bytes());
        assert_eq!(told, Err(refused), "{text}");
    }
}
