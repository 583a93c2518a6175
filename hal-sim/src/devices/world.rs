//! A world and the devices of the robots in it.
//!
//! A [`World`] is a value: the same arena, parameters, seed and calls give the same bytes of
//! state, whatever else runs in the process. It holds no program; [`World::add_robot`] hands out
//! the devices a robot program runs on, and [`World::step`] moves everything on by
//! [`PHYSICS_STEP`](crate::world::PHYSICS_STEP). Between steps bodies stand still, and a device
//! asked for something answers from the state of the last step.

use std::cell::RefCell;
use std::rc::Rc;

use crawler_hal::{Clock, ResetCause};

use super::ports::{BodyEvent, Ports, Shared};
use super::{BodyParts, broken};
use crate::faults::{Fault, FaultError, Part};
use crate::render::{self, Frame, Motion};
use crate::sched::SimClock;
use crate::world::{
    Arena, Body, DropError, Dropped, DroppedItem, Inputs, Members, Observation, Parameters,
    PlacementError, Pose, Power, Presence, Published, RobotIndex, Space, Wiring, WorldError,
};

/// Physics steps between two looks at the watchdogs: 100 ms.
const WATCHDOG_STEPS: u64 = 10;

/// A world with the devices of the robots in it; it holds no program.
pub struct World {
    pub(crate) shared: Rc<Shared>,
    /// The robots whose devices are here.
    pub(super) members: Members,
    /// What the devices of each robot share with the world; `None` for those of other shards.
    pub(super) robots: Vec<Option<Rc<Ports>>>,
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
        Self::replica(arena, parameters, seed, clock, Members::ALL)
    }

    /// The same for one shard of a world.
    pub(crate) fn replica(
        arena: Arena,
        parameters: Parameters,
        seed: u64,
        clock: &SimClock,
        members: Members,
    ) -> Result<Self, WorldError> {
        parameters.validate()?;
        Ok(Self {
            shared: Rc::new(Shared {
                space: RefCell::new(Space::new(arena, parameters)?),
                clock: clock.world(),
                seed,
                events: RefCell::new(Vec::new()),
                frame: RefCell::new(None),
                pages: Rc::default(),
            }),
            members,
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

    /// Where the centre of mover `mover` is now, in the order of the arena; `None` when there is
    /// none. It runs behind its path when it had to wait for robots.
    pub fn mover(&self, mover: usize) -> Option<[f32; 2]> {
        let space = self.shared.space.borrow();
        (mover < space.movers.len()).then(|| {
            let centre = space.movers.now(mover).centre();
            [centre.x, centre.y]
        })
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
        self.shared.space.borrow_mut().clear_of(x, y, limit)
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
        let (index, parts) = self.place(pose, wiring, &Body::default())?;
        let Some(parts) = parts else {
            unreachable!("every robot of a world that is handed out is a member of it")
        };
        Ok((index, parts))
    }

    /// Takes a robot out of the world: it is no longer seen, touched or moved. Its devices are
    /// disconnected. Does nothing when there is no such robot.
    pub fn remove_robot(&mut self, robot: RobotIndex) {
        let i = robot.get() as usize;
        if i >= self.robots.len() {
            return;
        }
        if let Some(ports) = self.ports(robot) {
            ports.life.set(ports.life.get().wrapping_add(1));
        }
        self.shared.space.borrow_mut().remove(i);
    }

    /// Starts a robot anew after [`BodyEvent::Reset`], or at will: the devices handed out before
    /// are disconnected, all outputs are low, the flash keeps its contents.
    ///
    /// `None` when there is no such robot, when it was removed or has no power, and when its flash holds no
    /// program that starts.
    pub fn boot(&mut self, robot: RobotIndex, cause: ResetCause) -> Option<BodyParts> {
        let ports = self.ports(robot)?;
        {
            let mut space = self.shared.space.borrow_mut();
            let i = ports.index();
            if space.bodies.published.presence[i] != Presence::Present {
                return None;
            }
            space.bodies.inputs[i] = Inputs::default();
        }
        ports.life.set(ports.life.get().wrapping_add(1));
        ports.resetting.set(false);
        let mut watchdog = ports.watchdog.get();
        watchdog.fed = None;
        ports.watchdog.set(watchdog);
        ports.sonar.borrow_mut().restart();
        ports.chip.borrow_mut().restore_power();
        let started = ports.start(cause)?;
        Some(BodyParts::new(ports, started))
    }

    /// Moves everything on by one [`PHYSICS_STEP`](crate::world::PHYSICS_STEP).
    ///
    /// Call it when the clock has reached the end of the step, before the programs run that are
    /// due then.
    pub fn step(&mut self) {
        let mut changes = Vec::new();
        let (steps, watchdog_us) = {
            let mut space = self.shared.space.borrow_mut();
            space.step(self.members, |i, power| changes.push((i, power)));
            (
                space.steps,
                u64::from(space.parameters.surroundings.watchdog_ms) * 1_000,
            )
        };
        for (i, power) in changes {
            let Some(ports) = &self.robots[i] else {
                continue;
            };
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
            for ports in self.robots.iter().flatten() {
                ports.check_watchdog(now, watchdog_us);
            }
        }
    }

    /// Takes what happened to robots since the last call, in order.
    pub fn take_events(&mut self) -> Vec<BodyEvent> {
        core::mem::take(&mut *self.shared.events.borrow_mut())
    }

    /// Breaks something of a robot's body, until [`World::heal`]. A fault takes the place of an
    /// earlier one of the same part. A robot of another shard is left to that one.
    ///
    /// # Errors
    /// See [`FaultError`]; nothing is broken then.
    pub fn inject(&mut self, robot: RobotIndex, fault: Fault) -> Result<(), FaultError> {
        fault.validate()?;
        if self.pose(robot).is_none() {
            return Err(FaultError::NoRobot);
        }
        self.ports(robot)
            .map_or(Ok(()), |ports| broken::inject(ports, fault))
    }

    /// Mends one part of a robot's body.
    pub(crate) fn mend(&mut self, robot: RobotIndex, part: Part) {
        if let Some(ports) = self.ports(robot) {
            broken::mend(ports, part);
        }
    }

    /// Makes the program of a robot panic with `text`, as a board's handler notes it, and resets
    /// it. Does nothing when there is no such robot.
    pub fn crash(&mut self, robot: RobotIndex, text: &str) {
        if let Some(ports) = self.ports(robot) {
            ports.panic.replace(Some(text.to_owned()));
            ports.ask_reset(ResetCause::Panic);
        }
    }

    /// Resets the controller of a robot.
    #[cfg(test)]
    pub(crate) fn reset(&mut self, robot: RobotIndex, cause: ResetCause) {
        if let Some(ports) = self.ports(robot) {
            ports.ask_reset(cause);
        }
    }

    /// Mends all that was broken about a robot by [`World::inject`].
    pub fn heal(&mut self, robot: RobotIndex) {
        if let Some(ports) = self.ports(robot) {
            broken::heal(ports);
        }
    }

    /// The truth about a robot; `None` when it never existed.
    pub fn observe(&self, robot: RobotIndex) -> Option<Observation> {
        let ports = self.ports(robot)?;
        let seen = self.shared.space.borrow().observe(ports.index())?;
        Some(Observation {
            starvations: ports.watchdog.get().bites,
            flash_violations: ports.chip.borrow().violations(),
            ..seen
        })
    }

    /// How the ranger of a robot is wired; `None` when it never existed.
    pub fn wiring(&self, robot: RobotIndex) -> Option<Wiring> {
        Some(self.ports(robot)?.wiring)
    }

    /// The true distance in metres from a robot's ranger to the nearest echo within its reach,
    /// without its errors. `None` when nothing sends one.
    pub fn true_range(&self, robot: RobotIndex) -> Option<f32> {
        self.robots.get(robot.get() as usize)?;
        let mut space = self.shared.space.borrow_mut();
        space.list_robots(0);
        let ranger = space.parameters.ranger;
        space.range(
            robot.get() as usize,
            f32::from(ranger.nearest_mm) * 1e-3,
            f32::from(ranger.farthest_mm) * 1e-3,
        )
    }

    /// Draws what the camera of a robot sees. Nothing is allocated once a frame has held a picture
    /// with as much in it. Returns whether there is such a robot in the world; the frame is left
    /// alone otherwise.
    pub fn render(&self, robot: RobotIndex, frame: &mut Frame) -> bool {
        let mut space = self.shared.space.borrow_mut();
        render::view(&mut space, robot.get() as usize, frame)
    }

    /// The same as if the robot moved like this, which blurs the picture.
    pub fn render_moving(&self, robot: RobotIndex, motion: Motion, frame: &mut Frame) -> bool {
        let mut space = self.shared.space.borrow_mut();
        render::view_moving(&mut space, robot.get() as usize, motion, frame)
    }

    /// Puts something into the world where nothing but robots is looked for: it may stand in an
    /// obstacle, as those of an arena may, and movers pass through it as they do through those.
    /// Returns its number.
    ///
    /// # Errors
    /// See [`DropError`]; the world is then unchanged.
    pub fn drop_in(&mut self, what: Dropped) -> Result<u32, DropError> {
        self.shared.space.borrow_mut().drop_in(what)
    }

    /// Takes away what was dropped as number `id`. False when nothing of that number lies there.
    pub fn take_away(&mut self, id: u32) -> bool {
        self.shared.space.borrow_mut().take_away(id)
    }

    /// What was dropped into the world and lies there, in the order in which it came.
    #[must_use]
    pub fn dropped(&self) -> Vec<DroppedItem> {
        self.shared.space.borrow().items.all().to_vec()
    }

    pub(super) fn ports(&self, robot: RobotIndex) -> Option<&Rc<Ports>> {
        self.robots.get(robot.get() as usize)?.as_ref()
    }

    /// Puts a robot at `pose`, with what is known of its body, and with devices when it is a member.
    pub(crate) fn place(
        &mut self,
        pose: Pose,
        wiring: Wiring,
        known: &Body,
    ) -> Result<(RobotIndex, Option<BodyParts>), PlacementError> {
        let seed = self.shared.seed;
        let index = self.shared.space.borrow_mut().place(pose, seed, known)?;
        let ports = self.furnish(index, wiring);
        Ok((index, ports.as_ref().and_then(Self::switch_on)))
    }

    /// Gives the newest robot its devices, when it is a member. Its flash is blank, and it is not switched on.
    pub(super) fn furnish(&mut self, index: RobotIndex, wiring: Wiring) -> Option<Rc<Ports>> {
        let ports = self
            .members
            .contains(index.get() as usize)
            .then(|| Rc::new(Ports::new(Rc::clone(&self.shared), index, wiring)));
        self.robots.push(ports.clone());
        ports
    }

    /// Switches a new robot on. `None` when its flash holds no program that starts.
    pub(super) fn switch_on(ports: &Rc<Ports>) -> Option<BodyParts> {
        let started = ports.start(ports.cause.get())?;
        Some(BodyParts::new(ports, started))
    }

    /// Memory of the host that the flash of the robots here takes, in bytes: what was written, and what they
    /// share once.
    #[must_use]
    pub fn flash_footprint(&self) -> usize {
        let robots = self.robots.iter().flatten();
        let own: usize = robots.map(|ports| ports.chip.borrow().footprint()).sum();
        own + self.shared.pages.borrow().footprint()
    }

    /// The longest time between two feedings of a robot's watchdog, microseconds.
    #[cfg(test)]
    pub(crate) fn longest_feed_gap_us(&self, robot: RobotIndex) -> Option<u64> {
        Some(self.ports(robot)?.watchdog.get().longest_us)
    }

    /// The flash of a robot.
    #[cfg(test)]
    pub(crate) fn chip(&self, robot: RobotIndex) -> Option<Rc<RefCell<super::Chip>>> {
        Some(Rc::clone(&self.ports(robot)?.chip))
    }

    /// The robots whose devices are here.
    pub(crate) fn members(&self) -> Members {
        self.members
    }

    /// Writes what other shards need to know of the members over `out`.
    pub(crate) fn publish(&self, out: &mut Vec<Published>) {
        self.shared.space.borrow().publish(self.members, out);
    }

    /// Takes over what another shard told of its members.
    pub(crate) fn take_over(&mut self, members: Members, published: &[Published]) {
        let mut space = self.shared.space.borrow_mut();
        space.take_over(members, published);
    }

    /// Picks a robot up and puts it down at `pose`; its wheels turn as they did, and its program is not told. Does nothing when
    /// there is none.
    ///
    /// # Errors
    /// See [`PlacementError`]; it is where it was then.
    pub(crate) fn carry(&mut self, robot: RobotIndex, pose: Pose) -> Result<(), PlacementError> {
        let mut space = self.shared.space.borrow_mut();
        space.carry(robot.get() as usize, pose)
    }

    /// Where a robot is, and how fast forward and anticlockwise, in metres and radians per second;
    /// member or not.
    pub(crate) fn motion(&self, robot: RobotIndex) -> Option<(Pose, [f32; 2])> {
        let pose = self.pose(robot)?;
        let i = robot.get() as usize;
        let space = self.shared.space.borrow();
        let seen = &space.bodies.published;
        let forward = seen.velocity.get(i)?.dot(*seen.heading.get(i)?);
        Some((pose, [forward, *seen.spin.get(i)?]))
    }

    /// Where a robot is, member or not; `None` when it never existed or was taken away.
    pub(crate) fn pose(&self, robot: RobotIndex) -> Option<Pose> {
        let i = robot.get() as usize;
        let space = self.shared.space.borrow();
        let presence = *space.bodies.published.presence.get(i)?;
        (presence != Presence::Removed).then(|| space.bodies.pose(i))
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
