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

use super::Scene;

/// `gather` rests behind somebody who is nearer than this, in metres. A body has 0.16 m across, the
/// critical distance of 0.25 m lies between two of them, and a message about a cell has room for all who
/// stand so far apart in it.
pub const BESIDE: f32 = 0.6;
/// So near to the place a robot is there, in metres.
pub const THERE: f32 = 0.3;
const BESIDE_MM: i32 = (BESIDE * 1_000.0) as i32;
/// Slower than this somebody rests, in millimetres per second.
const RESTS_MM_S: i32 = 50;
/// Nearer than this others are kept off, in millimetres.
const ROOM_MM: i32 = 500;
/// Somebody nearer than that by this pushes as hard as the place pulls, in metres.
const GIVE: f32 = 0.25;

/// Who waits behind somebody that its ranger sees is nearer to it than this, in millimetres.
const QUEUE_MM: i32 = 1_200;

/// Wanted velocity, as a share of the permitted speed, and whether what is ahead may be somebody who goes to the
/// place as well: then the robot waits and does not turn aside.
pub(super) fn gather(scene: &Scene<'_>, place: [f32; 2]) -> ([f32; 2], bool) {
    const REST: ([f32; 2], bool) = ([0.0; 2], false);
    let to = [place[0] - scene.pose.x, place[1] - scene.pose.y];
    let left = libm::hypotf(to[0], to[1]);
    if left.is_nan() || left < THERE {
        return REST;
    }
    let way = to.map(|along| along / left);
    let [ahead_x, ahead_y] = way.map(|along| (along * 1_024.0) as i32);
    let left_mm = super::thousandths(left).min(super::FARTHEST_MM);
    let (mut push, mut queue) = ([0_i32; 2], false);
    for other in scene.others() {
        if other.square >= QUEUE_MM * QUEUE_MM {
            continue;
        }
        let distance = other.square.isqrt().max(1);
        let ahead = (other.at[0] * ahead_x + other.at[1] * ahead_y) >> 10;
        // On the way is within 60° of it.
        let on_the_way = 2 * ahead > distance;
        queue |= on_the_way;
        if distance >= BESIDE_MM {
            continue;
        }
        let [vx, vy] = other.velocity;
        let rests = vx * vx + vy * vy < RESTS_MM_S * RESTS_MM_S;
        // The last is the law of cosines: nearer to the place.
        if rests && on_the_way && other.square < 2 * ahead * left_mm {
            return REST;
        }
        let inside = ROOM_MM - distance;
        if inside > 0 {
            push[0] -= other.at[0] * inside / distance;
            push[1] -= other.at[1] * inside / distance;
        }
    }
    let [x, y] = push.map(|mm| mm as f32 * (0.001 / GIVE));
    ([way[0] + x, way[1] + y], queue)
}
