//! Where a robot may drive.

use std::fmt;
use std::sync::Arc;

pub use crawler_twin::around::{Room, Solid};

/// Metres from the middle of a robot to whatever ends the place it may drive in: its body, what it may go beyond what
/// was rehearsed before it is stopped, and what it takes to stop.
pub const CLEAR_M: f64 = 0.35;
/// Metres from the middle of a robot to that of another one.
pub const BESIDE_M: f64 = 0.6;

/// A region of the floor.
pub trait Region: Send + Sync + fmt::Debug {
    /// Whether a place is in it.
    fn holds(&self, at: [f64; 2]) -> bool;
    /// How far its edge is from a place, metres.
    fn to_edge(&self, at: [f64; 2]) -> f64;
}

/// A square along the axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Square {
    /// Its middle, metres.
    pub middle: [f64; 2],
    /// From there to each side, metres.
    pub half: f64,
}

impl Region for Square {
    fn holds(&self, at: [f64; 2]) -> bool {
        (0..2).all(|axis| (at[axis] - self.middle[axis]).abs() <= self.half)
    }

    fn to_edge(&self, at: [f64; 2]) -> f64 {
        let beyond = [0, 1].map(|axis| (at[axis] - self.middle[axis]).abs() - self.half);
        match beyond.map(|beyond| beyond.max(0.0)) {
            [0.0, 0.0] => -beyond[0].max(beyond[1]),
            [x, y] => x.hypot(y),
        }
    }
}

/// Where robots are to stay in or out of.
#[derive(Debug, Clone)]
pub struct Border {
    /// For people.
    pub name: String,
    /// Whether they are to stay in.
    pub keeps_in: bool,
    /// Where.
    pub region: Arc<dyn Region>,
}

/// All that is known of the ground.
#[derive(Debug, Clone, Default)]
pub struct Ground {
    /// Every fence.
    pub fences: Vec<Border>,
    /// What a person says to be free.
    pub area: Option<Arc<dyn Region>>,
    /// Where the robot is a simulated one.
    pub room: Option<Room>,
}

impl Ground {
    /// Whether anything says where a robot is to stay.
    #[must_use]
    pub fn is_bounded(&self) -> bool {
        let is_kept_in = self.fences.iter().any(|fence| fence.keeps_in);
        self.area.is_some() || self.room.is_some() || is_kept_in
    }

    /// What is nearer to a place than a robot may come; for people.
    #[must_use]
    pub fn against(&self, at: [f64; 2]) -> Option<String> {
        let is_clear = |region: &dyn Region, keeps_in: bool| {
            region.holds(at) == keeps_in && region.to_edge(at) >= CLEAR_M
        };
        for fence in &self.fences {
            if !is_clear(fence.region.as_ref(), fence.keeps_in) {
                return Some(format!("the fence {}", fence.name));
            }
        }
        let area = self.area.as_deref();
        if area.is_some_and(|area| !is_clear(area, true)) {
            return Some("the edge of the free area".to_owned());
        }
        let room = self.room.as_ref()?;
        if room.to_wall(at) < CLEAR_M {
            return Some("a wall".to_owned());
        }
        let is_near = |solid: &&Solid| solid.distance(at) < CLEAR_M;
        let solid = room.solids.iter().find(is_near)?;
        Some(format!(
            "what stands at {:.2}, {:.2}",
            solid.at[0], solid.at[1]
        ))
    }
}

/// Whether two convex polygons are at least `by` metres apart.
#[must_use]
pub fn are_apart(one: &[[f64; 2]], other: &[[f64; 2]], by: f64) -> bool {
    separates(one, other, by) || separates(other, one, by)
}

/// Whether the other polygon is beyond an edge of one.
fn separates(one: &[[f64; 2]], other: &[[f64; 2]], by: f64) -> bool {
    let next = one.iter().cycle().skip(1);
    one.iter().zip(next).any(|(a, b)| {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let length = dx.hypot(dy);
        if length < 1e-9 {
            return false;
        }
        let normal = [dy / length, -dx / length];
        let along = |at: &[f64; 2]| at[0] * normal[0] + at[1] * normal[1];
        let most = one.iter().map(along).fold(f64::NEG_INFINITY, f64::max);
        let least = other.iter().map(along).fold(f64::INFINITY, f64::min);
        least - most >= by
    })
}
