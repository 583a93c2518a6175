//! One draw: the fleet from the moment on, as it was or with another command.

use std::fmt;

use crawler_protocol::RobotState;
use crawler_sim::run::{Duration, Instant, Simulation, SimulationError};
use crawler_sim::scenario::{KnownBody, Scatter, Scenario, Selector, SpawnPose};
use crawler_sim::world::{Arena, Chassis, Pose};
use rand_pcg::Pcg32;

use crate::bodies::Body;
use crate::past::{LEAD_MS, Order, Past, PastRobot};
use crate::question::{Question, STEP_MS};

/// For robots to boot, and to learn what time it is and where they are.
const BOOT_MS: u64 = 20_000;
/// Around what stands in no arena that is known, metres.
const MARGIN_M: f32 = 10.0;
/// What is left free between robots that are put somewhere, metres.
const CLEAR_M: f32 = 0.002;
/// How often robots that would touch are moved apart.
const ROUNDS: usize = 200;
/// Fixes for each robot in a second.
const FIXES_HZ: f32 = 10.0;

/// Where robots were at a point of time.
pub(crate) type Places = Vec<Pose>;

/// What became of a world.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Branch {
    /// At each point, of each robot: where it is.
    pub(crate) places: Vec<Places>,
    /// Likewise what it was doing.
    pub(crate) states: Vec<Vec<RobotState>>,
    /// Of each robot: how often it touched something.
    pub(crate) contacts: Vec<u32>,
    /// Of each robot: how far it went, metres.
    pub(crate) ways: Vec<f32>,
    /// Least distance between the middles of two robots at any of the points, metres; `None` with one robot.
    pub(crate) nearest: Option<f32>,
}

/// Why there is no world.
#[derive(Debug)]
pub(crate) enum NoWorld {
    /// It cannot be set up.
    Simulation(SimulationError),
    /// Nobody waits for it any more.
    Ended,
}

impl fmt::Display for NoWorld {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulation(error) => error.fmt(f),
            Self::Ended => f.write_str("it was ended"),
        }
    }
}

impl From<SimulationError> for NoWorld {
    fn from(error: SimulationError) -> Self {
        Self::Simulation(error)
    }
}

/// The world of a question, before anything is drawn.
#[derive(Debug, Clone)]
pub(crate) struct Setting<'a> {
    past: &'a Past,
    question: &'a Question,
    bodies: &'a [Body],
    scenario: Scenario,
    /// Where robots are at the moment, none within another.
    there: Vec<Pose>,
}

impl<'a> Setting<'a> {
    pub(crate) fn new(past: &'a Past, bodies: &'a [Body], question: &'a Question) -> Self {
        let arena = past.arena.clone().unwrap_or_else(|| open(&past.robots));
        let apart = |pose: fn(&PastRobot) -> Pose| {
            let poses = past.robots.iter().map(pose).collect();
            set_apart(&arena, poses)
        };
        let (begin, there) = (apart(|robot| robot.begin), apart(|robot| robot.there));
        let mut scenario = Scenario::plain("what if".to_owned());
        scenario.robots = past.robots.len() as u32;
        scenario.arena.width = Some(arena.width);
        scenario.arena.height = Some(arena.height);
        scenario.arena.obstacles = arena.obstacles;
        scenario.arena.movers = arena.movers;
        scenario.arena.patches = arena.patches;
        scenario.arena.objects = arena.objects;
        scenario.arena.scatter = Scatter {
            per_square_metre: 0.0,
            ..scenario.arena.scatter
        };
        let poses = begin.iter().map(|pose| SpawnPose {
            x: pose.x,
            y: pose.y,
            theta: pose.theta,
        });
        scenario.spawn.poses = poses.collect();
        scenario.tracker.rate_hz = FIXES_HZ;
        Self {
            past,
            question,
            bodies,
            scenario,
            there,
        }
    }

    /// The world of a draw; the first has the bodies in the middle of all. `ended` says whether anybody still waits.
    ///
    /// # Errors
    /// [`NoWorld`]
    pub(crate) fn run(
        &self,
        draw: u32,
        with_change: bool,
        ended: &dyn Fn() -> bool,
    ) -> Result<Branch, NoWorld> {
        let mut world = Simulation::lockstep(self.drawn(draw), u64::from(draw) + 1)?;
        let robots = self.past.robots.len();
        let ready = |world: &Simulation| (0..robots).all(|robot| world.takes_commands(robot));
        while !ready(&world) && world.now() < Instant::from_millis(BOOT_MS) {
            stop_if(ended)?;
            world.run_for(Duration::from_millis(100));
        }
        let moment = world.now() + Duration::from_millis(LEAD_MS as u64);
        let mut orders = Orders::new(&self.past.robots, moment);
        orders.follow(&mut world, moment, ended)?;
        for (robot, pose) in self.there.iter().enumerate() {
            // Where somebody stands already it goes on from where it is.
            let _ = world.carry(robot, *pose);
        }
        if with_change {
            for (robot, past) in self.past.robots.iter().enumerate() {
                if self.question.asks(&past.robot) {
                    world.submit(robot, self.question.action.clone());
                }
            }
        }
        self.watch(&mut world, moment, &mut orders, ended)
    }

    fn watch(
        &self,
        world: &mut Simulation,
        moment: Instant,
        orders: &mut Orders,
        ended: &dyn Fn() -> bool,
    ) -> Result<Branch, NoWorld> {
        let robots = 0..self.past.robots.len();
        let contacts = |world: &Simulation| -> Vec<u32> {
            let of = |robot| world.observe(robot).map_or(0, |seen| seen.contacts);
            robots.clone().map(of).collect()
        };
        let before = contacts(world);
        let (mut places, mut states): (Vec<Places>, Vec<Vec<RobotState>>) = Default::default();
        let mut ways = vec![0.0; robots.len()];
        let mut nearest = None;
        for point in 0..self.question.points() as u64 {
            let at = moment + Duration::from_millis(point * u64::from(STEP_MS));
            orders.follow(world, at, ended)?;
            let told = robots.clone().map(|robot| {
                let place = world.pose(robot).unwrap_or(self.there[robot]);
                let own = world.robot(robot).map(|own| own.snapshot().state);
                (place, own.unwrap_or(RobotState::Error))
            });
            let (now, doing): (Places, Vec<RobotState>) = told.unzip();
            if let Some(last) = places.last() {
                for (way, (from, to)) in ways.iter_mut().zip(last.iter().zip(&now)) {
                    *way += apart(*from, *to);
                }
            }
            for (one, place) in now.iter().enumerate() {
                let others = now[one + 1..].iter().map(|other| apart(*place, *other));
                nearest = others.chain(nearest).reduce(f32::min);
            }
            places.push(now);
            states.push(doing);
        }
        let after = contacts(world);
        Ok(Branch {
            places,
            states,
            contacts: after.iter().zip(&before).map(|(a, b)| a - b).collect(),
            ways,
            nearest,
        })
    }

    fn drawn(&self, draw: u32) -> Scenario {
        let mut scenario = self.scenario.clone();
        let mut rng = Pcg32::new(u64::from(draw), 0x7768_6174_6966);
        let robots = self.bodies.iter().enumerate();
        scenario.bodies = robots
            .map(|(robot, body)| {
                let body = match draw {
                    0 => body.middle(),
                    _ => body.draw(&mut rng),
                };
                let robots = Selector::List(vec![robot as u32]);
                KnownBody { robots, ..body }
            })
            .collect();
        scenario
    }
}

/// Distance between two places, metres.
pub(crate) fn apart(one: Pose, other: Pose) -> f32 {
    (one.x - other.x).hypot(one.y - other.y)
}

/// An error once nobody waits any more.
pub(crate) fn stop_if(ended: &dyn Fn() -> bool) -> Result<(), NoWorld> {
    if ended() { Err(NoWorld::Ended) } else { Ok(()) }
}

/// What robots are told, in order.
struct Orders {
    /// When, to whom and what; the next one last.
    due: Vec<(Instant, usize, Order)>,
}

impl Orders {
    fn new(robots: &[PastRobot], moment: Instant) -> Self {
        let each = robots.iter().enumerate();
        let mut due: Vec<(Instant, usize, Order)> = each
            .flat_map(|(robot, past)| {
                past.orders.iter().map(move |order| {
                    let at = order.at_ms.max(-LEAD_MS) * 1_000;
                    let at = moment.as_micros().saturating_add_signed(at);
                    (Instant::from_micros(at), robot, order.clone())
                })
            })
            .collect();
        due.sort_by_key(|(at, ..)| *at);
        due.reverse();
        Self { due }
    }

    /// Lets time pass until `end`, and has robots told what they were told meanwhile.
    fn follow(
        &mut self,
        world: &mut Simulation,
        end: Instant,
        ended: &dyn Fn() -> bool,
    ) -> Result<(), NoWorld> {
        stop_if(ended)?;
        while let Some((at, robot, order)) = self.due.pop_if(|(at, ..)| *at <= end) {
            if at > world.now() {
                world.run_until(at);
            }
            world.submit(robot, order.action);
        }
        world.run_until(end);
        Ok(())
    }
}

/// Ground without anything in it around where robots were, since nobody knows what stands there.
fn open(robots: &[PastRobot]) -> Arena {
    let places = robots.iter().flat_map(|robot| {
        let path = robot.path.iter().flatten().copied();
        path.chain([robot.begin, robot.there])
    });
    let (x, y) = places.fold((0.0_f32, 0.0_f32), |(x, y), place| {
        (x.max(place.x.abs()), y.max(place.y.abs()))
    });
    let side = |most: f32| (2.0 * (most + MARGIN_M)).min(*crawler_sim::world::ARENA_SIDE_M.end());
    Arena::empty(side(x), side(y))
}

/// Poses near these such that no robot is in a wall or in another robot, as far as that can be: what robots say of where they
/// are is a little wrong.
fn set_apart(arena: &Arena, mut poses: Vec<Pose>) -> Vec<Pose> {
    let radius = Chassis::default().radius_m;
    let least = 2.0 * radius + CLEAR_M;
    let half = [arena.width, arena.height].map(|side| (side * 0.5 - radius - CLEAR_M).max(0.0));
    for _ in 0..ROUNDS {
        let mut moved = false;
        for one in 0..poses.len() {
            for other in one + 1..poses.len() {
                let (a, b) = (poses[one], poses[other]);
                let (dx, dy) = (b.x - a.x, b.y - a.y);
                let far = dx.hypot(dy);
                if far >= least {
                    continue;
                }
                // In the same place one goes to the right.
                let (ux, uy) = if far > 1e-6 {
                    (dx / far, dy / far)
                } else {
                    (1.0, 0.0)
                };
                let by = (least - far) * 0.5 + 1e-4;
                (poses[one].x, poses[one].y) = (a.x - ux * by, a.y - uy * by);
                (poses[other].x, poses[other].y) = (b.x + ux * by, b.y + uy * by);
                moved = true;
            }
            moved |= free(arena, half, &mut poses[one], radius);
        }
        if !moved {
            break;
        }
    }
    poses
}

/// Moves a robot out of walls and of what stands in the arena; whether it had to.
fn free(arena: &Arena, half: [f32; 2], pose: &mut Pose, radius: f32) -> bool {
    let inside = [
        pose.x.clamp(-half[0], half[0]),
        pose.y.clamp(-half[1], half[1]),
    ];
    let mut moved = inside != [pose.x, pose.y];
    [pose.x, pose.y] = inside;
    let room = arena.clearance(pose.x, pose.y);
    if room < radius + CLEAR_M * 0.5 {
        // Up the slope of the distance.
        const D: f32 = 1e-3;
        let slope = [
            arena.clearance(pose.x + D, pose.y) - arena.clearance(pose.x - D, pose.y),
            arena.clearance(pose.x, pose.y + D) - arena.clearance(pose.x, pose.y - D),
        ];
        let steep = slope[0].hypot(slope[1]);
        let (ux, uy) = if steep > 1e-9 {
            (slope[0] / steep, slope[1] / steep)
        } else {
            (1.0, 0.0)
        };
        let by = radius + CLEAR_M - room;
        (pose.x, pose.y) = (pose.x + ux * by, pose.y + uy * by);
        moved = true;
    }
    moved
}

#[cfg(test)]
mod tests {
    use crawler_sim::world::Obstacle;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(crawler_properties::cases(64))]

        #[test]
        fn robots_are_set_apart_by_little(
            places in prop::collection::vec((-1.9_f32..1.9, -1.9_f32..1.9), 1..12),
            noise in prop::collection::vec((-0.03_f32..0.03, -0.03_f32..0.03), 12),
        ) {
            let mut arena = Arena::empty(4.0, 4.0);
            arena.obstacles = vec![Obstacle::Circle { x: 0.0, y: 0.0, r: 0.3 }];
            // Where robots can be, and what they say of it.
            let mut true_places: Vec<(f32, f32)> = Vec::new();
            for place in places {
                let clear = arena.clearance(place.0, place.1) >= 0.085;
                let alone = true_places.iter().all(|other| (other.0 - place.0).hypot(other.1 - place.1) >= 0.17);
                if clear && alone {
                    true_places.push(place);
                }
            }
            let told: Vec<Pose> = true_places
                .iter()
                .zip(&noise)
                .map(|(place, noise)| Pose::new(place.0 + noise.0, place.1 + noise.1, 1.0))
                .collect();
            let set = set_apart(&arena, told.clone());
            for (one, pose) in set.iter().enumerate() {
                prop_assert!(arena.clearance(pose.x, pose.y) >= 0.085, "{pose:?}");
                prop_assert!(apart(*pose, told[one]) < 0.25, "{pose:?} from {:?}", told[one]);
                for other in &set[one + 1..] {
                    prop_assert!(apart(*pose, *other) >= 0.17, "{pose:?} and {other:?}");
                }
            }
        }
    }
}
