//! Many runs in parallel, a world to a thread.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};

use super::trial::{Trial, run_trial_unless, run_trial_watched};
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

/// How far many runs are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Done {
    /// Runs that are over.
    pub runs: usize,
    /// What share of their longest time those under way have behind them, added up.
    pub under_way: f64,
}

/// How far the run of one thread is, in millionths.
#[derive(Debug, Default)]
struct UnderWay(AtomicU32);

impl UnderWay {
    fn set(&self, share: f64) {
        self.0.store((share * 1e6) as u32, Ordering::Relaxed);
    }

    fn share(&self) -> f64 {
        f64::from(self.0.load(Ordering::Relaxed)) * 1e-6
    }
}

/// Does all `jobs` on `threads` threads; tells `done` after each, and about once in a second of a world between.
/// The results stand in the order of the jobs, and do not depend on the number of threads. Once
/// `stop` is set no further one is begun; those that were not are `None`.
pub fn run_all(
    jobs: &[Job<'_>],
    threads: usize,
    stop: &AtomicBool,
    done: &(dyn Fn(Done) + Sync),
) -> Vec<Option<Trial>> {
    let results = Mutex::new(vec![None; jobs.len()]);
    let (next, finished) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let threads = threads.clamp(1, jobs.len().max(1));
    let under_way: Vec<UnderWay> = (0..threads).map(|_| UnderWay::default()).collect();
    let tell = |runs: usize| {
        let under_way = under_way.iter().map(UnderWay::share).sum();
        done(Done { runs, under_way });
    };
    let work = |own: &UnderWay| {
        while !stop.load(Ordering::Relaxed) {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(number) else { return };
            let trial = run_caught(job, &mut |share| {
                own.set(share);
                tell(finished.load(Ordering::Relaxed));
            });
            own.set(0.0);
            if let Ok(mut results) = results.lock() {
                results[number] = Some(trial);
            }
            tell(finished.fetch_add(1, Ordering::Relaxed) + 1);
        }
    };
    std::thread::scope(|scope| {
        let work = &work;
        let (own, others) = under_way.split_at(1);
        for other in others {
            scope.spawn(move || work(other));
        }
        own.iter().for_each(work);
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

fn run_caught(job: &Job<'_>, watch: &mut dyn FnMut(f64)) -> Trial {
    let run = || run_trial_watched(job.scenario, job.seed, watch);
    caught(job.seed, run).unwrap_or_else(|broken| *broken)
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
