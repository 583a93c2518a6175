//! Pictures out of byte streams, whatever the bytes.

use std::vec;
use std::vec::Vec;

use proptest::prelude::*;

use super::super::framing::{Frame, Verdict};
use super::super::jpeg::{Step, Walker};
use super::bench::JPEG;

/// The JPEG found in `bytes`, given in pieces of `piece` bytes.
fn find(bytes: &[u8], piece: usize, room: usize) -> (Verdict, Vec<u8>) {
    let mut buffer = vec![0xA5; room];
    let mut frame = Frame::jpeg(&mut buffer);
    for piece in bytes.chunks(piece) {
        let verdict = frame.take(piece);
        if verdict != Verdict::More {
            return (verdict, buffer);
        }
    }
    (Verdict::More, buffer)
}

#[test]
fn padding_and_cut_pieces_do_not_matter() {
    for before in [&[][..], &[0], &[0xFF], &[0xFF, 0xFF], &[0xD8, 0xFF, 0x00]] {
        for piece in 1..30 {
            let stream = [before, JPEG, &[0xFF, 0xD9, 0, 0]].concat();
            let (verdict, buffer) = find(&stream, piece, 100);
            assert_eq!(verdict, Verdict::Whole(JPEG.len()), "{before:?} {piece}");
            assert_eq!(&buffer[..JPEG.len()], JPEG);
        }
    }
}

#[test]
fn what_breaks_off_does_not_hide_the_next() {
    for cut in 3..JPEG.len() {
        let mut buffer = vec![0; 64];
        let mut frame = Frame::jpeg(&mut buffer);
        assert_eq!(frame.take(&JPEG[..cut]), Verdict::More, "{cut}");
        assert_eq!(frame.end(Verdict::More), Verdict::More);
        assert_eq!(frame.take(JPEG), Verdict::Whole(JPEG.len()), "{cut}");
        assert_eq!(&buffer[..JPEG.len()], JPEG);
    }
}

#[test]
fn a_length_that_is_none_is_no_jpeg() {
    for length in [0, 1_u8] {
        let mut walker = Walker::new();
        let steps: Vec<Step> = [0xFF, 0xD8, 0xFF, 0xE0, 0, length]
            .into_iter()
            .map(|byte| walker.step(byte))
            .collect();
        assert_eq!(steps[5], Step::Broken);
    }
}

#[test]
fn a_jpeg_that_does_not_fit_is_told_from_one_without_end() {
    let (verdict, _) = find(JPEG, 7, JPEG.len() - 1);
    assert_eq!(verdict, Verdict::TooLarge);
    let mut buffer = vec![0; 10];
    let mut frame = Frame::jpeg(&mut buffer);
    assert_eq!(frame.take(&JPEG[..JPEG.len() - 2]), Verdict::More);
    assert_eq!(frame.end(Verdict::More), Verdict::TooLarge);
}

proptest! {
    #[test]
    fn any_bytes_give_a_jpeg_or_nothing_and_stay_in_the_buffer(
        bytes in proptest::collection::vec(
            prop_oneof![Just(0xFF), Just(0xD8), Just(0xD9), Just(0xDA), Just(0), any::<u8>()],
            0..300,
        ),
        piece in 1..40_usize,
        room in 0..64_usize,
    ) {
        let (verdict, buffer) = find(&bytes, piece, room);
        prop_assert_eq!(buffer.len(), room);
        if let Verdict::Whole(len) = verdict {
            let jpeg = &buffer[..len];
            prop_assert!(jpeg.starts_with(&[0xFF, 0xD8]) && jpeg.ends_with(&[0xFF, 0xD9]));
            prop_assert!(bytes.windows(len).any(|part| part == jpeg));
        }
        prop_assert_eq!(find(&bytes, 300, room).0, verdict);
    }

    #[test]
    fn frames_of_pixels_are_whole_or_dropped(
        lengths in proptest::collection::vec(0..40_usize, 1..8),
        piece in 1..13_usize,
        luma: bool,
    ) {
        let mut buffer = [0_u8; 16];
        let wanted = if luma { 32 } else { 16 };
        let mut frame = if luma {
            Frame::luma_of_yuyv(&mut buffer)
        } else {
            Frame::bytes(&mut buffer)
        };
        for (number, &length) in lengths.iter().enumerate() {
            let bytes: Vec<u8> = (0..length).map(|i| (number * 50 + i) as u8).collect();
            for piece in bytes.chunks(piece) {
                prop_assert_eq!(frame.take(piece), Verdict::More);
            }
            let verdict = frame.end(Verdict::More);
            let whole = length == wanted;
            prop_assert_eq!(verdict == Verdict::Whole(16), whole);
            if whole {
                let step = wanted / 16;
                let right = buffer.iter().enumerate().all(|(i, &b)| b == bytes[i * step]);
                prop_assert!(right);
                return Ok(());
            }
        }
    }
}
