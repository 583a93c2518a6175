//! Known scenes, and what has to be seen of them.

mod look;

use super::coat::Pattern;
use super::*;
use crate::world::{Pose, Vec2};

const LENS: Lens = Lens {
    pose: Pose::new(0.0, 0.0, 0.0),
    height: 0.07,
    pitch: 0.0,
    half_view: core::f32::consts::FRAC_PI_6,
    distortion: 0.0,
};

/// Focal length of the square frame in pixels: 48 ÷ tan 30°.
const FOCAL: f32 = 83.138;

const RED: [u8; 3] = [200, 30, 30];
const BLUE: [u8; 3] = [30, 70, 190];

fn shape(form: Form, x: f32, y: f32, colour: [u8; 3], of: Seen) -> Shape {
    Shape {
        form,
        at: Vec2::new(x, y),
        colour,
        front: None,
        coat: Coat::default(),
        of,
    }
}

fn post(x: f32, y: f32, radius: f32, height: f32, of: Seen) -> Shape {
    shape(Form::Cylinder { radius, height }, x, y, RED, of)
}

fn picture(lens: Lens, shapes: &[Shape]) -> Frame {
    let mut frame = Frame::square();
    frame.scene.set(lens, Vec2::new(4.0, 4.0), Decor::default());
    frame.scene.shapes.extend(shapes);
    paint(&mut frame);
    frame
}

/// First and last row or column in which something is seen.
fn extent(frame: &Frame, of: Seen) -> ([u16; 2], [u16; 2]) {
    let all = (0..96_u16).flat_map(|y| (0..96_u16).map(move |x| (x, y)));
    let shown: Vec<_> = all.filter(|&(x, y)| frame.seen(x, y) == Some(of)).collect();
    let columns = shown.iter().map(|&(x, _)| x);
    let rows = shown.iter().map(|&(_, y)| y);
    (
        [
            columns.clone().min().expect("it is seen"),
            columns.max().expect("it is seen"),
        ],
        [
            rows.clone().min().expect("it is seen"),
            rows.max().expect("it is seen"),
        ],
    )
}

fn near(pixel: u16, place: f32) {
    let off = f32::from(pixel) + 0.5 - place;
    assert!(off.abs() <= 1.0, "pixel {pixel} for {place}");
}

#[test]
fn an_empty_room_is_floor_wall_and_sky_where_they_belong() {
    let frame = picture(LENS, &[]);
    assert_eq!(frame.rgb().len(), 96 * 96 * 3);
    assert_eq!(frame.seen(48, 95), Some(Seen::Floor));
    assert_eq!(
        frame.seen(48, 47),
        Some(Seen::Wall),
        "the horizon is a wall"
    );
    assert_eq!(frame.seen(48, 0), Some(Seen::Sky));
    let (_, rows) = extent(&frame, Seen::Wall);
    // Four metres ahead: 0.23 m above the lens and 0.07 m below it.
    near(rows[0], 48.0 - 0.23 / 4.0 * FOCAL);
    near(rows[1], 48.0 + 0.07 / 4.0 * FOCAL);
    let depth = frame.depth(48, 47).expect("within the frame");
    assert!((depth - 4.0).abs() < 1e-4, "{depth}");
    assert!(frame.depth(48, 0).is_some_and(f32::is_infinite));
    assert_eq!(frame.seen(96, 0), None);
    assert!(frame.spots().is_empty());
}

#[test]
fn a_post_is_where_perspective_puts_it() {
    let frame = picture(LENS, &[post(1.0, 0.25, 0.1, 0.2, Seen::Obstacle(0))]);
    let (columns, rows) = extent(&frame, Seen::Obstacle(0));
    // Edges of the disc as seen from the lens: bearing ± asin(0.1 / 1.0308).
    let (bearing, half) = (libm::atan2f(0.25, 1.0), libm::asinf(0.1 / 1.030_776));
    near(columns[0], 48.0 - libm::tanf(bearing + half) * FOCAL);
    near(columns[1], 48.0 - libm::tanf(bearing - half) * FOCAL);
    let nearest = 1.0 - 0.1 * 0.97;
    near(rows[0], 48.0 - 0.13 / nearest * FOCAL);
    near(rows[1], 48.0 + 0.07 / nearest * FOCAL);
}

#[test]
fn every_form_shows_its_colour_under_the_light() {
    let forms = [
        Form::Cylinder {
            radius: 0.1,
            height: 0.2,
        },
        Form::Box {
            axis: Vec2::unit(0.6),
            half: Vec2::new(0.1, 0.1),
            height: 0.2,
        },
        Form::Ball { radius: 0.1 },
        Form::Cone {
            radius: 0.1,
            height: 0.2,
        },
    ];
    for form in forms {
        let frame = picture(LENS, &[shape(form, 0.8, 0.0, BLUE, Seen::Object(3))]);
        let [spot] = frame.spots()[..] else {
            panic!("{form:?}: {:?}", frame.spots())
        };
        assert_eq!(spot.of, Seen::Object(3));
        assert!((spot.x - 48.0).abs() < 0.6, "{form:?}: {spot:?}");
        // About 0.2 m wide and high at 0.7 to 0.8 m; a cone and a ball have cut corners.
        assert!((180..800).contains(&spot.pixels), "{form:?}: {spot:?}");
        for y in 0..96 {
            for x in 0..96 {
                if frame.seen(x, y) != Some(Seen::Object(3)) {
                    continue;
                }
                let [red, green, blue] = frame.colour(x, y).expect("within the frame");
                assert!(blue > 80 && blue > 2 * green && green > red, "{form:?}");
                let depth = frame.depth(x, y).expect("within the frame");
                assert!((0.65..0.96).contains(&depth), "{form:?}: {depth}");
            }
        }
    }
}

#[test]
fn the_side_towards_the_light_is_brighter() {
    // The light comes from behind and from the right of a lens that looks against x.
    let turned = Lens {
        pose: Pose::new(0.0, 0.0, core::f32::consts::PI),
        ..LENS
    };
    let frame = picture(turned, &[post(0.6, 0.0, 0.1, 0.3, Seen::Obstacle(0))]);
    let (columns, _) = extent(&frame, Seen::Obstacle(0));
    let red = |x| frame.colour(x, 48).expect("within the frame")[0];
    assert!(red(columns[1] - 1) > red(columns[0] + 1) + 5);
    // From above everything is brightest.
    let above = Lens {
        height: 0.6,
        pitch: 0.7,
        ..LENS
    };
    let frame = picture(above, &[post(0.6, 0.0, 0.1, 0.1, Seen::Obstacle(0))]);
    let lid = (0..96_u16)
        .filter_map(|y| {
            frame
                .colour(48, y)
                .filter(|_| frame.seen(48, y) == Some(Seen::Obstacle(0)))
        })
        .map(|colour| colour[0])
        .max();
    assert!(lid.is_some_and(|lid| lid >= 180), "{lid:?}");
}

#[test]
fn the_near_hides_the_far_whatever_comes_first() {
    let small = post(2.0, 0.0, 0.1, 0.1, Seen::Obstacle(0));
    let large = post(1.0, 0.0, 0.2, 0.3, Seen::Obstacle(1));
    let one = picture(LENS, &[small, large]);
    let two = picture(LENS, &[large, small]);
    assert_eq!(one.rgb(), two.rgb());
    assert_eq!(one.spots().len(), 1);
    assert_eq!(one.spots()[0].of, Seen::Obstacle(1));
    // Beside it, half of it shows.
    let aside = post(2.0, 0.4, 0.1, 0.1, Seen::Obstacle(0));
    let frame = picture(LENS, &[large, aside]);
    let whole = picture(LENS, &[aside]);
    let pixels = |frame: &Frame| {
        let spots = frame.spots();
        spots
            .iter()
            .find(|spot| spot.of == Seen::Obstacle(0))
            .map(|spot| spot.pixels)
    };
    assert!(pixels(&frame) < pixels(&whole) && pixels(&frame).is_some());
}

#[test]
fn what_is_behind_or_beside_the_lens_is_not_seen() {
    for (x, y) in [(-1.0, 0.0), (0.0, 1.0), (0.3, -1.0)] {
        let frame = picture(LENS, &[post(x, y, 0.1, 0.3, Seen::Obstacle(0))]);
        assert!(frame.spots().is_empty(), "({x}, {y})");
    }
    // Around the lens nothing is drawn, rather than everything.
    let frame = picture(LENS, &[post(0.0, 0.0, 0.2, 0.3, Seen::Obstacle(0))]);
    assert!(frame.spots().is_empty());
}

#[test]
fn a_lens_that_looks_down_sees_the_floor_before_it() {
    let down = Lens { pitch: 0.5, ..LENS };
    let ball = shape(Form::Ball { radius: 0.02 }, 0.15, 0.0, RED, Seen::Object(0));
    assert!(picture(LENS, &[ball]).spots()[0].y > picture(down, &[ball]).spots()[0].y);
    let sweep = |lens: Lens| lens.half_sweep(1.0);
    assert!((sweep(LENS) - LENS.half_view).abs() < 1e-6);
    assert!(sweep(down) > LENS.half_view && sweep(down) < 1.5);
    let straight_down = Lens { pitch: 1.5, ..LENS };
    assert!(sweep(straight_down) <= 1.5);
}

#[test]
fn the_shapes_agree_with_what_lies_inside_them() {
    // Marching along the ray in steps of a tenth of a millimetre.
    let inside = |shape: &Shape, x: f32, y: f32, z: f32| {
        let away = Vec2::new(x, y).minus(shape.at);
        match shape.form {
            Form::Cylinder { radius, height } => away.length() <= radius && z <= height && z >= 0.0,
            Form::Box { axis, half, height } => {
                let local = away.into_frame(axis);
                let flat = local.x.abs() <= half.x && local.y.abs() <= half.y;
                flat && z <= height && z >= 0.0
            }
            Form::Ball { radius } => {
                let up = z - radius;
                away.dot(away) + up * up <= radius * radius
            }
            Form::Cone { radius, height } => {
                z >= 0.0 && z <= height && away.length() <= radius * (1.0 - z / height)
            }
        }
    };
    let forms = [
        Form::Cylinder {
            radius: 0.12,
            height: 0.1,
        },
        Form::Box {
            axis: Vec2::unit(-0.4),
            half: Vec2::new(0.15, 0.05),
            height: 0.1,
        },
        Form::Ball { radius: 0.1 },
        Form::Cone {
            radius: 0.12,
            height: 0.15,
        },
    ];
    let mut met = 0;
    for form in forms {
        let shape = shape(form, 0.5, 0.05, RED, Seen::Object(0));
        for k in 0..400_u16 {
            let (u, v) = (f32::from(k % 20) - 10.0, f32::from(k / 20) - 10.0);
            let (eye, ray) = (0.17, super::shape::Vec3::new(1.0, u * 0.05, v * 0.05 - 0.2));
            let exact = shape.hit(eye, ray).map(|hit| hit.along);
            let marched = (0..8_000_u16)
                .map(|step| f32::from(step) * 1e-4)
                .find(|t| inside(&shape, t * ray.x, t * ray.y, eye + t * ray.z));
            match (exact, marched) {
                (Some(exact), Some(marched)) => {
                    assert!((exact - marched).abs() < 2e-3, "{form:?} {ray:?}");
                    met += 1;
                }
                (None, None) => {}
                // A chord shorter than the steps, or the lower edge.
                (exact, marched) => {
                    let along = exact.or(marched).expect("one of them");
                    let wider = (-8..=8_i8).any(|nudge| {
                        let t = along + f32::from(nudge) * 1e-4;
                        inside(&shape, t * ray.x, t * ray.y, eye + t * ray.z + 2e-4)
                            || inside(&shape, t * ray.x, t * ray.y, eye + t * ray.z - 2e-4)
                    });
                    assert!(wider, "{form:?} {ray:?}: {exact:?} {marched:?}");
                }
            }
        }
    }
    assert!(met > 200, "{met}");
}

#[test]
fn a_frame_has_a_size() {
    assert!(Frame::new(0, 96).is_err());
    assert!(Frame::new(96, 2_049).is_err());
    let frame = Frame::new(320, 240).expect("a size");
    assert_eq!((frame.width(), frame.height()), (320, 240));
}
