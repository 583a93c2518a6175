//! A world in virtual time, handled like a program in a debugger.

use std::time::Duration as StdDuration;

use crawler_hal::{Duration, Instant};

use super::snapshot::{RestoreError, Snapshot, SnapshotError};
use crate::run::control::Factor;
use crate::run::{Simulation, SimulationError};
use crate::world::PHYSICS_STEP;

pub use crate::run::FactorError;

/// What a single step is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Physics moves everything on once.
    Physics,
    /// Every program has one period of its control activity.
    Control,
}

impl Step {
    /// How long it is.
    #[must_use]
    pub const fn span(self) -> Duration {
        match self {
            Self::Physics => PHYSICS_STEP,
            Self::Control => crawler_app::controller::PERIOD,
        }
    }
}

/// A simulation that stands still until told to go on.
///
/// It reads no clock: [`Debugger::pass`] is told how much real time has passed. Whatever is done
/// to the simulation here goes into its journal, so that [`Debugger::snapshot`] holds it.
#[derive(Debug)]
pub struct Debugger {
    simulation: Simulation,
    paused: bool,
    factor: Factor,
}

impl Debugger {
    /// Takes a simulation in hand, paused, at the pace of real time.
    #[must_use]
    pub fn new(simulation: Simulation) -> Self {
        Self {
            simulation,
            paused: true,
            factor: Factor::REAL_TIME,
        }
    }

    /// Lets go of the simulation.
    #[must_use]
    pub fn into_simulation(self) -> Simulation {
        self.simulation
    }

    /// The simulation.
    #[must_use]
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// The simulation, to do something to it: commands, faults, more robots or fewer.
    pub fn simulation_mut(&mut self) -> &mut Simulation {
        &mut self.simulation
    }

    /// Whether it stands still.
    #[must_use]
    pub const fn is_paused(&self) -> bool {
        self.paused
    }

    /// Has it stand still.
    pub const fn pause(&mut self) {
        self.paused = true;
    }

    /// Has it go on.
    pub const fn resume(&mut self) {
        self.paused = false;
    }

    /// How many times as fast as real time it runs.
    #[must_use]
    pub const fn factor(&self) -> f64 {
        self.factor.get()
    }

    /// Has it run so many times as fast as real time.
    ///
    /// # Errors
    /// [`FactorError`] when that is no usable number; nothing has changed then.
    pub fn set_factor(&mut self, factor: f64) -> Result<(), FactorError> {
        self.factor = Factor::new(factor)?;
        Ok(())
    }

    /// Makes `count` steps and stands still. Returns the moment reached, which lies on the grid of
    /// such steps: the first one may be shorter.
    pub fn step(&mut self, step: Step, count: u32) -> Instant {
        self.paused = true;
        self.simulation.run_until(self.after(step, count));
        self.simulation.now()
    }

    /// The moment at which `count` steps from now will end.
    #[must_use]
    pub fn after(&self, step: Step, count: u32) -> Instant {
        let span = step.span().as_micros();
        let begun = self.simulation.now().as_micros() / span;
        let end = begun.saturating_add(u64::from(count)).saturating_mul(span);
        Instant::from_micros(end)
    }

    /// Takes another simulation in hand instead, and has it stand still.
    pub fn replace(&mut self, simulation: Simulation) {
        self.simulation = simulation;
        self.paused = true;
    }

    /// Lets `real` time pass: nothing happens while paused. Returns how much virtual time passed.
    pub fn pass(&mut self, real: StdDuration) -> Duration {
        if self.paused {
            return Duration::ZERO;
        }
        let span = self.factor.of(real);
        self.simulation.run_for(span);
        span
    }

    /// Lets time pass up to `end`, whether paused or not, as fast as it can.
    pub fn run_until(&mut self, end: Instant) {
        self.simulation.run_until(end);
    }

    /// Begins again in the same process: the same scenario with `seed`, or with the seed it had.
    ///
    /// # Errors
    /// See [`SimulationError`]; a live simulation is none that a debugger takes. The world is as
    /// it was then.
    pub fn reset(&mut self, seed: Option<u64>) -> Result<(), SimulationError> {
        self.simulation = self.simulation.anew(seed)?;
        Ok(())
    }

    /// Keeps the world as it is.
    ///
    /// # Errors
    /// See [`SnapshotError`].
    pub fn snapshot(&self) -> Result<Snapshot, SnapshotError> {
        Snapshot::of(&self.simulation)
    }

    /// Goes back, or on, to a world that was kept, and stands still.
    ///
    /// # Errors
    /// See [`RestoreError`]; the world is as it was then.
    pub fn restore(&mut self, snapshot: &Snapshot) -> Result<(), RestoreError> {
        self.simulation = snapshot.restore()?;
        self.paused = true;
        Ok(())
    }
}

#[cfg(test)]
mod tests;
