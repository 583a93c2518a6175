//! Many runs in parallel, a world to a thread.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::trial::{Trial, run_trial, run_trial_unless};
use super::verdict::Criterion;
use crate::scenario::Scenario;

/// A run to do.
#[derive(Debug, Clone)]
pub struct Job<'a> {
    /// Of what.
    pub scenario: &'a Scenario,
    /// With which seed.
    pub seed: u64,
}

/// Does all `jobs` on `threads` threads; calls `done` with the number of finished ones after each.
/// The results stand in the order of the jobs, and do not depend on the number of threads. Once
/// `stop` is set no further one is begun; those that were not are `None`.
pub fn run_all(
    jobs: &[Job<'_>],
    threads: usize,
    stop: &AtomicBool,
    done: &(dyn Fn(usize) + Sync),
) -> Vec<Option<Trial>> {
    let results = Mutex::new(vec![None; jobs.len()]);
    let (next, finished) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let work = || {
        while !stop.load(Ordering::Relaxed) {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(number) else { return };
            let trial = run_caught(job);
            if let Ok(mut results) = results.lock() {
                results[number] = Some(trial);
            }
            done(finished.fetch_add(1, Ordering::Relaxed) + 1);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads.clamp(1, jobs.len().max(1)) {
            scope.spawn(work);
        }
        work();
    });
    results
        .into_inner()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Does one job, and gives it up in the middle once `stop` is set: there is nothing to show of it
/// then. One that panics has failed.
#[must_use]
pub fn run_unless(job: &Job<'_>, stop: &AtomicBool) -> Option<Trial> {
    caught(job.seed, || run_trial_unless(job.scenario, job.seed, stop))
        .unwrap_or_else(|broken| Some(*broken))
}

fn run_caught(job: &Job<'_>) -> Trial {
    caught(job.seed, || run_trial(job.scenario, job.seed)).unwrap_or_else(|broken| *broken)
}

/// A run that panics has found a mistake in the program or the simulator; the others go on.
fn caught<T>(seed: u64, run: impl FnOnce() -> T) -> Result<T, Box<Trial>> {
    catch_unwind(AssertUnwindSafe(run)).map_err(|cause| {
        let text = cause.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| cause.downcast_ref::<&str>().copied());
        let what = text.unwrap_or("without a word").to_owned();
        Box::new(Trial::broken(seed, Criterion::Panic, what))
    })
}
