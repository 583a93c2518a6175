use proptest::prelude::*;

use super::fence::HYSTERESIS;
use super::shape::{Point, Shape, ShapeError};
use super::{Fence, FenceAction, FenceKind};

const SQUARE: [Point; 4] = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];

fn shape(corners: &[Point]) -> Shape {
    Shape::new(corners.to_vec()).expect("a polygon")
}

fn fence(kind: FenceKind, corners: &[Point]) -> Fence {
    Fence {
        id: "1".into(),
        name: "yard".into(),
        kind,
        action: FenceAction::Warn,
        shape: shape(corners),
        by: String::new(),
        made_at: 0,
    }
}

#[test]
fn what_is_no_polygon_is_refused_with_the_corner() {
    let many = |count: usize| {
        let angle = |n: usize| n as f64 / count as f64 * std::f64::consts::TAU;
        (0..count)
            .map(|n| [angle(n).cos(), angle(n).sin()])
            .collect()
    };
    assert!(Shape::new(many(3)).is_ok());
    assert!(Shape::new(many(32)).is_ok());
    for (corners, error) in [
        (vec![], ShapeError::Count(0)),
        (many(2), ShapeError::Count(2)),
        (many(33), ShapeError::Count(33)),
        (
            vec![[0.0, 0.0], [f64::NAN, 0.0], [0.0, 1.0]],
            ShapeError::Place(2),
        ),
        (
            vec![[0.0, 0.0], [1.0, f64::INFINITY], [0.0, 1.0]],
            ShapeError::Place(2),
        ),
        (
            vec![[0.0, 0.0], [1.0, 0.0], [0.0, 10_000.1]],
            ShapeError::Place(3),
        ),
        (
            vec![[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
            ShapeError::Twice(3),
        ),
        (
            vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]],
            ShapeError::Twice(1),
        ),
        // A bow tie.
        (
            vec![[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]],
            ShapeError::Crossing(1, 3),
        ),
        // A corner on another edge.
        (
            vec![[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.0], [0.0, 2.0]],
            ShapeError::Crossing(1, 3),
        ),
        // There and back.
        (
            vec![[0.0, 0.0], [2.0, 0.0], [1.0, 0.0], [0.0, 2.0]],
            ShapeError::Crossing(1, 2),
        ),
        (
            vec![[2.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 0.0]],
            ShapeError::Crossing(1, 4),
        ),
        (
            vec![[0.0, 0.0], [0.09, 0.0], [0.09, 0.09], [0.0, 0.09]],
            ShapeError::Small,
        ),
    ] {
        assert_eq!(Shape::new(corners.clone()), Err(error), "{corners:?}");
        assert!(!error.to_string().is_empty());
    }
    // A corner in the middle of a straight edge does no harm.
    let straight = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 2.0]];
    assert_eq!(shape(&straight).corners(), straight);
}

#[test]
fn a_hollow_is_outside() {
    let hollow = shape(&[[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]]);
    assert!(hollow.holds([2.0, 0.5]) && hollow.holds([0.2, 3.0]));
    assert!(!hollow.holds([2.0, 3.0]) && !hollow.holds([5.0, 1.0]));
    assert!((shape(&SQUARE).to_edge([1.0, 0.75]) - 0.75).abs() < 1e-12);
    assert!((shape(&SQUARE).to_edge([-3.0, -4.0]) - 5.0).abs() < 1e-12);
}

#[test]
fn a_crossing_ends_a_little_later_than_it_began() {
    let inside = fence(FenceKind::KeepIn, &SQUARE);
    for (x, was, is) in [
        (1.99, false, false),
        (2.01, false, true),
        (1.95, true, true),
        (1.89, true, false),
    ] {
        assert_eq!(inside.is_violated([x, 1.0], was), is, "in: {x}");
    }
    let outside = fence(FenceKind::KeepOut, &SQUARE);
    for (x, was, is) in [
        (2.01, false, false),
        (1.99, false, true),
        (2.05, true, true),
        (2.11, true, false),
        (9.0, true, false),
    ] {
        assert_eq!(outside.is_violated([x, 1.0], was), is, "out: {x}");
    }
    // Nowhere inside of it is as deep as that, and yet one can be back.
    let narrow = fence(
        FenceKind::KeepIn,
        &[[0.0, 0.0], [9.0, 0.0], [9.0, 0.12], [0.0, 0.12]],
    );
    assert!(narrow.is_violated([4.0, 0.13], false));
    assert!(!narrow.is_violated([4.0, 0.06], true));
}

/// A polygon whose corners go around a place, which sees all of them.
fn star() -> impl Strategy<Value = (Point, Vec<Point>)> {
    let corner = (0.0..0.8_f64, 0.5..40.0_f64);
    let place = [-900.0..900.0_f64, -900.0..900.0_f64];
    (place, prop::collection::vec(corner, 4..=32)).prop_map(|(middle, corners)| {
        let count = corners.len() as f64;
        let around = corners.into_iter().enumerate().map(|(n, (late, far))| {
            let angle = (n as f64 + late) / count * std::f64::consts::TAU;
            [middle[0] + far * angle.cos(), middle[1] + far * angle.sin()]
        });
        (middle, around.collect())
    })
}

proptest! {
    #[test]
    fn inside_is_what_the_middle_sees(
        (middle, corners) in star(), edge in 0..32_usize, along in 0.0..1.0_f64,
        share in 0.0..2.0_f64,
    ) {
        prop_assume!((share - 1.0).abs() > 1e-6);
        let shape = Shape::new(corners.clone());
        prop_assert!(shape.is_ok(), "{shape:?}");
        let shape = shape.expect("a polygon");
        let (a, b) = (corners[edge % corners.len()], corners[(edge + 1) % corners.len()]);
        let at = [0, 1].map(|axis| {
            let edge: f64 = a[axis] + along * (b[axis] - a[axis]);
            middle[axis] + share * (edge - middle[axis])
        });
        prop_assert_eq!(shape.holds(at), share < 1.0);
        prop_assert!(shape.to_edge(at) <= shape.to_edge(middle) + 80.0);
    }

    #[test]
    fn direction_and_beginning_change_nothing(
        (_, corners) in star(), turn in 0..32_usize, at in [-950.0..950.0_f64, -950.0..950.0_f64],
    ) {
        let mut other = corners.clone();
        other.rotate_left(turn % corners.len());
        other.reverse();
        let (one, other) = (shape(&corners), shape(&other));
        prop_assert_eq!(one.holds(at), other.holds(at));
        prop_assert!((one.to_edge(at) - other.to_edge(at)).abs() < 1e-6);
        prop_assert!((one.depth() - other.depth()).abs() < 1e-6);
    }

    #[test]
    fn the_edge_comes_no_nearer_than_one_walks(
        (middle, corners) in star(), to in [-60.0..60.0_f64, -60.0..60.0_f64],
    ) {
        let shape = shape(&corners);
        let there = [middle[0] + to[0], middle[1] + to[1]];
        let walked = to[0].hypot(to[1]);
        let (from, after) = (shape.to_edge(middle), shape.to_edge(there));
        prop_assert!((from - after).abs() <= walked + 1e-9);
        if shape.holds(there) != shape.holds(middle) {
            prop_assert!(from <= walked + 1e-9, "it went through no edge");
        }
    }

    #[test]
    fn noise_at_the_edge_is_one_crossing(
        noise in prop::collection::vec(-0.049..0.049_f64, 1..200), keep_in: bool,
    ) {
        let kind = if keep_in { FenceKind::KeepIn } else { FenceKind::KeepOut };
        let fence = fence(kind, &SQUARE);
        let (mut was, mut crossings) = (false, 0);
        for x in noise {
            let is = fence.is_violated([2.0 + x, 1.0], was);
            crossings += u32::from(is && !was);
            prop_assert!(is || !was, "back within {HYSTERESIS} m");
            was = is;
        }
        prop_assert!(crossings <= 1);
    }

    #[test]
    fn any_corners_are_a_polygon_or_an_error(
        corners in prop::collection::vec([any::<f64>(), any::<f64>()], 0..40),
        small in prop::collection::vec([-3..3_i8, -3..3_i8], 0..12),
        at in [any::<f32>(), any::<f32>()],
    ) {
        let at = at.map(f64::from);
        let small = small.into_iter().map(|corner| corner.map(f64::from)).collect();
        for corners in [corners, small] {
            if let Ok(shape) = Shape::new(corners) {
                shape.holds(at);
                shape.to_edge(at);
                // What it says of its depth is so: somewhere on a grid over it.
                prop_assert!(shape.depth() > 0.0);
            }
        }
    }
}
