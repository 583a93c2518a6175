//! Double deep Q-learning (Mnih and others 2015; van Hasselt, Guez and Silver 2016) with returns of several
//! steps: acting, and learning what actions are worth from a memory of what happened.

mod config;
mod memory;
mod update;
mod window;

use rand_core::Rng;

use crate::actor::Actor;
use crate::adam;
use crate::batch::{PIECE, Runner};
use crate::categorical;
use crate::checkpoint::{CheckpointError, Kind, Reader, Writer};
use crate::compute::Compute;
use crate::config::{self as common, ConfigError, Diverged};
use crate::environment::{Environment, Episode, Interface, Status};
use crate::learner::Learner;
use crate::network::Network;
use crate::policy::Policy;
use crate::random::{self, Purpose};
use memory::{Memory, Transition};
use update::{Objective, Piece};
use window::Window;

pub use config::Config;

/// One environment, and what its agents went through lately.
#[derive(Debug)]
struct Stage<E> {
    actor: Actor<E>,
    windows: Vec<Window>,
    /// Since the last round; at most as much as a round brings.
    fresh: Memory,
}

/// A run of DQN. After each [`round`](Self::round) it can be kept, and gone on with.
#[derive(Debug)]
pub struct Dqn<E> {
    config: Config,
    compute: Compute,
    interface: Interface,
    learner: Learner,
    target: Network,
    memory: Memory,
    stages: Vec<Stage<E>>,
    round: u64,
    updates: u64,
    pieces: Vec<Piece>,
    acting: Vec<Runner>,
    learning: Vec<update::Scratch>,
}

/// What a round came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Rounds of the run so far.
    pub round: u64,
    /// Steps of all agents so far.
    pub agent_steps: u64,
    /// Episodes that came to an end in this round.
    pub episodes: Vec<Episode>,
    /// Part of the actions that were taken by chance.
    pub exploration: f32,
    /// Mean loss, if there was enough to learn from.
    pub loss: Option<f64>,
    /// What the actions learned from are worth, in the mean.
    pub value: Option<f64>,
}

impl<E: Environment> Dqn<E> {
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
        let shape = config
            .hidden
            .shape(interface.observation, interface.actions);
        let network = Network::initial(shape, 1.0, config.seed, 0);
        // What windows held from the round before may come on top.
        let fresh = (config.steps + config.horizon) * interface.agents;
        let stage = |(number, environment)| Stage {
            actor: Actor::new(environment, config.seed, number),
            windows: vec![Window::default(); interface.agents],
            fresh: Memory::new(fresh, &interface),
        };
        let pieces = config.minibatch.div_ceil(PIECE);
        let threads = 0..compute.threads();
        Ok(Self {
            stages: (0..).zip(environments).map(stage).collect(),
            pieces: (0..pieces).map(|_| Piece::new(&network)).collect(),
            acting: threads.clone().map(|_| Runner::new(&network)).collect(),
            learning: threads.map(|_| update::Scratch::new(&network)).collect(),
            memory: Memory::new(config.memory, &interface),
            target: network.clone(),
            learner: Learner::new(network),
            config,
            compute,
            interface,
            round: 0,
            updates: 0,
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
        Policy::new(self.learner.network.clone())
    }

    /// The part of actions that are taken by chance in this round.
    fn exploration(&self) -> f32 {
        let left = 1.0 - (self.round as f32 / self.config.exploring.max(1) as f32).min(1.0);
        self.config.exploration + (1.0 - self.config.exploration) * left
    }

    /// Acts and learns.
    ///
    /// # Errors
    /// When the loss is no number any more. The network is that before the step of the optimiser that would have
    /// spoilt it.
    pub fn round(&mut self) -> Result<Report, Diverged> {
        let exploration = self.exploration();
        let acting = Acting {
            config: &self.config,
            interface: self.interface,
            compute: &self.compute,
            network: &self.learner.network,
            round: self.round,
            exploration,
        };
        Compute::spread(&mut self.stages, &mut self.acting, |runner, stages| {
            acting.run(runner, stages);
        });
        for stage in &mut self.stages {
            for index in 0..stage.fresh.len() {
                self.memory.push(&stage.fresh.get(index));
            }
            stage.fresh.clear();
        }
        let learned = if self.memory.len() < self.config.warm_up {
            None
        } else {
            Some(self.learn()?)
        };
        self.round += 1;
        let finished = self
            .stages
            .iter_mut()
            .map(|stage| &mut stage.actor.finished);
        let episodes = finished.flat_map(|finished| finished.drain(..)).collect();
        Ok(Report {
            round: self.round,
            agent_steps: self.round * self.samples() as u64,
            episodes,
            exploration,
            loss: learned.map(|(loss, _)| loss),
            value: learned.map(|(_, value)| value),
        })
    }

    /// Takes the steps of the optimiser of a round. Returns the mean loss and value.
    fn learn(&mut self) -> Result<(f64, f64), Diverged> {
        let config = &self.config;
        let rate = common::falling(config.rate, config.final_rate, self.round, config.rounds);
        let (mut loss, mut value) = (0.0, 0.0);
        for _ in 0..self.config.updates {
            let mut rng = random::stream(self.config.seed, Purpose::Replay, (self.updates, 0));
            let mut left = self.config.minibatch;
            for piece in &mut self.pieces {
                let samples = left.min(PIECE);
                left -= samples;
                piece.samples.clear();
                for _ in 0..samples {
                    let drawn = random::below(&mut rng, self.memory.len() as u32);
                    piece.samples.push(drawn);
                }
            }
            let objective = Objective {
                compute: &self.compute,
                network: &self.learner.network,
                target: &self.target,
                memory: &self.memory,
                minibatch: self.config.minibatch,
            };
            Compute::spread(&mut self.pieces, &mut self.learning, |scratch, pieces| {
                for piece in pieces {
                    objective.differentiate(scratch, piece);
                }
            });
            let Some((first, rest)) = self.pieces.split_first_mut() else {
                continue;
            };
            for piece in rest {
                let both = first.gradient.iter_mut().zip(&piece.gradient);
                both.for_each(|(sum, gradient)| *sum += gradient);
                first.loss += piece.loss;
                first.value += piece.value;
            }
            let scale = adam::clip(&first.gradient, self.config.gradient).ok_or(Diverged)?;
            self.learner.step(&first.gradient, scale, rate);
            self.updates += 1;
            if self.updates.is_multiple_of(self.config.target) {
                self.target.clone_from(&self.learner.network);
            }
            loss += first.loss;
            value += first.value;
        }
        let samples = (self.config.updates * self.config.minibatch) as f64;
        Ok((loss / samples, value / samples))
    }

    /// The hash of what bytes of a run follow from, beside the environments.
    fn fingerprint(&self) -> [u8; 32] {
        let mut writer = Writer::default();
        self.config.write(&mut writer);
        self.interface.write(&mut writer);
        writer.u64(self.stages.len() as u64);
        writer.hash()
    }

    /// All that the run needs to go on, the memory included.
    pub fn checkpoint(&self) -> Vec<u8> {
        let mut writer = Writer::new(Kind::Dqn, self.fingerprint());
        writer.u64(self.round);
        writer.u64(self.updates);
        self.learner.write(&mut writer);
        writer.f32s(self.target.parameters());
        self.memory.write(&mut writer);
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
        let mut reader = Reader::new(checkpoint, Kind::Dqn)?;
        reader.expect(self.fingerprint())?;
        self.round = reader.count()?;
        self.updates = reader.count()?;
        self.learner.read(&mut reader)?;
        self.target
            .change(|parameters| reader.f32s(parameters, "weights"))?;
        self.memory.read(&mut reader)?;
        let (horizon, gamma) = (self.config.horizon, self.config.gamma);
        let width = self.interface.observation;
        for stage in &mut self.stages {
            let progress = reader.progress()?;
            let mut windows = vec![Window::default(); self.interface.agents];
            // What goes out of the windows here went into the memory before.
            let each = |observed: &[f32], actions: &[u8], rewards: &[f32], next: &[f32]| {
                let seen = observed.chunks_exact(width).zip(next.chunks_exact(width));
                let done = actions.iter().zip(rewards);
                for (window, ((observation, next), (action, reward))) in
                    windows.iter_mut().zip(seen.zip(done))
                {
                    window.push(observation, *action, *reward);
                    window.shift(horizon, gamma, next, &mut |_| {});
                }
            };
            stage
                .actor
                .resume(&progress, each)
                .map_err(|_| CheckpointError::Invalid("running episode"))?;
            stage.windows = windows;
        }
        reader.finish()
    }
}

/// Who acts in a round.
struct Acting<'a> {
    config: &'a Config,
    interface: Interface,
    compute: &'a Compute,
    network: &'a Network,
    round: u64,
    exploration: f32,
}

impl Acting<'_> {
    /// Takes the steps of a round in these environments.
    fn run<E: Environment>(&self, runner: &mut Runner, stages: &mut [Stage<E>]) {
        let (agents, width) = (self.interface.agents, self.interface.observation);
        let stream = |stage: &Stage<E>| {
            let place = (self.round, u64::from(stage.actor.number));
            random::stream(self.config.seed, Purpose::Actions, place)
        };
        let mut streams: Vec<_> = stages.iter().map(stream).collect();
        let mut actions = vec![0; agents];
        let mut rewards = vec![0.0; agents];
        let mut next = vec![0.0; agents * width];
        for _ in 0..self.config.steps {
            runner.reserve(self.network, stages.len() * agents);
            let rows = runner.inputs.chunks_exact_mut(agents * width);
            for (stage, row) in stages.iter().zip(rows) {
                stage.actor.observe(row);
            }
            runner.run(self.network, self.compute);
            let rows = runner.inputs.chunks_exact(agents * width);
            let values = runner.outputs.chunks_exact(agents * self.interface.actions);
            for (((stage, rng), row), values) in
                stages.iter_mut().zip(&mut streams).zip(rows).zip(values)
            {
                let values = values.chunks_exact(self.interface.actions);
                for (action, values) in actions.iter_mut().zip(values) {
                    *action = self.choose(rng, values);
                }
                let status = stage.actor.step(&actions, &mut rewards);
                stage.actor.observe(&mut next);
                let fresh = &mut stage.fresh;
                let mut keep = |transition: &Transition<'_>| fresh.push(transition);
                let seen = row.chunks_exact(width).zip(next.chunks_exact(width));
                let done = actions.iter().zip(&rewards);
                for (window, ((observation, next), (action, reward))) in
                    stage.windows.iter_mut().zip(seen.zip(done))
                {
                    window.push(observation, *action, *reward);
                    let gamma = self.config.gamma;
                    match status {
                        Status::Running => {
                            window.shift(self.config.horizon, gamma, next, &mut keep);
                        }
                        Status::Terminated => window.drain(gamma, false, next, &mut keep),
                        Status::Truncated => window.drain(gamma, true, next, &mut keep),
                    }
                }
                if status != Status::Running {
                    stage.actor.begin();
                }
            }
        }
    }

    /// The best action, or any.
    fn choose(&self, rng: &mut impl Rng, values: &[f32]) -> u8 {
        // Both are always drawn, so that what follows does not depend on what was decided.
        let (by_chance, any) = (
            random::uniform(rng) < self.exploration,
            random::below(rng, values.len() as u32),
        );
        if by_chance {
            any as u8
        } else {
            categorical::best(values) as u8
        }
    }
}
