//! Where a robot may drive.

use std::sync::Arc;

use crawler_fleet::{Fence, FenceKind, Shape};

/// Metres from the middle of a robot to whatever ends the place it may drive in: its body, what it may go beyond what
/// was rehearsed before it is stopped, and what it takes to stop.
pub const CLEAR_M: f64 = 0.35;
/// Metres from the middle of a robot to that of another one.
pub const BESIDE_M: f64 = 0.6;

/// Something that stands in the way: a box whose edges are rounded.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Post {
    /// Its middle, metres.
    pub at: [f64; 2],
    /// Half of its length and width, metres.
    pub half: [f64; 2],
    /// How it is turned, anticlockwise, radians.
    pub theta: f64,
    /// What is around the box, metres.
    pub radius: f64,
}

impl Post {
    /// How far it is from a place, metres.
    #[must_use]
    pub fn distance(&self, at: [f64; 2]) -> f64 {
        let (sin, cos) = self.theta.sin_cos();
        let (dx, dy) = (at[0] - self.at[0], at[1] - self.at[1]);
        let along = (cos * dx + sin * dy).abs() - self.half[0];
        let across = (cos * dy - sin * dx).abs() - self.half[1];
        along.max(0.0).hypot(across.max(0.0)) - self.radius
    }
}

/// The walled rectangle around the origin that simulated robots are in.
#[derive(Debug, Clone, PartialEq)]
pub struct Room {
    /// Length and width, metres.
    pub sides: [f64; 2],
    /// What stands in it.
    pub posts: Vec<Post>,
}

/// All that is known of the ground.
#[derive(Debug, Clone, Default)]
pub struct Ground {
    /// Every fence.
    pub fences: Vec<Arc<Fence>>,
    /// What a person says to be free.
    pub area: Option<Shape>,
    /// Where the robot is a simulated one.
    pub room: Option<Room>,
}

impl Ground {
    /// Whether anything says where a robot is to stay.
    #[must_use]
    pub fn is_bounded(&self) -> bool {
        let keeps_in = |fence: &Arc<Fence>| fence.kind == FenceKind::KeepIn;
        self.area.is_some() || self.room.is_some() || self.fences.iter().any(keeps_in)
    }

    /// What is nearer to a place than a robot may come; for people.
    #[must_use]
    pub fn against(&self, at: [f64; 2]) -> Option<String> {
        let is_within = |shape: &Shape| shape.holds(at) && shape.to_edge(at) >= CLEAR_M;
        for fence in &self.fences {
            let shape = &fence.shape;
            let is_clear = match fence.kind {
                FenceKind::KeepIn => is_within(shape),
                FenceKind::KeepOut => {
                    !shape.is_near(at, CLEAR_M)
                        || (!shape.holds(at) && shape.to_edge(at) >= CLEAR_M)
                }
            };
            if !is_clear {
                return Some(format!("the fence {}", fence.name));
            }
        }
        if self.area.as_ref().is_some_and(|area| !is_within(area)) {
            return Some("the edge of the free area".to_owned());
        }
        let room = self.room.as_ref()?;
        if (0..2).any(|axis| at[axis].abs() > room.sides[axis] * 0.5 - CLEAR_M) {
            return Some("a wall".to_owned());
        }
        let is_near = |post: &&Post| post.distance(at) < CLEAR_M;
        let post = room.posts.iter().find(is_near)?;
        Some(format!(
            "what stands at {:.2}, {:.2}",
            post.at[0], post.at[1]
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
