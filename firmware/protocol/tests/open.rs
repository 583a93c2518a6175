//! A reader that is older than the robot: what it does not know costs nothing of what it knows.

use crawler_protocol::open::{self, MAX_WORD, Open, Read, Report, UnknownWord};
use crawler_protocol::{
    DecodeError, Detections, Kind, MAX_MESSAGE, MapSegment, ParametersMessage, RobotState,
    StatusMessage, Telemetry, TelemetryEncoding,
};
use minicbor::Encoder;
use minicbor::encode::write::Cursor;
use proptest::prelude::*;
use serde_json::{Value, json};

/// Puts fields into the message and every object in it, but for maps, whose members have any name.
/// Returns how many.
fn extend(value: &mut Value, map: Option<&str>) -> u32 {
    match value {
        Value::Object(members) => {
            let mut added = 0;
            for (name, member) in members.iter_mut() {
                added += match member {
                    Value::Object(named) if map == Some(name.as_str()) => {
                        named.values_mut().map(|inner| extend(inner, None)).sum()
                    }
                    other => extend(other, None),
                };
            }
            members.insert("aa".into(), json!({ "x": [1, { "y": null }] }));
            members.insert("zz".into(), json!("new"));
            added + 2
        }
        Value::Array(elements) => elements.iter_mut().map(|inner| extend(inner, None)).sum(),
        _ => 0,
    }
}

fn same<T: Report + PartialEq + std::fmt::Debug>(
    json: &[u8],
    map: Option<&str>,
) -> Result<(), TestCaseError> {
    let mut value: Value = serde_json::from_slice(json).expect("JSON");
    // In the spelling and the order of that writer.
    let plain = value.to_string();
    prop_assume!(plain.len() <= MAX_MESSAGE);
    let Read { message, unknown } = open::read::<T>(plain.as_bytes()).expect(&plain);
    prop_assert!(unknown.is_none());
    let added = extend(&mut value, map);
    let longer = value.to_string();
    let read = open::read::<T>(longer.as_bytes());
    if longer.len() > MAX_MESSAGE {
        prop_assert_eq!(read.err(), Some(DecodeError::TooLarge));
        return Ok(());
    }
    let read = read.expect(&longer);
    prop_assert_eq!((read.unknown.fields, read.unknown.words), (added, 0));
    prop_assert_eq!(read.message, message);
    Ok(())
}

macro_rules! passes_over {
    ($($test:ident: $message:ty, $map:expr;)+) => {
        proptest! {
            $(#[test]
            fn $test(message in crate::common::$test()) {
                let mut buf = [0; MAX_MESSAGE];
                if let Ok(length) = message.to_json(&mut buf) {
                    same::<$message>(&buf[..length], $map)?;
                }
            })+
        }
    };
}

passes_over! {
    response: open::Response, None;
    status: open::StatusMessage, Some("models");
    heartbeat: open::Heartbeat, None;
    log_record: open::LogRecord, None;
    detections: Detections, None;
    map_segment: MapSegment, None;
    parameters: ParametersMessage, Some("values");
}

proptest! {
    #[test]
    fn telemetry(message in crate::common::telemetry()) {
        let mut buf = [0; MAX_MESSAGE];
        if let Ok(length) = message.to_json(&mut buf) {
            same::<open::Telemetry>(&buf[..length], None)?;
        }
        if let Ok(length) = message.to_cbor(&mut buf) {
            let mut samples = TelemetryEncoding::Cbor.open_samples(&buf[..length]);
            let read = samples.next().expect("one").expect("a sample");
            prop_assert!(read.unknown.is_none());
            prop_assert_eq!(read.message.pose, message.pose);
            prop_assert_eq!(read.message.state, Open::Known(message.state));
        }
    }

    /// Whatever a word is, what is kept of it is short and printable.
    #[test]
    fn words_are_bounded(text in any::<String>()) {
        let word = UnknownWord::new(&text);
        prop_assert!(word.as_str().len() <= MAX_WORD);
        prop_assert!(word.as_str().bytes().all(|byte| byte.is_ascii_graphic()));
    }

    #[test]
    fn words_are_counted_and_kept(word in "[A-Z_]{1,24}") {
        prop_assume!(RobotState::from_name(&word).is_none());
        let json = format!(
            r#"{{"robot":"a","seq":1,"timestamp":2,"uptime_ms":3,"state":"{word}"}}"#
        );
        let read = open::read::<open::Heartbeat>(json.as_bytes()).expect("a heartbeat");
        prop_assert_eq!((read.unknown.fields, read.unknown.words), (0, 1));
        prop_assert_eq!(read.message.state.name(), word.as_str());
        prop_assert_eq!(read.message.state.known(), None);
    }
}

#[test]
fn every_word_of_a_status_may_be_a_later_one() {
    let json = br#"{"robot":"a","online":true,"kind":"hovering","firmware":"9","board":"b",
        "capabilities":["drive","swim","dig"],"boot":{"count":1,"cause":"cosmic-ray"},"protocol":2}"#;
    assert_eq!(StatusMessage::from_json(json), Err(DecodeError::OutOfRange));
    let Read { message, unknown } = open::read::<open::StatusMessage>(json).expect("a status");
    assert_eq!((unknown.fields, unknown.words), (0, 4));
    let names: Vec<_> = message.capabilities.iter().map(Open::name).collect();
    assert_eq!(names, ["drive", "swim", "dig"]);
    assert_eq!(message.kind.name(), "hovering");
    assert!(message.kind != Kind::Physical);
    assert_eq!(message.boot.cause.name(), "cosmic-ray");
    assert_eq!(message.protocol, 2);
}

#[test]
fn what_is_known_is_read_as_strictly_as_ever() {
    let with = |field: &str| {
        let json =
            format!(r#"{{"robot":"a","seq":1,"timestamp":2,"uptime_ms":3,"state":"IDLE"{field}}}"#);
        open::read::<open::Heartbeat>(json.as_bytes()).err()
    };
    assert_eq!(with(""), None);
    assert_eq!(with(r#","seq":1"#), Some(DecodeError::DuplicateField));
    assert_eq!(with(r#","se\u0071":1"#), Some(DecodeError::DuplicateField));
    // Not the same field, and the same unknown one twice.
    assert_eq!(with(r#","Seq":1,"x":1,"x":2"#), None);
    let deep = |levels| format!(r#","x":{}1{}"#, "[".repeat(levels), "]".repeat(levels));
    assert_eq!(with(&deep(7)), None);
    assert_eq!(with(&deep(8)), Some(DecodeError::Malformed));
    let short = br#"{"robot":"a","seq":1,"timestamp":2,"uptime_ms":3,"mood":"IDLE"}"#;
    let read = open::read::<open::Heartbeat>(short);
    assert_eq!(read.err(), Some(DecodeError::MissingField));
    let odd = br#"{"robot":"a","seq":1,"timestamp":2,"uptime_ms":3,"state":4}"#;
    let read = open::read::<open::Heartbeat>(odd);
    assert_eq!(read.err(), Some(DecodeError::WrongType));
}

/// Telemetry of a later version in CBOR: more fields, of any kind of key, longer arrays, later numbers.
fn later(buf: &mut [u8], state: u8) -> usize {
    let mut out = Encoder::new(Cursor::new(buf));
    let mut write = || {
        out.map(11)?;
        out.u8(0)?.str("a")?.u8(1)?.u64(7)?.u8(2)?.u64(8)?;
        out.u8(3)?.u8(state)?.u8(4)?.u8(200)?;
        out.u8(5)?.array(6)?;
        for number in [1.0, 2.0, 3.0, 0.5, 9.0] {
            out.f32(number)?;
        }
        out.array(1)?.str("deeper")?;
        out.u8(8)?.array(2)?.f32(0.5)?.f32(-0.5)?;
        out.u8(9)?.array(3)?.u16(7_400)?.u8(50)?.bool(true)?;
        out.u8(77)?.map(1)?.u8(1)?.array(2)?.null()?.bytes(&[1])?;
        out.u32(70_000)?.u8(1)?;
        out.str("name")?.f64(1.0)?;
        Ok::<_, minicbor::encode::Error<_>>(())
    };
    write().expect("room");
    out.writer().position()
}

#[test]
fn later_telemetry_in_cbor_is_read() {
    let mut buf = [0; 256];
    let length = later(&mut buf, 9);
    assert!(Telemetry::from_cbor(&buf[..length]).is_err());
    // A sequence goes on behind what was passed over.
    let twice = |first: &[u8]| {
        let mut second = first.to_vec();
        // The number of the second sample: behind the heads of the map, the robot and its key.
        assert_eq!(second[5], 7);
        second[5] = 8;
        [first, &second].concat()
    };
    let payload = twice(&buf[..length]);
    let read: Result<Vec<_>, _> = TelemetryEncoding::CborSeq.open_samples(&payload).collect();
    let read = read.expect("two samples");
    assert_eq!(read.len(), 2);
    for Read { message, unknown } in read {
        // Three keys, two more of the pose and one of the battery.
        assert_eq!((unknown.fields, unknown.words), (6, 2));
        assert_eq!(message.state.name(), "9");
        assert_eq!(message.behaviour.name(), "200");
        assert_eq!((message.pose.theta, message.battery.mv), (3.0, 7_400));
    }
    // Cut off anywhere it is nothing, and a head may claim what it likes.
    for cut in 0..length {
        let mut samples = TelemetryEncoding::Cbor.open_samples(&buf[..cut]);
        assert!(samples.next().expect("one").is_err(), "cut at {cut}");
    }
}

#[test]
fn heads_that_claim_too_much_cost_nothing() {
    // An unknown key whose value is an array of 2^64 - 1 elements, and a pose of as many.
    for payload in [
        &b"\xab\x18\x4d\x9b\xff\xff\xff\xff\xff\xff\xff\xff\x00"[..],
        b"\xab\x05\x9b\xff\xff\xff\xff\xff\xff\xff\xff\xfa\x00\x00\x00\x00",
        b"\xbb\xff\xff\xff\xff\xff\xff\xff\xff\x18\x4d\x00",
    ] {
        let mut samples = TelemetryEncoding::Cbor.open_samples(payload);
        assert!(samples.next().expect("one").is_err());
    }
}
