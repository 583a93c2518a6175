//! A node: it trains the policy of all in worlds of its own.

use std::error::Error;
use std::fmt;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crawler_federated::message::Base;
use crawler_federated::quantise::ErrorFeedback;
use crawler_federated::{Announcement, MessageError, Plan, Report, Update};
use crawler_policy::ppo::{self, Ppo, WeightsError};
use crawler_policy::{Compute, ConfigError, Diverged, Episode};
use crawler_sim::scenario::Scenario;
use sha2::{Digest, Sha256};

use super::learner;
use crate::spread::Spread;

/// Why a node has no answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NodeError {
    /// What was announced is no message.
    Message(MessageError),
    /// What was announced cannot be learned by here.
    Config(ConfigError),
    /// The weights are of other networks than the plan says.
    Weights(WeightsError),
    /// Learning has come to no numbers.
    Diverged(Diverged),
}

impl fmt::Display for NodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Message(error) => error.fmt(f),
            Self::Config(error) => error.fmt(f),
            Self::Weights(error) => error.fmt(f),
            Self::Diverged(error) => error.fmt(f),
        }
    }
}

impl Error for NodeError {}

impl From<MessageError> for NodeError {
    fn from(error: MessageError) -> Self {
        Self::Message(error)
    }
}

impl From<ConfigError> for NodeError {
    fn from(error: ConfigError) -> Self {
        Self::Config(error)
    }
}

impl From<WeightsError> for NodeError {
    fn from(error: WeightsError) -> Self {
        Self::Weights(error)
    }
}

impl From<Diverged> for NodeError {
    fn from(error: Diverged) -> Self {
        Self::Diverged(error)
    }
}

/// What a node has to say.
#[derive(Debug, Clone, PartialEq)]
pub enum Answer {
    /// For the coordinator.
    Update(Vec<u8>),
    /// Nothing: the run is over, and this is what came of it.
    Over(Vec<f32>),
}

/// Who learns in worlds of its own, together with others.
pub struct Node {
    seed: u64,
    scenario: Arc<Scenario>,
    compute: Compute,
    run: Option<Run>,
}

/// What a node has of a run.
struct Run {
    plan: Plan,
    rounds: u32,
    ppo: Ppo<Spread>,
    vetoes: Arc<AtomicU64>,
    feedback: ErrorFeedback,
    /// What it has answered last.
    answered: Option<(Base, Vec<u8>)>,
}

impl Node {
    /// A node of this name, which learns in worlds of this scenario. From the name follows what it draws: nodes of one run are to
    /// have different ones.
    #[must_use]
    pub fn new(name: &str, scenario: Scenario, threads: NonZeroUsize) -> Self {
        let hash: [u8; 32] = Sha256::digest(name).into();
        let seed = u64::from_le_bytes(std::array::from_fn(|place| hash[place]));
        Self {
            seed,
            scenario: Arc::new(scenario),
            compute: Compute::new(threads),
            run: None,
        }
    }

    /// Learns as `announced` says, and answers it. Takes as long as learning does; where it has answered the same announcement before,
    /// it says the same again at once.
    ///
    /// What the optimiser keeps, and what rounding has left, stay with the node from round to round, so a node that was killed goes on a
    /// little differently.
    ///
    /// # Errors
    /// See [`NodeError`]. The next announcement may be answered all the same.
    pub fn answer(&mut self, announced: &[u8]) -> Result<Answer, NodeError> {
        let heard = Announcement::from_bytes(announced)?;
        if heard.is_over() {
            self.run = None;
            return Ok(Answer::Over(heard.weights));
        }
        let base = Announcement::base(announced);
        let mut run = match self.run.take() {
            Some(run) if run.plan == heard.plan && run.rounds == heard.rounds => run,
            _ => self.begin(&heard)?,
        };
        if let Some((answered, bytes)) = &run.answered
            && *answered == base
        {
            let bytes = bytes.clone();
            self.run = Some(run);
            return Ok(Answer::Update(bytes));
        }
        let update = run.learn(&heard, base)?;
        let bytes = update.to_bytes();
        run.answered = Some((base, bytes.clone()));
        self.run = Some(run);
        Ok(Answer::Update(bytes))
    }

    fn begin(&self, heard: &Announcement) -> Result<Run, NodeError> {
        let vetoes = Arc::new(AtomicU64::new(0));
        let world = |_| Spread::counting(Arc::clone(&self.scenario), Arc::clone(&vetoes));
        let worlds = (0..heard.plan.worlds).map(world);
        let seed = heard.plan.seed ^ self.seed;
        let ppo = learner(
            &heard.plan,
            seed,
            heard.rounds,
            self.compute,
            worlds.collect(),
        )?;
        Ok(Run {
            plan: heard.plan,
            rounds: heard.rounds,
            ppo,
            vetoes,
            feedback: ErrorFeedback::default(),
            answered: None,
        })
    }
}

impl Run {
    fn learn(&mut self, heard: &Announcement, base: Base) -> Result<Update, NodeError> {
        let done = u64::from(heard.round) * u64::from(heard.plan.rounds);
        self.ppo.adopt(&heard.weights, done)?;
        // Decisions that were taken before are counted already.
        self.vetoes.store(0, Ordering::Relaxed);
        let mut reports = Vec::new();
        for _ in 0..heard.plan.rounds {
            reports.push(self.ppo.round()?);
        }
        let learned = self.ppo.weights();
        let changes = learned.iter().zip(&heard.weights);
        let change: Vec<f32> = changes.map(|(learned, before)| learned - before).collect();
        Ok(Update {
            round: heard.round,
            base,
            report: self.report(&reports),
            change: self.feedback.quantise(&change),
        })
    }

    fn report(&self, reports: &[ppo::Report]) -> Report {
        let samples = self.ppo.samples() * reports.len();
        let vetoes = self.vetoes.load(Ordering::Relaxed);
        let each = || reports.iter().flat_map(|report| &report.episodes);
        let of_episodes = |number: fn(&Episode) -> f32| {
            each().map(number).sum::<f32>() / each().count().max(1) as f32
        };
        let of_rounds = |number: fn(&ppo::Report) -> f64| {
            (reports.iter().map(number).sum::<f64>() / reports.len().max(1) as f64) as f32
        };
        Report {
            samples: u32::try_from(samples).unwrap_or(u32::MAX),
            episodes: u32::try_from(each().count()).unwrap_or(u32::MAX),
            success: of_episodes(|episode| f32::from(u8::from(episode.succeeded))),
            reward: of_episodes(|episode| episode.reward),
            length: of_episodes(|episode| episode.length as f32),
            entropy: of_rounds(|report| report.entropy),
            divergence: of_rounds(|report| report.divergence),
            clipped: of_rounds(|report| report.clipped),
            critic: of_rounds(|report| report.value_loss),
            loss: of_rounds(|report| report.policy_loss),
            vetoes: (vetoes as f32 / samples.max(1) as f32).min(1.0),
        }
    }
}
