//! Telemetry as CBOR, and several samples in one message.

use crawler_protocol::{
    Battery, BehaviourName, DecodeError, EncodeError, MAX_BATCH, MAX_MESSAGE, Pose, RobotId,
    RobotState, Says, Telemetry, TelemetryEncoding, Wheels,
};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;

use TelemetryEncoding::{Cbor, CborSeq, Json, JsonSeq};

/// The telemetry of the contract's example, as another encoder writes it.
const CONTRACT: &[&str] = &[
    "ab006873696d2d3030303101190385021b0000017fcaaf6274030204000584fa3f9a1cacfabe",
    "9eb852fa3fc91687fa3da3d70a0619032c07fa41b400000882fa3f19999afa3f19999a098219",
    "1dba18470a383c",
];

fn contract() -> Vec<u8> {
    let digits: String = CONTRACT.concat();
    (0..digits.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap())
        .collect()
}

fn sample() -> Telemetry {
    Telemetry {
        robot: RobotId::new("sim-0001").unwrap(),
        seq: 901,
        timestamp: 1_648_372_966_004,
        state: RobotState::Moving,
        behaviour: BehaviourName::Manual,
        pose: Pose {
            x: 1.204,
            y: -0.310,
            theta: 1.571,
            sigma: 0.08,
        },
        range_mm: Some(812),
        temperature_c: Some(22.5),
        wheels: Wheels {
            left: 0.6,
            right: 0.6,
        },
        battery: Battery {
            mv: 7610,
            percent: 71,
        },
        rssi_dbm: Some(-61),
        says: None,
    }
}

fn cbor(sample: &Telemetry) -> Vec<u8> {
    let mut buf = [0; MAX_MESSAGE];
    let length = sample.to_cbor(&mut buf).unwrap();
    buf[..length].to_vec()
}

/// All `samples` in one message; `None` when they do not fit.
fn message(how: TelemetryEncoding, samples: &[Telemetry]) -> Option<Vec<u8>> {
    let mut buf = [0; MAX_MESSAGE];
    let mut length = 0;
    for sample in samples {
        match how.append(sample, &mut buf, length) {
            Ok(longer) => length = longer,
            Err(error) => {
                assert_eq!(error, EncodeError::TooLarge);
                return None;
            }
        }
    }
    Some(buf[..length].to_vec())
}

fn read(how: TelemetryEncoding, payload: &[u8]) -> Result<Vec<Telemetry>, DecodeError> {
    how.samples(payload).collect()
}

#[test]
fn bytes_are_those_of_the_contract() {
    assert_eq!(cbor(&sample()), contract());
    assert_eq!(Telemetry::from_cbor(&contract()), Ok(sample()));
    // No enum may be given another order: its places are numbers on the wire.
    let states = "INITIALIZING IDLE MOVING SCANNING CAUTION AVOIDING UPDATING ERROR";
    let names: Vec<_> = RobotState::ALL.iter().map(|state| state.name()).collect();
    assert_eq!(names.join(" "), states);
    let behaviours = "manual wander goto disperse gather flock formation policy follow patrol consensus allocate cover";
    let names: Vec<_> = BehaviourName::ALL.iter().map(|name| name.name()).collect();
    assert_eq!(names.join(" "), behaviours);
}

#[test]
fn readers_are_as_strict_as_those_of_json() {
    let whole = contract();
    let changed = |at: usize, byte: u8| {
        let mut bytes = whole.clone();
        bytes[at] = byte;
        Telemetry::from_cbor(&bytes)
    };
    for length in 0..whole.len() {
        let error = Telemetry::from_cbor(&whole[..length]);
        assert_eq!(error, Err(DecodeError::Malformed), "at {length}");
    }
    let mut more = whole.clone();
    more.push(0);
    assert_eq!(Telemetry::from_cbor(&more), Err(DecodeError::Malformed));
    assert_eq!(
        Telemetry::from_cbor(&[0; MAX_MESSAGE + 1]),
        Err(DecodeError::TooLarge)
    );
    // The head says one field less: the rest is no sample of its own.
    assert_eq!(changed(0, 0xAA), Err(DecodeError::Malformed));
    // An endless map, and none at all.
    assert_eq!(changed(0, 0xBF), Err(DecodeError::WrongType));
    assert_eq!(changed(0, 0x8B), Err(DecodeError::WrongType));
    // Key of the robot: unknown, a negative one, that of another field.
    assert_eq!(changed(1, 12), Err(DecodeError::UnknownField));
    assert_eq!(changed(1, 0x20), Err(DecodeError::UnknownField));
    assert_eq!(changed(1, 1), Err(DecodeError::WrongType));
    // Its name: bytes instead of text, a capital, not UTF-8.
    assert_eq!(changed(2, 0x48), Err(DecodeError::WrongType));
    assert_eq!(changed(3, b'S'), Err(DecodeError::OutOfRange));
    assert_eq!(changed(3, 0xFF), Err(DecodeError::Malformed));
    // The key of the time becomes that of the number.
    let at = whole.windows(2).position(|pair| pair == [2, 0x1B]).unwrap();
    assert_eq!(changed(at, 1), Err(DecodeError::DuplicateField));
    // A state that is none, a percentage that is none.
    let at = whole.windows(2).position(|pair| pair == [3, 2]).unwrap();
    assert_eq!(changed(at + 1, 8), Err(DecodeError::OutOfRange));
    let at = whole
        .windows(2)
        .position(|pair| pair == [0x18, 71])
        .unwrap();
    assert_eq!(changed(at + 1, 101), Err(DecodeError::OutOfRange));
    assert_eq!(changed(at + 1, 100).unwrap().battery.percent, 100);
    // Infinity, and a double where a single belongs.
    let at = whole.iter().position(|byte| *byte == 0xFA).unwrap();
    let mut infinite = whole.clone();
    infinite[at + 1..at + 5].copy_from_slice(&f32::INFINITY.to_be_bytes());
    assert_eq!(
        Telemetry::from_cbor(&infinite),
        Err(DecodeError::OutOfRange)
    );
    assert_eq!(changed(at, 0xFB), Err(DecodeError::WrongType));
    // `null` is for what knows no better way to say nothing.
    let at = whole.windows(2).position(|pair| pair == [6, 0x19]).unwrap();
    assert_eq!(changed(at + 1, 0xF6), Err(DecodeError::WrongType));
    // What must be there is missing.
    assert_eq!(
        Telemetry::from_cbor(&[0xA0]),
        Err(DecodeError::MissingField)
    );
    // A head that promises more than any memory holds.
    let vast = [0xBB, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF];
    assert_eq!(Telemetry::from_cbor(&vast), Err(DecodeError::Malformed));
}

#[test]
fn what_is_not_a_number_does_not_leave() {
    let mut buf = [0; MAX_MESSAGE];
    let mut lost = sample();
    lost.pose.x = f32::NAN;
    assert_eq!(lost.to_cbor(&mut buf), Err(EncodeError::NotFinite));
    let mut sample = sample();
    sample.temperature_c = Some(f32::INFINITY);
    let length = sample.to_cbor(&mut buf).unwrap();
    let read = Telemetry::from_cbor(&buf[..length]).unwrap();
    assert_eq!(read.temperature_c, None);
    for room in 0..length {
        let cut = sample.to_cbor(&mut buf[..room]);
        assert_eq!(cut, Err(EncodeError::TooLarge));
    }
}

#[test]
fn the_content_type_tells_how_to_read() {
    for how in TelemetryEncoding::ALL {
        assert_eq!(TelemetryEncoding::of(Some(how.content_type())), Some(how));
    }
    assert_eq!(TelemetryEncoding::of(None), Some(Json));
    let of = |text| TelemetryEncoding::of(Some(text));
    assert_eq!(of("Application/JSON; charset=utf-8"), Some(Json));
    assert_eq!(of(" application/cbor-seq "), Some(CborSeq));
    for other in [
        "",
        "cbor",
        "text/plain",
        "application/cbor2",
        "application/xml",
    ] {
        assert_eq!(of(other), None, "{other}");
    }
}

#[test]
fn a_batch_is_one_rising_row_of_at_most_ten() {
    let row = |numbers: &[u64]| -> Vec<Telemetry> {
        let with = |seq: &u64| Telemetry {
            seq: *seq,
            ..sample()
        };
        numbers.iter().map(with).collect()
    };
    for how in [JsonSeq, CborSeq] {
        let three = row(&[1, 2, 7]);
        let bytes = message(how, &three).unwrap();
        assert_eq!(read(how, &bytes), Ok(three));
        for numbers in [[1, 1], [2, 1]] {
            let bytes = message(how, &row(&numbers)).unwrap();
            assert_eq!(read(how, &bytes), Err(DecodeError::OutOfRange));
        }
        assert_eq!(read(how, &[]), Err(DecodeError::Malformed));
        // One is a batch too, but no batch is one.
        let one = message(how, &row(&[1])).unwrap();
        assert_eq!(read(how, &one), Ok(row(&[1])));
    }
    assert_eq!(message(Json, &row(&[1, 2])), None);
    assert_eq!(message(Cbor, &row(&[1, 2])), None);
    let two = message(CborSeq, &row(&[1, 2])).unwrap();
    assert_eq!(read(Cbor, &two), Err(DecodeError::Malformed));
    let two = message(JsonSeq, &row(&[1, 2])).unwrap();
    assert_eq!(read(Json, &two), Err(DecodeError::Malformed));
    assert_eq!(read(JsonSeq, &two[1..]), Err(DecodeError::Malformed));
    assert_eq!(read(JsonSeq, b"\x1e\x1e"), Err(DecodeError::Malformed));

    let least = |seq| Telemetry {
        robot: RobotId::new("a").unwrap(),
        seq,
        range_mm: None,
        temperature_c: None,
        rssi_dbm: None,
        ..sample()
    };
    let most: Vec<_> = (0..MAX_BATCH as u64).map(least).collect();
    let mut bytes = message(CborSeq, &most).unwrap();
    assert_eq!(read(CborSeq, &bytes), Ok(most));
    bytes.extend(cbor(&least(99)));
    assert!(bytes.len() <= MAX_MESSAGE);
    assert_eq!(read(CborSeq, &bytes), Err(DecodeError::TooLarge));
    let mut samples = CborSeq.samples(&bytes).skip(MAX_BATCH);
    assert_eq!(samples.next(), Some(Err(DecodeError::TooLarge)));
    assert_eq!(samples.next(), None, "after an error there is nothing");
    let long = vec![0; MAX_MESSAGE + 1];
    for how in TelemetryEncoding::ALL {
        assert_eq!(read(how, &long), Err(DecodeError::TooLarge));
    }
}

#[test]
fn what_a_robot_says_is_one_to_six_numbers() {
    let with = |says: &[i32]| Telemetry {
        says: Says::of_numbers(says),
        ..sample()
    };
    assert_eq!(Says::of_numbers(&[]), None);
    assert_eq!(Says::of_numbers(&[0; 7]), None);
    let most = with(&[9, -1, i32::MAX, i32::MIN, 0, 24]);
    let bytes = cbor(&most);
    let said = [0x0B, 0x86, 9, 0x20, 0x1A, 0x7F, 0xFF, 0xFF, 0xFF, 0x3A];
    let at = bytes.windows(said.len()).position(|part| part == said);
    let at = at.expect("behind the others") + 1;
    assert_eq!(Telemetry::from_cbor(&bytes), Ok(most));
    // More than there may be, none, an endless array, no array.
    for (head, error) in [
        (0x87, DecodeError::OutOfRange),
        (0x80, DecodeError::OutOfRange),
        (0x9F, DecodeError::WrongType),
        (0x40, DecodeError::WrongType),
    ] {
        let mut bytes = bytes.clone();
        bytes[at] = head;
        assert_eq!(Telemetry::from_cbor(&bytes), Err(error), "{head:#x}");
    }
    let mut buf = [0; MAX_MESSAGE];
    let length = with(&[8, 5]).to_json(&mut buf).unwrap();
    let text = std::str::from_utf8(&buf[..length]).unwrap();
    assert!(text.ends_with(r#","says":[8,5]}"#), "{text}");
    for other in [
        "[]",
        "[1,2,3,4,5,6,7]",
        "[1.5]",
        "[3000000000]",
        "8",
        "null",
    ] {
        let text = text.replace("[8,5]", other);
        assert!(Telemetry::from_json(text.as_bytes()).is_err(), "{other}");
    }
}

/// As many as the robot's parameters allow fit, whatever they say, or the robot sends fewer.
#[test]
fn ten_samples_of_a_usual_robot_fit() {
    let usual: Vec<_> = (0..MAX_BATCH as u64)
        .map(|seq| Telemetry {
            seq: 1_000_000 + seq,
            ..sample()
        })
        .collect();
    let bytes = message(CborSeq, &usual).expect("ten samples fit");
    assert!(bytes.len() <= 900, "{} bytes", bytes.len());
    assert!(message(JsonSeq, &usual[..3]).is_some());
}

/// The table of keys in the documentation, and the keys of the encoder.
#[test]
fn the_description_has_the_fields_of_the_encoder() {
    let text = include_str!("../../../docs/protocol.md");
    let (_, rest) = text.split_once("telemetry = {\n").expect("the CDDL");
    let (body, _) = rest.split_once("\n}").expect("its end");
    let told: Vec<(u8, &str)> = body
        .lines()
        .map(|line| {
            let line = line.trim_start().trim_start_matches("? ");
            let (key, _) = line.split_once(": ").expect("a key");
            let (_, name) = line.split_once("; ").expect("a name");
            let name = name.split([',', ':', ' ']).next();
            (key.parse().expect("a number"), name.expect("a name"))
        })
        .collect();
    let mut buf = [0; MAX_MESSAGE];
    let full = Telemetry {
        says: Says::of_numbers(&[8, 1]),
        ..sample()
    };
    let length = full.to_json(&mut buf).unwrap();
    let json = std::str::from_utf8(&buf[..length]).unwrap();
    for (place, (key, name)) in told.iter().enumerate() {
        assert_eq!(usize::from(*key), place);
        assert!(json.contains(&format!("\"{name}\":")), "{name}");
    }
    let bytes = cbor(&full);
    assert_eq!(bytes[0], 0xA0 | told.len() as u8, "as many fields");
    let mut decoder = minicbor::Decoder::new(&bytes[1..]);
    for (key, name) in &told {
        assert_eq!(decoder.u8().unwrap(), *key, "{name}");
        decoder.skip().unwrap();
    }
}

proptest! {
    #[test]
    fn cbor_value_and_json_are_the_same(telemetry in crate::common::telemetry()) {
        let bytes = cbor(&telemetry);
        let read = Telemetry::from_cbor(&bytes).unwrap();
        prop_assert_eq!(&read, &telemetry);
        let (mut one, mut other) = ([0; MAX_MESSAGE], [0; MAX_MESSAGE]);
        let length = telemetry.to_json(&mut one).unwrap();
        prop_assert_eq!(read.to_json(&mut other), Ok(length));
        prop_assert_eq!(one, other);
        let back = Telemetry::from_json(&one[..length]).unwrap();
        prop_assert_eq!(cbor(&back), bytes);
    }

    #[test]
    fn samples_come_back_in_their_order(
        mut telemetry in vec(crate::common::telemetry(), 1..=MAX_BATCH),
        how in select(vec![JsonSeq, CborSeq]),
    ) {
        telemetry.sort_by_key(|sample| sample.seq);
        telemetry.dedup_by_key(|sample| sample.seq);
        while message(how, &telemetry).is_none() {
            telemetry.pop();
        }
        let bytes = message(how, &telemetry).unwrap();
        prop_assert!(bytes.len() <= MAX_MESSAGE);
        prop_assert_eq!(read(how, &bytes), Ok(telemetry));
    }

    #[test]
    fn no_bytes_make_a_reader_panic(
        bytes in vec(any::<u8>(), 0..200),
        how in select(TelemetryEncoding::ALL.to_vec()),
    ) {
        let read: Vec<_> = how.samples(&bytes).collect();
        prop_assert!((1..=MAX_BATCH + 1).contains(&read.len()));
    }

    #[test]
    fn damaged_samples_are_read_or_refused(
        telemetry in crate::common::telemetry(),
        damage in vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = cbor(&telemetry);
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(read) = Telemetry::from_cbor(&bytes) {
            prop_assert_eq!(Telemetry::from_cbor(&cbor(&read)), Ok(read));
        }
    }
}
