//! A run of many nodes, with its files: those of a [run](crate::Run) of one, whose checkpoint is of the last round.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crawler_federated::coordinator::{Answer, Round};
use crawler_federated::{Aggregation, Coordinator, Plan, Settings};
use crawler_policy::{Compute, Policy};
use crawler_sim::scenario::Scenario;
use serde_json::{Value, json};

use super::{initial, policy};
use crate::curve::Line;
use crate::error::RunError;
use crate::files::Files;
use crate::judge::{self, Summary};
use crate::run::Options;

/// Decisions of one robot in a round of a learner.
const STEPS: u64 = 128;
/// Samples in a step of the optimiser on all nodes together.
const MINIBATCH: usize = 512;

/// What nodes learn together by.
#[derive(Debug, Clone, PartialEq)]
pub struct FederatedOptions {
    /// As of a run of one; decisions are those of all nodes, worlds are those of each node.
    pub options: Options,
    /// Nodes that are expected.
    pub nodes: usize,
    /// So many have to answer a round.
    pub quorum: usize,
    /// How long the others are waited for.
    pub deadline: Duration,
    /// How updates become one.
    pub aggregation: Aggregation,
    /// Part of the step before that is taken again.
    pub momentum: f32,
    /// How strongly each node is pulled back to what all have: the proximal term of `FedProx`.
    pub proximal: f32,
}

impl Default for FederatedOptions {
    fn default() -> Self {
        Self {
            options: Options {
                worlds: 8,
                ..Options::default()
            },
            nodes: 8,
            quorum: 5,
            deadline: Duration::from_mins(1),
            aggregation: Aggregation::Mean,
            momentum: 0.7,
            proximal: 0.0,
        }
    }
}

impl FederatedOptions {
    /// Rounds that a run in worlds with so many robots comes to.
    #[must_use]
    pub fn rounds(&self, robots: u32) -> u64 {
        let each = STEPS * self.options.worlds as u64 * u64::from(robots) * self.nodes as u64;
        self.options.steps.div_ceil(each.max(1)).max(1)
    }

    /// The same for the coordinator.
    #[must_use]
    pub fn settings(&self, robots: u32) -> Settings {
        let most = |number: usize| u16::try_from(number).unwrap_or(u16::MAX);
        Settings {
            rounds: u32::try_from(self.rounds(robots)).unwrap_or(u32::MAX),
            nodes: self.nodes,
            quorum: self.quorum,
            deadline: self.deadline,
            aggregation: self.aggregation,
            momentum: self.momentum,
            plan: Plan {
                seed: self.options.seed,
                worlds: most(self.options.worlds),
                rounds: 1,
                // All take as many steps of the optimiser as one would that had all worlds.
                minibatch: most((MINIBATCH / self.nodes.max(1)).max(16)),
                units: most(self.options.units),
                central: self.options.privileged,
                proximal: self.proximal,
            },
        }
    }

    fn describe(&self) -> Value {
        let mut told = self.options.describe();
        if let Value::Object(told) = &mut told {
            told.extend([
                ("nodes".to_owned(), json!(self.nodes)),
                ("quorum".to_owned(), json!(self.quorum)),
                ("deadline_s".to_owned(), json!(self.deadline.as_secs())),
                ("aggregation".to_owned(), json!(self.aggregation.as_str())),
                ("momentum".to_owned(), json!(self.momentum)),
                ("proximal".to_owned(), json!(self.proximal)),
            ]);
        }
        told
    }
}

/// A run of many nodes under way. Times are those since any moment that stays the same.
pub struct Coordination {
    options: FederatedOptions,
    coordinator: Coordinator,
    files: Files,
    scenario: Arc<Scenario>,
    compute: Compute,
    since: Duration,
    /// What the last round came to, since this was opened.
    last: Option<Round>,
}

impl Coordination {
    /// Begins a run with files in `folder`, or goes on with the one that is there. What came of it is judged in worlds of `scenario`.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn open(
        options: &FederatedOptions,
        folder: &Path,
        scenario: Scenario,
        threads: NonZeroUsize,
        now: Duration,
    ) -> Result<Self, RunError> {
        let settings = options.settings(scenario.robots);
        let coordinator = match Files::checkpoint(folder)? {
            Some((path, bytes)) => Coordinator::resume(settings, &bytes, now)
                .map_err(|error| RunError::Rounds(path, error))?,
            None => Coordinator::new(settings, initial(&settings.plan)?, now)?,
        };
        Ok(Self {
            options: options.clone(),
            files: Files::open(folder, coordinator.rounds().into())?,
            coordinator,
            scenario: Arc::new(scenario),
            compute: Compute::new(threads),
            since: now,
            last: None,
        })
    }

    /// The curve so far, as in its file.
    #[must_use]
    pub fn curve(&self) -> &str {
        self.files.curve()
    }

    /// The rounds, to look at.
    #[must_use]
    pub const fn coordinator(&self) -> &Coordinator {
        &self.coordinator
    }

    /// What the last round came to; `None` for the time being after it was opened.
    #[must_use]
    pub const fn last(&self) -> Option<&Round> {
        self.last.as_ref()
    }

    /// Takes what a node has sent.
    pub fn receive(&mut self, node: &str, bytes: &[u8]) -> Answer {
        self.coordinator.receive(node, bytes)
    }

    /// Ends the round if it is over at `now`, and keeps it before anybody is told of the next one.
    ///
    /// # Errors
    /// [`RunError::File`].
    pub fn close(&mut self, now: Duration) -> Result<Option<Line>, RunError> {
        let before = self.coordinator.counts().samples;
        let Some(round) = self.coordinator.close(now) else {
            return Ok(None);
        };
        let steps = self.coordinator.counts().samples;
        let line = line(&round, steps);
        let took = now.saturating_sub(self.since);
        self.since = now;
        self.files.add(line, steps - before, took.as_secs_f64())?;
        self.files.keep(&self.coordinator.checkpoint())?;
        self.last = Some(round);
        Ok(Some(line))
    }

    fn policy(&self) -> Result<Policy, RunError> {
        let plan = &self.coordinator.settings().plan;
        policy(plan, self.coordinator.weights())
    }

    /// What was learned so far, as robots have it; nobody has judged it.
    ///
    /// # Errors
    /// [`RunError::Unfit`] when it is none for robots.
    pub fn so_far(&self) -> Result<Vec<u8>, RunError> {
        Ok(judge::so_far(&self.policy()?)?)
    }

    /// Judges what was learned, and writes it down.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn finish(&self) -> Result<Summary, RunError> {
        let (policy, options) = (self.policy()?, self.options.describe());
        let rounds = self.coordinator.rounds().into();
        self.files
            .finish(&policy, &self.scenario, &self.compute, &options, rounds)
    }
}

/// A round for the curve, after so many decisions in all: what nodes said, on average over episodes, or decisions.
fn line(round: &Round, steps: u64) -> Line {
    let reports = || round.nodes.iter().map(|part| &part.report);
    let episodes: u64 = reports().map(|report| u64::from(report.episodes)).sum();
    let samples: u64 = reports().map(|report| u64::from(report.samples)).sum();
    // Of no episodes there is no mean: not a number.
    let of_episodes = |number: fn(&crawler_federated::Report) -> f32| {
        let sum: f64 = reports()
            .map(|report| f64::from(number(report)) * f64::from(report.episodes))
            .sum();
        (sum / episodes as f64) as f32
    };
    let of_samples = |number: fn(&crawler_federated::Report) -> f32| {
        let sum: f64 = reports()
            .map(|report| f64::from(number(report)) * f64::from(report.samples))
            .sum();
        sum / samples.max(1) as f64
    };
    Line {
        round: round.round.into(),
        steps,
        episodes: usize::try_from(episodes).unwrap_or(usize::MAX),
        reward: of_episodes(|report| report.reward),
        success: of_episodes(|report| report.success),
        length: of_episodes(|report| report.length),
        entropy: of_samples(|report| report.entropy),
        divergence: of_samples(|report| report.divergence),
        clipped: of_samples(|report| report.clipped),
        critic: of_samples(|report| report.critic),
        loss: of_samples(|report| report.loss),
        vetoes: of_samples(|report| report.vetoes) as f32,
    }
}

#[cfg(test)]
mod tests;
