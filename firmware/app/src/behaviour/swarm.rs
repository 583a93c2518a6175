//! Moving by where others are: each behaviour is a rule for a wanted velocity, and all of them are
//! steered alike.
//!
//! | behaviour | rule | after |
//! |---|---|---|
//! | `disperse` | away from everyone within 1.2 m | potential fields: Howard, Mataric and Sukhatme, "Mobile Sensor Network Deployment using Potential Fields", DARS 2002 |
//! | `gather` | to one place, and rest behind those who rest there already | |
//! | `flock` | separation, alignment, cohesion, and on | Reynolds, "Flocks, Herds, and Schools", SIGGRAPH 1987 |
//! | `formation` | 0.8 m from each neighbour: a lattice of triangles | α-lattices: Olfati-Saber, "Flocking for Multi-Agent Dynamic Systems", IEEE TAC 51(3), 2006 |
//!
//! None of them has a leader or knows more than the nearest sixteen. Whoever is alone rests, but for
//! `flock`, which goes on. What the ranger sees in the way is avoided as in
//! `wander`.

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
/// Beyond this distance from where it wants to be a robot hurries, in metres.
const FAR: f32 = 0.5;
/// Turning rate per radian of heading error, per second; see [`super::goto_twist`].
const HEADING_GAIN: f32 = 2.5;
/// Beyond this heading error the robot turns in place.
const TURN_IN_PLACE: f32 = 1.0;
/// How little sure of its place a robot may be to move by others, in metres of sigma.
const VAGUE: f32 = 0.5;

/// Wanted motion of a robot at `pose` among `near`, at most at `speed` m/s and `max_turn` rad/s.
pub fn swarm_twist(
    swarm: Swarm,
    pose: &Pose,
    near: &[Neighbour],
    speed: f32,
    max_turn: f32,
) -> Twist {
    // Not sure of its place it would run from, or into, others that are elsewhere.
    if pose.sigma > VAGUE {
        return Twist::ZERO;
    }
    let [x, y] = match swarm {
        Swarm::Disperse => disperse::disperse(pose, near),
        Swarm::Gather { x, y } => gather::gather(pose, near, [x, y]),
        Swarm::Flock => flock::flock(pose, near, speed),
        Swarm::Formation => formation::formation(pose, near),
    };
    let share = libm::hypotf(x, y);
    if share.is_nan() || share < REST {
        return Twist::ZERO;
    }
    let error = wrap(libm::atan2f(y, x) - pose.theta);
    let v = if libm::fabsf(error) > TURN_IN_PLACE {
        0.0
    } else {
        speed * share.min(1.0) * libm::cosf(error)
    };
    Twist {
        v,
        w: (HEADING_GAIN * error).clamp(-max_turn, max_turn),
    }
}

/// From the robot to `other`: direction, and distance in metres. Two in one place are apart by
/// noise alone, so any direction will do.
fn towards(pose: &Pose, other: &Neighbour) -> ([f32; 2], f32) {
    let [dx, dy] = [other.x - pose.x, other.y - pose.y];
    let distance = libm::hypotf(dx, dy);
    if distance < 1e-3 {
        return ([libm::cosf(pose.theta), libm::sinf(pose.theta)], 0.0);
    }
    ([dx / distance, dy / distance], distance)
}

fn add(sum: &mut [f32; 2], direction: [f32; 2], by: f32) {
    sum[0] += direction[0] * by;
    sum[1] += direction[1] * by;
}

#[cfg(test)]
mod tests;
