//! Every way in which a command can be wrong has its own answer.

use crawler_protocol::{
    Action, BehaviourSpec, Command, CommandName, DEFAULT_WANDER_SPEED, Direction, EncodeError,
    MAX_MESSAGE, ParameterValue, PolicyName, Reason, Source,
};

fn parse(body: &str) -> Result<Action, Reason> {
    let json = format!(r#"{{{body},"timestamp":1,"seq":17,"source":"operator:ada"}}"#);
    match Command::parse(json.as_bytes()) {
        Ok(command) => Ok(command.action),
        Err(error) => {
            // Whatever is wrong with the rest: the robot can answer.
            assert_eq!(error.seq, Some(17), "{json}");
            assert_eq!(
                error.source.as_ref().map(Source::as_str),
                Some("operator:ada"),
                "{json}"
            );
            Err(error.reason)
        }
    }
}

#[test]
fn every_reason_a_command_can_be_refused_for() {
    let table = [
        (r#""command":"fly""#, Reason::UnknownCommand),
        (
            r#""command":"a-very-long-name-indeed""#,
            Reason::UnknownCommand,
        ),
        (r#""command":"Stop""#, Reason::UnknownCommand),
        (r#""command":7"#, Reason::WrongType),
        (r#""command":null"#, Reason::WrongType),
        (r#""command":["stop"]"#, Reason::WrongType),
        (r#""parameters":{}"#, Reason::MissingField),
        (r#""command":"stop","colour":"red""#, Reason::UnknownField),
        (
            r#""command":"stop","":{"a":[1,{"b":null}]}"#,
            Reason::UnknownField,
        ),
        (
            r#""command":"stop","a-name-longer-than-any-field-has":1"#,
            Reason::UnknownField,
        ),
        (
            r#""command":"stop","command":"stop""#,
            Reason::DuplicateField,
        ),
        (
            r#""command":"stop","c\u006fmmand":"stop""#,
            Reason::DuplicateField,
        ),
        (
            r#""command":"stop","parameters":{},"parameters":null"#,
            Reason::DuplicateField,
        ),
        (r#""command":"stop","parameters":[]"#, Reason::WrongType),
        (r#""command":"stop","parameters":"{}""#, Reason::WrongType),
        (
            r#""command":"stop","parameters":{"now":true}"#,
            Reason::UnknownField,
        ),
        (r#""command":"move""#, Reason::MissingField),
        (
            r#""command":"move","parameters":null"#,
            Reason::MissingField,
        ),
        (
            r#""command":"move","parameters":{"direction":"forward","speed":80}"#,
            Reason::MissingField,
        ),
        (
            r#""command":"move","parameters":{"direction":"forward","speed":80,"durations":1}"#,
            Reason::UnknownField,
        ),
        (
            r#""command":"move","parameters":{"direction":"forward","speed":80,"duration":1,"speed":80}"#,
            Reason::DuplicateField,
        ),
        (
            r#""command":"move","parameters":{"direction":"up","speed":80,"duration":1}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"move","parameters":{"direction":1,"speed":80,"duration":1}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"move","parameters":{"direction":"left","speed":101,"duration":1}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"move","parameters":{"direction":"left","speed":-1,"duration":1}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"move","parameters":{"direction":"left","speed":80.5,"duration":1}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"move","parameters":{"direction":"left","speed":"80","duration":1}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"move","parameters":{"direction":"left","speed":true,"duration":1}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"move","parameters":{"direction":"left","speed":null,"duration":1}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"move","parameters":{"direction":"left","speed":{"a":1},"duration":1}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"move","parameters":{"direction":"left","speed":80,"duration":10001}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"move","parameters":{"direction":"left","speed":80,"duration":1e999}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"drive","parameters":{"v":0.1}"#,
            Reason::MissingField,
        ),
        (
            r#""command":"drive","parameters":{"v":10.001,"w":0}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"drive","parameters":{"v":0,"w":-51}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"goto","parameters":{"x":1e5,"y":0}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"goto","parameters":{"x":1,"y":"2"}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{}"#,
            Reason::MissingField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"dance"}"#,
            Reason::UnknownBehaviour,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":2}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"flock","speed":1}"#,
            Reason::UnknownField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"wander","speed":1000}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"goto","x":1}"#,
            Reason::MissingField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"gather","x":1,"y":10001}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"gather","x":"1"}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"gather","r":1}"#,
            Reason::UnknownField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"follow"}"#,
            Reason::MissingField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"follow","leader":"Sim 1"}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"follow","leader":"a","distance":0.2}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"follow","leader":"a","distance":-1}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"consensus","f":1}"#,
            Reason::MissingField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"consensus","value":1,"measure":"range"}"#,
            Reason::UnknownField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"consensus","measure":"mood"}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"consensus","value":2e6}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"consensus","value":"1"}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"consensus","value":1,"f":8}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"allocate","tasks":[]}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"formation","shape":"star"}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"formation","spacing":0.8}"#,
            Reason::UnknownField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"formation","shape":"line","radius":1}"#,
            Reason::UnknownField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"formation","shape":"line","spacing":0.4}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"formation","shape":"circle","radius":8.5}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"formation","shape":"wedge","heading":7}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"formation","shape":"wedge","path":[]}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"cover"}"#,
            Reason::MissingField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"cover","area":[[0,0],[1,1]]}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"allocate"}"#,
            Reason::MissingField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","laps":1}"#,
            Reason::MissingField,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":[[0,0]]}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":[[0,0],[1,1]],"laps":1001}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":[[0,0],[1,1]],"laps":0.5}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":[[0,0],[1,20000]]}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":[[0,0],[1,1],[1,1],[1,1],[1,1],[1,1],[1,1],[1,1],[1,1]]}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":[0,0]}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":[[0,0],[1]]}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":[[0,0],[1,1,1]]}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":[[0,0],["1",1]]}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"patrol","waypoints":"0,0 1,1"}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"wander","speed":[[1,1]]}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"set","parameters":{"a":[[1,1]]}"#,
            Reason::WrongType,
        ),
        (r#""command":"set","parameters":{}"#, Reason::MissingField),
        (r#""command":"set""#, Reason::MissingField),
        (
            r#""command":"set","parameters":{"":1}"#,
            Reason::UnknownParameter,
        ),
        (
            r#""command":"set","parameters":{"Safe-Distance":1}"#,
            Reason::UnknownParameter,
        ),
        (
            r#""command":"set","parameters":{"a_name_longer_than_thirty_two_bytes":1}"#,
            Reason::UnknownParameter,
        ),
        (
            r#""command":"goto","parameters":{"a_name_longer_than_thirty_two_bytes":1}"#,
            Reason::UnknownField,
        ),
        (
            r#""command":"set","parameters":{"a":[1]}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"set","parameters":{"a":null}"#,
            Reason::WrongType,
        ),
        (
            r#""command":"set","parameters":{"a":1,"\u0061":2}"#,
            Reason::DuplicateField,
        ),
        (
            r#""command":"set","parameters":{"a":4e38}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"set","parameters":{"a":"line\nline"}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"set","parameters":{"a":"0123456789012345678901234567890123456789012345678901234567890123+"}"#,
            Reason::OutOfRange,
        ),
        (
            r#""command":"set","parameters":{"a":1,"b":1,"c":1,"d":1,"e":1,"f":1,"g":1,"h":1,"i":1}"#,
            Reason::TooLarge,
        ),
        // Syntax comes before meaning, whichever stands first in the text.
        (r#""command":"fly","colour":"#, Reason::Malformed),
    ];
    for (body, reason) in table {
        if reason == Reason::Malformed {
            let json = format!("{{{body}}}");
            assert_eq!(
                Command::parse(json.as_bytes()).unwrap_err().reason,
                reason,
                "{json}"
            );
        } else {
            assert_eq!(parse(body), Err(reason), "{body}");
        }
    }
}

#[test]
fn what_names_the_sender_is_checked_too() {
    let table = [
        (
            r#""seq":1,"source":"a""#,
            Reason::MissingField,
            Some(1),
            true,
        ),
        (
            r#""timestamp":1,"source":"a""#,
            Reason::MissingField,
            None,
            true,
        ),
        (
            r#""timestamp":1,"seq":1"#,
            Reason::MissingField,
            Some(1),
            false,
        ),
        (
            r#""timestamp":"1","seq":1,"source":"a""#,
            Reason::WrongType,
            Some(1),
            true,
        ),
        (
            r#""timestamp":-1,"seq":1,"source":"a""#,
            Reason::OutOfRange,
            Some(1),
            true,
        ),
        (
            r#""timestamp":1,"seq":1.5,"source":"a""#,
            Reason::WrongType,
            None,
            true,
        ),
        (
            r#""timestamp":1,"seq":18446744073709551616,"source":"a""#,
            Reason::OutOfRange,
            None,
            true,
        ),
        (
            r#""timestamp":1,"seq":null,"source":"a""#,
            Reason::WrongType,
            None,
            true,
        ),
        (
            r#""timestamp":1,"seq":1,"source":"""#,
            Reason::OutOfRange,
            Some(1),
            false,
        ),
        (
            r#""timestamp":1,"seq":1,"source":"\"""#,
            Reason::OutOfRange,
            Some(1),
            false,
        ),
        (
            r#""timestamp":1,"seq":1,"source":"ä""#,
            Reason::OutOfRange,
            Some(1),
            false,
        ),
        (
            r#""timestamp":1,"seq":1,"source":7"#,
            Reason::WrongType,
            Some(1),
            false,
        ),
        (
            r#""timestamp":1,"seq":1,"seq":2,"source":"a""#,
            Reason::DuplicateField,
            Some(1),
            true,
        ),
        (
            r#""timestamp":1,"seq":1,"source":"0123456789012345678901234567890123456789012345678""#,
            Reason::OutOfRange,
            Some(1),
            false,
        ),
    ];
    for (body, reason, seq, source) in table {
        let json = format!(r#"{{"command":"stop",{body}}}"#);
        let error = Command::parse(json.as_bytes()).expect_err(&json);
        assert_eq!(
            (error.reason, error.seq, error.source.is_some()),
            (reason, seq, source),
            "{json}"
        );
    }
}

#[test]
fn every_command_is_understood() {
    let speed = |speed| Action::Behave(BehaviourSpec::Wander { speed });
    let table = [
        (
            r#""command":"move","parameters":{"direction":"backward","speed":80.0,"duration":0}"#,
            Action::Move {
                direction: Direction::Backward,
                speed: 80,
                duration_ms: 0,
            },
        ),
        (
            r#""command":"drive","parameters":{"w":-1.5e-1,"v":0.2}"#,
            Action::Drive { v: 0.2, w: -0.15 },
        ),
        (
            r#""parameters":{"x":1,"y":-2.5},"command":"goto""#,
            Action::Goto { x: 1.0, y: -2.5 },
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"wander"}"#,
            speed(DEFAULT_WANDER_SPEED),
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"wander","speed":0}"#,
            speed(0),
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"goto","x":1,"y":2}"#,
            Action::Behave(BehaviourSpec::Goto { x: 1.0, y: 2.0 }),
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"gather"}"#,
            Action::Behave(BehaviourSpec::Gather { x: 0.0, y: 0.0 }),
        ),
        (
            r#""command":"behave","parameters":{"behaviour":"gather","y":-2}"#,
            Action::Behave(BehaviourSpec::Gather { x: 0.0, y: -2.0 }),
        ),
        (r#""command":"stop""#, Action::Stop),
        (r#""command":"est\u006fp","parameters":{}"#, Action::Estop),
        (r#""command":"reset","parameters":null"#, Action::Reset),
        (r#""command":"scan""#, Action::Scan),
        (r#""command":"capture""#, Action::Capture),
        (r#""command":"report_map""#, Action::ReportMap),
        (r#""command":"identify""#, Action::Identify),
        (r#""command":"reboot""#, Action::Reboot),
    ];
    for (body, action) in table {
        assert_eq!(parse(body), Ok(action), "{body}");
    }
    let Ok(Action::Set(values)) = parse(
        r#""command":"set","parameters":{"safe_distance_mm":600,"name":"b\u00f6b \ud83e\udd16","lamp":false}"#,
    ) else {
        panic!("a set command");
    };
    let names: Vec<_> = values.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["safe_distance_mm", "name", "lamp"]);
    assert_eq!(values[0].1, ParameterValue::Number(600.0));
    assert_eq!(
        values[1].1,
        ParameterValue::Text("böb 🤖".try_into().unwrap())
    );
    assert_eq!(values[2].1, ParameterValue::Bool(false));
}

#[test]
fn a_comparison_of_a_policy_begins_with_its_name_and_ends_without() {
    let named = |name| {
        let policy = Some(PolicyName::new(name).unwrap());
        Ok(Action::Shadow { policy })
    };
    let ended = || Ok(Action::Shadow { policy: None });
    for (parameters, expected) in [
        (r#","parameters":{"policy":"gather-2"}"#, named("gather-2")),
        (r#","parameters":{}"#, ended()),
        (r#","parameters":null"#, ended()),
        ("", ended()),
        (r#","parameters":{"policy":""}"#, Err(Reason::OutOfRange)),
        (r#","parameters":{"policy":1}"#, Err(Reason::WrongType)),
        (
            r#","parameters":{"policy":"a","speed":1}"#,
            Err(Reason::UnknownField),
        ),
    ] {
        let body = format!(r#""command":"shadow"{parameters}"#);
        assert_eq!(parse(&body), expected, "{body}");
    }
}

#[test]
fn exactly_what_can_move_a_robot_is_motion() {
    use CommandName as Name;
    let moving = [
        Name::Move,
        Name::Drive,
        Name::Scan,
        Name::Behave,
        Name::Goto,
    ];
    for name in Name::ALL {
        let parameters = match name {
            Name::Move => r#"{"direction":"left","speed":1,"duration":1}"#,
            Name::Drive => r#"{"v":0,"w":0}"#,
            Name::Goto => r#"{"x":0,"y":0}"#,
            Name::Behave => r#"{"behaviour":"manual"}"#,
            Name::Set => r#"{"a":1}"#,
            _ => "null",
        };
        let action = parse(&format!(r#""command":"{name}","parameters":{parameters}"#)).unwrap();
        assert_eq!(action.command(), *name);
        assert_eq!(action.is_motion(), moving.contains(name), "{name}");
    }
}

#[test]
fn a_request_has_no_sender() {
    assert_eq!(Action::parse(br#"{"command":"stop"}"#), Ok(Action::Stop));
    for field in [r#""timestamp":1"#, r#""seq":1"#, r#""source":"a""#] {
        let json = format!(r#"{{"command":"stop",{field}}}"#);
        assert_eq!(
            Action::parse(json.as_bytes()),
            Err(Reason::UnknownField),
            "{json}"
        );
    }
    assert_eq!(Action::parse(b"{}"), Err(Reason::MissingField));
}

#[test]
fn a_number_that_is_none_does_not_leave() {
    let mut buf = [0; MAX_MESSAGE];
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut values = crawler_protocol::ParameterValues::new();
        values
            .push(("a".try_into().unwrap(), ParameterValue::Number(bad)))
            .unwrap();
        for action in [
            Action::Drive { v: bad, w: 0.0 },
            Action::Goto { x: 0.0, y: bad },
            Action::Behave(BehaviourSpec::Goto { x: bad, y: 0.0 }),
            Action::Set(values),
        ] {
            assert_eq!(action.to_json(&mut buf), Err(EncodeError::NotFinite));
            assert!(serde_json::to_vec(&action).is_err());
        }
    }
}
