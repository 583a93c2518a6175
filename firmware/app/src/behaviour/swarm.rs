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
//! What is said about every neighbour is in whole millimetres, since a board has no floating-point unit.

mod disperse;
mod flock;
mod formation;
mod gather;

use crawler_protocol::Pose;

use crate::goal::Swarm;
use crate::motion::{Twist, wrap};
use crate::neighbours::Neighbour;

pub use disperse::APART;
pub use formation::LATTICE;
pub use gather::{BESIDE, THERE};

/// Wanted speed, as a share of the permitted one, below which a robot rests: noise of a few
/// centimetres must not keep it turning.
const REST: f32 = 0.08;
/// Turning rate per radian of heading error, per second; see [`super::goto_twist`].
const HEADING_GAIN: f32 = 2.5;
/// Beyond this heading error the robot turns in place.
const TURN_IN_PLACE: f32 = 1.0;
/// How little sure of its place a robot may be to move by others, in metres of sigma.
pub(super) const VAGUE: f32 = 0.5;
/// Farther than this nobody is reckoned with, in millimetres, so that no product overflows.
const FARTHEST_MM: i32 = 10_000;
/// Who would rather be where something is rests this far from it, in millimetres: out of the critical
/// distance, so that it does not turn aside for what it wants nothing from.
const HELD_UP_MM: u16 = 330;
/// Who disperses and is pressed by more than this, as a share of the permitted speed, does not wait.
const PRESSED: f32 = 0.5;
/// Cosine of the heading error within which what is ahead is in the way.
const AHEAD: f32 = 0.9;

/// What a rule goes by.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// Where the robot should be.
    pub pose: &'a Pose,
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
struct Other {
    /// Millimetres along both axes.
    at: [i32; 2],
    /// Square of its distance.
    square: i32,
    /// Millimetres per second along both axes.
    velocity: [i32; 2],
    /// Milliradians per second.
    turn: i32,
}

impl Scene<'_> {
    /// Who is within reckoning.
    fn others(&self) -> impl Iterator<Item = Other> {
        let own = [self.pose.x, self.pose.y].map(thousandths);
        self.near.iter().filter_map(move |other| {
            let [x, y] = [other.x, other.y].map(thousandths);
            let at = [x.saturating_sub(own[0]), y.saturating_sub(own[1])];
            if at
                .iter()
                .any(|along| !(-FARTHEST_MM..=FARTHEST_MM).contains(along))
            {
                return None;
            }
            Some(Other {
                at,
                square: at[0] * at[0] + at[1] * at[1],
                velocity: other
                    .velocity
                    .map(|along| thousandths(along).clamp(-FARTHEST_MM, FARTHEST_MM)),
                turn: thousandths(other.turn).clamp(-FARTHEST_MM, FARTHEST_MM),
            })
        })
    }
}

/// In thousandths; casts saturate, and no number is 0.
fn thousandths(value: f32) -> i32 {
    (value * 1_000.0) as i32
}

/// Wanted motion of a robot in `scene`, within what it permits.
pub fn swarm_twist(swarm: Swarm, scene: &Scene<'_>) -> Twist {
    // Not sure of its place it would run from, or into, others that are elsewhere.
    if scene.pose.sigma > VAGUE {
        return Twist::ZERO;
    }
    match swarm {
        Swarm::Disperse => scene.steer(disperse::disperse(scene), PRESSED),
        Swarm::Gather { x, y } => {
            let (wish, waits) = gather::gather(scene, [x, y]);
            scene.steer(wish, if waits { f32::INFINITY } else { 0.0 })
        }
        Swarm::Flock => flock::flock(scene),
        Swarm::Formation => scene.steer(formation::formation(scene), 0.0),
    }
}

/// Motion of a robot at `pose` with a wish for a velocity along both axes, as a share of `speed`.
pub fn steer(wish: [f32; 2], pose: &Pose, speed: f32, max_turn: f32) -> Twist {
    let scene = Scene {
        pose,
        near: &[],
        ahead_mm: None,
        speed,
        max_turn,
    };
    scene.steer(wish, 0.0)
}

impl Scene<'_> {
    /// Turns to `wish`, a velocity as a share of the permitted speed along both axes, and drives there. Below a
    /// wish of `waits_below` it does not turn aside for what is in the way, but waits.
    fn steer(&self, [x, y]: [f32; 2], waits_below: f32) -> Twist {
        let share = libm::hypotf(x, y);
        if share.is_nan() || share < REST {
            return Twist::ZERO;
        }
        let error = wrap(libm::atan2f(y, x) - self.pose.theta);
        if !error.is_finite() {
            return Twist::ZERO;
        }
        let forward = libm::cosf(error);
        if share < waits_below && forward > AHEAD && self.ahead_mm.is_some_and(|mm| mm < HELD_UP_MM)
        {
            return Twist::ZERO;
        }
        let v = if libm::fabsf(error) > TURN_IN_PLACE {
            0.0
        } else {
            self.speed * share.min(1.0) * forward
        };
        Twist {
            v,
            w: (HEADING_GAIN * error).clamp(-self.max_turn, self.max_turn),
        }
    }
}

#[cfg(test)]
mod tests;
