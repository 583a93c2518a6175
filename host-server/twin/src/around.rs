//! What a robot may touch: the walls of a room, what stands in it, and other robots.
//!
//! A robot that rubs along a wall or pushes another one does less than its motors make, and nothing is wrong with it. A
//! twin knows no walls; where somebody does, [`crate::shadow::Shadow::near`] has it look on meanwhile.

use std::collections::HashMap;
use std::hash::Hash;

/// Metres from the middle of a robot to a wall that it may touch until the next fix, or has since the last one.
const WALL_M: f64 = 0.17;
/// The same to the middle of another robot.
const ROBOT_M: f64 = 0.28;
/// Where a robot was so long ago it may not be any more, seconds.
const FRESH_S: f64 = 3.0;

/// Something that stands in the way: a box whose edges are rounded.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Solid {
    /// Its middle, metres.
    pub at: [f64; 2],
    /// Half of its length and width, metres.
    pub half: [f64; 2],
    /// How it is turned, anticlockwise, radians.
    pub theta: f64,
    /// What is around the box, metres.
    pub radius: f64,
}

impl Solid {
    /// How far it is from a place, metres.
    #[must_use]
    pub fn distance(&self, at: [f64; 2]) -> f64 {
        let (sin, cos) = self.theta.sin_cos();
        let (dx, dy) = (at[0] - self.at[0], at[1] - self.at[1]);
        let along = (cos * dx + sin * dy).abs() - self.half[0];
        let across = (cos * dy - sin * dx).abs() - self.half[1];
        along.max(0.0).hypot(across.max(0.0)) - self.radius
    }
}

/// The walled rectangle around the origin that simulated robots are in.
#[derive(Debug, Clone, PartialEq)]
pub struct Room {
    /// Length and width, metres.
    pub sides: [f64; 2],
    /// What stands in it.
    pub solids: Vec<Solid>,
}

impl Room {
    /// How far the nearest wall is from a place, metres; less than nothing beyond it.
    #[must_use]
    pub fn to_wall(&self, at: [f64; 2]) -> f64 {
        let to = [0, 1].map(|axis: usize| self.sides[axis] * 0.5 - at[axis].abs());
        to[0].min(to[1])
    }

    /// Whether a robot there may touch a wall or what stands in the room.
    #[must_use]
    pub fn is_near(&self, at: [f64; 2]) -> bool {
        let solids = &mut self.solids.iter();
        self.to_wall(at) < WALL_M || solids.any(|solid| solid.distance(at) < WALL_M)
    }
}

/// Robots by where they were seen last.
#[derive(Debug, Clone)]
pub struct Robots<K> {
    /// Place and time.
    seen: HashMap<K, ([f64; 2], f64)>,
    /// Those in each square of the floor whose sides are [`ROBOT_M`].
    squares: HashMap<[i64; 2], Vec<K>>,
}

impl<K> Default for Robots<K> {
    fn default() -> Self {
        Self {
            seen: HashMap::new(),
            squares: HashMap::new(),
        }
    }
}

fn square(at: [f64; 2]) -> [i64; 2] {
    // What is no number is nowhere near; beyond all floors is the farthest square.
    at.map(|along| (along / ROBOT_M).floor() as i64)
}

impl<K: Clone + Eq + Hash> Robots<K> {
    /// Takes in where a robot was seen, at a second.
    pub fn see(&mut self, robot: &K, at: [f64; 2], at_s: f64) {
        let before = self.seen.insert(robot.clone(), (at, at_s));
        let (from, to) = (before.map(|(place, _)| square(place)), square(at));
        if from == Some(to) {
            return;
        }
        if let Some(from) = from {
            self.leave(robot, from);
        }
        self.squares.entry(to).or_default().push(robot.clone());
    }

    /// Forgets a robot.
    pub fn forget(&mut self, robot: &K) {
        if let Some((place, _)) = self.seen.remove(robot) {
            self.leave(robot, square(place));
        }
    }

    fn leave(&mut self, robot: &K, from: [i64; 2]) {
        let Some(there) = self.squares.get_mut(&from) else {
            return;
        };
        there.retain(|one| one != robot);
        if there.is_empty() {
            self.squares.remove(&from);
        }
    }

    /// Whether a robot there may touch another one, of those that were seen not long before a second.
    #[must_use]
    pub fn is_near(&self, robot: &K, at: [f64; 2], at_s: f64) -> bool {
        let [x, y] = square(at);
        let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [dx, dy]));
        let touches = |other: &K| {
            let Some((place, seen_s)) = self.seen.get(other) else {
                return false;
            };
            let distance = (place[0] - at[0]).hypot(place[1] - at[1]);
            other != robot && distance < ROBOT_M && at_s - seen_s < FRESH_S
        };
        around
            .map(|[dx, dy]| [x.saturating_add(dx), y.saturating_add(dy)])
            .filter_map(|square| self.squares.get(&square))
            .any(|there| there.iter().any(touches))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn walls_and_what_stands_there_are_near_by_their_edges() {
        let solid = Solid {
            at: [1.0, 0.0],
            half: [0.5, 0.1],
            theta: std::f64::consts::FRAC_PI_2,
            radius: 0.0,
        };
        let room = Room {
            sides: [8.0, 4.0],
            solids: vec![solid],
        };
        assert!((room.to_wall([-3.0, 0.5]) - 1.0).abs() < 1e-12);
        assert!((room.to_wall([0.0, -1.9]) - 0.1).abs() < 1e-12);
        assert!((solid.distance([1.0, 0.6]) - 0.1).abs() < 1e-12);
        assert!((solid.distance([1.3, 0.0]) - 0.2).abs() < 1e-12);
        for (at, near) in [
            ([0.0, 1.9], true),
            ([0.0, 1.8], false),
            ([-3.84, 0.0], true),
            ([1.0, 0.65], true),
            ([1.0, 0.7], false),
            ([9.0, 0.0], true),
        ] {
            assert_eq!(room.is_near(at), near, "{at:?}");
        }
    }

    proptest! {
        #[test]
        fn robots_are_near_whatever_squares_they_are_in(
            steps in prop::collection::vec((0_u8..6, -1.0..1.0_f64, -1.0..1.0_f64, prop::bool::weighted(0.1)), 1..200),
            looks in prop::collection::vec((0_u8..6, -1.0..1.0_f64, -1.0..1.0_f64), 1..20),
        ) {
            let (mut robots, mut seen) = (Robots::default(), HashMap::new());
            for (second, (robot, x, y, goes)) in steps.iter().enumerate() {
                let at_s = second as f64 * 0.1;
                if *goes {
                    robots.forget(robot);
                    seen.remove(robot);
                } else {
                    robots.see(robot, [*x, *y], at_s);
                    seen.insert(*robot, ([*x, *y], at_s));
                }
            }
            let at_s = steps.len() as f64 * 0.1;
            for (robot, x, y) in looks {
                let near = seen.iter().any(|(other, (place, seen_s))| {
                    let distance = (place[0] - x).hypot(place[1] - y);
                    *other != robot && distance < ROBOT_M && at_s - seen_s < FRESH_S
                });
                prop_assert_eq!(robots.is_near(&robot, [x, y], at_s), near);
            }
            let held: usize = robots.squares.values().map(Vec::len).sum();
            prop_assert_eq!(held, seen.len());
            prop_assert!(robots.squares.values().all(|there| !there.is_empty()));
            robots.see(&9, [f64::NAN, f64::INFINITY], at_s);
            prop_assert!(!robots.is_near(&8, [f64::NAN, -f64::INFINITY], at_s));
        }
    }
}
