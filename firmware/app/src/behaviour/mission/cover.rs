//! `cover`: to the middle of what is nearer to oneself than to anybody else.
//!
//! Lloyd's rule: the cell of a robot is the part of the area that is nearer to it than to any other robot that covers
//! the same area, and it goes to the centroid of that cell. The sum over the area of the square of the distance to the
//! nearest robot falls with every such move (Lloyd, "Least squares quantization in PCM", IEEE Trans. Information Theory
//! 28(2), 1982; Cortés, Martínez, Karataş and Bullo, "Coverage control for mobile sensing networks", IEEE TRA 20(2),
//! 2004). A robot that has come to within [`THERE_MM`] of its centroid rests until that is [`OFF_MM`] away: what is told
//! late, and noise of a few centimetres, keep nobody going.
//!
//! A robot reckons with no more of it than what it reaches, which is half as far as it hears at least: so nobody whom it
//! does not hear has any of that, and who comes and goes at the rim of what is heard moves nobody (Cortés, Martínez and
//! Bullo, "Spatially-distributed coverage optimization and control with limited-range interactions", ESAIM: COCV 11, 2005).
//!
//! The cell is the area, cut by the line in the middle between the robot and each other one. It is reckoned over a few
//! steps, a few of the others in each, so that no step is dear.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{BehaviourName, MAX_PLACES, Places, Says};

use super::{MissionNews, Scene, Wish};
use crate::behaviour::swarm::{FULL, from};
use crate::motion::angle::{length, millimetres};
use crate::neighbours::{MOST, Neighbour};

/// Time between two rounds: neighbours are told about as often.
const ROUND: Duration = Duration::from_millis(500);
/// A robot has come to its centroid within so many millimetres,
const THERE_MM: i32 = 20;
/// and goes on when that is farther away than this: of robots side by side each then has no more than four times as much
/// less room than the next one.
const OFF_MM: i32 = 45;
/// With more than this to go it hurries, in millimetres,
const HURRY_MM: i32 = 160;
/// and beyond this it finds its way round things.
const FAR_MM: i32 = 600;
/// Nothing farther away than this along an axis is reckoned with, in millimetres, so that no product overflows.
const FARTHEST_MM: i32 = 16_000;
/// Others that are looked at in one step.
const EACH: usize = 4;
/// The robot reaches as far as if others were all around it here, in millimetres: an octagon with 1.05 m from its middle
/// to its sides.
const AROUND: [Point; 8] = [
    [2_100, 0],
    [1_485, 1_485],
    [0, 2_100],
    [-1_485, 1_485],
    [-2_100, 0],
    [-1_485, -1_485],
    [0, -2_100],
    [1_485, -1_485],
];
/// Corners of a cell: each cut of a convex area adds one at most. Of an area with a dent that has more, the last are
/// left out.
const CORNERS: usize = MAX_PLACES + AROUND.len() + MOST;

/// From the robot, in millimetres along both axes.
type Point = [i32; 2];

/// A robot that covers its part of an area.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Cover {
    area: Places,
    /// Stands for the area where only sameness counts.
    list: i32,
    /// Where it goes; `None` while it rests.
    target: Option<[f32; 2]>,
    looked: Option<Instant>,
    /// The cell while it is reckoned.
    cell: Option<Cell>,
}

/// What is left of the area after a look at some of the others.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Cell {
    /// Where the robot was when it began to look.
    at: [f32; 2],
    /// How many of the others have been looked at.
    seen: u8,
    left: Polygon,
}

impl Cover {
    pub(super) fn new(area: Places) -> Self {
        let bytes = area.as_slice().iter().flatten();
        let hash = crate::neighbours::hash(bytes.flat_map(|along| along.to_le_bytes()));
        Self {
            area,
            list: (hash & 0xFFFF) as i32,
            target: None,
            looked: None,
            cell: None,
        }
    }

    /// `[list, whether it rests]`.
    pub(super) fn says(&self) -> Says {
        let rests = i32::from(self.target.is_none());
        Says::new(BehaviourName::Cover, &[self.list, rests])
    }

    pub(super) const fn destination(&self) -> Option<[f32; 2]> {
        self.target
    }

    pub(super) fn step(&mut self, scene: &Scene<'_>) -> (Wish, Option<MissionNews>) {
        if let Some(mut cell) = self.cell.take() {
            if usize::from(cell.seen) < AROUND.len() + scene.near.len() {
                self.look(&mut cell, scene.near);
                self.cell = Some(cell);
            } else {
                self.decide(&cell);
            }
        } else if self.looked.is_none_or(|at| scene.now - at >= ROUND) {
            self.looked = Some(scene.now);
            let at = [scene.pose.x, scene.pose.y];
            self.cell = Some(Cell {
                at,
                seen: 0,
                left: self.around(at.map(millimetres)),
            });
        }
        let wish = self.target.map_or(Wish::Rest, |to| {
            let way = [to[0] - scene.pose.x, to[1] - scene.pose.y].map(millimetres);
            if length(way) > FAR_MM {
                Wish::Place(to, 1.0)
            } else {
                Wish::Velocity(way.map(|along| along * FULL / HURRY_MM))
            }
        });
        (wish, None)
    }

    /// Takes what is out of reach, then what is nearer to the next few of the others.
    fn look(&self, cell: &mut Cell, near: &[Neighbour]) {
        let own = cell.at.map(millimetres);
        let seen = usize::from(cell.seen);
        cell.seen = cell.seen.saturating_add(EACH as u8);
        if let Some(sides) = AROUND.get(seen..seen + EACH) {
            for side in sides {
                cell.left.cut(*side);
            }
            return;
        }
        for other in near.iter().skip(seen - AROUND.len()).take(EACH) {
            let said = other.says.as_ref();
            let said = said.and_then(|says| says.by(BehaviourName::Cover));
            if said.and_then(<[i32]>::first) == Some(&self.list)
                && let Some(at) = from(own, other)
            {
                cell.left.cut(at);
            }
        }
    }

    /// Where to go, once all of the others have been looked at.
    fn decide(&mut self, cell: &Cell) {
        let own = cell.at.map(millimetres);
        // Who is outside, where others are nearer to all of the area, goes in between them.
        let middle = cell.left.centroid();
        let middle = middle.or_else(|| self.around(own).centroid());
        let [x, y] = middle.unwrap_or_default();
        let near = if self.target.is_some() {
            THERE_MM
        } else {
            OFF_MM
        };
        let metres = |own: f32, mm: i32| own + mm as f32 * 0.001;
        self.target =
            (x * x + y * y > near * near).then(|| [metres(cell.at[0], x), metres(cell.at[1], y)]);
    }

    /// The area from a robot that is at `own`. Corners that are too far away are drawn nearer: the area is there all
    /// the same, and cells end at others.
    fn around(&self, own: Point) -> Polygon {
        let mut area = Polygon::NONE;
        for place in self.area.as_slice() {
            let [x, y] = place.map(millimetres);
            let from = [x.saturating_sub(own[0]), y.saturating_sub(own[1])];
            area.push(from.map(|along| along.clamp(-FARTHEST_MM, FARTHEST_MM)));
        }
        area
    }
}

/// A part of the floor, from a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Polygon {
    corners: [[i16; 2]; CORNERS],
    count: u8,
}

impl Polygon {
    const NONE: Self = Self {
        corners: [[0; 2]; CORNERS],
        count: 0,
    };

    /// Adds a corner. Where there are too many, the polygon is a little smaller.
    fn push(&mut self, corner: Point) {
        if let Some(free) = self.corners.get_mut(usize::from(self.count)) {
            // Within ±[`FARTHEST_MM`].
            *free = corner.map(|along| along as i16);
            self.count += 1;
        }
    }

    fn corners(&self) -> impl DoubleEndedIterator<Item = Point> {
        let all = self.corners.get(..usize::from(self.count));
        let all = all.unwrap_or_default().iter();
        all.map(|corner| corner.map(i32::from))
    }

    /// Takes away what is nearer to a robot that is at `other` than to this one.
    fn cut(&mut self, other: Point) {
        // All of it is on the near side of the line in the middle, whose distance is half of that of the other robot.
        let half = (other[0] * other[0] + other[1] * other[1]) >> 1;
        let beyond = |[x, y]: Point| x * other[0] + y * other[1] - half;
        // Two in one place share it.
        if half == 0 || self.corners().all(|corner| beyond(corner) <= 0) {
            return;
        }
        let whole = *self;
        let Some(mut before) = whole.corners().next_back() else {
            return;
        };
        self.count = 0;
        let mut was = beyond(before);
        for corner in whole.corners() {
            let is = beyond(corner);
            if (was > 0) != (is > 0) {
                self.push(between(before, was, corner, is));
            }
            if is <= 0 {
                self.push(corner);
            }
            (before, was) = (corner, is);
        }
    }

    /// The centroid of what it encloses; none of what encloses nothing.
    fn centroid(&self) -> Option<Point> {
        let mut before = self.corners().next_back()?;
        let (mut twice, mut sum) = (0_i64, [0_i64; 2]);
        for corner in self.corners() {
            // Less than 2³⁰.
            let cross = i64::from(before[0] * corner[1] - corner[0] * before[1]);
            twice += cross;
            for (sum, (a, b)) in sum.iter_mut().zip(before.into_iter().zip(corner)) {
                *sum += i64::from(a + b) * cross;
            }
            before = corner;
        }
        // A square centimetre has a middle, less may be what rounding has left.
        if twice.abs() < 200 {
            return None;
        }
        // Of a ring that crosses itself it may be anywhere.
        let within = |along: i64| along.clamp(-i64::from(FARTHEST_MM), FARTHEST_MM.into()) as i32;
        Some(sum.map(|sum| within(sum / (3 * twice))))
    }
}

/// Where the line from `a` to `b` crosses 0, when it is at `of_a` and at `of_b` of different sides.
fn between(a: Point, of_a: i32, b: Point, of_b: i32) -> Point {
    // Less than 2³¹; with 15 bits of it no product has more than 31.
    let span = of_a.abs_diff(of_b);
    let shift = (32 - span.leading_zeros()).saturating_sub(15);
    let (part, span) = (
        (of_a.unsigned_abs() >> shift) as i32,
        (span >> shift) as i32,
    );
    let along = |a: i32, b: i32| a + (b - a) * part / span.max(1);
    [along(a[0], b[0]), along(a[1], b[1])]
}

#[cfg(test)]
mod tests;
