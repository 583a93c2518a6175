//! What each fuzz target does with its bytes. The fuzzer and the replay of its corpus in the tests of
//! `crawler-protocol` include this file, so both run the same code.
//!
//! A target proves more than the absence of a panic: what was read survives being written and read
//! again, and what is called malformed is malformed to an independent parser too.

use crawler_protocol::open::{self, Read, Report};
use crawler_protocol::{
    Action, CellDigest, Command, DecodeError, Detections, EncodeError, FaultCommand, Fleet,
    Heartbeat, LogRecord, MAX_BATCH, MAX_DEPTH, MAX_MESSAGE, MapSegment, ParametersMessage,
    PoseFix, Reason, Response, StatusMessage, SwarmResponse, Telemetry, TelemetryEncoding,
    TimeMessage, Topic, UpdateCommand,
};

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 20] = [
    ("command", command),
    ("command_request", command_request),
    ("topic", topic),
    ("response", response),
    ("swarm_response", swarm_response),
    ("status", status),
    ("heartbeat", heartbeat),
    ("telemetry", telemetry),
    ("telemetry_cbor", telemetry_cbor),
    ("detections", detections),
    ("log_record", log_record),
    ("map_segment", map_segment),
    ("parameters", parameters),
    ("cell_digest", cell_digest),
    ("pose_fix", pose_fix),
    ("time", time),
    ("fault_command", fault_command),
    ("open", open_messages),
    ("update_command", update_command),
    ("update_report", update_report),
];

/// Compares our verdict on the syntax with that of another parser.
fn check_syntax(data: &[u8], reason: Option<Reason>) {
    if data.len() > MAX_MESSAGE {
        assert_eq!(reason, Some(Reason::TooLarge));
        return;
    }
    let theirs = core::str::from_utf8(data)
        .is_ok_and(|text| serde_json::from_str::<serde::de::IgnoredAny>(text).is_ok());
    if reason == Some(Reason::Malformed) {
        // Two things are malformed to us alone: more levels than any message has, and half a
        // surrogate pair, which the other parser does not look at.
        let levels = data
            .iter()
            .filter(|byte| matches!(byte, b'{' | b'['))
            .count();
        let escape = data.windows(2).any(|pair| pair == b"\\u");
        assert!(!theirs || levels > usize::from(MAX_DEPTH) || escape);
    } else {
        assert!(theirs, "accepted what is not JSON");
    }
}

fn command(data: &[u8]) {
    let result = Command::parse(data);
    check_syntax(data, result.as_ref().err().map(|error| error.reason));
    if let Ok(read) = result {
        let mut buf = [0; MAX_MESSAGE];
        match read.to_json(&mut buf) {
            Ok(length) => assert_eq!(Command::parse(&buf[..length]), Ok(read)),
            // Numbers may have come in a shorter spelling than ours.
            Err(error) => assert_eq!(error, EncodeError::TooLarge),
        }
    }
}

fn command_request(data: &[u8]) {
    let result = Action::parse(data);
    check_syntax(data, result.as_ref().err().copied());
    if let Ok(read) = result {
        let mut buf = [0; MAX_MESSAGE];
        match read.to_json(&mut buf) {
            Ok(length) => assert_eq!(Action::parse(&buf[..length]), Ok(read)),
            Err(error) => assert_eq!(error, EncodeError::TooLarge),
        }
    }
}

fn topic(data: &[u8]) {
    let fleet = Fleet::default();
    if let Ok(text) = core::str::from_utf8(data)
        && let Ok(topic) = Topic::parse(&fleet, text)
    {
        assert_eq!(topic.render(&fleet).as_str(), text);
    }
}

/// How a text leaves: each control character as a space.
fn one_line(text: &str) -> String {
    text.chars()
        .map(|character| {
            if character.is_control() {
                ' '
            } else {
                character
            }
        })
        .collect()
}

macro_rules! message {
    ($($name:ident: $message:ty, same = $same:expr;)+) => {
        $(fn $name(data: &[u8]) {
            let result = <$message>::from_json(data);
            check_syntax(data, result.as_ref().err().map(|error| error.reason()));
            let Ok(read) = result else {
                return;
            };
            let (mut first, mut second) = ([0; MAX_MESSAGE], [0; MAX_MESSAGE]);
            let length = match read.to_json(&mut first) {
                Ok(length) => length,
                Err(error) => return assert_eq!(error, EncodeError::TooLarge),
            };
            let again: Result<$message, DecodeError> = <$message>::from_json(&first[..length]);
            let again = again.expect("what we write, we read");
            assert_eq!(again.to_json(&mut second), Ok(length));
            assert_eq!(first, second);
            let same: fn(&$message, &$message) -> bool = $same;
            assert!(same(&read, &again), "{read:?} became {again:?}");
        })+
    };
}

message! {
    response: Response, same = PartialEq::eq;
    swarm_response: SwarmResponse, same = PartialEq::eq;
    // Control characters in texts leave as spaces.
    status: StatusMessage, same = |read, again| {
        let mut rest = read.clone();
        rest.firmware.clone_from(&again.firmware);
        rest.board.clone_from(&again.board);
        rest.boot.panic.clone_from(&again.boot.panic);
        let panic = read.boot.panic.as_deref().map(one_line);
        rest == *again
            && again.firmware.as_str() == one_line(&read.firmware)
            && again.board.as_str() == one_line(&read.board)
            && again.boot.panic.as_deref() == panic.as_deref()
    };
    heartbeat: Heartbeat, same = PartialEq::eq;
    telemetry: Telemetry, same = PartialEq::eq;
    detections: Detections, same = PartialEq::eq;
    map_segment: MapSegment, same = |read, again| {
        // Whatever was read can be looked at.
        for row in 0..=read.row_count() {
            for column in 0..=u8::MAX {
                let inside = read.is_consistent() && row < read.row_count() && column < read.columns;
                assert!(!inside || read.cell(column, row).is_some());
            }
        }
        read == again
    };
    pose_fix: PoseFix, same = PartialEq::eq;
    time: TimeMessage, same = PartialEq::eq;
    // Control characters in texts leave as spaces.
    log_record: LogRecord, same = |read, again| {
        let mut rest = read.clone();
        rest.event.clone_from(&again.event);
        rest.text.clone_from(&again.text);
        rest == *again
            && again.event.as_str() == one_line(&read.event)
            && again.text.as_str() == one_line(&read.text)
    };
    // Details may be left out, values not.
    parameters: ParametersMessage, same = |read, again| {
        read.values.len() == again.values.len()
            && read.values.iter().zip(&again.values).all(|(one, two)| {
                one.name == two.name && one.value == two.value
            })
    };
    // The last robots may be left out, and the count tells.
    cell_digest: CellDigest, same = |read, again| {
        read.count == again.count && read.robots.starts_with(&again.robots)
    };
}

/// What a robot reads of what simulators are told.
fn fault_command(data: &[u8]) {
    let result = FaultCommand::from_json(data);
    check_syntax(data, result.as_ref().err().map(|error| error.reason()));
    if let Ok(Some(read)) = result {
        let mut buf = [0; MAX_MESSAGE];
        match read.to_json(&mut buf) {
            Ok(length) => assert_eq!(FaultCommand::from_json(&buf[..length]), Ok(Some(read))),
            Err(error) => assert_eq!(error, EncodeError::TooLarge),
        }
    }
}

/// In whichever way telemetry is written, what was read survives being written and read again.
fn telemetry_cbor(data: &[u8]) {
    for how in TelemetryEncoding::ALL {
        let read: Result<Vec<_>, _> = how.samples(data).collect();
        let Ok(read) = read else {
            continue;
        };
        assert!((1..=MAX_BATCH).contains(&read.len()));
        let mut buf = [0; MAX_MESSAGE];
        let written = read
            .iter()
            .try_fold(0, |at, sample| how.append(sample, &mut buf, at));
        let length = match written {
            Ok(length) => length,
            // Numbers may have come in a shorter spelling than ours.
            Err(error) => {
                assert_eq!(error, EncodeError::TooLarge);
                continue;
            }
        };
        if matches!(how, TelemetryEncoding::Cbor | TelemetryEncoding::CborSeq) {
            assert!(length <= data.len(), "there is no shorter way");
        }
        let again: Result<Vec<_>, _> = how.samples(&buf[..length]).collect();
        assert_eq!(again, Ok(read));
    }
}

/// What a strict reader takes, one that knows less than everything takes as well, and knows all of it;
/// what it takes beyond that is short of nothing but fields and words.
fn open_message<T: Report>(data: &[u8], strict: Result<(), DecodeError>) {
    match (open::read::<T>(data), strict) {
        (Ok(Read { unknown, .. }), Ok(())) => assert!(unknown.is_none(), "{unknown:?}"),
        (Ok(Read { unknown, .. }), Err(error)) => {
            assert!(!unknown.is_none(), "{error}");
            assert!(unknown.fields as usize <= MAX_MESSAGE);
        }
        (Err(error), strict) => {
            assert!(strict.is_err());
            assert_ne!(error, DecodeError::UnknownField);
        }
    }
}

fn open_messages(data: &[u8]) {
    open_message::<open::Response>(data, Response::from_json(data).map(drop));
    open_message::<open::StatusMessage>(data, StatusMessage::from_json(data).map(drop));
    open_message::<open::Heartbeat>(data, Heartbeat::from_json(data).map(drop));
    open_message::<open::Telemetry>(data, Telemetry::from_json(data).map(drop));
    open_message::<open::LogRecord>(data, LogRecord::from_json(data).map(drop));
    open_message::<Detections>(data, Detections::from_json(data).map(drop));
    open_message::<MapSegment>(data, MapSegment::from_json(data).map(drop));
    open_message::<ParametersMessage>(data, ParametersMessage::from_json(data).map(drop));
    for how in TelemetryEncoding::ALL {
        let strict: Result<Vec<_>, _> = how.samples(data).collect();
        let read: Result<Vec<_>, _> = how.open_samples(data).collect();
        match (read, strict) {
            (Ok(read), Ok(strict)) => {
                assert_eq!(read.len(), strict.len());
                assert!(read.iter().all(|sample| sample.unknown.is_none()));
            }
            (Ok(read), Err(_)) => {
                assert!((1..=MAX_BATCH).contains(&read.len()));
                assert!(read.iter().any(|sample| !sample.unknown.is_none()));
            }
            (Err(_), strict) => assert!(strict.is_err()),
        }
    }
}

/// What a robot reads of what it is told about updates; others may have written it too.
fn update_command(data: &[u8]) {
    let result = UpdateCommand::from_json(data);
    check_syntax(data, result.as_ref().err().map(|error| error.reason()));
    if let Ok(Some(read)) = result {
        let mut buf = [0; MAX_MESSAGE];
        let length = read.to_json(&mut buf).expect("every one fits");
        assert_eq!(UpdateCommand::from_json(&buf[..length]), Ok(Some(read)));
        assert_eq!(open::update(data), Ok(open::Update::Command));
    }
}

/// What a server reads of what a robot says about updates: written again, it says the same, without what was
/// not known.
fn update_report(data: &[u8]) {
    let result = open::update(data);
    check_syntax(data, result.as_ref().err().map(|error| error.reason()));
    match result {
        Ok(open::Update::Report(Read { message, unknown })) => {
            assert!(unknown.fields as usize <= MAX_MESSAGE);
            assert_eq!(UpdateCommand::from_json(data), Ok(None));
            let mut buf = [0; MAX_MESSAGE];
            let length = message.to_json(&mut buf).expect("every one fits");
            let unknown = open::Unknown {
                fields: 0,
                ..unknown
            };
            let again = open::Update::Report(Read { message, unknown });
            assert_eq!(open::update(&buf[..length]), Ok(again));
        }
        Ok(open::Update::Command) => {}
        // A robot does not take what a server does not know.
        Ok(open::Update::Unknown(_)) => assert!(UpdateCommand::from_json(data).is_err()),
        Err(error) => assert_ne!(error, DecodeError::UnknownField),
    }
}
