//! Segments of a map: the longest one, what their cells say, and what is none.

use crawler_protocol::{
    DecodeError, MAX_MAP_BYTES, MAX_MESSAGE, MAX_WAY, MapCell, MapSegment, RobotId,
};
use proptest::prelude::*;

/// The finite number with the longest spelling.
const LONG: f32 = -1.175_494_4e-38;

fn segment(columns: u8, cells: &[u8]) -> MapSegment {
    MapSegment {
        robot: RobotId::new("sim-0001").unwrap(),
        seq: 17,
        timestamp: 1_648_372_966_004,
        cell_mm: 100,
        origin: [-48, -40],
        columns,
        rows: 80,
        row: 16,
        cells: heapless::Vec::from_slice(cells).unwrap(),
        goal: Some([1.5, -2.0]),
        next: None,
        way: [[47, 40], [51, 40]].into_iter().collect(),
    }
}

fn json(segment: &MapSegment) -> String {
    let mut buf = [0; MAX_MESSAGE];
    let length = segment.to_json(&mut buf).unwrap();
    String::from_utf8(buf[..length].to_vec()).unwrap()
}

#[test]
fn it_is_written_as_the_contract_has_it() {
    let text = json(&segment(24, b"Many h"));
    assert_eq!(
        text,
        r#"{"robot":"sim-0001","seq":17,"timestamp":1648372966004,"cell_mm":100,"origin":[-48,-40],"columns":24,"rows":80,"row":16,"cells":"TWFueSBo","goal":[1.5,-2.0],"next":null,"way":[[47,40],[51,40]]}"#
    );
}

#[test]
fn the_longest_segment_fits() {
    let mut buf = [0; MAX_MESSAGE];
    let longest = MapSegment {
        robot: RobotId::new(&"a".repeat(32)).unwrap(),
        seq: u64::MAX,
        timestamp: u64::MAX,
        cell_mm: u16::MAX,
        origin: [i32::MIN; 2],
        cells: [0xFF; MAX_MAP_BYTES].into_iter().collect(),
        goal: Some([LONG; 2]),
        next: Some([LONG; 2]),
        way: [[95, 79]; MAX_WAY].into_iter().collect(),
        ..segment(96, &[])
    };
    let length = longest.to_json(&mut buf).unwrap();
    assert_eq!(MapSegment::from_json(&buf[..length]), Ok(longest.clone()));
    assert!(longest.is_consistent());
    assert_eq!((longest.row_count(), longest.is_last()), (16, false));
}

#[test]
fn both_bits_of_a_cell_tell_what_is_there() {
    // The lower row has columns 0 to 3 in every way there is, and the last one.
    let rows = [
        [0b1100, 0, 0x80, 0b1010, 0, 0],
        [0, 0, 0, 0, 0, 0b1000_0000],
    ];
    let segment = segment(24, rows.as_flattened());
    let cell = |column, row| segment.cell(column, row);
    let lower: Vec<_> = (0..4).map(|column| cell(column, 0).unwrap()).collect();
    assert_eq!(
        lower,
        [
            MapCell::Unmarked,
            MapCell::Cleared,
            MapCell::Blocked,
            MapCell::Fixed
        ]
    );
    assert_eq!(cell(23, 0), Some(MapCell::Blocked));
    assert_eq!(cell(23, 1), Some(MapCell::Cleared));
    assert_eq!((cell(24, 0), cell(0, 2)), (None, None));
    assert_eq!(segment.row_count(), 2);
}

#[test]
fn parts_that_do_not_fit_each_other_are_told_apart() {
    let mut good = segment(24, &[0; 12]);
    good.way = [[3, 40], [23, 79]].into_iter().collect();
    assert!(good.is_consistent());
    let last = MapSegment {
        row: 78,
        ..good.clone()
    };
    assert!(last.is_consistent() && last.is_last());
    for wrong in [
        MapSegment {
            cells: heapless::Vec::new(),
            ..good.clone()
        },
        // A row and a half.
        MapSegment {
            cells: [0; 9].into_iter().collect(),
            ..good.clone()
        },
        segment(96, &[0; 12]),
        // A row beyond the last one.
        MapSegment {
            row: 79,
            ..good.clone()
        },
        MapSegment {
            row: u8::MAX,
            ..good.clone()
        },
        MapSegment {
            way: [[24, 0]].into_iter().collect(),
            ..good.clone()
        },
        MapSegment {
            way: [[0, 80]].into_iter().collect(),
            ..good
        },
    ] {
        assert!(!wrong.is_consistent(), "{wrong:?}");
    }
}

#[test]
fn what_is_no_segment_is_refused() {
    let good = json(&segment(24, b"Many h"));
    let too_long = format!("\"{}\"", "A".repeat(MAX_MAP_BYTES / 3 * 4 + 4));
    for (part, other, error) in [
        (r#""TWFueSBo""#, r#""TWFueSB""#, DecodeError::OutOfRange),
        (r#""TWFueSBo""#, r#""TWFueSA=""#, DecodeError::OutOfRange),
        (r#""TWFueSBo""#, r#""TWFueSB-""#, DecodeError::OutOfRange),
        (r#""TWFueSBo""#, r#""TWFueS o""#, DecodeError::OutOfRange),
        (r#""TWFueSBo""#, r#""""#, DecodeError::OutOfRange),
        (r#""TWFueSBo""#, &too_long, DecodeError::OutOfRange),
        (r#""TWFueSBo""#, "[0,0,0]", DecodeError::WrongType),
        (
            r#""columns":24"#,
            r#""columns":25"#,
            DecodeError::OutOfRange,
        ),
        (r#""columns":24"#, r#""columns":0"#, DecodeError::OutOfRange),
        (
            r#""columns":24"#,
            r#""columns":120"#,
            DecodeError::OutOfRange,
        ),
        (r#""rows":80"#, r#""rows":97"#, DecodeError::OutOfRange),
        (r#""rows":80"#, r#""rows":0"#, DecodeError::OutOfRange),
        (r#""row":16"#, r#""row":256"#, DecodeError::OutOfRange),
        (
            r#""cell_mm":100"#,
            r#""cell_mm":0"#,
            DecodeError::OutOfRange,
        ),
        ("[-48,-40]", "[-48]", DecodeError::OutOfRange),
        ("[-48,-40]", "[-48,-40,0]", DecodeError::OutOfRange),
        ("[1.5,-2.0]", "[1.5,1e99]", DecodeError::OutOfRange),
        (r#""goal":[1.5,-2.0],"#, "", DecodeError::MissingField),
        (r#""next":null"#, r#""next":"#, DecodeError::Malformed),
    ] {
        assert!(good.contains(part), "{part}");
        let text = good.replace(part, other);
        let read = MapSegment::from_json(text.as_bytes());
        assert_eq!(read, Err(error), "{other}");
    }
    let way = format!("[{}]", ["[1,1]"; MAX_WAY + 1].join(","));
    let text = good.replace("[[47,40],[51,40]]", &way);
    let read = MapSegment::from_json(text.as_bytes());
    assert_eq!(read, Err(DecodeError::OutOfRange));
}

proptest! {
    /// What any other implementation writes for these bytes is what we write, and both are read.
    #[test]
    fn cells_are_base64(groups in proptest::collection::vec(any::<[u8; 3]>(), 1..=128)) {
        const ALPHABET: &[u8] =
            b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let bytes = groups.as_flattened();
        // Bit by bit, as RFC 4648 says it.
        let bits: Vec<u8> = bytes
            .iter()
            .flat_map(|byte| (0..8).rev().map(move |bit| byte >> bit & 1))
            .collect();
        let text: String = bits
            .chunks(6)
            .map(|six| six.iter().fold(0, |value, bit| value << 1 | usize::from(*bit)))
            .map(|value| char::from(ALPHABET[value]))
            .collect();
        let written = json(&segment(24, bytes));
        let quoted = format!("\"cells\":\"{text}\"");
        prop_assert!(written.contains(&quoted));
        let read = MapSegment::from_json(written.as_bytes()).unwrap();
        prop_assert_eq!(read.cells.as_slice(), bytes);
    }
}
