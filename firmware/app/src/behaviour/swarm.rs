//! Moving by where others are: each behaviour is a rule for a wanted velocity, and all of them are
//! steered alike.
//!
//! | behaviour | rule | after |
//! |---|---|---|
//! | `disperse` | away from everyone within 1.2 m | potential fields: Howard, Matarić and Sukhatme, "Mobile Sensor Network Deployment using Potential Fields", DARS 2002 |
//! | `gather` | to one place, and rest behind those who rest there already | |
//! | `flock` | the mean course, its turns and all; separation and cohesion within narrow bounds | Reynolds, "Flocks, Herds, and Schools", SIGGRAPH 1987 |
//! | `formation` | to the free place of a lattice of triangles that is nearest to its middle | |
//!
//! None of them has a leader or knows more than the nearest sixteen. What the ranger sees in the way is
//! avoided as in `wander`. docs/behaviours.md says why each of them converges, and what was measured.
//!
//! All of it is in whole numbers, since a board has no floating-point unit: see [`crate::motion::angle`].

mod disperse;
mod flock;
mod formation;
mod gather;
pub(super) mod lattice;

use super::HEADING_GAIN;
use crate::goal::Swarm;
use crate::motion::Twist;
use crate::motion::angle::{Angle, PoseMm, length, millimetres};
use crate::neighbours::Neighbour;

pub use disperse::APART;
pub use formation::LATTICE;
pub use gather::{BESIDE, THERE};

/// What stands for the permitted speed in a wish.
pub(super) const FULL: i32 = 1_024;
/// Wanted speed below which a robot rests: noise of a few centimetres must not keep it turning.
const REST: i32 = FULL * 8 / 100;
/// Longest coordinate of a wish that is reckoned with.
const LONGEST_WISH: i32 = 30 * FULL;
/// Beyond this heading error the robot turns in place, in milliradians.
const TURN_IN_PLACE: i32 = 1_000;
/// How little sure of its place a robot may be to move by others, in metres of sigma.
pub(crate) const VAGUE: f32 = 0.5;
/// Farther than this nobody is reckoned with, in millimetres, so that no product overflows.
const FARTHEST_MM: i32 = 10_000;
/// Who would rather be where something is rests this far from it, in millimetres: out of the critical
/// distance, so that it does not turn aside for what it wants nothing from.
const HELD_UP_MM: u16 = 330;
/// Who disperses and is pressed by more than this does not wait.
const PRESSED: i32 = FULL / 2;
/// Within this heading error what is ahead is in the way, in milliradians.
const AHEAD: i32 = 450;

/// What a rule goes by.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// Where the robot should be.
    pub here: PoseMm,
    /// How sure of that it is, as one standard deviation in metres.
    pub sigma: f32,
    /// Where others should be.
    pub near: &'a [Neighbour],
    /// What the ranger sees ahead, in millimetres.
    pub ahead_mm: Option<u16>,
    /// Permitted speed, in metres per second.
    pub speed: f32,
    /// Permitted rate of turning, in radians per second.
    pub max_turn: f32,
}

/// Another robot, from where the robot is.
#[derive(Debug, Clone, Copy)]
struct Other<'a> {
    /// Millimetres along both axes.
    at: [i32; 2],
    /// Square of its distance.
    square: i32,
    /// The rest of it.
    is: &'a Neighbour,
}

impl<'a> Scene<'a> {
    /// One of those near, unless it is too far away to be reckoned with.
    // Sixteen times in a step: a call costs as much again.
    #[inline]
    fn other(&self, is: &'a Neighbour) -> Option<Other<'a>> {
        let at = from(self.here.at, is)?;
        Some(Other {
            at,
            square: at[0] * at[0] + at[1] * at[1],
            is,
        })
    }
}

/// Where `other` is from a robot that is at `own`, unless that is too far away to be reckoned with.
#[inline]
pub(super) fn from(own: [i32; 2], other: &Neighbour) -> Option<[i32; 2]> {
    // Wrapped around it is too far away as well: nobody is a thousand kilometres off its own place.
    let x = other.at[0].wrapping_sub(own[0]);
    let y = other.at[1].wrapping_sub(own[1]);
    let fits = |along: i32| (along.wrapping_add(FARTHEST_MM) as u32) <= 2 * FARTHEST_MM as u32;
    (fits(x) && fits(y)).then_some([x, y])
}

/// Wanted motion of a robot in `scene`, within what it permits.
pub fn swarm_twist(swarm: Swarm, scene: &Scene<'_>) -> Twist {
    // Not sure of its place it would run from, or into, others that are elsewhere.
    if scene.sigma > VAGUE {
        return Twist::ZERO;
    }
    match swarm {
        Swarm::Disperse => scene.steer(disperse::disperse(scene), PRESSED),
        Swarm::Gather { x, y } => {
            let (wish, waits) = gather::gather(scene, [x, y].map(millimetres));
            scene.steer(wish, if waits { i32::MAX } else { 0 })
        }
        Swarm::Flock => flock::flock(scene),
        Swarm::Formation => scene.steer(formation::formation(scene), 0),
    }
}

/// Motion of a robot at `here` with a wish for a velocity along both axes, in 1/1024 of `speed`.
pub fn steer(wish: [i32; 2], here: &PoseMm, speed: f32, max_turn: f32) -> Twist {
    let scene = Scene {
        here: *here,
        sigma: 0.0,
        near: &[],
        ahead_mm: None,
        speed,
        max_turn,
    };
    scene.steer(wish, 0)
}

impl Scene<'_> {
    /// Turns to `wish`, a velocity in 1/[`FULL`] of the permitted speed along both axes, and drives there. Below a
    /// wish of `waits_below` it does not turn aside for what is in the way, but waits.
    fn steer(&self, wish: [i32; 2], waits_below: i32) -> Twist {
        let wish = wish.map(|along| along.clamp(-LONGEST_WISH, LONGEST_WISH));
        let share = length(wish);
        if share < REST {
            return Twist::ZERO;
        }
        let [forward, aside] = self.here.turned(wish);
        let error = Angle::of([forward, aside]);
        let off = error.milliradians().abs();
        if share < waits_below && off < AHEAD && self.ahead_mm.is_some_and(|mm| mm < HELD_UP_MM) {
            return Twist::ZERO;
        }
        let v = if off > TURN_IN_PLACE {
            0.0
        } else {
            // What of the wish lies ahead, in 1/[`FULL`] of the speed at most.
            let part = (forward * share.min(FULL) / share).min(FULL);
            self.speed * (part as f32 * (1.0 / FULL as f32))
        };
        Twist {
            v,
            w: (HEADING_GAIN * error.radians()).clamp(-self.max_turn, self.max_turn),
        }
    }
}

#[cfg(test)]
mod tests;
