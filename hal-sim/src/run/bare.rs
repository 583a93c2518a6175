//! Worlds without robot programs: what training wants.
//!
//! A [`BareWorld`] has the same bodies, sensors and randomness as a [`Simulation`], and runs the
//! same control law, filters, odometry and motor driver, called as plain functions. There is no
//! scheduler, no network, no flash and no log. It is a value: a clone is a snapshot in memory, and
//! [`BareWorld::save`] one in bytes.
//!
//! A robot is steered in one of two ways ([`Steering`]): by the shipped controller, which takes
//! orders, or by a function of the caller's that sees what a program would see ([`Senses`]) and
//! answers with a [`Drive`].
//!
//! # Beside a simulation with programs
//! Everything happens at the moment it would happen under the firmware: control every 20 ms, a
//! measurement every 80 ms that is known when its last byte has come over the line, the battery
//! once a second. With the same scenario and seed and the same orders at the same moments, robots
//! go the same way to the last bit, as long as
//!
//! * no brown-out happens: a robot whose supply comes back starts at the next whole control step
//!   here, and at the physics step under the firmware;
//! * no fault is injected and nobody sets parameters: there is neither here;
//! * nobody is sent to a place: the program plans its ways over a map of 4 KB
//!   ([`navigation`](crawler_app::navigation)), which robots here do without: they drive straight there and turn aside;
//! * no two events of one robot fall on the same microsecond in another order than the scheduler's
//!   (control before sense before power).
//!
//! [`Simulation`]: super::Simulation

mod pins;
mod robot;
mod state;
mod steering;
#[cfg(test)]
mod tests;

use crawler_app::controller::{PERIOD, Tuning};
use crawler_app::order::Task;
use crawler_app::parameters::Parameters as Settings;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{ResponseStatus, RobotState};

use super::error::SimulationError;
use super::machine;
use crate::render::{self, Frame};
use crate::scenario::Scenario;
use crate::world::{
    Arena, Body, Fingerprint, Members, Observation, PHYSICS_STEP, Parameters, PlacementError, Pose,
    RobotIndex, Space, Wiring, WorldError,
};
use robot::BareRobot;

pub use state::StateError;
pub use steering::{Drive, Senses, Steering};

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct BareWorld {
    space: Space,
    seed: u64,
    now: Instant,
    /// Settings of controllers and gauges: the usual ones.
    settings: Settings,
    /// What follows from them and the shape of the drive at the nominal voltage.
    tuning: Tuning,
    robots: Vec<BareRobot>,
}

impl BareWorld {
    /// An arena without robots.
    ///
    /// # Errors
    /// When the arena or a parameter is not sound.
    pub fn new(arena: Arena, parameters: Parameters, seed: u64) -> Result<Self, WorldError> {
        parameters.validate()?;
        let geometry = machine::geometry(&parameters.chassis);
        let settings = Settings::default();
        Ok(Self {
            tuning: Tuning::new(&settings, &geometry),
            space: Space::new(arena, parameters)?,
            seed,
            now: Instant::BOOT,
            settings,
            robots: Vec::new(),
        })
    }

    /// The world of a scenario, with its robots where a [`Simulation`](super::Simulation) of this
    /// seed has them. Commands, links and the tracker of the scenario are left out.
    ///
    /// # Errors
    /// See [`SimulationError`].
    pub fn of_scenario(
        scenario: &Scenario,
        seed: u64,
        steering: Steering,
    ) -> Result<Self, SimulationError> {
        scenario.validate()?;
        let arena = scenario.arena(seed)?;
        let mut spawner = scenario.spawner(&arena, seed);
        let parameters = scenario.drawn_parameters(seed);
        let mut world = Self::new(arena, parameters, seed)?;
        // Robots believe what the scenario states, whatever is drawn for their world.
        let believed = machine::geometry(&scenario.parameters.chassis);
        world.tuning = Tuning::new(&world.settings, &believed);
        let margin = parameters.chassis.radius_m + scenario.spawn.clearance;
        for number in 0..scenario.robots {
            let space = &mut world.space;
            let robot = number as usize;
            let pose = spawner
                .given(robot)
                .or_else(|| {
                    spawner.find(robot, |pose| {
                        space.clearance(pose.position(), margin) >= margin
                    })
                })
                .ok_or(SimulationError::NoRoom(number + 1, scenario.robots))?;
            world.add(
                pose,
                scenario.wiring(robot),
                &scenario.body(robot),
                steering,
            )?;
        }
        Ok(world)
    }

    /// Puts a robot at `pose` and switches it on. Its ranger is wired as the parameters say.
    ///
    /// # Errors
    /// See [`PlacementError`]; the world is then unchanged.
    pub fn add_robot(
        &mut self,
        pose: Pose,
        steering: Steering,
    ) -> Result<RobotIndex, PlacementError> {
        self.add_wired(pose, self.space.parameters.ranger.wiring, steering)
    }

    /// The same with this wiring of its ranger, whatever the parameters say.
    ///
    /// # Errors
    /// See [`PlacementError`]; the world is then unchanged.
    pub fn add_wired(
        &mut self,
        pose: Pose,
        wiring: Wiring,
        steering: Steering,
    ) -> Result<RobotIndex, PlacementError> {
        self.add(pose, wiring, &Body::default(), steering)
    }

    fn add(
        &mut self,
        pose: Pose,
        wiring: Wiring,
        known: &Body,
        steering: Steering,
    ) -> Result<RobotIndex, PlacementError> {
        let robot = self.space.place(pose, self.seed, known)?;
        let body = BareRobot::new(self, robot, wiring, steering);
        self.robots.push(body);
        Ok(robot)
    }

    /// Lets time pass for as many whole control steps (20 ms) as `period` takes, one at least.
    /// Robots of [`Steering::Caller`] go on with what they were told last.
    pub fn step(&mut self, period: Duration) {
        self.step_with(period, |_, _| None);
    }

    /// The same, asking `steer` at each control step what a robot of [`Steering::Caller`] is to
    /// do; `None` is to go on. Robots of [`Steering::Shipped`] steer themselves.
    ///
    /// Allocates nothing.
    pub fn step_with(
        &mut self,
        period: Duration,
        mut steer: impl FnMut(RobotIndex, &Senses) -> Option<Drive>,
    ) {
        let count = period.as_micros().div_ceil(PERIOD.as_micros()).max(1);
        for _ in 0..count {
            self.control_step(&mut steer);
        }
    }

    fn control_step(&mut self, steer: &mut impl FnMut(RobotIndex, &Senses) -> Option<Drive>) {
        let end = self.now + PERIOD;
        while self.now < end {
            // What the rangers do between two steps of the world sees it as it is then.
            let next = self.now + PHYSICS_STEP;
            for (i, robot) in self.robots.iter_mut().enumerate() {
                robot.sense(&mut self.space, i, next);
            }
            let robots = &mut self.robots;
            self.space
                .step(Members::ALL, |i, power| robots[i].power_changed(power));
            self.now = next;
        }
        for i in 0..self.robots.len() {
            if self.robots[i].wants_boot(&self.space, i) {
                self.robots[i] = self.robots[i].booted_again(self, RobotIndex::new(i as u32));
            }
            let robot = &mut self.robots[i];
            robot.control(&mut self.space, i, self.now, &self.tuning, steer);
        }
    }

    /// Gives a robot of [`Steering::Shipped`] an order, which it takes at its next control step;
    /// false when there is no such robot or it has four waiting already.
    pub fn order(&mut self, robot: RobotIndex, task: Task) -> bool {
        let now = self.now;
        self.robots
            .get_mut(robot.get() as usize)
            .is_some_and(|body| body.order(task, now))
    }

    /// Has a robot of [`Steering::Shipped`] stop at once, as `stop` does, and `estop` when it is an
    /// emergency; false when there is no such robot.
    pub fn halt(&mut self, robot: RobotIndex, emergency: bool) -> bool {
        let i = robot.get() as usize;
        let (now, tuning) = (self.now, &self.tuning);
        match self.robots.get_mut(i) {
            Some(body) => body.halt(&mut self.space, i, emergency, now, tuning),
            None => false,
        }
    }

    /// How the last order of a robot ended, or was refused; `None` while it goes on.
    pub fn answer(&self, robot: RobotIndex) -> Option<ResponseStatus> {
        self.robots.get(robot.get() as usize)?.answer()
    }

    /// The state of a robot's controller; `None` for other robots.
    pub fn state(&self, robot: RobotIndex) -> Option<RobotState> {
        self.robots.get(robot.get() as usize)?.state()
    }

    /// What a robot knows; `None` when it never existed.
    pub fn senses(&self, robot: RobotIndex) -> Option<Senses> {
        let i = robot.get() as usize;
        Some(self.robots.get(i)?.senses(&self.space, i, self.now))
    }

    /// The truth about a robot; `None` when it never existed.
    pub fn observe(&self, robot: RobotIndex) -> Option<Observation> {
        self.space.observe(robot.get() as usize)
    }

    /// The truth about where a robot is, how fast it drives ahead (m/s) and how fast it turns (rad/s); `None` when it
    /// never existed.
    pub fn motion(&self, robot: RobotIndex) -> Option<(Pose, [f32; 2])> {
        let i = robot.get() as usize;
        let seen = &self.space.bodies.published;
        let forward = seen.velocity.get(i)?.dot(*seen.heading.get(i)?);
        let pose = self.space.observe(i)?.pose;
        Some((pose, [forward, *seen.spin.get(i)?]))
    }

    /// What robots believe of their drive.
    pub const fn tuning(&self) -> &Tuning {
        &self.tuning
    }

    /// Draws what the camera of a robot sees; see [`crate::devices::World::render`].
    pub fn render(&mut self, robot: RobotIndex, frame: &mut Frame) -> bool {
        render::view(&mut self.space, robot.get() as usize, frame)
    }

    /// Takes a robot out of the world.
    pub fn remove_robot(&mut self, robot: RobotIndex) {
        self.space.remove(robot.get() as usize);
    }

    /// Time since the beginning of the world.
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Number of robots ever added.
    pub fn robots(&self) -> usize {
        self.robots.len()
    }

    /// The arena.
    pub fn arena(&self) -> &Arena {
        &self.space.arena
    }

    /// The parameters.
    pub fn parameters(&self) -> &Parameters {
        &self.space.parameters
    }

    /// A fingerprint of all that follows depends on.
    pub fn hash(&self) -> u64 {
        let mut hash = Fingerprint::new();
        hash.word(self.seed);
        hash.word(self.now.as_micros());
        hash.word(self.space.fingerprint());
        for robot in &self.robots {
            robot.fingerprint(|word| hash.word(word));
        }
        hash.value()
    }
}
