//! The devices under the shipped drivers, and under abuse.

mod boot;
mod flash;
mod line;
mod others;
mod outliers;
mod ranger;
mod slots;

use core::future::Future;

use crawler_hal::{Clock, Duration, Instant, RangerPort};

use super::*;
use crate::sched::Scheduler;
use crate::world::{Arena, Obstacle, Parameters, Pose, RobotIndex, Spread};

/// One robot before a wall or an obstacle.
struct TestBody {
    world: World,
    scheduler: Scheduler,
    robot: RobotIndex,
    parts: Option<BodyParts>,
}

impl TestBody {
    fn new(arena: Arena, parameters: Parameters, seed: u64, pose: Pose) -> Self {
        let clock = SimClock::new();
        let scheduler = Scheduler::new(&clock);
        let mut world =
            World::with_parameters(arena, parameters, seed, &clock).expect("a sound world");
        let (robot, parts) = world.add_robot(pose).expect("a free place");
        Self {
            world,
            scheduler,
            robot,
            parts: Some(parts),
        }
    }

    /// A robot that looks at a post `distance_m` before its ranger, in a wide arena.
    fn facing(distance_m: f32, parameters: Parameters, seed: u64) -> Self {
        let post = Obstacle::Circle {
            x: parameters.ranger.mount_m + distance_m + 0.3,
            y: 0.0,
            r: 0.3,
        };
        let arena = Arena {
            obstacles: vec![post],
            ..Arena::empty(40.0, 40.0)
        };
        Self::new(arena, parameters, seed, Pose::default())
    }

    fn parts(&mut self) -> BodyParts {
        self.parts.take().expect("taken once")
    }

    /// Runs a program to its end; bodies stand still meanwhile.
    fn run<F: Future>(&mut self, program: F) -> F::Output {
        let limit = self.scheduler.now() + Duration::from_secs(10);
        self.scheduler
            .block_on(program, limit)
            .expect("the program ends")
    }
}

/// Robots all alike and a ranger without error.
fn exact() -> Parameters {
    let mut parameters = Parameters {
        spread: Spread::NONE,
        ..Parameters::default()
    };
    parameters.ranger.noise_mm = 0.0;
    parameters.ranger.noise_share = 0.0;
    parameters.ranger.dropout = 0.0;
    parameters.ranger.multipath = 0.0;
    parameters.ranger.ghost = 0.0;
    parameters
}
