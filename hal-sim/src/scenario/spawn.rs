//! Free places: for robots, and for obstacles among others.

use std::collections::BTreeMap;

use rand_core::Rng;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use super::passable::apart;
use super::timeline::MOST_ENTRIES;
use super::{Scenario, ScenarioError};
use crate::world::{Arena, Pose};

/// Draws for one thing before it is given up: a place for it hardly exists then.
pub(super) const TRIES: u32 = 2_000;

/// Where robots start. The first ones stand at `poses`; the others along `line`, or in `zones`,
/// or anywhere, looking anywhere.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Spawn {
    /// Free space between a robot's rim and anything else, metres. Given poses need none.
    pub clearance: f32,
    /// Share of robots whose ranger is wired for trigger and echo, 0 to 1; the others have a
    /// serial line. They take turns, so that any number of robots has this share as nearly as it
    /// can. Without it all are wired as `parameters.ranger.wiring` says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pulse_share: Option<f32>,
    /// Share of robots that have a camera, 0 to 1; they take turns too. A camera costs 16 KB of
    /// memory, and time only when it takes a picture.
    pub camera_share: f32,
    /// Where the first robots stand.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub poses: Vec<SpawnPose>,
    /// Where the others stand, evenly from one end to the other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<Line>,
    /// Where the others are drawn; they take turns at the zones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub zones: Vec<Zone>,
}

impl Default for Spawn {
    fn default() -> Self {
        Self {
            clearance: 0.1,
            pulse_share: None,
            camera_share: 0.0,
            poses: Vec::new(),
            line: None,
            zones: Vec::new(),
        }
    }
}

/// A given pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpawnPose {
    /// Metres.
    pub x: f32,
    /// Metres.
    pub y: f32,
    /// Where it looks, radians, anticlockwise from the x axis.
    #[serde(default)]
    pub theta: f32,
}

/// A line of robots.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// Place of the first one, metres.
    pub from: [f32; 2],
    /// Place of the last one, metres.
    pub to: [f32; 2],
    /// Where all look, radians, anticlockwise from the x axis.
    #[serde(default)]
    pub theta: f32,
}

/// A rectangle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Zone {
    /// Its middle, metres.
    pub x: f32,
    /// Its middle, metres.
    pub y: f32,
    /// Length along x, metres.
    pub w: f32,
    /// Length along y, metres.
    pub h: f32,
}

impl Scenario {
    /// The poses that do not depend on the seed, for as many robots as there are, with the key of
    /// each.
    fn fixed_poses(&self) -> Vec<(String, Pose)> {
        let robots = self.robots as usize;
        let given = self.spawn.poses.iter().take(robots).enumerate();
        let mut poses: Vec<_> = given
            .map(|(index, at)| {
                let pose = Pose::new(at.x, at.y, at.theta);
                (format!("spawn.poses[{index}]"), pose)
            })
            .collect();
        if let Some(line) = &self.spawn.line {
            let others = robots - poses.len();
            for number in 0..others {
                poses.push(("spawn.line".to_owned(), line.pose(number, others)));
            }
        }
        poses
    }

    /// Checks that given starting places are in the arena and free.
    pub(super) fn validate_spawn(&self, arena: &Arena) -> Result<(), ScenarioError> {
        let spawn = &self.spawn;
        if spawn.poses.len() > MOST_ENTRIES || spawn.zones.len() > MOST_ENTRIES {
            let rule = format!("must have at most {MOST_ENTRIES} entries");
            return Err(ScenarioError::value("spawn", rule));
        }
        if spawn.line.is_some() && !spawn.zones.is_empty() {
            let rule = "and spawn.zones exclude each other";
            return Err(ScenarioError::value("spawn.line", rule));
        }
        let half = [arena.width * 0.5, arena.height * 0.5];
        for (index, zone) in spawn.zones.iter().enumerate() {
            let key = format!("spawn.zones[{index}]");
            let sized = zone.w > 0.0 && zone.h > 0.0;
            // Not-a-number and infinities fail these comparisons.
            let inside = zone.x.abs() + zone.w * 0.5 <= half[0] + 1e-3
                && zone.y.abs() + zone.h * 0.5 <= half[1] + 1e-3;
            if !sized || !inside {
                let rule = "must have a positive width and height and lie in the arena";
                return Err(ScenarioError::value(key, rule));
            }
        }
        let radius = self.parameters.chassis.radius_m;
        let poses = self.fixed_poses();
        for (key, pose) in &poses {
            if !(pose.x.is_finite() && pose.y.is_finite() && pose.theta.is_finite()) {
                return Err(ScenarioError::value(key.as_str(), "must be finite"));
            }
            if arena.clearance(pose.x, pose.y) < radius {
                let rule = format!(
                    "puts a robot at {}, {}, into a wall or an obstacle",
                    pose.x, pose.y
                );
                return Err(ScenarioError::value(key.as_str(), rule));
            }
        }
        // By x, so that only neighbours are compared.
        let mut order: Vec<usize> = (0..poses.len()).collect();
        order.sort_by(|&a, &b| poses[a].1.x.total_cmp(&poses[b].1.x));
        for (rank, &a) in order.iter().enumerate() {
            for &b in &order[rank + 1..] {
                let ((_, one), (_, two)) = (&poses[a], &poses[b]);
                if two.x - one.x >= 2.0 * radius {
                    break;
                }
                if apart([one.x, one.y], [two.x, two.y]) < 2.0 * radius {
                    let (first, second) = (a.min(b), a.max(b));
                    let rule = format!("overlaps {}: robots {first} and {second}", poses[first].0);
                    return Err(ScenarioError::value(poses[second].0.as_str(), rule));
                }
            }
        }
        Ok(())
    }

    /// Draws starting poses. Whoever places a robot there checks that the place is free.
    #[must_use]
    pub fn spawner(&self, arena: &Arena, seed: u64) -> Spawner {
        Spawner {
            half_width: arena.width * 0.5,
            half_height: arena.height * 0.5,
            fixed: self.fixed_poses().into_iter().map(|(_, p)| p).collect(),
            zones: self.spawn.zones.clone(),
            rng: Pcg32::new(seed, 0x7370_6177),
        }
    }
}

impl Line {
    fn pose(&self, number: usize, of: usize) -> Pose {
        let share = if of > 1 {
            number as f32 / (of - 1) as f32
        } else {
            0.5
        };
        let at = |axis: usize| self.from[axis] + (self.to[axis] - self.from[axis]) * share;
        Pose::new(at(0), at(1), self.theta)
    }
}

/// A stream of poses, see [`Scenario::spawner`].
#[derive(Debug, Clone)]
pub struct Spawner {
    half_width: f32,
    half_height: f32,
    fixed: Vec<Pose>,
    zones: Vec<Zone>,
    rng: Pcg32,
}

impl Spawner {
    /// The given pose of robot number `robot`. It may not be free any more.
    #[must_use]
    pub fn given(&self, robot: usize) -> Option<Pose> {
        self.fixed.get(robot).copied()
    }

    /// Where robot number `robot` begins: where it is told to, or at the first drawn place with
    /// this much room, metres, by what `clearance` says of a point. `None` when there is none.
    pub(crate) fn place(
        &mut self,
        robot: usize,
        margin: f32,
        mut clearance: impl FnMut(f32, f32) -> f32,
    ) -> Option<Pose> {
        let given = self.given(robot);
        given.or_else(|| self.find(robot, |pose| clearance(pose.x, pose.y) >= margin))
    }

    /// The first drawn pose for robot number `robot` that `free` agrees to; `None` when it refuses
    /// too many.
    pub fn find(&mut self, robot: usize, mut free: impl FnMut(Pose) -> bool) -> Option<Pose> {
        let beyond = robot.saturating_sub(self.fixed.len());
        let (middle, half) = match self.zones.get(beyond % self.zones.len().max(1)) {
            Some(zone) => ([zone.x, zone.y], [zone.w * 0.5, zone.h * 0.5]),
            None => ([0.0; 2], [self.half_width, self.half_height]),
        };
        let mut draw = |half: f32| {
            let unit = (self.rng.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0);
            (2.0 * unit - 1.0) * half
        };
        (0..TRIES).find_map(|_| {
            let pose = Pose::new(
                middle[0] + draw(half[0]),
                middle[1] + draw(half[1]),
                draw(core::f32::consts::PI),
            );
            free(pose).then_some(pose)
        })
    }
}

/// Obstacles by square, while an arena is being filled.
pub(super) struct Nearby {
    side: f32,
    squares: BTreeMap<(i32, i32), Vec<u32>>,
    /// Obstacles of the scenario itself, of any size: looked at every time.
    fixed: usize,
}

impl Nearby {
    pub(super) fn new(arena: &Arena, side: f32) -> Self {
        Self {
            side: side.max(0.5),
            squares: BTreeMap::new(),
            fixed: arena.obstacles.len(),
        }
    }

    fn square(&self, x: f32, y: f32) -> (i32, i32) {
        (
            libm::floorf(x / self.side) as i32,
            libm::floorf(y / self.side) as i32,
        )
    }

    pub(super) fn add(&mut self, index: u32, x: f32, y: f32) {
        let square = self.square(x, y);
        self.squares.entry(square).or_default().push(index);
    }

    /// Distance to the nearest wall or obstacle, or something larger than `limit`.
    pub(super) fn clearance(&self, arena: &Arena, x: f32, y: f32, limit: f32) -> f32 {
        // An obstacle's centre is at most one square from any point of it.
        let reach = (limit / self.side) as i32 + 2;
        let (column, row) = self.square(x, y);
        let mut close = Arena::empty(arena.width, arena.height);
        close.obstacles.extend(&arena.obstacles[..self.fixed]);
        let bodies = arena.objects.iter().map(crate::world::Object::body);
        close.obstacles.extend(bodies);
        close
            .obstacles
            .extend(arena.movers.iter().map(|mover| mover.body));
        for (_, square) in self
            .squares
            .range((column - reach, i32::MIN)..=(column + reach, i32::MAX))
            .filter(|((_, r), _)| (row - reach..=row + reach).contains(r))
        {
            close
                .obstacles
                .extend(square.iter().map(|&index| arena.obstacles[index as usize]));
        }
        close.clearance(x, y)
    }
}
