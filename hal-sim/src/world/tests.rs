//! What must hold of every world.

mod cone;
mod contact;
mod convergence;
mod dropped;
mod hearing;
mod known;
mod momentum;
mod motion;
mod movers;
mod power;
mod values;
mod view;

use crawler_hal::ResetCause;
use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;

use super::*;
use crate::devices::{BodyEvent, BodyParts, World};
use crate::sched::{Scheduler, SimClock};

/// A world, its clock, and the parts of its robots.
pub(crate) struct TestWorld {
    pub(crate) world: World,
    pub(crate) scheduler: Scheduler,
    pub(crate) parts: Vec<BodyParts>,
}

impl TestWorld {
    pub(crate) fn new(arena: Arena, parameters: Parameters, seed: u64) -> Self {
        let clock = SimClock::new();
        let scheduler = Scheduler::new(&clock);
        let world = World::with_parameters(arena, parameters, seed, &clock).expect("a sound world");
        Self {
            world,
            scheduler,
            parts: Vec::new(),
        }
    }

    /// Robots all alike, in an empty arena of ten metres.
    pub(crate) fn plain() -> Self {
        Self::new(Arena::empty(10.0, 10.0), alike(), 1)
    }

    pub(crate) fn add(&mut self, x: f32, y: f32, theta: f32) -> RobotIndex {
        let (robot, parts) = self
            .world
            .add_robot(Pose::new(x, y, theta))
            .expect("a free place");
        self.parts.push(parts);
        robot
    }

    /// Sets both wheels, each −255 to 255, as the L298N driver does.
    pub(crate) fn drive(&mut self, robot: usize, left: i16, right: i16) {
        let parts = &mut self.parts[robot];
        for (port, duty) in [(&mut parts.left, left), (&mut parts.right, right)] {
            port.in1.set_state((duty > 0).into()).expect("infallible");
            port.in2.set_state((duty < 0).into()).expect("infallible");
            port.enable
                .set_duty_cycle(duty.unsigned_abs())
                .expect("within the maximum");
        }
    }

    /// One physics step, with the clock.
    pub(crate) fn step(&mut self) {
        let next = self.scheduler.now() + PHYSICS_STEP;
        self.scheduler.advance_to(next);
        self.world.step();
        self.scheduler.run();
    }

    pub(crate) fn steps(&mut self, count: u32) {
        for _ in 0..count {
            self.step();
        }
    }

    pub(crate) fn see(&self, robot: usize) -> Observation {
        self.world
            .observe(RobotIndex::new(robot as u32))
            .expect("it exists")
    }
}

/// Nominal parameters without differences between robots.
pub(crate) fn alike() -> Parameters {
    Parameters {
        spread: Spread::NONE,
        ..Parameters::default()
    }
}
