//! Proximal policy optimisation (Schulman and others 2017): steps in the environments by the policy of the
//! round, then a few passes over them that move the policy a little.

mod config;
mod federated;
mod rollout;
mod update;

use crate::actor::Actor;
use crate::adam;
use crate::batch::PIECE;
use crate::checkpoint::{CheckpointError, Kind, Reader, Writer};
use crate::compute::Compute;
use crate::config::{self as common, ConfigError, Diverged};
use crate::environment::{Environment, Episode, Interface};
use crate::learner::Learner;
use crate::network::Network;
use crate::policy::Policy;
use crate::random::{self, Purpose};
use rollout::{Rollout, Stage, Trajectory};
use update::{Objective, Piece, Sums};

pub use config::{Config, Critic};
pub use federated::WeightsError;

/// A run of PPO. After each [`round`](Self::round) it can be kept, and gone on with.
#[derive(Debug)]
pub struct Ppo<E> {
    config: Config,
    compute: Compute,
    interface: Interface,
    policy: Learner,
    value: Learner,
    stages: Vec<Stage<E>>,
    round: u64,
    /// What was adopted last, by network; empty where nothing pulls back to it.
    anchors: [Vec<f32>; 2],
    pieces: Vec<Piece>,
    acting: Vec<rollout::Scratch>,
    learning: Vec<update::Scratch>,
}

/// What a round came to. Means are over all samples that were learned from; those of the policy over steps at which it
/// chose.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Rounds of the run so far.
    pub round: u64,
    /// Steps of all agents so far.
    pub agent_steps: u64,
    /// Episodes that came to an end in this round.
    pub episodes: Vec<Episode>,
    /// The clipped objective, negative.
    pub policy_loss: f64,
    /// Half of the squared error of the critic.
    pub value_loss: f64,
    /// Entropy of the policy, in nats.
    pub entropy: f64,
    /// How far the policy has moved: the Kullback-Leibler divergence, estimated (Schulman 2020, k3).
    pub divergence: f64,
    /// Part of the samples whose objective was clipped.
    pub clipped: f64,
    /// How often the samples were learned from.
    pub epochs: usize,
}

impl<E: Environment> Ppo<E> {
    /// Begins a run in these environments.
    ///
    /// # Errors
    /// When a value is out of range, or the environments differ.
    pub fn new(
        config: Config,
        compute: Compute,
        environments: Vec<E>,
    ) -> Result<Self, ConfigError> {
        let interface = common::interface(&environments)?;
        config.validate(&interface, environments.len())?;
        let seen = match config.critic {
            Critic::Own => interface.observation,
            Critic::Central => interface.state,
        };
        let shape = config
            .hidden
            .shape(interface.observation, interface.actions);
        let policy = Network::initial(shape, 0.01, config.seed, 0);
        let value = Network::initial(config.hidden.shape(seen, 1), 1.0, config.seed, 1);
        let stage = |(number, environment)| Stage {
            actor: Actor::new(environment, config.seed, number),
            trajectory: Trajectory::new(&interface, &config),
        };
        let stages: Vec<Stage<E>> = (0..).zip(environments).map(stage).collect();
        let samples = config.steps * interface.agents * stages.len();
        let pieces = config.minibatch.min(samples).div_ceil(PIECE);
        let threads = 0..compute.threads();
        Ok(Self {
            pieces: (0..pieces).map(|_| Piece::new(&policy, &value)).collect(),
            acting: threads
                .clone()
                .map(|_| rollout::Scratch::new(&policy, &value))
                .collect(),
            learning: threads
                .map(|_| update::Scratch::new(&policy, &value))
                .collect(),
            policy: Learner::new(policy),
            value: Learner::new(value),
            config,
            compute,
            interface,
            stages,
            round: 0,
            anchors: [Vec::new(), Vec::new()],
        })
    }

    /// Rounds so far.
    pub const fn rounds(&self) -> u64 {
        self.round
    }

    /// Steps of all agents in a round.
    pub const fn samples(&self) -> usize {
        self.config.steps * self.interface.agents * self.stages.len()
    }

    /// What has been learned so far.
    pub fn policy(&self) -> Policy {
        Policy::new(self.policy.network.clone())
    }

    /// Acts and learns.
    ///
    /// # Errors
    /// When the loss is no number any more. The networks are those before the step of the optimiser that would
    /// have spoilt them.
    pub fn round(&mut self) -> Result<Report, Diverged> {
        let rollout = Rollout {
            config: &self.config,
            interface: self.interface,
            compute: &self.compute,
            policy: &self.policy.network,
            value: &self.value.network,
            round: self.round,
        };
        Compute::spread(&mut self.stages, &mut self.acting, |scratch, stages| {
            rollout.run(scratch, stages);
        });
        let (sums, epochs) = self.learn()?;
        self.round += 1;
        let finished = self
            .stages
            .iter_mut()
            .map(|stage| &mut stage.actor.finished);
        let episodes = finished.flat_map(|finished| finished.drain(..)).collect();
        let (samples, chosen) = (sums.samples as f64, sums.chosen.max(1) as f64);
        Ok(Report {
            round: self.round,
            agent_steps: self.round * self.samples() as u64,
            episodes,
            policy_loss: sums.policy / chosen,
            value_loss: sums.value / samples,
            entropy: sums.entropy / chosen,
            divergence: sums.divergence / chosen,
            clipped: sums.clipped as f64 / chosen,
            epochs,
        })
    }

    /// Mean of the advantages where the policy chose, and the inverse of their deviation.
    fn advantages(&self) -> (f32, f32) {
        let all = || {
            let ways = self.stages.iter().map(|stage| &stage.trajectory);
            let each = ways.flat_map(|way| way.advantages.iter().zip(&way.chosen));
            each.filter_map(|(advantage, chosen)| chosen.then_some(f64::from(*advantage)))
        };
        let count = all().count().max(1) as f64;
        let mean = all().sum::<f64>() / count;
        let variance = all().map(|a| (a - mean) * (a - mean)).sum::<f64>() / count;
        (mean as f32, (1.0 / (variance.sqrt() + 1e-8)) as f32)
    }

    /// Learns from the samples of the round. Returns what losses came to, and the number of epochs.
    fn learn(&mut self) -> Result<(Sums, usize), Diverged> {
        let config = &self.config;
        let rate = common::falling(config.rate, config.final_rate, self.round, config.rounds);
        let (advantages, samples) = (self.advantages(), self.samples());
        let ways: Vec<&Trajectory> = self.stages.iter().map(|stage| &stage.trajectory).collect();
        let mut total = Sums::default();
        for epoch in 0..self.config.epochs {
            let place = (self.round, epoch as u64);
            let mut rng = random::stream(self.config.seed, Purpose::Order, place);
            let order = random::permutation(&mut rng, samples as u32);
            let mut sums = Sums::default();
            for minibatch in order.chunks(self.config.minibatch) {
                let parts = minibatch.chunks(PIECE);
                let pieces = &mut self.pieces[..parts.len()];
                for (piece, part) in pieces.iter_mut().zip(parts) {
                    piece.samples.clear();
                    piece.samples.extend_from_slice(part);
                }
                let objective = Objective {
                    config: &self.config,
                    interface: self.interface,
                    compute: &self.compute,
                    policy: &self.policy.network,
                    value: &self.value.network,
                    ways: &ways,
                    advantages,
                    minibatch: minibatch.len(),
                };
                Compute::spread(pieces, &mut self.learning, |scratch, pieces| {
                    for piece in pieces {
                        objective.differentiate(scratch, piece);
                    }
                });
                let Some((first, rest)) = pieces.split_first_mut() else {
                    continue;
                };
                for piece in rest {
                    for (sum, gradient) in first.gradients.iter_mut().zip(&piece.gradients) {
                        sum.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
                    }
                    first.sums.add(&piece.sums);
                }
                for (gradient, (anchor, learner)) in first
                    .gradients
                    .iter_mut()
                    .zip(self.anchors.iter().zip([&self.policy, &self.value]))
                {
                    federated::pull_back(gradient, self.config.proximal, learner, anchor);
                }
                let [policy, value] = &first.gradients;
                // One by one: networks share nothing, and a critic far off would hold up the policy.
                let scales = [policy, value].map(|g| adam::clip(g, self.config.gradient));
                let [Some(policy_scale), Some(value_scale)] = scales else {
                    return Err(Diverged);
                };
                self.policy.step(policy, policy_scale, rate);
                self.value.step(value, value_scale, rate);
                sums.add(&first.sums);
            }
            total.add(&sums);
            let moved = sums.divergence / sums.chosen.max(1) as f64;
            if self.config.divergence > 0.0 && moved > self.config.divergence {
                return Ok((total, epoch + 1));
            }
        }
        Ok((total, self.config.epochs))
    }

    /// The hash of what bytes of a run follow from, beside the environments.
    fn fingerprint(&self) -> [u8; 32] {
        let mut writer = Writer::default();
        self.config.write(&mut writer);
        self.interface.write(&mut writer);
        writer.u64(self.stages.len() as u64);
        writer.hash()
    }

    /// All that the run needs to go on.
    pub fn checkpoint(&self) -> Vec<u8> {
        let mut writer = Writer::new(Kind::Ppo, self.fingerprint());
        writer.u64(self.round);
        self.policy.write(&mut writer);
        self.value.write(&mut writer);
        for stage in &self.stages {
            writer.progress(&stage.actor.progress());
        }
        writer.finish()
    }

    /// Goes on with a run, to the same bytes as if it had never been interrupted. Configuration and environments
    /// have to be those that it began with; threads need not.
    ///
    /// # Errors
    /// When the bytes are no checkpoint of such a run. What there was is spoilt then: begin anew.
    pub fn resume(&mut self, checkpoint: &[u8]) -> Result<(), CheckpointError> {
        let mut reader = Reader::new(checkpoint, Kind::Ppo)?;
        reader.expect(self.fingerprint())?;
        self.round = reader.count()?;
        self.policy.read(&mut reader)?;
        self.value.read(&mut reader)?;
        for stage in &mut self.stages {
            let progress = reader.progress()?;
            stage
                .actor
                .resume(&progress, |_, _, _, _| {})
                .map_err(|_| CheckpointError::Invalid("running episode"))?;
        }
        reader.finish()
    }
}
