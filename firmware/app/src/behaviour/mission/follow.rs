//! `follow`: behind a leader, directly or over others who follow it.
//!
//! Of all neighbours the robot goes behind the one with the fewest hops to the leader: the leader itself
//! has none, a robot behind it one, and so on. A follower that loses sight of the leader in the crowd so
//! goes behind others, without being told whom. Hops are a function of what the neighbours said last; when
//! the leader is gone, they rise with every round until nobody has fewer than [`MOST_HOPS`], and all rest.

use crawler_protocol::{BehaviourName, Pose, Says};

use super::{MissionNews, Scene, Wish};
use crate::behaviour::swarm::VAGUE;
use crate::neighbours::Neighbour;

/// Longest chain: robots that are farther from the leader than this do not follow it.
const MOST_HOPS: u8 = 16;
/// Others are kept off from this distance on, in metres: a body has 0.16 m across.
const SPACE: f32 = 0.42;
/// With this much more than its distance to go a robot hurries, in metres.
const FAR: f32 = 0.5;
/// How strongly those who are too near are kept off, at no distance at all.
const SEPARATION: f32 = 1.5;

/// A robot that follows another one.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Follow {
    leader: u32,
    /// Metres.
    distance: f32,
    /// Over how many robots it follows the leader, the leader included; 0 for not at all.
    hops: u8,
}

impl Follow {
    pub(super) const fn new(leader: u32, distance: f32) -> Self {
        Self {
            leader,
            distance,
            hops: 0,
        }
    }

    pub(super) fn says(&self) -> Says {
        let hops = i32::from(self.hops);
        Says::new(BehaviourName::Follow, &[self.leader as i32, hops])
    }

    pub(super) fn step(&mut self, scene: &Scene<'_>) -> (Wish, Option<MissionNews>) {
        let before = self.hops;
        let ahead = self.ahead(scene);
        self.hops = ahead.map_or(0, |(_, hops)| hops + 1);
        let lost = before > 0 && self.hops == 0;
        let news = lost.then_some(MissionNews::LeaderLost);
        // Not sure of its place it would run into others that are elsewhere.
        let Some((ahead, _)) = ahead.filter(|_| scene.pose.sigma <= VAGUE) else {
            return (Wish::Rest, news);
        };
        let (direction, distance) = towards(scene.pose, ahead);
        let mut wish = [0.0; 2];
        let behind = distance - self.distance;
        if behind > 0.0 {
            let pull = (behind / FAR).min(1.0);
            for ((wish, direction), velocity) in wish.iter_mut().zip(direction).zip(ahead.velocity)
            {
                *wish = direction * pull + velocity / scene.speed.max(0.01);
            }
        }
        for other in scene.near {
            let (direction, distance) = towards(scene.pose, other);
            let inside = (SPACE - distance) / SPACE;
            if inside > 0.0 {
                for (wish, direction) in wish.iter_mut().zip(direction) {
                    *wish -= SEPARATION * inside * direction;
                }
            }
        }
        (Wish::Velocity(wish), news)
    }

    /// The neighbour to go behind, and how many hops it has: the fewest, and of those the nearest.
    fn ahead<'a>(&self, scene: &Scene<'a>) -> Option<(&'a Neighbour, u8)> {
        let away = |other: &Neighbour| {
            let (dx, dy) = (other.x - scene.pose.x, other.y - scene.pose.y);
            dx * dx + dy * dy
        };
        let mut best: Option<(&Neighbour, u8, f32)> = None;
        for other in scene.near {
            let Some(hops) = self.hops_of(other) else {
                continue;
            };
            let away = away(other);
            if best.is_none_or(|(_, least, nearest)| (hops, away) < (least, nearest)) {
                best = Some((other, hops, away));
            }
        }
        best.map(|(other, hops, _)| (other, hops))
    }

    /// Over how many robots `other` follows the same leader; 0 is the leader itself, `None` not at all.
    fn hops_of(&self, other: &Neighbour) -> Option<u8> {
        if other.who == self.leader {
            return Some(0);
        }
        let [leader, hops] = *other.says?.by(BehaviourName::Follow)? else {
            return None;
        };
        let hops = u8::try_from(hops).ok()?;
        (leader == self.leader as i32 && (1..MOST_HOPS).contains(&hops)).then_some(hops)
    }
}

/// From the robot to `other`: direction, and distance in metres. Two in one place are apart by noise alone, so any
/// direction will do.
fn towards(pose: &Pose, other: &Neighbour) -> ([f32; 2], f32) {
    let [dx, dy] = [other.x - pose.x, other.y - pose.y];
    let distance = libm::hypotf(dx, dy);
    if distance < 1e-3 {
        return ([libm::cosf(pose.theta), libm::sinf(pose.theta)], 0.0);
    }
    ([dx / distance, dy / distance], distance)
}
