//! A training run with its files: what was learned, a curve, and a checkpoint to go on from.
//!
//! | file | |
//! |---|---|
//! | `checkpoint` | all that the run needs to go on, of the last round that is a multiple of ten, or the last one |
//! | `curve.csv` | a line for each round |
//! | `events.out.tfevents.terracrawler` | the same for `TensorBoard`, as soon as a round is over |
//! | `policy.tcpo` | the policy for robots, once the run is over |
//! | `policy` | the same in floats |
//! | `run.json` | options, results and hashes |
//!
//! Whoever has a run stand between two rounds [keeps](Run::keep) it, so that nothing is done twice.
//!
//! But for the events, nothing in them tells the time of day or how fast the machine is: who runs the same options again, in one go or
//! killed and begun again ten times, on one thread or many, has the same bytes.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crawler_policy::Compute;
use crawler_policy::ppo::{Config, Critic, Ppo};
use crawler_sim::scenario::Scenario;
use serde_json::{Value, json};

use crate::curve::Line;
use crate::error::RunError;
use crate::files::Files;
use crate::judge::{self, Summary};
use crate::spread::Spread;

/// Samples in a step of the optimiser.
const MINIBATCH: usize = 512;
/// Decisions for which a robot keeps to an action, on average, in the first round. The shield lets nobody drive who has not
/// looked around, and robots that choose anew every 100 ms do not come to look around, nor away from where they are.
const HOLD: f32 = 8.0;

/// What a run is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Names the run.
    pub seed: u64,
    /// Steps of all agents, rounded up to whole rounds.
    pub steps: u64,
    /// Worlds side by side.
    pub worlds: usize,
    /// Units of both hidden layers.
    pub units: usize,
    /// Whether the critic sees what no robot knows.
    pub privileged: bool,
}

impl Options {
    /// Rounds that a run in worlds with so many robots comes to.
    #[must_use]
    pub fn rounds(&self, robots: u32) -> u64 {
        let round = Config::default().steps * self.worlds * robots as usize;
        self.steps.div_ceil(round.max(1) as u64).max(1)
    }

    /// For `run.json`.
    pub(crate) fn describe(&self) -> Value {
        let Self {
            seed,
            steps,
            worlds,
            units,
            privileged,
        } = self;
        json!({
            "seed": seed,
            "steps": steps,
            "worlds": worlds,
            "units": units,
            "privileged": privileged,
        })
    }

    /// What a run of so many rounds learns by.
    #[must_use]
    pub fn config(&self, rounds: u64) -> Config {
        let mut config = Config {
            seed: self.seed,
            critic: if self.privileged {
                Critic::Central
            } else {
                Critic::Own
            },
            entropy: 0.003,
            minibatch: MINIBATCH,
            hold: HOLD,
            rounds,
            ..Config::default()
        };
        config.hidden.units = vec![self.units; 2];
        config
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seed: 1,
            steps: 4_000_000,
            worlds: 64,
            units: 64,
            privileged: true,
        }
    }
}

/// A run under way.
pub struct Run {
    options: Options,
    files: Files,
    scenario: Arc<Scenario>,
    compute: Compute,
    ppo: Ppo<Spread>,
    rounds: u64,
    /// Of the round under way.
    vetoes: Arc<AtomicU64>,
}

impl Run {
    /// Begins a run with files in `folder`, or goes on with the one that is there.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn open(
        options: &Options,
        folder: &Path,
        scenario: Scenario,
        threads: NonZeroUsize,
    ) -> Result<Self, RunError> {
        let scenario = Arc::new(scenario);
        let compute = Compute::new(threads);
        let rounds = options.rounds(scenario.robots);
        let config = options.config(rounds);
        let vetoes = Arc::new(AtomicU64::new(0));
        let world = |_| Spread::counting(Arc::clone(&scenario), Arc::clone(&vetoes));
        let worlds = (0..options.worlds).map(world);
        let mut ppo = Ppo::new(config, compute, worlds.collect())?;
        if let Some((path, bytes)) = Files::checkpoint(folder)? {
            let resumed = ppo.resume(&bytes);
            resumed.map_err(|error| RunError::Checkpoint(path, error))?;
        }
        // Decisions that were taken again are counted already.
        vetoes.store(0, Ordering::Relaxed);
        Ok(Self {
            options: options.clone(),
            files: Files::open(folder, ppo.rounds())?,
            scenario,
            compute,
            ppo,
            rounds,
            vetoes,
        })
    }

    /// The curve so far, as in its file.
    #[must_use]
    pub fn curve(&self) -> &str {
        self.files.curve()
    }

    /// Rounds so far, and of the whole run.
    pub const fn rounds(&self) -> (u64, u64) {
        (self.ppo.rounds(), self.rounds)
    }

    /// Goes on by a round; `None` when the run is over.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn round(&mut self) -> Result<Option<Line>, RunError> {
        if self.ppo.rounds() >= self.rounds {
            return Ok(None);
        }
        let began = Instant::now();
        let report = self.ppo.round()?;
        let took_s = began.elapsed().as_secs_f64();
        let decisions = report.agent_steps / report.round.max(1);
        let vetoes = self.vetoes.swap(0, Ordering::Relaxed);
        let line = Line::of(&report, vetoes as f32 / decisions as f32);
        self.files.add(line, decisions, took_s)?;
        if line.is_kept() || line.round == self.rounds {
            self.keep()?;
        }
        Ok(Some(line))
    }

    /// Writes down all that the run needs to go on after the last round.
    ///
    /// # Errors
    /// [`RunError::File`]: what was kept before stays.
    pub fn keep(&self) -> Result<(), RunError> {
        self.files.keep(&self.ppo.checkpoint())
    }

    /// What was learned so far, as robots have it; nobody has judged it.
    ///
    /// # Errors
    /// [`RunError::Unfit`] when it is none for robots.
    pub fn so_far(&self) -> Result<Vec<u8>, RunError> {
        Ok(judge::so_far(&self.ppo.policy())?)
    }

    /// Judges what was learned, and writes it down.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn finish(&self) -> Result<Summary, RunError> {
        let options = self.options.describe();
        let policy = self.ppo.policy();
        self.files.finish(
            &policy,
            &self.scenario,
            &self.compute,
            &options,
            self.rounds,
        )
    }
}

#[cfg(test)]
mod tests;
