//! A live world, kept in memory and gone on from.
//!
//! Programs are futures, which nothing can copy. So what is kept is everything else: bodies,
//! faults, what was dropped, and what robots have in their flash. Robots boot there anew.

use crawler_hal::{Duration, Instant};
use crawler_protocol::Fleet;

use super::{BrokerAddress, HISTORY_PERIOD, Machine, PHYSICS_STEP, Simulation, Way};
use crate::devices::WorldCheckpoint;
use crate::faults::Fault;
use crate::run::error::SimulationError;
use crate::run::hashes::Hashes;
use crate::run::machine;
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

impl Simulation {
    /// Keeps the world as it is, but for its programs.
    pub(crate) fn keep(&self) -> Checkpoint {
        let now = self.now();
        let faults = self.troubles.all().map(|(robot, fault, until)| {
            let left = (until < Instant::FAR_FUTURE).then(|| until.saturating_since(now));
            (robot, fault, left)
        });
        let robots = self.machines.iter();
        Checkpoint {
            scenario: self.scenario.clone(),
            seed: self.seed,
            at: now,
            world: self.world.keep(),
            robots: robots.map(|one| (one.boots, one.history)).collect(),
            faults: faults.collect(),
            hashes: self.hashes.clone(),
        }
    }

    /// A simulation in which the robots of a kept one stand again, each where it was and under its
    /// name. [`Simulation::go_on`] does the rest before time passes.
    ///
    /// # Errors
    /// See [`SimulationError`].
    pub(crate) fn again(
        kept: &Checkpoint,
        fleet: Fleet,
        way: Way,
        broker: BrokerAddress,
    ) -> Result<Self, SimulationError> {
        let clock = SimClock::new();
        let (scenario, seed) = (kept.scenario.clone(), kept.seed);
        let mut simulation = Self::deserted(scenario, seed, &clock, fleet, way, broker, None)?;
        // Time goes on: movers, the timeline and the history are where they were.
        simulation.sched.advance_to(kept.at);
        let steps = |count: u64, period: Duration| {
            Instant::from_micros(count.saturating_mul(period.as_micros()))
        };
        let after = |period: Duration| steps(kept.at.as_micros() / period.as_micros() + 1, period);
        simulation.next_step = steps(kept.world.steps() + 1, PHYSICS_STEP);
        simulation.next_history = after(HISTORY_PERIOD);
        simulation.next_cells = after(crawler_cells::PERIOD);
        simulation.director.skip_to(kept.at);
        simulation.hashes = kept.hashes.clone();
        for (number, &(boots, history)) in kept.robots.iter().enumerate() {
            let wiring = simulation.scenario.wiring(number);
            let (index, parts) = simulation.world.put_back(&kept.world, number, wiring);
            let config = simulation.config(number, parts.as_ref().map(|parts| &parts.started));
            let id = config.id.clone();
            let is_removed = kept.world.is_removed(number);
            let robot = (!is_removed).then(|| machine::context(config));
            let program = robot
                .as_ref()
                .zip(parts)
                .map(|(robot, parts)| simulation.start_program(robot, parts, number, number));
            simulation.machines.push(Machine {
                id,
                index,
                boots: boots + u32::from(program.is_some()),
                robot,
                program,
                link: number,
                history,
            });
            simulation.director.add_idle();
        }
        simulation.send_messenger(&clock);
        Ok(simulation)
    }

    /// Breaks what was broken, and goes on from the kept state of bodies and flash.
    pub(crate) fn go_on(&mut self, kept: &Checkpoint) {
        for &(robot, fault, left) in &kept.faults {
            // It could be broken this way before, so it can again.
            let broken = self.break_part(robot, fault, left);
            debug_assert!(broken.is_ok(), "{fault:?}: {broken:?}");
        }
        // After the faults: what they destroy at once has been destroyed, and used since.
        self.world.take_up(&kept.world);
    }
}
