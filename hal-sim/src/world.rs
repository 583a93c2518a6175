//! One simulated arena and the bodies in it.
//!
//! A [`World`] is a value: the same arena, parameters, seed and calls give the same bytes of
//! state, whatever else runs in the process. It holds no program; [`World::add_robot`] hands out
//! the devices a robot program runs on, and [`World::step`] moves everything on by
//! [`PHYSICS_STEP`]. Between steps bodies stand still, and a device asked for something answers
//! from the state of the last step.

mod arena;
mod battery;
mod bodies;
mod error;
mod geometry;
mod grid;
mod hash;
mod parameters;
mod physics;
mod ports;
mod rng;
mod space;
#[cfg(test)]
mod tests;

use std::cell::RefCell;
use std::rc::Rc;

use crawler_hal::{Clock, Millivolts, ResetCause};

pub use arena::{ARENA_SIDE_M, Arena, ArenaError, MAX_OBSTACLES, Obstacle};
pub use error::{PlacementError, WorldError};
pub use geometry::Pose;
pub use parameters::{
    Chassis, Gauge, Pack, ParameterError, Parameters, Ranger, Spread, Surroundings, Wiring,
};
pub use physics::PHYSICS_STEP;
pub use ports::BodyEvent;

pub(crate) use bodies::{Bridge, Inputs, Presence};
pub(crate) use geometry::Vec2;
pub(crate) use ports::{Ports, Shared, Wire};
pub(crate) use rng::{Purpose, normal, stream, uniform};
pub(crate) use space::{Sight, Space, Surface};

use crate::devices::BodyParts;
use crate::faults::{Fault, FaultError};
use crate::sched::SimClock;
use geometry::wrap_any;
use physics::Power;

/// Most robots of one world; the live feed counts them in 16 bits.
pub const MAX_ROBOTS: usize = 65_535;

/// Physics steps between two looks at the watchdogs: 100 ms.
const WATCHDOG_STEPS: u64 = 10;

/// A robot of a world. Given out in order from 0 and never used again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RobotIndex(u32);

impl RobotIndex {
    /// The robot added as number `index`, counting from 0.
    pub const fn new(index: u32) -> Self {
        Self(index)
    }

    /// The number, counting from 0.
    pub const fn get(self) -> u32 {
        self.0
    }
}

/// The truth about a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Where it is and where it looks.
    pub pose: Pose,
    /// Forward speed of the wheels' middle, metres per second.
    pub speed: f32,
    /// Rate of turn, radians per second, anticlockwise.
    pub turn: f32,
    /// How often it began to touch something.
    pub contacts: u32,
    /// Terminal voltage of the pack.
    pub battery: Millivolts,
    /// Share of the charge left, 0 to 1.
    pub charge: f32,
    /// Duty of the left and right enable input, −255 to 255, negative while the direction pins
    /// say backward, 0 while they say brake.
    pub duty: [i16; 2],
    /// Level of the lamp pin.
    pub lamp: bool,
    /// Whether its supply is above the brown-out voltage.
    pub powered: bool,
    /// Whether it is still in the world.
    pub present: bool,
    /// How often the watchdog bit.
    pub starvations: u32,
    /// Rules of flash memory broken by the program.
    pub flash_violations: u32,
}

/// See the [module](self).
pub struct World {
    shared: Rc<Shared>,
    robots: Vec<Rc<Ports>>,
}

impl World {
    /// An arena without robots, nominal in every parameter.
    ///
    /// # Errors
    /// When the arena is not sound.
    pub fn new(arena: Arena, seed: u64, clock: &SimClock) -> Result<Self, WorldError> {
        Self::with_parameters(arena, Parameters::default(), seed, clock)
    }

    /// An arena without robots. Its devices keep the time of `clock`.
    ///
    /// # Errors
    /// When the arena or a parameter is not sound.
    pub fn with_parameters(
        arena: Arena,
        parameters: Parameters,
        seed: u64,
        clock: &SimClock,
    ) -> Result<Self, WorldError> {
        parameters.validate()?;
        Ok(Self {
            shared: Rc::new(Shared {
                space: RefCell::new(Space::new(arena, parameters)?),
                clock: clock.world(),
                seed,
                events: RefCell::new(Vec::new()),
            }),
            robots: Vec::new(),
        })
    }

    /// The arena.
    pub fn arena(&self) -> Arena {
        self.shared.space.borrow().arena.clone()
    }

    /// The parameters.
    pub fn parameters(&self) -> Parameters {
        self.shared.space.borrow().parameters
    }

    /// Number of robots ever added.
    pub fn robots(&self) -> usize {
        self.robots.len()
    }

    /// Number of physics steps so far.
    pub fn steps(&self) -> u64 {
        self.shared.space.borrow().steps
    }

    /// Distance in metres from a point to the nearest wall, obstacle or robot, negative within
    /// one. Obstacles and robots beyond `limit` may be left out.
    pub fn clearance(&self, x: f32, y: f32, limit: f32) -> f32 {
        let mut space = self.shared.space.borrow_mut();
        space.clearance(Vec2::new(x, y), limit.clamp(0.0, 1_000.0))
    }

    /// Puts a robot at `pose` and switches it on. Its ranger is wired as the parameters say.
    ///
    /// # Errors
    /// See [`PlacementError`]; the world is then unchanged.
    pub fn add_robot(&mut self, pose: Pose) -> Result<(RobotIndex, BodyParts), PlacementError> {
        self.add_wired(pose, self.parameters().ranger.wiring)
    }

    /// Puts a robot with this wiring of its ranger at `pose`, whatever the parameters say, and
    /// switches it on.
    ///
    /// # Errors
    /// See [`PlacementError`]; the world is then unchanged.
    pub fn add_wired(
        &mut self,
        pose: Pose,
        wiring: Wiring,
    ) -> Result<(RobotIndex, BodyParts), PlacementError> {
        if !pose.is_finite() {
            return Err(PlacementError::NotFinite);
        }
        if self.robots.len() >= MAX_ROBOTS {
            return Err(PlacementError::Full);
        }
        let radius = self.parameters().chassis.radius_m;
        if self.clearance(pose.x, pose.y, 2.0 * radius) < radius {
            return Err(PlacementError::Occupied);
        }
        let index = RobotIndex(self.robots.len() as u32);
        let mut rng = stream(self.shared.seed, index.0, Purpose::Build);
        {
            let space = &mut *self.shared.space.borrow_mut();
            let pose = Pose::new(pose.x, pose.y, wrap_any(pose.theta));
            space.bodies.push(pose, &space.parameters, &mut rng);
        }
        let ports = Rc::new(Ports::new(Rc::clone(&self.shared), index, wiring));
        let parts = BodyParts::new(&ports);
        self.robots.push(ports);
        Ok((index, parts))
    }

    /// Takes a robot out of the world: it is no longer seen, touched or moved. Its devices are
    /// disconnected. Does nothing when there is no such robot.
    pub fn remove_robot(&mut self, robot: RobotIndex) {
        let Some(ports) = self.robots.get(robot.0 as usize) else {
            return;
        };
        ports.life.set(ports.life.get().wrapping_add(1));
        let mut space = self.shared.space.borrow_mut();
        let i = ports.index();
        space.bodies.presence[i] = Presence::Removed;
        space.bodies.inputs[i] = bodies::Inputs::default();
        space.bodies.left[i] = 0.0;
        space.bodies.right[i] = 0.0;
    }

    /// Starts a robot anew after [`BodyEvent::Reset`], or at will: the devices handed out before
    /// are disconnected, all outputs are low, the flash keeps its contents.
    ///
    /// `None` when there is no such robot, or it was removed or has no power.
    pub fn boot(&mut self, robot: RobotIndex, cause: ResetCause) -> Option<BodyParts> {
        let ports = self.robots.get(robot.0 as usize)?;
        {
            let mut space = self.shared.space.borrow_mut();
            let i = ports.index();
            if space.bodies.presence[i] != Presence::Present {
                return None;
            }
            space.bodies.inputs[i] = bodies::Inputs::default();
        }
        ports.life.set(ports.life.get().wrapping_add(1));
        ports.resetting.set(false);
        ports.cause.set(cause);
        let mut watchdog = ports.watchdog.get();
        watchdog.fed = None;
        ports.watchdog.set(watchdog);
        ports.sonar.borrow_mut().restart();
        ports.chip.borrow_mut().restore_power();
        Some(BodyParts::new(ports))
    }

    /// Moves everything on by one [`PHYSICS_STEP`].
    ///
    /// Call it when the clock has reached the end of the step, before the programs run that are
    /// due then.
    pub fn step(&mut self) {
        let mut changes = Vec::new();
        let (steps, watchdog_us) = {
            let mut space = self.shared.space.borrow_mut();
            space.step(|i, power| changes.push((i, power)));
            (
                space.steps,
                u64::from(space.parameters.surroundings.watchdog_ms) * 1_000,
            )
        };
        for (i, power) in changes {
            let ports = &self.robots[i];
            match power {
                Power::Lost => {
                    ports.life.set(ports.life.get().wrapping_add(1));
                    ports.resetting.set(false);
                    ports.chip.borrow_mut().lose_power();
                    let mut watchdog = ports.watchdog.get();
                    watchdog.fed = None;
                    ports.watchdog.set(watchdog);
                    self.shared
                        .events
                        .borrow_mut()
                        .push(BodyEvent::PowerLost(ports.robot));
                }
                Power::Restored => ports.ask_reset(ResetCause::BrownOut),
            }
        }
        if steps.is_multiple_of(WATCHDOG_STEPS) {
            let now = self.shared.clock.now();
            for ports in &self.robots {
                ports.check_watchdog(now, watchdog_us);
            }
        }
    }

    /// Takes what happened to robots since the last call, in order.
    pub fn take_events(&mut self) -> Vec<BodyEvent> {
        core::mem::take(&mut *self.shared.events.borrow_mut())
    }

    /// Breaks something about a robot, until [`World::heal`]. Does nothing when there is no such
    /// robot.
    ///
    /// # Errors
    /// When a number of the fault is out of its range; nothing is broken then.
    pub fn inject(&mut self, robot: RobotIndex, fault: Fault) -> Result<(), FaultError> {
        match self.robots.get(robot.0 as usize) {
            Some(ports) => crate::faults::inject(ports, fault),
            None => fault.validate(),
        }
    }

    /// Makes the program of a robot panic with `text`, as a board's handler notes it, and resets
    /// it. Does nothing when there is no such robot.
    pub fn crash(&mut self, robot: RobotIndex, text: &str) {
        if let Some(ports) = self.robots.get(robot.0 as usize) {
            ports.panic.replace(Some(text.to_owned()));
            ports.ask_reset(ResetCause::Panic);
        }
    }

    /// Mends all that was broken about a robot by [`World::inject`].
    pub fn heal(&mut self, robot: RobotIndex) {
        if let Some(ports) = self.robots.get(robot.0 as usize) {
            crate::faults::heal(ports);
        }
    }

    /// The truth about a robot; `None` when it never existed.
    pub fn observe(&self, robot: RobotIndex) -> Option<Observation> {
        let ports = self.robots.get(robot.0 as usize)?;
        let i = ports.index();
        let space = self.shared.space.borrow();
        let bodies = &space.bodies;
        let duty = |bridge: Bridge| match bridge.drive() {
            bodies::Drive::Forward => i16::from(bridge.duty),
            bodies::Drive::Backward => -i16::from(bridge.duty),
            bodies::Drive::Brake => 0,
        };
        Some(Observation {
            pose: bodies.pose(i),
            speed: (bodies.left[i] + bodies.right[i]) * 0.5,
            turn: (bodies.right[i] - bodies.left[i]) / bodies.build[i].track_m,
            contacts: bodies.contacts[i],
            battery: Millivolts((bodies.supply_v[i] * 1_000.0) as u16),
            charge: (bodies.charge_as[i] * space.per_capacity) as f32,
            duty: [duty(bodies.inputs[i].left), duty(bodies.inputs[i].right)],
            lamp: bodies.inputs[i].lamp,
            powered: bodies.presence[i] == Presence::Present,
            present: bodies.presence[i] != Presence::Removed,
            starvations: ports.watchdog.get().bites,
            flash_violations: ports.chip.borrow().violations(),
        })
    }

    /// How the ranger of a robot is wired; `None` when it never existed.
    pub fn wiring(&self, robot: RobotIndex) -> Option<Wiring> {
        Some(self.robots.get(robot.0 as usize)?.wiring)
    }

    /// The true distance in metres from a robot's ranger to the nearest echo within its reach,
    /// without its errors. `None` when nothing sends one.
    pub fn true_range(&self, robot: RobotIndex) -> Option<f32> {
        self.robots.get(robot.0 as usize)?;
        let mut space = self.shared.space.borrow_mut();
        space.list_robots(0);
        let ranger = space.parameters.ranger;
        space.range(
            robot.0 as usize,
            f32::from(ranger.nearest_mm) * 1e-3,
            f32::from(ranger.farthest_mm) * 1e-3,
        )
    }

    /// A fingerprint of the full physical state: every bit of every body, the generators of its
    /// devices, and its flash.
    pub fn hash(&self) -> u64 {
        let mut hasher = hash::Hasher::new();
        let space = self.shared.space.borrow();
        hasher.word(space.steps);
        hash::bodies(&mut hasher, &space.bodies);
        for ports in &self.robots {
            ports.sonar.borrow().fingerprint(|word| hasher.word(word));
            ports.chip.borrow().fingerprint(|word| hasher.word(word));
            hasher.generator(&ports.gauge_rng.borrow());
            hasher.generator(&ports.camera_rng.borrow());
            hasher.word(u64::from(ports.life.get()));
        }
        hasher.finish()
    }
}

impl core::fmt::Debug for World {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("World")
            .field("robots", &self.robots.len())
            .field("steps", &self.steps())
            .finish_non_exhaustive()
    }
}
