//! What there is to see of a simulation.

use std::rc::Rc;

use crawler_hal::Instant;
use crawler_protocol::{Fleet, RobotId};

use super::{EPOCH_MS, Simulation, Way};
use crate::devices::World;
use crate::net::lockstep::VirtualNetwork;
use crate::run::eyes::Looks;
use crate::run::machine::SimRobot;
use crate::run::parallel::ShardHandle;
use crate::scenario::Scenario;
use crate::world::{Observation, Pose, RobotIndex};

impl Simulation {
    /// The scenario.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The seed.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The fleet all robots belong to.
    #[must_use]
    pub fn fleet(&self) -> &Fleet {
        &self.fleet
    }

    /// Time since the beginning of the world.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.sched.now()
    }

    /// Unix time in milliseconds, as a lockstep world's server tells it.
    #[must_use]
    pub fn unix_ms(&self) -> u64 {
        EPOCH_MS + self.now().as_millis()
    }

    /// What looking has come to: frames seen and in memory. Nothing where the scenario has no
    /// detector.
    #[must_use]
    pub fn looks(&self) -> Looks {
        self.detector
            .as_ref()
            .map_or_else(Looks::default, |detector| detector.looks())
    }

    /// Number of robots ever added.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.machines.len()
    }

    /// A robot's program as it is now; a new one after each boot. `None` also when another shard
    /// runs it.
    #[must_use]
    pub fn robot(&self, robot: usize) -> Option<&Rc<SimRobot>> {
        self.machines.get(robot)?.robot.as_ref()
    }

    /// Name of a robot on the wire.
    #[must_use]
    pub fn id(&self, robot: usize) -> Option<&RobotId> {
        self.machines.get(robot).map(|machine| &machine.id)
    }

    /// How often a robot's program was started.
    #[must_use]
    pub fn boots(&self, robot: usize) -> u32 {
        self.machines.get(robot).map_or(0, |machine| machine.boots)
    }

    /// Where a robot is, whichever shard runs it; `None` when it is not in the world.
    #[must_use]
    pub fn pose(&self, robot: usize) -> Option<Pose> {
        self.world.pose(self.machines.get(robot)?.index)
    }

    /// The truth about a robot. `None` also when another shard runs it.
    #[must_use]
    pub fn observe(&self, robot: usize) -> Option<Observation> {
        self.world.observe(self.machines.get(robot)?.index)
    }

    /// The world.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The world, to break things in it. Its robots and its time are the simulation's to change.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// Number of a robot in the world.
    #[must_use]
    pub fn index(&self, robot: usize) -> Option<RobotIndex> {
        self.machines.get(robot).map(|machine| machine.index)
    }

    /// The network of a lockstep simulation.
    #[must_use]
    pub fn network(&self) -> Option<&VirtualNetwork> {
        if let Way::Lockstep(network) = &self.way {
            Some(network)
        } else {
            None
        }
    }

    /// Number of robots that were added and not removed.
    #[must_use]
    pub fn present(&self) -> u32 {
        let poses = self.machines.iter().map(|m| self.world.pose(m.index));
        poses.flatten().count() as u32
    }

    /// Whether this is one of several shards of a world and another one has failed. Time passes no
    /// more then.
    pub(crate) fn is_cut_off(&self) -> bool {
        self.shard_handle
            .as_ref()
            .is_some_and(ShardHandle::is_cut_off)
    }

    /// The next moment at which anything but physics happens.
    #[must_use]
    pub fn next_due(&mut self) -> Instant {
        let due = self.sched.next_due().unwrap_or(Instant::FAR_FUTURE);
        let network = match &self.way {
            Way::Lockstep(network) => Instant::from_micros(network.next_due()),
            _ => Instant::FAR_FUTURE,
        };
        due.min(self.initial.due())
            .min(self.next_time)
            .min(self.troubles.next())
            .min(self.director.next_due())
            .min(network)
    }

    /// See [`Scheduler::wake_outer_when_ready`].
    #[cfg(feature = "live")]
    pub(crate) fn wake_when_ready(&self, waker: &std::task::Waker) -> bool {
        self.sched.wake_outer_when_ready(waker)
    }

    /// Polls of tasks so far.
    #[must_use]
    pub fn polls(&self) -> u64 {
        self.sched.polls()
    }
}
