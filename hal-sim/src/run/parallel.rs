//! One world on several threads.
//!
//! Each thread has a *shard*: a [`Simulation`] with the whole arena and all bodies, but the
//! programs and devices of its own robots only. Between two physics steps robots do nothing to
//! each other; at the end of a step the shards tell each other where their robots are and what
//! they published. So a robot's history cannot depend on which thread runs it, and the history of
//! the world not on their number.

mod barrier;
mod exchange;
mod measure;

use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crawler_hal::{Duration, Instant};

pub(crate) use exchange::ShardHandle;
pub use measure::{Clocks, Pace, measure};

use super::error::SimulationError;
use super::hashes::{self, Hashes};
use super::simulation::Simulation;
use crate::net::lockstep::PeerStatistics;
use crate::scenario::Scenario;
use crate::world::Observation;
use exchange::Exchange;

/// Most threads that one world is given.
pub const MAX_THREADS: usize = 256;

/// What to run.
#[derive(Debug, Clone, Copy)]
pub struct Plan<'a> {
    /// The recipe of the world.
    pub scenario: &'a Scenario,
    /// What it leaves to chance.
    pub seed: u64,
    /// Whether robots have a network; see [`Simulation::lockstep`] and
    /// [`Simulation::without_network`].
    pub network: bool,
    /// How many threads share the robots, 1 to [`MAX_THREADS`]. With one, no thread is started.
    pub threads: usize,
    /// How long the world runs.
    pub span: Duration,
}

/// What became of a run.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Outcome {
    /// The truth about each robot at the end.
    pub robots: Vec<Observation>,
    /// How often each robot's program was started.
    pub boots: Vec<u32>,
    /// [`Simulation::history_hash`].
    pub history: u64,
    /// [`Simulation::hashes`].
    pub hashes: Hashes,
    /// Totals of the broker; nothing without a network.
    pub statistics: PeerStatistics,
    /// Polls of tasks.
    pub polls: u64,
}

/// Why a run came to nothing.
#[derive(Debug)]
#[non_exhaustive]
pub enum ParallelError {
    /// That many threads are not possible.
    Threads(usize),
    /// The world cannot be set up.
    SetUp(SimulationError),
    /// A thread cannot be started, and why.
    Start(std::io::Error),
    /// Something panicked in this shard, saying this.
    Panicked(usize, String),
    /// The script did not do the same in all shards: they stopped at different moments.
    Script,
}

impl fmt::Display for ParallelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Threads(threads) => {
                write!(
                    f,
                    "a world runs on 1 to {MAX_THREADS} threads, not {threads}"
                )
            }
            Self::SetUp(error) => write!(f, "{error}"),
            Self::Start(error) => write!(f, "starting a thread: {error}"),
            Self::Panicked(shard, text) => write!(f, "shard {shard} panicked: {text}"),
            Self::Script => f.write_str("the script did not do the same in every shard"),
        }
    }
}

impl std::error::Error for ParallelError {}

impl From<SimulationError> for ParallelError {
    fn from(error: SimulationError) -> Self {
        Self::SetUp(error)
    }
}

/// Runs a world.
///
/// `script` is called in every shard at the beginning and then whenever it said it wants to be
/// called again; `None` is never. It must do the same everywhere, so it may look at nothing but
/// what every shard knows: the time, [`Simulation::pose`], [`Simulation::present`]. What it does
/// to a robot that another shard runs is noted there and comes to nothing here.
///
/// # Errors
/// See [`ParallelError`]. A shard that fails ends all others at their next step.
pub fn run<S>(plan: &Plan<'_>, script: S) -> Result<Outcome, ParallelError>
where
    S: Fn(&mut Simulation, Instant) -> Option<Instant> + Sync,
{
    let parts = each(plan, |simulation| {
        let alone = run_shard(simulation, plan.span, &script);
        alone.then(|| Part::of(simulation))
    })?;
    merge(parts)
}

/// Lets the script and the time have their turns. False when another shard failed.
fn run_shard<S>(simulation: &mut Simulation, span: Duration, script: &S) -> bool
where
    S: Fn(&mut Simulation, Instant) -> Option<Instant>,
{
    let end = simulation.now() + span;
    loop {
        let now = simulation.now();
        let next = script(simulation, now).map_or(end, |next| next.min(end));
        // A script that asks for the present moment would keep the world where it is.
        let next = next.max(now + Duration::from_micros(1)).min(end);
        simulation.run_until(next);
        if simulation.is_cut_off() {
            return false;
        }
        if next >= end {
            return true;
        }
    }
}

/// Does `work` to every shard of a world, each on its own thread, and returns what came of it in
/// order of the shards.
fn each<R: Send>(
    plan: &Plan<'_>,
    work: impl Fn(&mut Simulation) -> R + Sync,
) -> Result<Vec<R>, ParallelError> {
    let threads = plan.threads;
    if threads == 0 || threads > MAX_THREADS {
        return Err(ParallelError::Threads(threads));
    }
    if threads == 1 {
        let alone = || Ok(work(&mut set_up(plan, None)?));
        return match catch_unwind(AssertUnwindSafe(alone)) {
            Ok(part) => part.map(|part| vec![part]),
            Err(panic) => Err(ParallelError::Panicked(0, text_of(panic.as_ref()))),
        };
    }
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let exchange = Arc::new(Exchange::new(threads, cores));
    let exchange = &exchange;
    let work = &work;
    std::thread::scope(|scope| {
        let mut running = Vec::new();
        for shard in 0..threads {
            let shard_handle = ShardHandle::new(exchange, shard);
            let started = std::thread::Builder::new()
                .name(format!("shard {shard}"))
                // A simulation is not `Send`: it is made on the thread that runs it.
                .spawn_scoped(scope, move || Ok(work(&mut set_up(plan, shard_handle)?)));
            match started {
                Ok(thread) => running.push(thread),
                Err(error) => {
                    // The seats of those that never came are given up, so those that run end.
                    return Err(ParallelError::Start(error));
                }
            }
        }
        let mut parts = Vec::new();
        let mut failed = None;
        for (shard, thread) in running.into_iter().enumerate() {
            match thread.join() {
                Ok(Ok(part)) => parts.push(part),
                Ok(Err(error)) => failed = failed.or(Some(ParallelError::SetUp(error))),
                Err(panic) => {
                    failed = Some(ParallelError::Panicked(shard, text_of(panic.as_ref())));
                }
            }
        }
        failed.map_or(Ok(parts), Err)
    })
}

fn set_up(
    plan: &Plan<'_>,
    shard_handle: Option<ShardHandle>,
) -> Result<Simulation, SimulationError> {
    let (scenario, seed) = (plan.scenario.clone(), plan.seed);
    if plan.network {
        Simulation::lockstep_shard(scenario, seed, shard_handle)
    } else {
        Simulation::shard_without_network(scenario, seed, shard_handle)
    }
}

fn text_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied();
    let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    text.unwrap_or("something without words").to_owned()
}

/// What one shard knows at the end.
struct Part {
    now: Instant,
    robots: Vec<(Option<Observation>, u32)>,
    history: u64,
    hashes: Hashes,
    statistics: PeerStatistics,
    polls: u64,
}

impl Part {
    fn of(simulation: &Simulation) -> Self {
        Self {
            now: simulation.now(),
            robots: (0..simulation.robots())
                .map(|robot| (simulation.observe(robot), simulation.boots(robot)))
                .collect(),
            history: simulation.partial_history(),
            hashes: simulation.hashes().clone(),
            statistics: simulation
                .network()
                .map(crate::net::lockstep::VirtualNetwork::statistics)
                .unwrap_or_default(),
            polls: simulation.polls(),
        }
    }
}

fn merge(parts: Vec<Option<Part>>) -> Result<Outcome, ParallelError> {
    let shards = parts.len();
    let mut parts: Vec<Part> = parts
        .into_iter()
        .collect::<Option<_>>()
        // Nobody failed, and yet somebody was left alone: the others were done before.
        .ok_or(ParallelError::Script)?;
    let first = parts.first().ok_or(ParallelError::Threads(0))?;
    let (now, robots) = (first.now, first.robots.len());
    let differs = |part: &Part| {
        part.now != now
            || part.robots.len() != robots
            || part.hashes.as_slice().len() != first.hashes.as_slice().len()
    };
    if parts.iter().any(differs) {
        return Err(ParallelError::Script);
    }
    let seen = (0..robots).map(|robot| parts[robot % shards].robots[robot]);
    let (observed, boots): (Vec<_>, Vec<_>) = seen.unzip();
    let observed = observed.into_iter().collect::<Option<_>>();
    let shares = parts.iter().map(|part| part.history);
    let history = hashes::total(now, shares.fold(0, u64::wrapping_add));
    let mut statistics = PeerStatistics::default();
    let mut polls = 0;
    for part in &parts {
        statistics.add(&part.statistics);
        polls += part.polls;
    }
    let others = parts.split_off(1);
    let mut all = parts.remove(0).hashes;
    for other in &others {
        all.add(&other.hashes);
    }
    Ok(Outcome {
        robots: observed.ok_or(ParallelError::Script)?,
        boots,
        history,
        hashes: all,
        statistics,
        polls,
    })
}
