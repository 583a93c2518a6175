//! Moving by where others are: each behaviour is a rule for a wanted velocity, and all of them are
//! steered alike.
//!
//! | behaviour | rule | after |
//! |---|---|---|
//! | `disperse` | away from everyone within 1.2 m | potential fields: Howard, Mataric and Sukhatme, "Mobile Sensor Network Deployment using Potential Fields", DARS 2002 |
//! | `gather` | to the middle of those in sight, and rest beside the first of them | |
//! | `flock` | separation, alignment, cohesion, and on | Reynolds, "Flocks, Herds, and Schools", SIGGRAPH 1987 |
//! | `formation` | 0.8 m from each neighbour: a lattice of triangles | α-lattices: Olfati-Saber, "Flocking for Multi-Agent Dynamic Systems", IEEE TAC 51(3), 2006 |
//!
//! None of them has a leader or knows more than the nearest sixteen. Whoever is alone rests, but for
//! `flock`, which goes on. What the ranger sees in the way is avoided as in
//! `wander`.

use crawler_protocol::Pose;

use crate::goal::Swarm;
use crate::motion::{Twist, wrap};
use crate::neighbours::Neighbour;

/// `disperse` rests when nobody is nearer than this, in metres.
pub const APART: f32 = 1.2;
/// `gather` rests when somebody is nearer than this, in metres. A body has 0.16 m across, and the
/// critical distance of 0.15 m lies between two of them.
pub const BESIDE: f32 = 0.42;
/// Distance between neighbours in `formation`, in metres.
pub const LATTICE: f32 = 0.8;
/// Neighbours farther than this are not next to it in the lattice: less than the √3 sides of a
/// triangle that lead to the one behind.
const LATTICE_REACH: f32 = 1.3 * LATTICE;
/// Pull of a neighbour in the lattice that is too far, as a share of the push of one that is too
/// near: else those around press the ones in the middle together.
const PULL: f32 = 0.3;
/// `flock` keeps this distance, in metres.
const FLOCK_APART: f32 = 0.6;
/// Weights of separation, alignment, cohesion and going on, in `flock`.
const FLOCK: [f32; 4] = [1.5, 1.0, 0.3, 0.6];
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
        Swarm::Disperse => disperse(pose, near),
        Swarm::Gather => gather(pose, near),
        Swarm::Flock => flock(pose, near, speed),
        Swarm::Formation => formation(pose, near),
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

fn disperse(pose: &Pose, near: &[Neighbour]) -> [f32; 2] {
    let mut sum = [0.0; 2];
    for other in near {
        let (direction, distance) = towards(pose, other);
        let inside = (APART - distance) / FAR;
        if inside > 0.0 {
            add(&mut sum, direction, -inside);
        }
    }
    sum
}

fn gather(pose: &Pose, near: &[Neighbour]) -> [f32; 2] {
    let mut middle = [pose.x, pose.y];
    let mut nearest = f32::INFINITY;
    for other in near {
        add(&mut middle, [other.x, other.y], 1.0);
        nearest = nearest.min(towards(pose, other).1);
    }
    if nearest <= BESIDE {
        return [0.0; 2];
    }
    let count = near.len() as f32 + 1.0;
    let middle = middle.map(|sum| sum / count);
    [(middle[0] - pose.x) / FAR, (middle[1] - pose.y) / FAR]
}

fn flock(pose: &Pose, near: &[Neighbour], speed: f32) -> [f32; 2] {
    let [separation, alignment, cohesion, onwards] = FLOCK;
    let mut sum = [0.0; 2];
    add(
        &mut sum,
        [libm::cosf(pose.theta), libm::sinf(pose.theta)],
        onwards,
    );
    let each = 1.0 / (near.len() as f32).max(1.0);
    for other in near {
        let (direction, distance) = towards(pose, other);
        let inside = (FLOCK_APART - distance) / FLOCK_APART;
        if inside > 0.0 {
            add(&mut sum, direction, -separation * inside);
        }
        add(&mut sum, other.velocity, alignment * each / speed.max(0.01));
        add(&mut sum, direction, cohesion * each * distance.min(1.0));
    }
    sum
}

fn formation(pose: &Pose, near: &[Neighbour]) -> [f32; 2] {
    let mut sum = [0.0; 2];
    let mut nearest: Option<([f32; 2], f32)> = None;
    for other in near {
        let (direction, distance) = towards(pose, other);
        if distance <= LATTICE_REACH {
            let off = (distance - LATTICE) / FAR;
            add(
                &mut sum,
                direction,
                if off > 0.0 { PULL * off } else { off },
            );
        }
        if nearest.is_none_or(|(_, least)| distance < least) {
            nearest = Some((direction, distance));
        }
    }
    match nearest {
        // Nobody is next to it yet: to whoever is nearest.
        Some((direction, distance)) if distance > LATTICE_REACH => {
            direction.map(|along| along * (distance - LATTICE) / FAR)
        }
        Some(_) | None => sum,
    }
}

#[cfg(test)]
#[path = "swarm_tests.rs"]
mod tests;
