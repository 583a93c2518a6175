//! Who is in a world: bodies, the program of each, and its link.
//!
//! Robots are numbered in the order in which they came, and the same number names body, program and link: they are
//! added here alone, all three at once, and no number is used again.

use std::rc::Rc;

use crawler_hal::Clock as _;
use crawler_protocol::{RobotId, RobotState};

use super::programs::Programs;
use super::uplink::Uplink;
#[cfg(feature = "live")]
use crate::devices::WorldCheckpoint;
use crate::devices::{BodyEvent, BodyParts, World};
use crate::run::error::SimulationError;
use crate::run::machine::{self, Program, SimRobot};
use crate::scenario::Spawner;
use crate::sched::Scheduler;
use crate::world::{Fingerprint, Pose, RobotIndex};

/// A robot.
pub(super) struct Machine {
    id: RobotId,
    index: RobotIndex,
    /// `None` when another shard runs it.
    robot: Option<Rc<SimRobot>>,
    /// `None` without power, and after removal.
    program: Option<Program>,
    /// Number of its link, where links have numbers.
    link: usize,
    boots: u32,
    /// Of its state so far and of its boots.
    history: Fingerprint,
}

impl Machine {
    /// Name on the wire.
    pub(super) const fn id(&self) -> &RobotId {
        &self.id
    }

    /// Number of its body.
    pub(super) const fn index(&self) -> RobotIndex {
        self.index
    }

    pub(super) const fn link(&self) -> usize {
        self.link
    }

    pub(super) const fn boots(&self) -> u32 {
        self.boots
    }

    pub(super) const fn history(&self) -> Fingerprint {
        self.history
    }

    /// What its program shares with the world; `None` when another shard runs it.
    pub(super) const fn robot(&self) -> Option<&Rc<SimRobot>> {
        self.robot.as_ref()
    }

    /// Its program and the context that it runs on, while it runs in this shard.
    pub(super) fn running(&self) -> Option<(&Rc<SimRobot>, &Program)> {
        self.robot.as_ref().zip(self.program.as_ref())
    }

    /// Whether the robot has booted and knows the time, without which it refuses to move.
    pub(super) fn takes_commands(&self) -> bool {
        self.running().is_some_and(|(robot, program)| {
            let booted = robot.snapshot().state != RobotState::Initializing;
            booted && robot.unix_ms(program.clock.now()).is_some()
        })
    }
}

/// See the [module](self).
pub(super) struct Population {
    /// Runs the programs, and has the time.
    pub(super) sched: Scheduler,
    pub(super) world: World,
    /// What programs are started with.
    pub(super) programs: Programs,
    machines: Vec<Machine>,
    spawner: Spawner,
}

impl Population {
    pub(super) const fn new(
        sched: Scheduler,
        world: World,
        programs: Programs,
        spawner: Spawner,
    ) -> Self {
        Self {
            sched,
            world,
            programs,
            machines: Vec::new(),
            spawner,
        }
    }

    /// Robots ever added.
    pub(super) const fn len(&self) -> usize {
        self.machines.len()
    }

    pub(super) fn get(&self, robot: usize) -> Option<&Machine> {
        self.machines.get(robot)
    }

    /// All robots ever added, in the order of their numbers.
    pub(super) fn iter(&self) -> std::slice::Iter<'_, Machine> {
        self.machines.iter()
    }

    /// Robots that were added and not removed.
    pub(super) fn present(&self) -> u32 {
        let poses = self.iter().map(|machine| self.world.pose(machine.index));
        poses.flatten().count() as u32
    }

    /// Where a robot is, whichever shard runs it; `None` when it is not in the world.
    pub(super) fn pose(&self, robot: usize) -> Option<Pose> {
        self.world.pose(self.get(robot)?.index)
    }

    /// A free place drawn from the seed, for the next robot.
    pub(super) fn free_place(&mut self) -> Result<Pose, SimulationError> {
        let number = self.machines.len();
        let clearance = self.programs.scenario().spawn.clearance;
        let margin = self.world.parameters().chassis.radius_m + clearance;
        let world = &self.world;
        let all = number as u32 + 1;
        self.spawner
            .place(number, margin, |x, y| world.clearance(x, y, margin))
            .ok_or(SimulationError::NoRoom(all, all))
    }

    /// Adds a robot at `pose` and boots it. Returns its number.
    pub(super) fn add(&mut self, pose: Pose, uplink: &Uplink) -> Result<usize, SimulationError> {
        let number = self.machines.len();
        let scenario = self.programs.scenario();
        let (wiring, known) = (scenario.wiring(number), scenario.body(number));
        let (index, parts) = self.world.place(pose, wiring, &known)?;
        // Also for robots of other shards.
        let link = uplink.add_link(number, (pose.x, pose.y));
        let runs_here = parts.is_some();
        let before = (1, Fingerprint::new());
        self.enlist((index, link), parts, runs_here, before, uplink);
        Ok(number)
    }

    /// Puts a robot of a kept world where it was, and boots it unless it had been taken out. It had booted so often,
    /// with this history.
    #[cfg(feature = "live")]
    pub(super) fn put_back(
        &mut self,
        kept: &WorldCheckpoint,
        (boots, history): (u32, Fingerprint),
        uplink: &Uplink,
    ) {
        let number = self.machines.len();
        let scenario = self.programs.scenario();
        let (wiring, known) = (scenario.wiring(number), scenario.body(number));
        let (index, parts) = self.world.put_back(kept, number, wiring, &known);
        let runs_here = !kept.is_removed(number);
        let boots = boots + u32::from(runs_here && parts.is_some());
        self.enlist((index, number), parts, runs_here, (boots, history), uplink);
    }

    /// Takes in the robot of a body and a link, and boots it if it runs here and the body hands over something to run on.
    fn enlist(
        &mut self,
        (index, link): (RobotIndex, usize),
        parts: Option<BodyParts>,
        runs_here: bool,
        (boots, history): (u32, Fingerprint),
        uplink: &Uplink,
    ) {
        let number = self.machines.len();
        let started = parts.as_ref().map(|parts| &parts.started);
        let config = self.programs.config(number, started, uplink);
        let id = config.id.clone();
        let robot = runs_here.then(|| machine::context(config));
        let program = robot
            .as_ref()
            .zip(parts)
            .map(|(robot, parts)| self.start(robot, parts, (number, link), uplink));
        self.machines.push(Machine {
            id,
            index,
            robot,
            program,
            link,
            boots,
            history,
        });
    }

    fn start(
        &mut self,
        robot: &Rc<SimRobot>,
        parts: BodyParts,
        numbers: (usize, usize),
        uplink: &Uplink,
    ) -> Program {
        let sched = &mut self.sched;
        self.programs.start(sched, robot, parts, numbers, uplink)
    }

    /// Takes a robot out of the world, program and all. False when there is none.
    pub(super) fn remove(&mut self, robot: usize) -> bool {
        let Some(machine) = self.machines.get_mut(robot) else {
            return false;
        };
        if let Some(program) = machine.program.take() {
            program.stop(&mut self.sched);
        }
        self.world.remove_robot(machine.index);
        true
    }

    /// Resets and power cuts: programs end, and begin anew. Returns whether there were any.
    pub(super) fn handle_events(&mut self, uplink: &Uplink) -> bool {
        let events = self.world.take_events();
        for event in &events {
            let (BodyEvent::PowerLost(index) | BodyEvent::Reset(index, _)) = *event;
            let number = index.get() as usize;
            let Some(machine) = self.machines.get_mut(number) else {
                continue;
            };
            if let Some(program) = machine.program.take() {
                program.stop(&mut self.sched);
            }
            let BodyEvent::Reset(_, cause) = *event else {
                continue;
            };
            let Some(parts) = self.world.boot(index, cause) else {
                continue;
            };
            let link = machine.link;
            let config = self.programs.config(number, Some(&parts.started), uplink);
            let robot = machine::context(config);
            let program = self.start(&robot, parts, (number, link), uplink);
            let machine = &mut self.machines[number];
            machine.boots += 1;
            machine.program = Some(program);
            machine.robot = Some(robot);
            machine.history.word(self.sched.now().as_micros());
        }
        !events.is_empty()
    }

    /// Takes the state of every robot of this shard into its history.
    pub(super) fn note_states(&mut self) {
        for robot in self.world.members().iter(self.machines.len()) {
            let machine = &mut self.machines[robot];
            let state = self.world.robot_hash(machine.index);
            machine.history.word(state.unwrap_or_default());
        }
    }
}
