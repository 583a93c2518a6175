//! Simple polygons: what is one, what is inside of it, and how far its edge is.

use std::fmt;
use std::ops::RangeInclusive;

use crawler_protocol::MAX_COORDINATE;

/// Corners that a polygon may have.
pub(crate) const CORNERS: RangeInclusive<usize> = 3..=32;
/// Smaller than this, in square metres, a polygon is a slip of the hand.
pub(crate) const LEAST_AREA: f64 = 0.01;

/// A place on the ground, x and y in metres.
pub(crate) type Point = [f64; 2];

/// Why corners do not make a polygon. Corners are counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShapeError {
    /// Too few or too many corners.
    Count(usize),
    /// A corner that is no place, or beyond where a robot can be sent.
    Place(usize),
    /// A corner at the place of the one before.
    Twice(usize),
    /// Two edges that meet where they should not, each by the corner it begins at.
    Crossing(usize, usize),
    /// It encloses next to nothing.
    Small,
}

impl fmt::Display for ShapeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count(count) => write!(
                f,
                "a fence has {} to {} corners, not {count}",
                CORNERS.start(),
                CORNERS.end()
            ),
            Self::Place(corner) => write!(
                f,
                "corner {corner} is not within {MAX_COORDINATE} m of the origin"
            ),
            Self::Twice(corner) => write!(f, "corner {corner} is where the one before it is"),
            Self::Crossing(one, other) => write!(
                f,
                "the edge from corner {one} and the edge from corner {other} cross or touch"
            ),
            Self::Small => write!(f, "the fence encloses less than {LEAST_AREA} m²"),
        }
    }
}

/// A simple polygon: its edges meet in its corners and nowhere else.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    corners: Vec<Point>,
    low: Point,
    high: Point,
    /// So deep inside there is a place, in metres.
    depth: f64,
}

impl Shape {
    /// The polygon of these corners, in either direction.
    ///
    /// # Errors
    /// [`ShapeError`] when it is none.
    pub fn new(corners: Vec<Point>) -> Result<Self, ShapeError> {
        if !CORNERS.contains(&corners.len()) {
            return Err(ShapeError::Count(corners.len()));
        }
        let farthest = f64::from(MAX_COORDINATE);
        // Written so that a value that is no number fails it.
        let near = |corner: &Point| corner.iter().all(|value| value.abs() <= farthest);
        if let Some(at) = corners.iter().position(|corner| !near(corner)) {
            return Err(ShapeError::Place(at + 1));
        }
        check_simple(&corners)?;
        let (mut area, mut length) = (0.0, 0.0);
        let first = corners[0];
        for (a, b) in edges(&corners) {
            area += turn(first, a, b) / 2.0;
            length += distance(a, b);
        }
        let area = area.abs();
        if area <= LEAST_AREA {
            return Err(ShapeError::Small);
        }
        let pick = |choose: fn(f64, f64) -> f64, axis: usize| {
            let values = corners.iter().map(|corner| corner[axis]);
            values.fold(first[axis], choose)
        };
        Ok(Self {
            low: [pick(f64::min, 0), pick(f64::min, 1)],
            high: [pick(f64::max, 0), pick(f64::max, 1)],
            // The largest circle in a region without holes has at least this radius: Bonnesen's
            // inequality, area + π r² ≤ r · perimeter (Osserman, "Bonnesen-style isoperimetric
            // inequalities", 1979).
            depth: area / length,
            corners,
        })
    }

    /// Its corners, as they were given.
    pub fn corners(&self) -> &[Point] {
        &self.corners
    }

    /// So deep inside there is a place for sure, in metres.
    pub const fn depth(&self) -> f64 {
        self.depth
    }

    /// Whether a place is within the polygon; one on its edge may be either.
    pub fn holds(&self, at: Point) -> bool {
        if !self.is_near(at, 0.0) {
            return false;
        }
        // How often the edge winds around the place (Sunday, "Inclusion of a Point in a Polygon").
        let mut winds = 0;
        for (a, b) in edges(&self.corners) {
            if a[1] <= at[1] {
                winds += i32::from(b[1] > at[1] && turn(a, b, at) > 0.0);
            } else {
                winds -= i32::from(b[1] <= at[1] && turn(a, b, at) < 0.0);
            }
        }
        winds != 0
    }

    /// Whether a place is within `reach` metres of the box around the polygon.
    pub fn is_near(&self, at: Point, reach: f64) -> bool {
        (0..2).all(|axis| at[axis] >= self.low[axis] - reach && at[axis] <= self.high[axis] + reach)
    }

    /// How far the edge is from a place, in metres.
    pub fn to_edge(&self, at: Point) -> f64 {
        let far = edges(&self.corners).map(|(a, b)| to_segment(at, a, b));
        far.fold(f64::INFINITY, f64::min)
    }
}

/// Each corner with the next; the first follows the last.
fn edges(corners: &[Point]) -> impl Iterator<Item = (Point, Point)> {
    let next = corners.iter().cycle().skip(1);
    corners.iter().copied().zip(next.copied())
}

/// Twice the area of the triangle; positive when it goes anticlockwise.
fn turn(a: Point, b: Point, c: Point) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
}

fn distance(a: Point, b: Point) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

fn to_segment(at: Point, a: Point, b: Point) -> f64 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let length = along[0] * along[0] + along[1] * along[1];
    let share = ((at[0] - a[0]) * along[0] + (at[1] - a[1]) * along[1]) / length;
    // An edge has a length, but its square may be too small for a number.
    let share = if share.is_finite() {
        share.clamp(0.0, 1.0)
    } else {
        0.0
    };
    distance(at, [a[0] + share * along[0], a[1] + share * along[1]])
}

/// Whether edges meet in corners alone.
fn check_simple(corners: &[Point]) -> Result<(), ShapeError> {
    let count = corners.len();
    let edges: Vec<_> = edges(corners).collect();
    for (index, (a, b)) in edges.iter().enumerate() {
        if a == b {
            return Err(ShapeError::Twice((index + 1) % count + 1));
        }
    }
    for (one, (a, b)) in edges.iter().enumerate() {
        for (other, (c, d)) in edges.iter().enumerate().skip(one + 1) {
            let meet = if other == one + 1 {
                folds_back(*a, *b, *d)
            } else if one == 0 && other == count - 1 {
                folds_back(*c, *d, *b)
            } else {
                meets(*a, *b, *c, *d)
            };
            if meet {
                return Err(ShapeError::Crossing(one + 1, other + 1));
            }
        }
    }
    Ok(())
}

/// Whether the edge from `b` to `c` lies on the one from `a` to `b`.
fn folds_back(a: Point, b: Point, c: Point) -> bool {
    let ahead = (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1]);
    turn(a, b, c) == 0.0 && ahead < 0.0
}

/// Whether two segments have a point in common.
fn meets(a: Point, b: Point, c: Point, d: Point) -> bool {
    let sides = [turn(c, d, a), turn(c, d, b), turn(a, b, c), turn(a, b, d)];
    let apart = |one: f64, other: f64| (one > 0.0 && other < 0.0) || (one < 0.0 && other > 0.0);
    if apart(sides[0], sides[1]) && apart(sides[2], sides[3]) {
        return true;
    }
    let on = |side: f64, from: Point, to: Point, at: Point| {
        let between = |axis: usize| {
            at[axis] >= from[axis].min(to[axis]) && at[axis] <= from[axis].max(to[axis])
        };
        side == 0.0 && between(0) && between(1)
    };
    on(sides[0], c, d, a) || on(sides[1], c, d, b) || on(sides[2], a, b, c) || on(sides[3], a, b, d)
}
