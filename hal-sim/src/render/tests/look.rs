//! What looks do to pictures, and what they leave alone.

use proptest::prelude::*;

use super::super::rays::Optics;
use super::*;
use crate::world::{Look, Parameters, Profile};

fn scene() -> Vec<Shape> {
    let coat = |pattern| Coat {
        pattern,
        other: [20, 90, 20],
        ..Coat::default()
    };
    let boxed = Form::Box {
        axis: Vec2::unit(0.5),
        half: Vec2::new(0.1, 0.15),
        height: 0.25,
    };
    let robot = Form::Cylinder {
        radius: 0.085,
        height: 0.12,
    };
    vec![
        Shape {
            coat: coat(Pattern::Checks),
            ..shape(boxed, 1.1, 0.3, BLUE, Seen::Obstacle(0))
        },
        Shape {
            coat: coat(Pattern::Robot),
            front: Some(Vec2::unit(2.5)),
            ..shape(robot, 0.6, -0.1, BLUE, Seen::Robot(1))
        },
        Shape {
            coat: coat(Pattern::Glossy),
            ..shape(Form::Ball { radius: 0.06 }, 0.5, 0.12, RED, Seen::Object(2))
        },
    ]
}

fn taken(lens: Lens, look: Look, motion: Motion, key: u64, shapes: &[Shape]) -> Frame {
    let mut frame = Frame::square();
    let half = Vec2::new(2.0, 2.0);
    frame.scene.set(lens, half, Decor::new(&look));
    frame.scene.look = look;
    frame.scene.shapes.extend(shapes);
    frame.take(motion, key);
    frame
}

fn with(look: Look) -> Frame {
    taken(LENS, look, Motion::default(), 1, &scene())
}

/// A look that a wild world may have.
fn wild(seed: u64) -> Look {
    Parameters::default().randomised(Profile::Wild, seed).look
}

fn truth(frame: &Frame) -> (Vec<Seen>, Vec<f32>) {
    (frame.seen.clone(), frame.depth.clone())
}

fn mean(frame: &Frame, of: impl Fn(u16, u16) -> bool) -> [f32; 3] {
    let (mut sums, mut count) = ([0.0; 3], 0.0_f32);
    for (x, y) in (0..96).flat_map(|y| (0..96).map(move |x| (x, y))) {
        if of(x, y) {
            let colour = frame.colour(x, y).expect("within the frame");
            count += 1.0;
            for (sum, level) in sums.iter_mut().zip(colour) {
                *sum += f32::from(level);
            }
        }
    }
    sums.map(|sum| sum / count)
}

#[test]
fn the_plain_look_is_a_perfect_camera() {
    let frame = with(Look::default());
    assert_eq!(frame.colour(2, 0), Some([196, 208, 222]));
    let (plain, again) = (
        with(Look::default()),
        with(Look {
            seed: 9,
            ..Look::default()
        }),
    );
    assert!(
        plain.rgb() == again.rgb(),
        "a seed without variety changes nothing"
    );
}

#[test]
fn paint_and_camera_leave_the_truth_alone() {
    let plain = with(Look::default());
    for seed in 0..40 {
        let look = Look {
            distortion: 0.0,
            ..wild(seed)
        };
        let motion = Motion { v: 0.3, w: 1.2 };
        let frame = taken(LENS, look, motion, seed, &scene());
        assert!(truth(&frame) == truth(&plain), "{look:?}");
        assert_eq!(frame.spots(), plain.spots());
        assert!(frame.rgb() != plain.rgb());
    }
}

#[test]
fn every_floor_and_wall_is_drawn_by_some_seed_and_is_not_one_colour() {
    let (mut floors, mut walls) = (Vec::new(), Vec::new());
    for seed in 0..200 {
        let look = Look {
            seed,
            variety: 1.0,
            ..Look::default()
        };
        let decor = Decor::new(&look);
        if !floors.contains(&decor.floor()) {
            floors.push(decor.floor());
            let frame = taken(LENS, look, Motion::default(), 1, &[]);
            let mut colours: Vec<[u8; 3]> = (0..96).filter_map(|x| frame.colour(x, 90)).collect();
            colours.sort_unstable();
            colours.dedup();
            let plain = decor.floor() == Floor::Plain;
            assert_eq!(
                colours.len() == 1,
                plain,
                "{:?}: {}",
                decor.floor(),
                colours.len()
            );
        }
        if !walls.contains(&decor.wall()) {
            walls.push(decor.wall());
        }
    }
    assert_eq!(
        (floors.len(), walls.len()),
        (Floor::ALL.len(), Wall::ALL.len())
    );
}

#[test]
fn a_texture_stays_where_it_is_when_the_robot_turns() {
    let look = Look {
        seed: 3,
        variety: 1.0,
        ..Look::default()
    };
    let decor = Decor::new(&look);
    let turned = Lens {
        pose: Pose::new(0.0, 0.0, 0.2),
        ..LENS
    };
    let (ahead, left) = (
        taken(LENS, look, Motion::default(), 1, &[]),
        taken(turned, look, Motion::default(), 1, &[]),
    );
    // The pixel in the middle of the turned picture, found in the other one.
    let column = 48.0 - libm::tanf(0.2) * FOCAL;
    assert_eq!(
        ahead.seen(column as u16, 47),
        left.seen(48, 47),
        "{:?}",
        decor.wall()
    );
    let near = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) < 12);
    let (one, two) = (ahead.colour(column as u16, 47), left.colour(48, 47));
    assert!(
        near(one.expect("a pixel"), two.expect("a pixel")),
        "{one:?} {two:?}"
    );
}

#[test]
fn distortion_moves_the_truth_with_the_pixels() {
    let ball = shape(Form::Ball { radius: 0.03 }, 1.0, 0.45, RED, Seen::Object(0));
    for distortion in [0.0, 0.1, 0.3, 0.5] {
        let lens = Lens { distortion, ..LENS };
        let frame = taken(lens, Look::default(), Motion::default(), 1, &[ball]);
        let spot = frame.spots()[0];
        // s (1 + k s²) = 0.45, and the ball is 40 mm below the lens.
        let mut s = 0.45;
        for _ in 0..40 {
            s = 0.45 / (1.0 + distortion * s * s);
        }
        let column = 48.0 - s * FOCAL;
        assert!(
            (spot.x - column).abs() < 0.8,
            "{distortion}: {spot:?} {column}"
        );
        // The pixels that are named are those that are painted.
        let colour = frame.colour(spot.x as u16, spot.y as u16);
        let [red, green, _] = colour.expect("within the frame");
        assert!(red > 2 * green, "{distortion}: {colour:?}");
    }
}

#[test]
fn exposure_saturates_and_corners_are_dark() {
    let sky = |_: u16, y: u16| y < 4;
    let plain = mean(&with(Look::default()), sky)[1];
    let mut last = 0.0;
    for exposure in [0.1, 0.5, 1.0, 1.2, 8.0] {
        let look = Look {
            exposure,
            ..Look::default()
        };
        let level = mean(&with(look), sky)[1];
        assert!(
            (level - (plain * exposure).min(255.0)).abs() < 1.0,
            "{exposure}: {level}"
        );
        assert!(level > last);
        last = level;
    }
    let dark = with(Look {
        vignette: 0.5,
        ..Look::default()
    });
    let corner = dark.colour(0, 0).expect("a pixel")[1];
    assert!((f32::from(corner) - 0.5 * plain).abs() < 4.0, "{corner}");
    assert_eq!(dark.colour(48, 47), with(Look::default()).colour(48, 47));
    let warm = Look {
        warmth: 0.2,
        exposure: 0.8,
        ..Look::default()
    };
    let [red, green, blue] = mean(&with(warm), sky);
    assert!(
        (red / green - 1.2 * 196.0 / 208.0).abs() < 0.02,
        "{red} {green}"
    );
    assert!(
        (blue / green - 0.8 * 222.0 / 208.0).abs() < 0.02,
        "{blue} {green}"
    );
}

#[test]
fn noise_has_the_deviation_it_says() {
    let clean = taken(LENS, Look::default(), Motion::default(), 1, &[]);
    let floor = |x: u16, y: u16| clean.seen(x, y) == Some(Seen::Floor);
    for (shot_noise, read_noise) in [(0.0, 3.0), (0.5, 0.0), (0.5, 4.0)] {
        let look = Look {
            shot_noise,
            read_noise,
            ..Look::default()
        };
        let noisy = taken(LENS, look, Motion::default(), 7, &[]);
        let wanted = clean.colour(48, 95).expect("a pixel").map(f32::from);
        let found = mean(&noisy, floor);
        for channel in 0..3 {
            let level = wanted[channel];
            assert!((found[channel] - level).abs() < 0.4, "{level}: {found:?}");
            let mut sum = 0.0;
            let mut count = 0.0_f32;
            for (x, y) in (0..96).flat_map(|y| (0..96).map(move |x| (x, y))) {
                if floor(x, y) {
                    let off = f32::from(noisy.colour(x, y).expect("a pixel")[channel]) - level;
                    sum += off * off;
                    count += 1.0;
                }
            }
            let variance = read_noise * read_noise + shot_noise * shot_noise * level;
            let ratio = sum / count / variance;
            assert!((0.9..1.12).contains(&ratio), "{look:?}: {ratio}");
        }
        let again = taken(LENS, look, Motion::default(), 7, &[]);
        let other = taken(LENS, look, Motion::default(), 8, &[]);
        assert!(noisy.rgb() == again.rgb() && noisy.rgb() != other.rgb());
    }
}

#[test]
fn motion_blurs_along_itself_around_the_middle() {
    let post = post(1.0, 0.0, 0.1, 0.3, Seen::Obstacle(0));
    let look = Look {
        shutter_ms: 30.0,
        ..Look::default()
    };
    let still = taken(LENS, look, Motion::default(), 1, &[post]);
    let turning = taken(LENS, look, Motion { v: 0.0, w: 1.8 }, 1, &[post]);
    let edge = |frame: &Frame| {
        // Levels between post and wall along the horizon.
        let red: Vec<i16> = (0..96)
            .map(|x| i16::from(frame.colour(x, 46).expect("a pixel")[1]))
            .collect();
        red.windows(2).filter(|pair| pair[0] != pair[1]).count()
    };
    assert!(
        edge(&turning) >= edge(&still) + 4,
        "{} {}",
        edge(&turning),
        edge(&still)
    );
    // Floor and sky, the same along a row, stay what they are.
    assert_eq!(still.colour(48, 95), turning.colour(48, 95));
    assert_eq!(still.colour(5, 2), turning.colour(5, 2));
    // The dark of the post stays around its middle.
    let middle = |frame: &Frame| {
        let dark = |x: u16| 255.0 - f32::from(frame.colour(x, 46).expect("a pixel")[1]);
        let sum: f32 = (30..66).map(dark).sum();
        (30..66)
            .map(|x| (f32::from(x) + 0.5) * dark(x))
            .sum::<f32>()
            / sum
    };
    assert!((middle(&still) - middle(&turning)).abs() < 0.2);
    let unmoved = taken(LENS, Look::default(), Motion { v: 0.4, w: 2.0 }, 1, &[post]);
    assert!(
        unmoved.rgb() == still.rgb(),
        "a shutter of no time freezes everything"
    );
    let driving = taken(
        LENS,
        look,
        Motion { v: 0.4, w: 0.0 },
        1,
        &[self::post(0.2, 0.05, 0.05, 0.3, Seen::Obstacle(0))],
    );
    let frozen = taken(
        LENS,
        look,
        Motion::default(),
        1,
        &[self::post(0.2, 0.05, 0.05, 0.3, Seen::Obstacle(0))],
    );
    assert!(driving.rgb() != frozen.rgb() && driving.spots() == frozen.spots());
}

#[test]
fn it_is_darker_under_things() {
    let look = Look {
        seed: 2,
        variety: 0.6,
        ..Look::default()
    };
    let ball = shape(Form::Ball { radius: 0.06 }, 0.45, 0.0, RED, Seen::Object(0));
    let (with, without) = (
        taken(LENS, look, Motion::default(), 1, &[ball]),
        taken(LENS, look, Motion::default(), 1, &[]),
    );
    let rows = (0..96).filter(|&y| with.seen(48, y) == Some(Seen::Object(0)));
    let below = rows.max().expect("it is seen") + 1;
    let level = |frame: &Frame, y| frame.colour(48, y).expect("a pixel")[1];
    assert!(level(&with, below) < level(&without, below));
    assert_eq!(
        level(&with, 95),
        level(&without, 95),
        "far from it nothing changes"
    );
    assert_eq!(with.seen(48, below), Some(Seen::Floor));
}

#[test]
fn the_census_knows_what_is_hidden_and_what_is_cut() {
    let far = post(1.5, 0.0, 0.15, 0.25, Seen::Obstacle(0));
    let free = taken(LENS, Look::default(), Motion::default(), 1, &[far]);
    let truths = free.truths();
    assert_eq!((truths[0].visible, truths[0].inside), (1.0, 1.0));
    assert_eq!(truths[0].spot, free.spots()[0]);
    // A box before its right half.
    let half = Form::Box {
        axis: Vec2::unit(0.0),
        half: Vec2::new(0.01, 0.2),
        height: 0.5,
    };
    let screen = shape(half, 0.8, -0.2, BLUE, Seen::Obstacle(1));
    let hidden = taken(LENS, Look::default(), Motion::default(), 1, &[far, screen]).truths();
    assert!((hidden[0].visible - 0.5).abs() < 0.06, "{hidden:?}");
    assert!((hidden[0].inside - 1.0).abs() < 1e-6);
    assert!((hidden[1].visible - 1.0).abs() < 1e-6);
    // At the edge of the picture.
    let edge = post(
        1.0,
        libm::tanf(LENS.half_view),
        0.1,
        0.15,
        Seen::Obstacle(0),
    );
    let cut = taken(LENS, Look::default(), Motion::default(), 1, &[edge]).truths();
    assert!((cut[0].inside - 0.5).abs() < 0.08, "{cut:?}");
    assert!((cut[0].visible - 1.0).abs() < 1e-6);
}

fn form(kind: u8, a: f32, b: f32, height: f32, turn: f32) -> Form {
    match kind {
        0 => Form::Cylinder { radius: a, height },
        1 => Form::Ball { radius: a },
        2 => Form::Cone { radius: a, height },
        _ => Form::Box {
            axis: Vec2::unit(turn),
            half: Vec2::new(a, b),
            height,
        },
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(96))]

    /// Only pixels that may show a shape are looked at; none is forgotten.
    #[test]
    fn no_pixel_of_a_shape_is_missed(
        kind in 0_u8..4, a in 0.02_f32..0.4, b in 0.02_f32..0.4, height in 0.02_f32..0.5,
        turn in -3.0_f32..3.0, x in -0.2_f32..1.9, y in -1.5_f32..1.5,
        pitch in -0.5_f32..0.5, distortion in 0.0_f32..0.5,
    ) {
        let lens = Lens { pitch, distortion, ..LENS };
        let one = shape(form(kind, a, b, height, turn), x, y, RED, Seen::Obstacle(0));
        let room = taken(lens, Look::default(), Motion::default(), 1, &[]);
        let frame = taken(lens, Look::default(), Motion::default(), 1, &[one]);
        let optics = Optics::new(&lens, 96, 96);
        for row in 0..96_u16 {
            for column in 0..96_u16 {
                let hit = one.hit(lens.height, optics.ray(i32::from(column), i32::from(row)));
                let behind = room.depth(column, row).expect("a pixel");
                let shows = hit.is_some_and(|hit| hit.along < behind);
                let seen = frame.seen(column, row) == Some(Seen::Obstacle(0));
                prop_assert_eq!(shows, seen, "({}, {})", column, row);
            }
        }
    }

    /// Any look that a world may have gives a picture, and the same one again, with the same truth.
    #[test]
    fn every_look_is_repeatable(
        seed in 0_u32..16_777_216, variety in 0.0_f32..=1.0, distortion in 0.0_f32..=0.5,
        shutter_ms in 0.0_f32..=100.0, exposure in 0.1_f32..=8.0, warmth in -0.5_f32..=0.5,
        vignette in 0.0_f32..=0.9, shot_noise in 0.0_f32..=8.0, read_noise in 0.0_f32..=64.0,
        v in -1.0_f32..1.0, w in -6.0_f32..6.0, key: u64,
    ) {
        let look = Look {
            seed, variety, distortion, shutter_ms, exposure, warmth, vignette, shot_noise,
            read_noise,
        };
        let lens = Lens { distortion, ..LENS };
        let motion = Motion { v, w };
        let frame = taken(lens, look, motion, key, &scene());
        let again = taken(lens, look, motion, key, &scene());
        prop_assert!(frame.rgb() == again.rgb());
        let plain = taken(lens, Look::default(), Motion::default(), 0, &scene());
        prop_assert!(truth(&frame) == truth(&plain));
    }
}
