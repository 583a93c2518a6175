//! How fast and how large simulations are.

use crawler_hal::{Duration, Instant};

use crate::run::machine::CONTROL_HZ;
use crate::run::{Simulation, SimulationError};
use crate::scenario::Scenario;

/// What the host can measure about its own process; handed in, because a simulation asks the
/// environment nothing.
pub trait Meter {
    /// Processor time used by this thread or process so far, seconds.
    fn cpu_s(&self) -> f64;
    /// Memory in use, bytes; `None` where it cannot be known.
    fn memory(&self) -> Option<u64>;
    /// Calls `work`, which is all that is measured. A profiler that counts one function's share
    /// is told the name of this one.
    fn measured(&self, work: &mut dyn FnMut()) {
        work();
    }
}

/// One measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Figures {
    /// Robots in the world.
    pub robots: u32,
    /// Virtual time measured, seconds.
    pub virtual_s: f64,
    /// Processor time it took, seconds.
    pub cpu_s: f64,
    /// Robots × control steps for each second of processor time.
    pub steps_per_cpu_s: f64,
    /// Processor time to set the robots up, seconds.
    pub spawn_s: f64,
    /// Bytes for each robot: body, devices, program and link.
    pub bytes_per_robot: Option<u64>,
    /// Robots whose wheels were driven at the end: one that stands costs less.
    pub moving: u32,
    /// Polls of tasks for each control step.
    pub polls_per_step: f64,
    /// Fingerprint of the run.
    pub history: u64,
}

/// Runs `scenario` in lockstep, and measures it from `warm_up` on for `span`. The initial command
/// takes about five virtual seconds to reach everyone.
///
/// # Errors
/// When the scenario cannot be set up.
pub fn measure<M: Meter>(
    scenario: Scenario,
    seed: u64,
    warm_up: Duration,
    span: Duration,
    meter: &M,
) -> Result<Figures, SimulationError> {
    figures(scenario, warm_up, span, meter, |scenario| {
        Simulation::lockstep(scenario, seed)
    })
}

/// The same for robots without a network: what bodies, devices and programs cost alone. The
/// initial command reaches everyone once they have booted.
///
/// # Errors
/// When the scenario cannot be set up.
pub fn measure_without_network<M: Meter>(
    scenario: Scenario,
    seed: u64,
    warm_up: Duration,
    span: Duration,
    meter: &M,
) -> Result<Figures, SimulationError> {
    figures(scenario, warm_up, span, meter, |scenario| {
        Simulation::without_network(scenario, seed)
    })
}

fn figures(
    scenario: Scenario,
    warm_up: Duration,
    span: Duration,
    meter: &impl Meter,
    set_up: impl FnOnce(Scenario) -> Result<Simulation, SimulationError>,
) -> Result<Figures, SimulationError> {
    let robots = scenario.robots;
    let before = meter.memory();
    let spawn = meter.cpu_s();
    let mut simulation = set_up(scenario)?;
    let spawn_s = meter.cpu_s() - spawn;
    let start = Instant::BOOT + warm_up;
    simulation.run_until(start);
    let polls = simulation.polls();
    let cpu = meter.cpu_s();
    meter.measured(&mut || simulation.run_until(start + span));
    let cpu_s = meter.cpu_s() - cpu;
    let virtual_s = span.as_micros() as f64 * 1e-6;
    let steps = f64::from(robots) * virtual_s * CONTROL_HZ as f64;
    let bytes = match (before, meter.memory()) {
        (Some(before), Some(after)) => {
            Some(after.saturating_sub(before) / u64::from(robots.max(1)))
        }
        _ => None,
    };
    let seen = (0..simulation.robots()).filter_map(|robot| simulation.observe(robot));
    let moving = seen.filter(|seen| seen.duty != [0, 0]);
    Ok(Figures {
        robots,
        virtual_s,
        cpu_s,
        steps_per_cpu_s: steps / cpu_s,
        spawn_s,
        bytes_per_robot: bytes,
        moving: moving.count() as u32,
        polls_per_step: (simulation.polls() - polls) as f64 / steps,
        history: simulation.history_hash(),
    })
}
