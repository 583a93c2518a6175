//! Steps in the environments, and what they were worth.

use rand_pcg::Pcg32;

use super::config::{Config, Critic};
use crate::actor::Actor;
use crate::advantage::Steps;
use crate::batch::Runner;
use crate::categorical;
use crate::compute::Compute;
use crate::environment::{Environment, Interface, Status};
use crate::network::Network;
use crate::random::{self, Purpose};

/// What happened to the agents of one environment in a round: step by step, agent by agent.
#[derive(Debug)]
pub(super) struct Trajectory {
    pub(super) observations: Vec<f32>,
    /// What the critic saw, if it is another thing.
    pub(super) states: Vec<f32>,
    pub(super) actions: Vec<u8>,
    /// Logarithm of the probability that the action had.
    pub(super) logarithms: Vec<f32>,
    /// Whether the policy chose it; otherwise the agent kept to the action before.
    pub(super) chosen: Vec<bool>,
    rewards: Vec<f32>,
    values: Vec<f32>,
    next_values: Vec<f32>,
    over: Vec<bool>,
    pub(super) advantages: Vec<f32>,
    /// What the critic should have expected.
    pub(super) targets: Vec<f32>,
}

impl Trajectory {
    pub(super) fn new(interface: &Interface, config: &Config) -> Self {
        let samples = config.steps * interface.agents;
        let state = match config.critic {
            Critic::Own => 0,
            Critic::Central => interface.state,
        };
        Self {
            observations: vec![0.0; samples * interface.observation],
            states: vec![0.0; samples * state],
            actions: vec![0; samples],
            logarithms: vec![0.0; samples],
            chosen: vec![true; samples],
            rewards: vec![0.0; samples],
            values: vec![0.0; samples],
            next_values: vec![0.0; samples],
            over: vec![false; config.steps],
            advantages: vec![0.0; samples],
            targets: vec![0.0; samples],
        }
    }
}

/// One environment and its trajectory.
#[derive(Debug)]
pub(super) struct Stage<E> {
    pub(super) actor: Actor<E>,
    pub(super) trajectory: Trajectory,
}

/// What a thread needs beside the environments.
#[derive(Debug)]
pub(super) struct Scratch {
    policy: Runner,
    value: Runner,
    probabilities: Vec<f32>,
}

impl Scratch {
    pub(super) fn new(policy: &Network, value: &Network) -> Self {
        Self {
            policy: Runner::new(policy),
            value: Runner::new(value),
            probabilities: vec![0.0; policy.shape().outputs],
        }
    }
}

/// The networks of a round, and who acts by them.
pub(super) struct Rollout<'a> {
    pub(super) config: &'a Config,
    pub(super) interface: Interface,
    pub(super) compute: &'a Compute,
    pub(super) policy: &'a Network,
    pub(super) value: &'a Network,
    pub(super) round: u64,
}

impl Rollout<'_> {
    /// Takes the steps of a round in these environments.
    pub(super) fn run<E: Environment>(&self, scratch: &mut Scratch, stages: &mut [Stage<E>]) {
        let stream = |stage: &Stage<E>| {
            let place = (self.round, u64::from(stage.actor.number));
            random::stream(self.config.seed, Purpose::Actions, place)
        };
        let mut streams: Vec<Pcg32> = stages.iter().map(stream).collect();
        let agents = self.interface.agents;
        let held = self.config.held(self.round);
        for step in 0..self.config.steps {
            self.look(scratch, stages);
            let rows = scratch
                .policy
                .inputs
                .chunks_exact(agents * self.interface.observation);
            let logits = scratch
                .policy
                .outputs
                .chunks_exact_mut(agents * self.interface.actions);
            let values = scratch.value.outputs.chunks_exact(agents);
            let mut truncated = Vec::new();
            let all = stages
                .iter_mut()
                .zip(&mut streams)
                .zip(rows)
                .zip(logits)
                .zip(values);
            for (index, ((((stage, rng), row), logits), values)) in all.enumerate() {
                let way = &mut stage.trajectory;
                way.observations[step * row.len()..][..row.len()].copy_from_slice(row);
                let here = step * agents..(step + 1) * agents;
                way.values[here.clone()].copy_from_slice(values);
                let before = stage.actor.last();
                let each = way.actions[here.clone()].iter_mut();
                let each = each.zip(&mut way.logarithms[here.clone()]);
                let each = each.zip(&mut way.chosen[here.clone()]);
                let logits = logits.chunks_exact_mut(self.interface.actions);
                for (agent, (((action, logarithm), chosen), logits)) in each.zip(logits).enumerate()
                {
                    *chosen = true;
                    // Nothing is drawn where nothing is kept to.
                    if held > 1.0
                        && let Some(before) = before.get(agent)
                        && random::uniform(rng) * held >= 1.0
                    {
                        *action = *before;
                        *chosen = false;
                        continue;
                    }
                    categorical::normalise(logits, &mut scratch.probabilities);
                    let choice = categorical::sample(&scratch.probabilities, random::uniform(rng));
                    *action = choice as u8;
                    *logarithm = logits[choice];
                }
                let status = stage
                    .actor
                    .step(&way.actions[here.clone()], &mut way.rewards[here.clone()]);
                way.over[step] = status != Status::Running;
                if status == Status::Truncated {
                    truncated.push(index);
                } else if status == Status::Terminated {
                    way.next_values[here].fill(0.0);
                    stage.actor.begin();
                }
            }
            if self.config.critic == Critic::Central {
                let width = agents * self.interface.state;
                for (stage, states) in stages
                    .iter_mut()
                    .zip(scratch.value.inputs.chunks_exact(width))
                {
                    stage.trajectory.states[step * width..][..width].copy_from_slice(states);
                }
            }
            for index in truncated {
                let stage = &mut stages[index];
                self.expect(&mut scratch.value, std::slice::from_ref(stage));
                let here = step * agents..(step + 1) * agents;
                stage.trajectory.next_values[here].copy_from_slice(&scratch.value.outputs);
                stage.actor.begin();
            }
        }
        self.expect(&mut scratch.value, stages);
        for (stage, last) in stages
            .iter_mut()
            .zip(scratch.value.outputs.chunks_exact(agents))
        {
            self.appraise(&mut stage.trajectory, last);
        }
    }

    /// Runs both networks on what is to be seen now.
    fn look<E: Environment>(&self, scratch: &mut Scratch, stages: &[Stage<E>]) {
        let width = self.interface.agents * self.interface.observation;
        scratch
            .policy
            .reserve(self.policy, stages.len() * self.interface.agents);
        for (stage, out) in stages
            .iter()
            .zip(scratch.policy.inputs.chunks_exact_mut(width))
        {
            stage.actor.observe(out);
        }
        scratch.policy.run(self.policy, self.compute);
        self.expect(&mut scratch.value, stages);
    }

    /// What the critic expects from here on, for each agent.
    fn expect<E: Environment>(&self, value: &mut Runner, stages: &[Stage<E>]) {
        let agents = self.interface.agents;
        value.reserve(self.value, stages.len() * agents);
        let width = agents * self.value.shape().inputs;
        for (stage, out) in stages.iter().zip(value.inputs.chunks_exact_mut(width)) {
            match self.config.critic {
                Critic::Own => stage.actor.observe(out),
                Critic::Central => stage.actor.state(out),
            }
        }
        value.run(self.value, self.compute);
    }

    /// Works out advantages and targets; `last` is what is expected after the last step.
    fn appraise(&self, way: &mut Trajectory, last: &[f32]) {
        let agents = self.interface.agents;
        for (step, over) in way.over.iter().enumerate() {
            if !over {
                let next = way.values.get((step + 1) * agents..(step + 2) * agents);
                way.next_values[step * agents..][..agents].copy_from_slice(next.unwrap_or(last));
            }
        }
        for agent in 0..agents {
            let steps = Steps {
                rewards: &way.rewards[agent..],
                values: &way.values[agent..],
                next_values: &way.next_values[agent..],
                over: &way.over,
                stride: agents,
            };
            let (gamma, lambda) = (self.config.gamma, self.config.lambda);
            steps.advantages(gamma, lambda, &mut way.advantages[agent..]);
        }
        for (target, (advantage, value)) in way
            .targets
            .iter_mut()
            .zip(way.advantages.iter().zip(&way.values))
        {
            *target = advantage + value;
        }
    }
}
