use super::*;
use crate::faults::Wheel;
use crate::world::{Colour, Object, ObjectShape, Obstacle};

#[test]
fn inputs_are_written_so_that_they_read_the_same() {
    let pose = Pose::new(0.1, -1.25, 3.0);
    let payload = |bytes: &[u8]| Payload::new(bytes);
    let inputs = [
        Input::Command {
            robot: Some(3),
            payload: payload(br#"{"command":"stop"}"#),
            numbered: true,
        },
        Input::Command {
            robot: None,
            payload: payload(&[0xFF, 0, b'"']),
            numbered: false,
        },
        Input::Message {
            topic: "crawler/x".to_owned(),
            payload: payload(b"hex:zz"),
            at_least_once: true,
            retain: false,
        },
        Input::Time {
            epoch_ms: 1 << 60,
            every_us: 5,
        },
        Input::Spawn { pose: Some(pose) },
        Input::Spawn { pose: None },
        Input::Remove { robot: 1 },
        Input::Cut {
            robot: 2,
            cut: Cut::NoAddress,
        },
        Input::Fault {
            robot: 0,
            fault: Fault::MotorWeak {
                wheel: Wheel::Left,
                strength: 0.1,
            },
            lasting_us: Some(7),
        },
        Input::Heal { robot: 0 },
        Input::Drop {
            what: Dropped::Obstacle(Obstacle::Box {
                x: 0.1,
                y: -1.7,
                w: 0.3,
                h: 0.2,
                theta: 0.7,
            }),
        },
        Input::Drop {
            what: Dropped::Object(Object {
                shape: ObjectShape::Cone,
                x: 1.3,
                y: 0.0,
                size: 0.1,
                colour: Colour::Purple,
            }),
        },
        Input::Take { item: 2 },
        Input::Carry {
            robot: 1,
            pose: Pose::new(1.0, -2.5, 0.25),
        },
        Input::Crash {
            robot: 9,
            text: "src/x.rs:1: \u{1F980}".to_owned(),
        },
    ];
    for (number, input) in inputs.into_iter().enumerate() {
        let entry = Entry {
            at_us: number as u64,
            settled: number % 2 == 0,
            input,
        };
        let text = serde_json::to_string(&entry).expect("writes");
        let read: Entry = serde_json::from_str(&text).expect(&text);
        assert_eq!(read, entry, "{text}");
    }
    for hostile in [
        r#"{"at_us":0,"input":"remove","robot":-1}"#,
        r#"{"at_us":0,"input":"remove","robot":1,"more":1}"#,
        r#"{"at_us":0,"input":"explode"}"#,
        r#"{"at_us":0,"input":"command","payload":"hex:0"}"#,
        r#"{"at_us":0,"input":"command","payload":"hex:é0"}"#,
        r#"{"at_us":0,"input":"spawn","pose":{"x":1,"y":2}}"#,
    ] {
        assert!(serde_json::from_str::<Entry>(hostile).is_err(), "{hostile}");
    }
}

#[test]
fn a_journal_is_bounded_and_says_what_it_lost() {
    let mut journal = Journal::default();
    for _ in 0..MAX_ENTRIES + 3 {
        journal.note(Instant::BOOT, Input::Heal { robot: 1 });
    }
    assert_eq!(journal.entries().len(), MAX_ENTRIES);
    assert_eq!(journal.lost(), 3);
    assert!(!journal.is_complete());

    let mut journal = Journal::default();
    let large = || Input::Crash {
        robot: 0,
        text: "x".repeat(MAX_BYTES / 2 + 1),
    };
    journal.note(Instant::BOOT, large());
    journal.note(Instant::BOOT, large());
    journal.note(Instant::BOOT, Input::Heal { robot: 1 });
    assert_eq!(journal.entries().len(), 1, "nothing after a gap");
    assert_eq!(journal.lost(), 2);
}
