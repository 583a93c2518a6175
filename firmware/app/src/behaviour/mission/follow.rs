//! `follow`: behind a leader, directly or over others who follow it.
//!
//! Of all neighbours the robot goes behind the one with the fewest hops to the leader: the leader itself
//! has none, a robot behind it one, and so on. A follower that loses sight of the leader in the crowd so
//! goes behind others, without being told whom. Hops are a function of what the neighbours said last; when
//! the leader is gone, they rise with every round until nobody has fewer than [`MOST_HOPS`], and all rest.

use crawler_protocol::{BehaviourName, Says};

use super::{MissionNews, Scene, Wish};
use crate::behaviour::swarm::{FULL, VAGUE, from};
use crate::motion::angle::{ONE, PoseMm, length, millimetres, unit};
use crate::neighbours::Neighbour;

/// Longest chain: robots that are farther from the leader than this do not follow it.
const MOST_HOPS: u8 = 16;
/// Others are kept off from this distance on, in millimetres: a body has 160 mm across.
const SPACE_MM: i32 = 420;
/// With this much more than its distance to go a robot hurries, in millimetres.
const FAR_MM: i32 = 500;
/// How strongly those who are too near are kept off, at no distance at all.
const SEPARATION: i32 = FULL * 3 / 2;

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
        let here = PoseMm::new(scene.pose);
        let mut wish = [0; 2];
        if let Some((direction, distance)) = towards(&here, ahead, i32::MAX) {
            let behind = distance - millimetres(self.distance);
            if behind > 0 {
                let pull = behind.min(FAR_MM) * FULL / FAR_MM;
                let speed = millimetres(scene.speed).max(10);
                for ((wish, direction), velocity) in
                    wish.iter_mut().zip(direction).zip(ahead.velocity())
                {
                    *wish = direction * pull / ONE + velocity * FULL / speed;
                }
            }
        }
        for other in scene.near {
            let Some((direction, distance)) = towards(&here, other, SPACE_MM) else {
                continue;
            };
            let push = SEPARATION * (SPACE_MM - distance) / SPACE_MM;
            for (wish, direction) in wish.iter_mut().zip(direction) {
                *wish -= push * direction / ONE;
            }
        }
        (Wish::Velocity(wish), news)
    }

    /// The neighbour to go behind, and how many hops it has: the fewest, and of those the nearest.
    fn ahead<'a>(&self, scene: &Scene<'a>) -> Option<(&'a Neighbour, u8)> {
        let own = [scene.pose.x, scene.pose.y].map(millimetres);
        let mut best: Option<(&Neighbour, u8, i32)> = None;
        for other in scene.near {
            let Some(hops) = self.hops_of(other) else {
                continue;
            };
            let Some([x, y]) = from(own, other) else {
                continue;
            };
            let away = x * x + y * y;
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
        let [leader, hops] = *other.says.as_ref()?.by(BehaviourName::Follow)? else {
            return None;
        };
        let hops = u8::try_from(hops).ok()?;
        (leader == self.leader as i32 && (1..MOST_HOPS).contains(&hops)).then_some(hops)
    }
}

/// From the robot to `other`: direction, and distance in millimetres, unless that is more than `most`. Two in one place
/// are apart by noise alone, so any direction will do.
fn towards(here: &PoseMm, other: &Neighbour, most: i32) -> Option<([i32; 2], i32)> {
    let [x, y] = from(here.at, other)?;
    if x.abs() > most || y.abs() > most {
        return None;
    }
    let distance = length([x, y]);
    let direction = if distance == 0 {
        here.ahead
    } else {
        unit([x, y])
    };
    (distance <= most).then_some((direction, distance))
}
