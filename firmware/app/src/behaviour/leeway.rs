//! How fast a robot may go on without running into those near.
//!
//! Whatever gap there is between two robots, it may shrink by no more than all of it within [`WITHIN`]: a barrier that two
//! who keep to it never reach, since what is left falls like an exponential (Wang, Ames and Egerstedt, "Safety barrier
//! certificates for collisions-free multirobot systems", IEEE TRO 33(3), 2017). What the other one does of it counts, so of
//! two who drive towards each other each does half, and one behind another that drives on may drive as fast. Whoever is
//! passed by with room to spare, when both go on, is not in the way (Fiorini and Shiller, "Motion planning in dynamic
//! environments using velocity obstacles", IJRR 17(7), 1998). Nobody is told anything beside where the others are.
//!
//! What is told is half a second old, and the speed falls with the gap, so that in that half second nobody covers more than
//! half of it.

use super::swarm::from;
use crate::motion::angle::{ONE_BITS, PoseMm, length, turned};
use crate::neighbours::Neighbour;
use crate::state::Side;

/// Farther than this along an axis nobody is reckoned with, in millimetres.
const REACH_MM: i32 = 800;
/// Between the middles of two robots that touch, in millimetres, and what they are not to come nearer by, for noise.
const BODIES_MM: i32 = 170 + 30;
/// Nearer than this nobody can be: somebody is not where it is told to be.
const NOBODY_MM: i32 = 110;
/// With so much between the middles of both another one is passed by at any speed, in millimetres: where the robot may go
/// where it likes, and where doors and corridors leave no more.
const ROOMY_MM: i32 = 260;
const NARROW_MM: i32 = 185;
/// The time in which the gap may shrink by all of it, in 1/1024 s.
const WITHIN: i32 = 1_024;
/// So much of the speed, in 1/1024, has to lead towards another one for it to count.
const TOWARDS: i32 = 300;
/// No robot is faster, in millimetres per second.
const FASTEST: i32 = 5_000;

/// Where others leave no more than this a robot turns aside, in millimetres per second.
const HELD_UP: i32 = 60;
/// Where they leave as much as this it goes on in the direction that it has turned to.
const FREE: i32 = 120;

/// How fast it may be, and for whose sake.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Leeway {
    /// Millimetres per second.
    pub speed: i32,
    /// The side on which whoever keeps it from being faster is.
    pub side: Side,
}

/// Where a robot is, and how it would drive on.
#[derive(Debug, Clone, Copy)]
pub struct Course {
    at: [i32; 2],
    way: [i32; 2],
    velocity: [i32; 2],
    sigma: i32,
    clear: i32,
}

impl Course {
    /// That of a robot at `here`, known to `sigma` millimetres, at `wanted` millimetres per second, back where that is negative.
    pub fn new(here: &PoseMm, sigma: i32, wanted: i32) -> Self {
        let way = if wanted < 0 {
            here.ahead.map(|along| -along)
        } else {
            here.ahead
        };
        let wanted = wanted.abs().min(FASTEST);
        Self {
            at: here.at,
            way,
            velocity: way.map(|along| (along * wanted) >> ONE_BITS),
            sigma,
            clear: ROOMY_MM,
        }
    }

    /// The same where there may be little room.
    #[must_use]
    pub const fn narrow(self) -> Self {
        Self {
            clear: NARROW_MM,
            ..self
        }
    }
}

impl Leeway {
    /// Nobody is near.
    pub const ALL: Self = Self {
        speed: FASTEST,
        side: Side::Left,
    };

    /// Of a robot at `here`, known to `sigma` millimetres, that would drive at `wanted` millimetres per second, back where
    /// that is negative.
    pub fn of(here: &PoseMm, sigma: i32, wanted: i32, near: &[Neighbour]) -> Self {
        let course = Course::new(here, sigma, wanted);
        near.iter()
            .fold(Self::ALL, |least, other| least.beside(&course, other))
    }

    /// What is left when `other` is near as well.
    #[must_use]
    pub fn beside(self, course: &Course, other: &Neighbour) -> Self {
        let Some([x, y]) = from(course.at, other) else {
            return self;
        };
        if x.abs().max(y.abs()) > REACH_MM {
            return self;
        }
        let [ahead, left] = turned([x, y], course.way);
        if ahead <= 0 {
            return self;
        }
        let far = length([x, y]);
        if far < NOBODY_MM {
            return self;
        }
        let towards = (ahead << 10) / far;
        let [vx, vy] = other.velocity();
        let relative = [course.velocity[0] - vx, course.velocity[1] - vy];
        // Twice the area between both, by how fast they go past each other, is how far apart they pass.
        let area = (x * relative[1] - y * relative[0]).abs();
        if towards < TOWARDS || area > course.clear * length(relative) {
            return self;
        }
        let gap = far - BODIES_MM - course.sigma;
        let away = (x * vx + y * vy) / far;
        let closing = (gap << 10) / WITHIN + away;
        let speed = (closing.max(0) << 10) / towards;
        if speed >= self.speed {
            return self;
        }
        let side = if left > 0 { Side::Left } else { Side::Right };
        Self { speed, side }
    }

    /// Where to turn because others do not let the robot go on.
    pub fn way_round(self) -> Option<Side> {
        (self.speed < HELD_UP).then(|| self.side.other())
    }

    /// Whether a robot that turns aside would not get on where it looks.
    pub const fn holds_up(self) -> bool {
        self.speed < FREE
    }

    /// What of a speed others leave, in metres per second.
    pub fn left_of(self, v: f32) -> f32 {
        if self == Self::ALL {
            return v;
        }
        let most = self.speed as f32 * 0.001;
        v.clamp(-most, most)
    }
}

#[cfg(test)]
mod tests;
