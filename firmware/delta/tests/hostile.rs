//! Patches that no tool would make.

use crawler_delta::{Decoder, DeltaError, Step};
use proptest::prelude::*;

use crate::support::{apply, heatshrink, number, patch, record};

const OLD: &[u8] = b"0123456789";

fn read(new: usize, patch: &[u8]) -> Result<Vec<u8>, DeltaError> {
    let made = apply(OLD, new, patch, 1, 1);
    assert_eq!(made, apply(OLD, new, patch, 9_999, 9_999));
    made
}

#[test]
fn records_do_what_they_say() {
    let contents = [
        &[0][..],
        // From the third byte on; two of them one higher, then a byte as it is, then back.
        &record(b"", b"", 3),
        &record(&[1, 1, 0], b"-", -6),
        // The whole of the old image, with every overflow.
        &record(&[0xD0; 10], b"", -10),
        &record(b"", b"end", 10),
    ];
    let made = read(17, &patch(17, &contents));
    assert_eq!(
        made.as_deref(),
        Ok(&b"455-\0\x01\x02\x03\x04\x05\x06\x07\x08\x09end"[..])
    );
}

#[test]
fn each_fault_has_its_name() {
    let good = patch(3, &[&[0], &record(b"", b"abc", 0)]);
    assert_eq!(read(3, &good).as_deref(), Ok(&b"abc"[..]));
    let mut other = good.clone();
    for kind in (0..=u8::MAX).filter(|kind| *kind != 0x04) {
        other[0] = kind;
        assert_eq!(read(3, &other), Err(DeltaError::Type), "{kind:#04x}");
    }
    let zeros = |length: usize| vec![0; length];
    let much = i64::from(i32::MAX);
    for (expected, new, patch) in [
        (DeltaError::Size, 4, good.clone()),
        (DeltaError::Size, 2, good.clone()),
        (DeltaError::Size, 3, vec![0x04, 0x00]),
        (DeltaError::Number, 3, [&[0x04][..], &number(-3)].concat()),
        (
            DeltaError::Number,
            3,
            [0x04, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF].to_vec(),
        ),
        (DeltaError::Window, 3, vec![0x04, 0x03, 0x70]),
        (DeltaError::Window, 3, vec![0x04, 0x03, 0x67]),
        (DeltaError::DataFormat, 3, patch(3, &[&[1]])),
        (DeltaError::Number, 3, patch(3, &[&number(-1)])),
        // Sizes of both parts.
        (
            DeltaError::TooLong,
            3,
            patch(3, &[&[0], &record(&zeros(4), b"", 0)]),
        ),
        (
            DeltaError::TooLong,
            3,
            patch(3, &[&[0], &record(b"", b"abcd", 0)]),
        ),
        (
            DeltaError::TooLong,
            3,
            patch(3, &[&[0], &record(&zeros(2), b"ab", 0)]),
        ),
        (DeltaError::TooLong, 3, patch(3, &[&[0], &number(much)])),
        (DeltaError::Number, 3, patch(3, &[&[0], &number(-2)])),
        (DeltaError::Number, 3, patch(3, &[&[0], &number(much + 1)])),
        // Outside of the old image, by size and by distance.
        (
            DeltaError::Outside,
            11,
            patch(11, &[&[0], &record(&zeros(11), b"", 0)]),
        ),
        (
            DeltaError::Outside,
            3,
            patch(3, &[&[0], &record(b"", b"", 8), &record(&zeros(3), b"", 0)]),
        ),
        (
            DeltaError::Outside,
            3,
            patch(3, &[&[0], &record(b"", b"", 11)]),
        ),
        (
            DeltaError::Outside,
            3,
            patch(3, &[&[0], &record(b"", b"", -1)]),
        ),
        (
            DeltaError::Outside,
            3,
            patch(3, &[&[0], &record(b"", b"a", much)]),
        ),
        (
            DeltaError::Outside,
            3,
            patch(3, &[&[0], &record(b"", b"a", -much)]),
        ),
        // A number goes on over the end of what may follow it.
        (DeltaError::Number, 3, patch(3, &[&[0], &[0x80; 9]])),
        (
            DeltaError::Trailing,
            3,
            patch(3, &[&[0], &record(b"", b"abc", 0), b"d"]),
        ),
        (DeltaError::Trailing, 3, [&good[..], b"d"].concat()),
        (DeltaError::CutOff, 3, good[..good.len() - 1].to_vec()),
        (DeltaError::CutOff, 3, vec![]),
    ] {
        assert_eq!(read(new, &patch), Err(expected), "{patch:02x?}");
    }
}

#[test]
fn the_largest_numbers_do_not_overflow() {
    let most = u32::MAX;
    for (old, new) in [(most, most), (most, 0), (0, most), (0, 0)] {
        let mut decoder = Decoder::new(old, new);
        let text = patch(i64::from(i32::MAX), &[]);
        assert_eq!(
            decoder.step(&mut &text[..], &mut [0]),
            Err(DeltaError::Size)
        );
    }
    // 2 GiB from 4: what is read lies where it should.
    let far = i64::from(i32::MAX);
    let text = patch(
        far,
        &[
            &[0],
            &record(b"", b"", far),
            &record(b"", b"", far),
            &record(&[7], b"", 0),
        ],
    );
    let (mut decoder, mut out) = (Decoder::new(most, i32::MAX as u32), [0; 4]);
    let mut rest = &text[..];
    let made = loop {
        match decoder.step(&mut rest, &mut out) {
            Ok(Step::Made { length: 0, .. }) => {}
            other => break other,
        }
    };
    let old = Some(2 * i32::MAX as u32);
    assert_eq!(made, Ok(Step::Made { length: 1, old }));
    assert_eq!(out[0], 7);
}

/// Records that make nothing: a few bits of a copy stand for hundreds of them.
#[test]
fn records_without_an_end_come_to_one() {
    // A zero, and copies of it, 512 bytes in 20 bits; not one of them belongs to the image.
    let mut bits = vec![1; 1];
    bits.extend([0; 8]);
    for _ in 0..10_000 {
        bits.extend([0; 11]);
        bits.extend([1; 9]);
    }
    let stream = bits
        .chunks(8)
        .map(|bits| bits.iter().fold(0, |byte, bit| byte << 1 | bit));
    let new = 1_000;
    let mut patch = [&[0x04][..], &number(new), &[0x66]].concat();
    patch.extend(stream);
    let mut decoder = Decoder::new(10, new as u32);
    let (mut rest, mut steps) = (&patch[..], 0);
    let error = loop {
        match decoder.step(&mut rest, &mut [0; 16]) {
            Ok(Step::Made {
                length: 0,
                old: None,
            }) => steps += 1,
            Ok(other) => panic!("{other:?}"),
            Err(error) => break error,
        }
    };
    assert_eq!(error, DeltaError::Records);
    assert_eq!(steps, new);
    // And there it stays.
    assert_eq!(decoder.step(&mut &[0][..], &mut [0]), Err(error));
    assert_eq!(decoder.finish(), Err(error));
}

#[test]
fn an_empty_buffer_takes_nothing() {
    let text = patch(3, &[&[0], &record(b"", b"abc", 0)]);
    let (mut decoder, mut rest) = (Decoder::new(0, 3), &text[..]);
    for _ in 0..3 {
        let step = decoder.step(&mut rest, &mut []);
        assert_eq!(
            step,
            Ok(Step::Made {
                length: 0,
                old: None
            })
        );
    }
    let mut out = [0; 3];
    let step = decoder.step(&mut rest, &mut out);
    assert_eq!(
        step,
        Ok(Step::Made {
            length: 3,
            old: None
        })
    );
    assert_eq!(&out, b"abc");
}

#[test]
fn codes_are_words() {
    let mut codes: Vec<_> = DeltaError::ALL.map(DeltaError::code).into();
    for (code, error) in codes.iter().zip(DeltaError::ALL) {
        assert!(
            code.bytes()
                .all(|byte| byte == b'_' || byte.is_ascii_lowercase())
        );
        assert!(code.starts_with("delta_") && !error.to_string().is_empty());
    }
    codes.sort_unstable();
    codes.dedup();
    assert_eq!(codes.len(), DeltaError::ALL.len());
}

proptest! {
    /// Any bytes, behind a head that is right: one step after the other, and an end.
    #[test]
    fn any_bytes_are_read_to_an_end(
        stream in prop::collection::vec(any::<u8>(), 0..400),
        parameters in prop::sample::select(vec![0x00, 0x44, 0x63, 0x66]),
        new in 1_usize..5_000,
        pieces in (1_usize..50, 1_usize..50),
    ) {
        let patch = [&[0x04][..], &number(new as i64), &[parameters], &stream].concat();
        let one = apply(&[7; 900], new, &patch, pieces.0, pieces.1);
        prop_assert_eq!(&one, &apply(&[7; 900], new, &patch, 9_999, 9_999));
        if let Ok(made) = one {
            prop_assert_eq!(made.len(), new);
        }
    }

    /// Any bytes as records: the same, and what is made is what they say.
    #[test]
    fn any_records_are_read_to_an_end(
        records in prop::collection::vec(0_u8..20, 0..300),
        new in 1_usize..200,
    ) {
        let contents = [&[0][..], &records].concat();
        let patch = [&[0x04][..], &number(new as i64), &[0x11], &heatshrink(&contents)].concat();
        let made = apply(OLD, new, &patch, 1, 1);
        prop_assert_eq!(made, model(OLD, new, &records));
    }
}

/// What records make, read in the plainest way; their numbers have one byte each and no sign.
fn model(old: &[u8], new: usize, records: &[u8]) -> Result<Vec<u8>, DeltaError> {
    let mut rest = records.iter().copied();
    let mut next = || rest.next().map(usize::from).ok_or(DeltaError::CutOff);
    let (mut made, mut at) = (vec![], 0);
    for _ in 0..=new {
        let size = next()?;
        if made.len() + size > new {
            return Err(DeltaError::TooLong);
        }
        if at + size > old.len() {
            return Err(DeltaError::Outside);
        }
        for _ in 0..size {
            made.push((next()? as u8).wrapping_add(old[at]));
            at += 1;
        }
        let size = next()?;
        if made.len() + size > new {
            return Err(DeltaError::TooLong);
        }
        for _ in 0..size {
            made.push(next()? as u8);
        }
        at += next()?;
        if at > old.len() {
            return Err(DeltaError::Outside);
        }
        if made.len() == new {
            return if next().is_ok() {
                Err(DeltaError::Trailing)
            } else {
                Ok(made)
            };
        }
    }
    // Of one record more than the image has bytes, none is needed.
    Err(DeltaError::Records)
}
