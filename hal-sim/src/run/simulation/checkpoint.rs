//! A live world, kept in memory and gone on from.
//!
//! Programs are futures, which nothing can copy. So what is kept is everything else: bodies,
//! faults, what was dropped, and what robots have in their flash. Robots boot there anew.

use crawler_hal::{Duration, Instant};
use crawler_protocol::Fleet;

use super::history::History;
use super::programs::BrokerAddress;
use super::runtime::Runtime;
use super::uplink::Way;
use crate::devices::WorldCheckpoint;
use crate::faults::Fault;
use crate::run::error::SimulationError;
use crate::run::hashes::Hashes;
use crate::scenario::Scenario;
use crate::sched::SimClock;
use crate::world::Fingerprint;

#[cfg(test)]
mod tests;

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct Checkpoint {
    scenario: Scenario,
    seed: u64,
    at: Instant,
    world: WorldCheckpoint,
    /// Boots and history of every robot ever added.
    robots: Vec<(u32, Fingerprint)>,
    /// What is broken, and for how long yet.
    faults: Vec<(usize, Fault, Option<Duration>)>,
    hashes: Hashes,
}

impl Checkpoint {
    /// The scenario.
    pub(crate) const fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// When it was kept.
    pub(crate) const fn at(&self) -> Instant {
        self.at
    }

    /// Robots in it.
    pub(crate) fn present(&self) -> u32 {
        let all = 0..self.world.robots();
        all.filter(|&robot| !self.world.is_removed(robot)).count() as u32
    }

    /// Memory that it takes, in bytes, as nearly as that matters.
    pub(crate) fn footprint(&self) -> usize {
        self.world.footprint() + size_of_val(self.hashes.as_slice())
    }
}

impl Runtime {
    /// Keeps the world as it is, but for its programs.
    pub(super) fn keep(&self) -> Checkpoint {
        let now = self.now();
        let faults = self.troubles.all().map(|(robot, fault, until)| {
            let left = (until < Instant::FAR_FUTURE).then(|| until.saturating_since(now));
            (robot, fault, left)
        });
        let robots = self.population.iter();
        Checkpoint {
            scenario: (*self.scenario).clone(),
            seed: self.seed,
            at: now,
            world: self.population.world.keep(),
            robots: robots.map(|one| (one.boots(), one.history())).collect(),
            faults: faults.collect(),
            hashes: self.history.hashes().clone(),
        }
    }

    /// A world in which the robots of a kept one stand again, each where it was and under its
    /// name. [`Self::go_on`] does the rest before time passes.
    pub(super) fn again(
        kept: &Checkpoint,
        way: (Fleet, Way),
        broker: BrokerAddress,
    ) -> Result<Self, SimulationError> {
        let clock = SimClock::new();
        let (scenario, seed) = (kept.scenario.clone(), kept.seed);
        let mut runtime = Self::deserted(scenario, seed, &clock, way, broker, None)?;
        // Time goes on: movers, the timeline and the history are where they were.
        runtime.skip_to(kept.at, kept.world.steps());
        runtime.history = History::go_on(kept.hashes.clone(), kept.at);
        for &before in &kept.robots {
            let population = &mut runtime.population;
            population.put_back(&kept.world, before, &runtime.uplink);
            runtime.director.add_idle();
        }
        runtime.connect_camera(&clock);
        Ok(runtime)
    }

    /// Breaks what was broken, and goes on from the kept state of bodies and flash.
    pub(super) fn go_on(&mut self, kept: &Checkpoint) {
        for &(robot, fault, left) in &kept.faults {
            // It could be broken this way before, so it can again.
            let broken = self.break_part(robot, fault, left);
            debug_assert!(broken.is_ok(), "{fault:?}: {broken:?}");
        }
        // After the faults: what they destroy at once has been destroyed, and used since.
        self.population.world.take_up(&kept.world);
    }
}
