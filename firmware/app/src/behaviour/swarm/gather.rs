//! `gather`: to one place, and rest behind those who rest there already.
//!
//! Whoever moves by others knows where it is in the coordinates in which others are told, so all know one
//! place without a word: the one they were told, by default the origin. Clusters that only look for each
//! other at random, as in Soysal and Şahin, "Probabilistic Aggregation Strategies in Swarm Robotic
//! Systems", IEEE SIS 2005, take a time that grows with the area, far more than minutes for two hundred robots.
//!
//! A robot rests when it is at the place, or when one that rests is nearer to the place, next to
//! it and on its way. So everyone who rests has a next one that rests and is nearer to the place, down to one
//! that is at it: those who rest are one cluster, however they came. Everyone else moves towards the
//! place.

use crawler_protocol::Pose;

use super::{add, towards};
use crate::neighbours::Neighbour;

/// `gather` rests behind somebody who is nearer than this, in metres. A body has 0.16 m across, the
/// critical distance of 0.25 m lies between two of them, and a message about a cell has room for all who
/// stand so far apart in it.
pub const BESIDE: f32 = 0.55;
/// So near to the place a robot is there, in metres.
pub const THERE: f32 = 0.3;
/// Slower than this somebody rests, in metres per second.
const RESTS: f32 = 0.05;
/// Cosine of the angle to the way ahead within which somebody is on it: 60°.
const ON_THE_WAY: f32 = 0.5;
/// Nearer than this others are kept off, in metres.
const ROOM: f32 = 0.45;
/// Somebody nearer than [`ROOM`] by this pushes as hard as the place pulls, in metres.
const GIVE: f32 = 0.25;

pub(super) fn gather(pose: &Pose, near: &[Neighbour], place: [f32; 2]) -> [f32; 2] {
    let to = [place[0] - pose.x, place[1] - pose.y];
    let left = libm::hypotf(to[0], to[1]);
    if left.is_nan() || left < THERE {
        return [0.0; 2];
    }
    let way = to.map(|along| along / left);
    let mut sum = way;
    for other in near {
        let (dx, dy) = (other.x - pose.x, other.y - pose.y);
        // Of the sixteen nearest six at most are so near, once they have found their places.
        let apart = dx * dx + dy * dy;
        if apart.is_nan() || apart >= BESIDE * BESIDE {
            continue;
        }
        let (direction, distance) = towards(pose, other);
        let [vx, vy] = other.velocity;
        let rests = vx * vx + vy * vy < RESTS * RESTS;
        let ahead = direction[0] * way[0] + direction[1] * way[1];
        // The last is the law of cosines: nearer to the place.
        if rests && ahead > ON_THE_WAY && distance < 2.0 * ahead * left {
            return [0.0; 2];
        }
        if distance < ROOM {
            add(&mut sum, direction, (distance - ROOM) / GIVE);
        }
    }
    sum
}
