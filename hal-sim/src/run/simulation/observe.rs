//! What there is to see of a simulation.

use std::rc::Rc;

use crawler_hal::Instant;
use crawler_protocol::{Fleet, RobotId};

use super::population::Machine;
use super::{Link, Simulation, history};
use crate::devices::World;
use crate::net::lockstep::VirtualNetwork;
use crate::run::director::{Broken, Issued, Target};
use crate::run::eyes::Looks;
use crate::run::hashes::{self, Hashes};
use crate::run::machine::SimRobot;
use crate::scenario::Scenario;
use crate::world::{Observation, Pose, RobotIndex};

impl Simulation {
    /// The scenario.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.runtime.scenario
    }

    /// The seed.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.runtime.seed
    }

    /// The fleet all robots belong to.
    #[must_use]
    pub fn fleet(&self) -> &Fleet {
        self.runtime.uplink.fleet()
    }

    /// Time since the beginning of the world.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.runtime.now()
    }

    /// Unix time in milliseconds, as a lockstep world's server tells it.
    #[must_use]
    pub fn unix_ms(&self) -> u64 {
        self.runtime.unix_ms()
    }

    /// What looking has come to: frames seen and in memory. Nothing where the scenario has no
    /// detector.
    #[must_use]
    pub fn looks(&self) -> Looks {
        self.runtime.population.programs.looks()
    }

    /// Number of robots ever added.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.runtime.population.len()
    }

    /// A robot's program as it is now; a new one after each boot. `None` also when another shard
    /// runs it.
    #[must_use]
    pub fn robot(&self, robot: usize) -> Option<&Rc<SimRobot>> {
        self.runtime.population.get(robot)?.robot()
    }

    /// Name of a robot on the wire.
    #[must_use]
    pub fn id(&self, robot: usize) -> Option<&RobotId> {
        self.runtime.population.get(robot).map(Machine::id)
    }

    /// How often a robot's program was started.
    #[must_use]
    pub fn boots(&self, robot: usize) -> u32 {
        self.runtime.population.get(robot).map_or(0, Machine::boots)
    }

    /// Where a robot is, whichever shard runs it; `None` when it is not in the world.
    #[must_use]
    pub fn pose(&self, robot: usize) -> Option<Pose> {
        self.runtime.population.pose(robot)
    }

    /// The truth about a robot. `None` also when another shard runs it.
    #[must_use]
    pub fn observe(&self, robot: usize) -> Option<Observation> {
        self.world().observe(self.index(robot)?)
    }

    /// The world.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.runtime.population.world
    }

    /// The world, to break things in it past the journal. Its robots and its time are the simulation's to change.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.runtime.population.world
    }

    /// Number of a robot in the world.
    #[must_use]
    pub fn index(&self, robot: usize) -> Option<RobotIndex> {
        self.runtime.population.get(robot).map(Machine::index)
    }

    /// The network of a lockstep simulation.
    #[must_use]
    pub fn network(&self) -> Option<&VirtualNetwork> {
        self.runtime.uplink.network()
    }

    /// Number of robots that were added and not removed.
    #[must_use]
    pub fn present(&self) -> u32 {
        self.runtime.population.present()
    }

    /// Whether this is one of several shards of a world and another one has failed. Time passes no
    /// more then.
    pub(crate) fn is_cut_off(&self) -> bool {
        self.runtime.is_cut_off()
    }

    /// The next moment at which anything but physics happens.
    #[must_use]
    pub fn next_due(&mut self) -> Instant {
        self.runtime.next_due()
    }

    /// See [`Scheduler::wake_outer_when_ready`].
    #[cfg(feature = "live")]
    pub(crate) fn wake_when_ready(&self, waker: &std::task::Waker) -> bool {
        self.runtime.population.sched.wake_outer_when_ready(waker)
    }

    /// Polls of tasks so far.
    #[must_use]
    pub fn polls(&self) -> u64 {
        self.runtime.population.sched.polls()
    }

    /// A fingerprint of all that happened so far: the full physical state once a second and now,
    /// every boot, and in lockstep every message that robots published.
    #[must_use]
    pub fn history_hash(&self) -> u64 {
        hashes::total(self.now(), self.partial_history())
    }

    /// The same for one robot: the first one whose fingerprint differs between two runs is where
    /// they part. `None` when it never existed, or another shard runs it.
    #[must_use]
    pub fn robot_history(&self, robot: usize) -> Option<u64> {
        let runtime = &self.runtime;
        history::of_robot(&runtime.population, &runtime.uplink, robot)
    }

    /// The fingerprint of the history at the end of each second: two runs of one recipe part
    /// within the first one that differs.
    #[must_use]
    pub fn hashes(&self) -> &Hashes {
        self.runtime.history.hashes()
    }

    /// The same as mere numbers, the first second first.
    #[must_use]
    pub fn second_hashes(&self) -> &[u64] {
        self.hashes().as_slice()
    }

    /// The share of this shard's robots in [`Simulation::history_hash`].
    pub(crate) fn partial_history(&self) -> u64 {
        history::of_shard(&self.runtime.population, &self.runtime.uplink)
    }

    /// The places that the scenario sends a robot to, in order.
    #[must_use]
    pub fn targets(&self, robot: usize) -> &[Target] {
        self.runtime.director.targets(robot)
    }

    /// Takes the commands that the scenario has given since the last call; of more than a few
    /// thousand, the first ones.
    pub fn take_issued(&mut self) -> Vec<Issued> {
        self.runtime.director.take_issued()
    }

    /// Takes the faults that the scenario has brought about since the last call; of more than a
    /// few thousand, the first ones.
    pub fn take_broken(&mut self) -> Vec<Broken> {
        self.runtime.director.take_broken()
    }

    /// Whether the scenario has nothing more in store: its timeline is over, and every goal was
    /// reached.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.runtime.director.is_over()
    }

    /// Whether a robot has booted and knows the time, so that it takes commands that reach it.
    #[must_use]
    pub fn takes_commands(&self, robot: usize) -> bool {
        self.runtime.takes_commands(robot)
    }

    /// How its robots reach their broker; `None` when that is a real one.
    #[must_use]
    pub fn link(&self) -> Option<Link> {
        self.runtime.uplink.link()
    }
}
