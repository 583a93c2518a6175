//! How much faster several threads are.

use std::sync::Mutex;
use std::sync::PoisonError;

use super::{ParallelError, Plan, each};
use crate::run::machine::CONTROL_HZ;

/// What the host can measure; handed in, because a simulation asks the environment nothing.
pub trait Clocks: Sync {
    /// Seconds since some moment.
    fn wall_s(&self) -> f64;
    /// Processor time used so far by the thread that asks, seconds.
    fn thread_cpu_s(&self) -> f64;
}

/// How fast a world ran.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Pace {
    /// Threads that shared the robots.
    pub threads: usize,
    /// Virtual time measured, seconds.
    pub virtual_s: f64,
    /// How long it took, seconds.
    pub wall_s: f64,
    /// Processor time of each thread, seconds.
    pub cpu_s: Vec<f64>,
    /// Robots × control steps for each second that passed.
    pub steps_per_s: f64,
    /// Robots × control steps for each second of processor time.
    pub steps_per_cpu_s: f64,
    /// Sum of the shards' shares of the history: the same for any number of threads.
    pub history: u64,
}

/// Runs a plan whose robots only do what the scenario tells them, and measures it from `warm_up`
/// on for the span of the plan.
///
/// # Errors
/// See [`ParallelError`].
pub fn measure<C: Clocks>(
    plan: &Plan<'_>,
    warm_up: crawler_hal::Duration,
    clocks: &C,
) -> Result<Pace, ParallelError> {
    // From the first that is warm to the last that is done.
    let wall = Mutex::new((f64::INFINITY, f64::NEG_INFINITY));
    let parts = each(plan, |simulation| {
        simulation.run_for(warm_up);
        let cpu = clocks.thread_cpu_s();
        {
            let mut wall = wall.lock().unwrap_or_else(PoisonError::into_inner);
            wall.0 = wall.0.min(clocks.wall_s());
        }
        simulation.run_for(plan.span);
        let cpu_s = clocks.thread_cpu_s() - cpu;
        {
            let mut wall = wall.lock().unwrap_or_else(PoisonError::into_inner);
            wall.1 = wall.1.max(clocks.wall_s());
        }
        (cpu_s, simulation.partial_history())
    })?;
    let (begun, done) = wall.into_inner().unwrap_or_else(PoisonError::into_inner);
    let wall_s = done - begun;
    let cpu_s: Vec<f64> = parts.iter().map(|&(cpu_s, _)| cpu_s).collect();
    let virtual_s = plan.span.as_micros() as f64 * 1e-6;
    let steps = f64::from(plan.scenario.robots) * virtual_s * CONTROL_HZ as f64;
    Ok(Pace {
        threads: plan.threads,
        virtual_s,
        wall_s,
        steps_per_s: steps / wall_s,
        steps_per_cpu_s: steps / cpu_s.iter().sum::<f64>(),
        cpu_s,
        history: parts
            .iter()
            .fold(0, |sum, &(_, share)| sum.wrapping_add(share)),
    })
}
