//! From pixels to things, each step against a plainer way to do the same.

use core::f32::consts::{FRAC_PI_4, FRAC_PI_6};
use std::string::ToString;
use std::vec;
use std::vec::Vec;

use crawler_detector::BLOB;
use crawler_hal::{FrameFormat, Instant};
use crawler_micromodel::{ModelError, Shape, best};
use embassy_futures::block_on;
use proptest::prelude::*;

use super::*;

const CELLS: Shape = Shape {
    height: 12,
    width: 12,
    channels: 4,
};
const INPUT: Shape = Shape {
    height: 96,
    width: 96,
    channels: 3,
};

/// Class, middle and lead of every thing, in the order of their first cells: the flood fill that
/// the detector was judged with.
fn flooded(output: &[i8], shape: Shape) -> Vec<(usize, f64, f64, u8)> {
    let (columns, rows) = (i64::from(shape.width), i64::from(shape.height));
    let mut open: Vec<(usize, u8)> = output
        .chunks(usize::from(shape.channels))
        .map(|logits| {
            let mut sorted = logits.to_vec();
            sorted.sort_unstable();
            let top = i16::from(sorted[sorted.len() - 1]);
            let margin = (top - i16::from(sorted[sorted.len() - 2])) as u8;
            let class = logits.iter().position(|&logit| i16::from(logit) == top);
            let class = class.filter(|_| margin >= LEAST_MARGIN).unwrap_or(0);
            (class, margin)
        })
        .collect();
    let mut found = Vec::new();
    for start in 0..open.len() {
        let class = open[start].0;
        if class == 0 {
            continue;
        }
        let mut stack = vec![(start as i64 / columns, start as i64 % columns)];
        let (mut weights, mut x, mut y, mut clearest) = (0.0, 0.0, 0.0, 0);
        while let Some((row, column)) = stack.pop() {
            let inside = (0..rows).contains(&row) && (0..columns).contains(&column);
            let at = (row * columns + column) as usize;
            if !inside || open[at].0 != class {
                continue;
            }
            open[at].0 = 0;
            let weight = f64::from(open[at].1) + 1.0;
            weights += weight;
            x += weight * column as f64;
            y += weight * row as f64;
            clearest = clearest.max(open[at].1);
            stack.extend((-1..=1).flat_map(|r| (-1..=1).map(move |c| (row + r, column + c))));
        }
        let x = (x / weights + 0.5) / columns as f64;
        let y = (y / weights + 0.5) / rows as f64;
        found.push((class, x, y, clearest));
    }
    found
}

fn logits() -> impl Strategy<Value = (Shape, Vec<i8>)> {
    // Few different values, so that things grow large and margins are often around the least one.
    let value = prop_oneof![8 => -6_i8..6, 1 => any::<i8>(), 4 => Just(0_i8)];
    (1_u16..=16, 1_u16..=16).prop_flat_map(move |(height, width)| {
        let shape = Shape {
            height,
            width,
            channels: 4,
        };
        let values = usize::from(height) * usize::from(width) * 4;
        (Just(shape), prop::collection::vec(value.clone(), values))
    })
}

proptest! {
    #[test]
    fn merging_is_a_flood_fill((shape, output) in logits()) {
        let mut expected = flooded(&output, shape);
        // Stable: of equals those found first.
        expected.sort_by_key(|thing| core::cmp::Reverse(thing.3));
        expected.truncate(MAX_SPOTS);
        let found = spots(&output, shape);
        prop_assert_eq!(found.len(), expected.len());
        for (spot, (class, x, y, margin)) in found.iter().zip(expected) {
            prop_assert_eq!(spot.class, Class::ALL[class - 1]);
            prop_assert_eq!(spot.margin, margin);
            prop_assert!((f64::from(spot.x) - x).abs() < 1e-6, "{} {}", spot.x, x);
            prop_assert!((f64::from(spot.y) - y).abs() < 1e-6, "{} {}", spot.y, y);
        }
    }

    /// Whatever shape is claimed for whatever bytes.
    #[test]
    fn no_output_is_a_panic(
        output in prop::collection::vec(any::<i8>(), 0..2_000),
        height in any::<u16>(), width in any::<u16>(), channels in any::<u16>(),
    ) {
        let found = spots(&output, Shape { height, width, channels });
        prop_assert!(found.is_empty() || output.len() == usize::from(height) * usize::from(width) * 4);
    }

    /// Of any size, against means in floating point.
    #[test]
    fn a_row_holds_means(
        width in 1_u16..300, height in 1_u16..300, grey in any::<bool>(),
        row in 0_usize..96, column in 0_usize..96, seed in any::<u32>(),
    ) {
        let format = if grey { FrameFormat::Grey8 } else { FrameFormat::Rgb565 };
        let size = (width, height);
        let mut state = seed | 1;
        let bytes: Vec<u8> = (0..frame_bytes(size, format).expect("a size"))
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 17;
                state ^= state << 5;
                state as u8
            })
            .collect();
        let picture = Picture::new(&bytes, size, format).expect("a frame");
        let mut out = [0; 288];
        picture.fill(INPUT, row, &mut out);
        let span = |at: usize, from: u16| {
            let begin = at * usize::from(from) / 96;
            begin..((at + 1) * usize::from(from) / 96).max(begin + 1)
        };
        for channel in 0..3 {
            let (mut sum, mut count) = (0.0, 0.0);
            for y in span(row, height) {
                for x in span(column, width) {
                    let at = y * usize::from(width) + x;
                    sum += if grey {
                        f64::from(bytes[at])
                    } else {
                        let word = u16::from_be_bytes([bytes[2 * at], bytes[2 * at + 1]]);
                        let five = |v: u16| f64::from((v & 31) << 3 | (v & 31) >> 2);
                        match channel {
                            0 => five(word >> 11),
                            1 => f64::from((word >> 5 & 63) << 2 | (word >> 5 & 63) >> 4),
                            _ => five(word),
                        }
                    };
                    count += 1.0;
                }
            }
            let mean = (sum / count + 0.5).floor() - 128.0;
            prop_assert_eq!(f64::from(out[column * 3 + channel]), mean);
        }
    }

    /// What a point of the world looks like is where the world has it.
    #[test]
    fn bearing_and_floor_undo_the_projection(
        half_view in 0.2_f32..0.7, pitch in -0.3_f32..0.6, height in 0.03_f32..0.3,
        forward in 0.3_f32..3.0, left in -0.3_f32..0.3, aspect in 0.5_f32..1.0,
    ) {
        let lens = Lens { half_view, pitch, height_m: height, forward_m: 0.02 };
        // In the frame of the camera: turned down by its pitch.
        let depth = forward * pitch.cos() + height * pitch.sin();
        let up = forward * pitch.sin() - height * pitch.cos();
        prop_assume!(depth > 0.05);
        let x = 0.5 - 0.5 * left / depth / half_view.tan();
        let y = 0.5 - 0.5 * up / depth / half_view.tan() / aspect;
        let bearing = lens.bearing(x, y, aspect);
        prop_assert!((bearing - left.atan2(forward)).abs() < 1e-3);
        let [at, beside] = lens.floor(x, y, aspect).expect("it is on the floor");
        prop_assert!((at - 0.02 - forward).abs() < 0.01 * forward * forward / height);
        prop_assert!((beside - left).abs() < 0.01 * forward / height);
    }

    #[test]
    fn no_lens_and_no_place_is_a_panic(
        half_view in any::<f32>(), pitch in any::<f32>(), height_m in any::<f32>(),
        x in any::<f32>(), y in any::<f32>(), aspect in any::<f32>(),
    ) {
        let lens = Lens { half_view, pitch, height_m, forward_m: 0.0 };
        lens.bearing(x, y, aspect);
        if let Some(place) = lens.floor(x, y, aspect) {
            prop_assert!(place.iter().all(|metres| metres.is_finite()));
        }
    }
}

#[test]
fn cells_that_touch_at_a_corner_are_one_thing_and_classes_do_not_mix() {
    let mut output = vec![0; 576];
    let mut set = |row: usize, column: usize, class: usize, lead: i8| {
        output[(row * 12 + column) * 4 + class] = lead;
    };
    set(2, 3, 2, 19);
    set(3, 4, 2, 39);
    // Beside it, of another class; and one that is not decided.
    set(3, 5, 3, 60);
    set(8, 8, 1, 15);
    let found = spots(&output, CELLS);
    assert_eq!(found.len(), 2);
    assert_eq!((found[0].class, found[0].margin), (Class::Robot, 60));
    assert_eq!((found[1].class, found[1].margin), (Class::Object, 39));
    // A third of the weight in the one cell and two thirds in the other.
    assert!((found[1].x - (3.0 + 2.0 / 3.0 + 0.5) / 12.0).abs() < 1e-6);
    assert!((found[1].y - (2.0 + 2.0 / 3.0 + 0.5) / 12.0).abs() < 1e-6);
}

#[test]
fn the_clearest_of_many_remain() {
    let mut output = vec![0; 576];
    for at in 0..36 {
        let (row, column) = (at / 6 * 2, at % 6 * 2);
        output[(row * 12 + column) * 4 + 1] = 10 + (at * 7 % 36) as i8;
    }
    let margins: Vec<u8> = spots(&output, CELLS).iter().map(|s| s.margin).collect();
    assert_eq!(margins, [45, 44, 43, 42, 41, 40, 39, 38]);
}

#[test]
fn a_frame_of_the_wrong_size_is_an_error() {
    let bytes = vec![0; 96 * 96 * 2];
    let frame = |len: usize, size, format| Picture::new(&bytes[..len], size, format).err();
    assert_eq!(frame(96 * 96, (96, 96), FrameFormat::Grey8), None);
    assert_eq!(frame(96 * 96 * 2, (96, 96), FrameFormat::Rgb565), None);
    let length = Some(PictureError::Length);
    assert_eq!(frame(96 * 96 - 1, (96, 96), FrameFormat::Grey8), length);
    assert_eq!(frame(96 * 96, (96, 96), FrameFormat::Rgb565), length);
    assert_eq!(frame(0, (96, 96), FrameFormat::Grey8), length);
    let size = Some(PictureError::Size);
    for sides in [(0, 96), (96, 0), (2_049, 1), (u16::MAX, u16::MAX)] {
        assert_eq!(frame(0, sides, FrameFormat::Rgb565), size, "{sides:?}");
    }
}

#[test]
fn rows_that_there_are_not_are_left_alone() {
    let picture = Picture::new(&[255], (1, 1), FrameFormat::Grey8).expect("a frame");
    let mut out = [7; 300];
    picture.fill(INPUT, 96, &mut out);
    assert_eq!(out, [7; 300]);
    picture.fill(INPUT, 95, &mut out);
    assert_eq!((&out[..288], &out[288..]), (&[127; 288][..], &[7; 12][..]));
}

fn finder(arena: &mut Vec<i8>) -> Finder<'static, '_> {
    let detector = Detector::new(BLOB).expect("the detector");
    arena.resize(detector.arena_bytes(), 0);
    detector.run_in(arena).expect("room")
}

/// Steadily or gently, a frame shows the same; and no frame shows what cannot be.
#[test]
fn every_frame_has_a_clean_answer_that_does_not_depend_on_who_waits() {
    let (mut one, mut other) = (Vec::new(), Vec::new());
    let (mut steady, mut gentle) = (finder(&mut one), finder(&mut other));
    let noise = (0..96 * 96).map(|at: u32| (at.wrapping_mul(2_654_435_761) >> 24) as u8);
    let frames = [vec![0; 96 * 96], vec![255; 96 * 96], noise.collect()];
    for bytes in &frames {
        let picture = Picture::new(bytes, (96, 96), FrameFormat::Grey8).expect("a frame");
        let found = steady.find(&picture);
        assert_eq!(block_on(gentle.find_gently(&picture)), found);
        for spot in &found {
            assert!(spot.margin >= LEAST_MARGIN, "{spot:?}");
            assert!((0.0..1.0).contains(&spot.x) && (0.0..1.0).contains(&spot.y));
        }
    }
}

/// What a dropped look leaves in the arena does not matter.
#[test]
fn a_dropped_look_leaves_nothing_behind() {
    let (mut one, mut other) = (Vec::new(), Vec::new());
    let (mut fresh, mut disturbed) = (finder(&mut one), finder(&mut other));
    let [dark, light] = [vec![9; 96 * 96], vec![200; 96 * 96]];
    let picture = |bytes| Picture::new(bytes, (96, 96), FrameFormat::Grey8).expect("a frame");
    for polls in [1, 50, 300] {
        let mut context = core::task::Context::from_waker(core::task::Waker::noop());
        let dropped = picture(&dark);
        let mut work = std::boxed::Box::pin(disturbed.find_gently(&dropped));
        for _ in 0..polls {
            assert!(
                work.as_mut().poll(&mut context).is_pending(),
                "a row at a time"
            );
        }
        drop(work);
        let found = block_on(disturbed.find_gently(&picture(&light)));
        assert_eq!(found, fresh.find(&picture(&light)));
    }
}

#[test]
fn own_eyes_have_room_for_frames_up_to_their_memory() {
    let mut arena = Vec::new();
    let mut memory = vec![0; 96 * 96];
    let mut eyes = OwnEyes::new(finder(&mut arena), &mut memory);
    assert!(eyes.open(96 * 96 + 1).is_none());
    let mut look = eyes.open(96 * 96).expect("room");
    assert_eq!(look.frame().len(), 96 * 96);
    assert!(block_on(look.find((96, 96), FrameFormat::Grey8)).is_ok());
    let look = eyes.open(96 * 96).expect("room again");
    let found = block_on(look.find((96, 96), FrameFormat::Rgb565));
    assert_eq!(found, Err(PictureError::Length));
}

fn crc32(bytes: &[u8]) -> u32 {
    let bit = |crc: u32, _| (crc >> 1) ^ (0xEDB8_8320 * (crc & 1));
    let step = |crc: u32, byte: &u8| (0..8).fold(crc ^ u32::from(*byte), bit);
    !bytes.iter().fold(u32::MAX, step)
}

#[test]
fn what_is_no_detector_is_refused() {
    let cut = Detector::new(&BLOB[..BLOB.len() - 1]).err();
    assert!(matches!(cut, Some(DetectorError::Model(_))), "{cut:?}");
    let detector = Detector::new(BLOB).expect("the detector");
    let needed = detector.arena_bytes();
    assert!(needed <= 64 * 1_024, "{needed} bytes of arena");
    let mut arena = vec![0; needed - 1];
    let refused = detector.run_in(&mut arena).err();
    let small = DetectorError::Model(ModelError::Arena { needed });
    assert_eq!(refused, Some(small));
    // The same model with another word for the same channel.
    let mut other = BLOB.to_vec();
    let at = other
        .windows(6)
        .position(|word| word == b"object")
        .expect("a label");
    other[at] = b'x';
    let checksum = crc32(&other[16..]);
    other[12..16].copy_from_slice(&checksum.to_le_bytes());
    assert_eq!(Detector::new(&other).err(), Some(DetectorError::Labels));
}

#[test]
fn sets_of_classes_are_letters() {
    let mut classes = Classes::default();
    assert_eq!(classes.to_string(), "-");
    for (class, letters) in Class::ALL.into_iter().zip(["b", "bo", "bor"]) {
        assert!(!classes.contains(class));
        classes.insert(class);
        assert!(classes.contains(class));
        assert_eq!(classes.to_string(), letters);
    }
    assert_eq!(best(&[0, 16]).margin, LEAST_MARGIN);
}

const NOW: Instant = Instant::from_millis(9_000);

fn view(x: f32, y: f32, heading: f32) -> View {
    let spot = Spot {
        class: Class::Object,
        x,
        y,
        margin: 30,
    };
    let spots = [spot].into_iter().collect();
    View::new(&spots, &Lens::default(), 1.0, (1, NOW, heading))
}

#[test]
fn what_is_low_and_in_front_is_in_the_way() {
    // Level with the lens: as high as the ranger, which sees it.
    assert_eq!(view(0.5, 0.5, 0.0).in_the_way, None);
    // 5 cm high, half a metre away: its middle is seen 9 % below.
    let far = 0.5 + 0.5 * (0.045 / 0.5) / FRAC_PI_6.tan();
    assert_eq!(view(0.5, far, 0.0).in_the_way, None);
    // At 30 cm it is.
    let near = 0.5 + 0.5 * (0.045 / 0.3) / FRAC_PI_6.tan();
    let low = view(0.5, near, 0.0).in_the_way.expect("in the way");
    assert!(low.ahead(0.0, NOW).expect("ahead").abs() < 1e-6);
    // At the edge of the picture it is beside the way.
    assert_eq!(view(0.05, near, 0.0).in_the_way, None);
    // At the bottom of the picture it is right in front of the wheels.
    assert!(view(0.9, 0.99, 0.0).in_the_way.is_some());
}

#[test]
fn the_way_is_free_again_when_the_robot_has_turned_or_time_has_passed() {
    let low = view(0.5, 0.7, 3.1).in_the_way.expect("in the way");
    let ahead = |theta, ms| {
        let now = NOW + crawler_hal::Duration::from_millis(ms);
        low.ahead(theta, now)
    };
    // The robot has turned to the left: it is to the right.
    assert!(ahead(-3.0, 0).expect("ahead") < 0.0);
    assert!(ahead(3.0, 1_500).expect("ahead") > 0.0);
    assert_eq!(ahead(3.1 - FRAC_PI_4, 0), None);
    assert_eq!(ahead(0.0, 0), None, "behind");
    assert_eq!(ahead(3.1, 1_501), None);
    assert_eq!(ahead(f32::NAN, 0), None);
}

#[test]
fn bearings_are_to_the_left() {
    let lens = Lens::default();
    assert!((lens.bearing(0.0, 0.5, 1.0) - FRAC_PI_6).abs() < 1e-6);
    assert!((lens.bearing(1.0, 0.5, 1.0) + FRAC_PI_6).abs() < 1e-6);
    assert_eq!(view(0.5, 0.4, 0.0).things[0].bearing, 0.0);
}
