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

use super::{FULL, Scene};
use crate::motion::angle::{ONE, ONE_BITS, length, unit};

/// `gather` rests behind somebody who is nearer than this, in metres. A body has 0.16 m across, the
/// critical distance of 0.25 m lies between two of them, and a message about a cell has room for all who
/// stand so far apart in it.
pub const BESIDE: f32 = 0.6;
/// So near to the place a robot is there, in metres.
pub const THERE: f32 = 0.3;
const BESIDE_MM: i32 = (BESIDE * 1_000.0) as i32;
const THERE_MM: i32 = (THERE * 1_000.0) as i32;
/// Slower than this somebody rests, in millimetres per second.
const RESTS_MM_S: i16 = 50;
/// Nearer than this others are kept off, in millimetres.
const ROOM_MM: i32 = 500;
/// Somebody nearer than that by this pushes as hard as the place pulls, in millimetres.
const GIVE_MM: i32 = 250;
/// Who waits behind somebody that its ranger sees is nearer to it than this, in millimetres.
const QUEUE_MM: i32 = 1_200;

/// Wanted velocity, in 1/[`FULL`] of the permitted speed, and whether what is ahead may be somebody who goes to the
/// place as well: then the robot waits and does not turn aside. The place is in millimetres.
pub(super) fn gather(scene: &Scene<'_>, place: [i32; 2]) -> ([i32; 2], bool) {
    const REST: ([i32; 2], bool) = ([0; 2], false);
    let to = [0, 1].map(|axis: usize| place[axis].saturating_sub(scene.here.at[axis]));
    let left = length(to);
    if left < THERE_MM {
        return REST;
    }
    let way = unit(to);
    let left = left.min(super::FARTHEST_MM);
    let (mut push, mut queue) = ([0_i32; 2], false);
    for other in scene.near {
        let Some(other) = scene.other(other) else {
            continue;
        };
        if other.square >= QUEUE_MM * QUEUE_MM {
            continue;
        }
        let distance = length(other.at).max(1);
        let ahead = (other.at[0] * way[0] + other.at[1] * way[1]) >> ONE_BITS;
        // On the way is within 60° of it.
        let on_the_way = 2 * ahead > distance;
        queue |= on_the_way;
        if distance >= BESIDE_MM {
            continue;
        }
        let rests = other.is.speed.abs() < RESTS_MM_S;
        // The last is the law of cosines: nearer to the place.
        if rests && on_the_way && other.square < 2 * ahead * left {
            return REST;
        }
        let inside = ROOM_MM - distance;
        if inside > 0 {
            push[0] -= other.at[0] * inside / distance;
            push[1] -= other.at[1] * inside / distance;
        }
    }
    let wish = |axis: usize| way[axis] * FULL / ONE + push[axis] * FULL / GIVE_MM;
    ([wish(0), wish(1)], queue)
}
