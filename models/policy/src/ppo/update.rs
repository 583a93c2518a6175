//! Gradients of the clipped objective, piece by piece (Schulman and others 2017).

use super::config::{Config, Critic};
use super::rollout::Trajectory;
use crate::batch::{PIECE, ROWS};
use crate::categorical;
use crate::compute::Compute;
use crate::environment::Interface;
use crate::network::{Network, Workspace};

/// What a loss came to, summed over samples.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Sums {
    pub(super) samples: u64,
    /// Those whose action the policy chose: all but the critic is about them.
    pub(super) chosen: u64,
    pub(super) policy: f64,
    pub(super) value: f64,
    pub(super) entropy: f64,
    pub(super) divergence: f64,
    pub(super) clipped: u64,
}

impl Sums {
    pub(super) fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.chosen += other.chosen;
        self.policy += other.policy;
        self.value += other.value;
        self.entropy += other.entropy;
        self.divergence += other.divergence;
        self.clipped += other.clipped;
    }
}

/// A few samples of a minibatch, and the gradients that they come to.
#[derive(Debug)]
pub(super) struct Piece {
    pub(super) samples: Vec<u32>,
    /// By the parameters of the policy, and of the critic.
    pub(super) gradients: [Vec<f32>; 2],
    pub(super) sums: Sums,
}

impl Piece {
    pub(super) fn new(policy: &Network, value: &Network) -> Self {
        Self {
            samples: Vec::with_capacity(PIECE),
            gradients: [policy, value].map(|network| vec![0.0; network.parameters().len()]),
            sums: Sums::default(),
        }
    }
}

/// What a thread needs.
#[derive(Debug)]
pub(super) struct Scratch {
    observations: Vec<f32>,
    states: Vec<f32>,
    policy: Workspace,
    value: Workspace,
    probabilities: Vec<f32>,
}

impl Scratch {
    pub(super) fn new(policy: &Network, value: &Network) -> Self {
        Self {
            observations: vec![0.0; ROWS * policy.shape().inputs],
            states: vec![0.0; ROWS * value.shape().inputs],
            policy: Workspace::new(policy, ROWS),
            value: Workspace::new(value, ROWS),
            probabilities: vec![0.0; policy.shape().outputs],
        }
    }
}

/// What a policy is judged by at one sample.
#[derive(Debug, Clone, Copy)]
struct Judged {
    action: usize,
    /// Logarithm of the probability that the action had when it was taken.
    logarithm: f32,
    advantage: f32,
}

/// What gradients are taken of.
pub(super) struct Objective<'a> {
    pub(super) config: &'a Config,
    pub(super) interface: Interface,
    pub(super) compute: &'a Compute,
    pub(super) policy: &'a Network,
    pub(super) value: &'a Network,
    pub(super) ways: &'a [&'a Trajectory],
    /// Mean of the advantages of the round, and the inverse of their deviation.
    pub(super) advantages: (f32, f32),
    /// Samples in the minibatch.
    pub(super) minibatch: usize,
}

impl Objective<'_> {
    /// Computes gradients and sums of a piece.
    pub(super) fn differentiate(&self, scratch: &mut Scratch, piece: &mut Piece) {
        piece.sums = Sums::default();
        for gradient in &mut piece.gradients {
            gradient.fill(0.0);
        }
        let Piece {
            samples,
            gradients: [policy, value],
            sums,
        } = piece;
        for samples in samples.chunks(ROWS) {
            self.gather(scratch, samples);
            self.policy_rows(scratch, samples, policy, sums);
            self.value_rows(scratch, samples, value, sums);
        }
    }

    /// Where a sample lies.
    fn find(&self, sample: u32) -> (&Trajectory, usize) {
        let each = self.config.steps * self.interface.agents;
        let sample = sample as usize;
        (self.ways[sample / each], sample % each)
    }

    fn gather(&self, scratch: &mut Scratch, samples: &[u32]) {
        let width = self.interface.observation;
        let rows = scratch.observations.chunks_exact_mut(width);
        for (sample, row) in samples.iter().zip(rows) {
            let (way, at) = self.find(*sample);
            row.copy_from_slice(&way.observations[at * width..][..width]);
        }
        if self.config.critic == Critic::Central {
            let width = self.interface.state;
            let rows = scratch.states.chunks_exact_mut(width);
            for (sample, row) in samples.iter().zip(rows) {
                let (way, at) = self.find(*sample);
                row.copy_from_slice(&way.states[at * width..][..width]);
            }
        }
    }

    fn policy_rows(
        &self,
        scratch: &mut Scratch,
        samples: &[u32],
        gradient: &mut [f32],
        sums: &mut Sums,
    ) {
        let (compute, rows) = (self.compute, samples.len());
        let inputs = &scratch.observations;
        self.policy
            .forward(compute, rows, inputs, &mut scratch.policy);
        let (stride, actions) = (self.policy.output_stride(), self.interface.actions);
        let (logits, slopes) = scratch.policy.outputs();
        let probabilities = &mut scratch.probabilities;
        let rows_of = logits
            .chunks_exact_mut(stride)
            .zip(slopes.chunks_exact_mut(stride));
        compute.run(
            #[inline(always)]
            || {
                for (sample, (logits, slopes)) in samples.iter().zip(rows_of) {
                    let (way, at) = self.find(*sample);
                    if !way.chosen[at] {
                        slopes.fill(0.0);
                        continue;
                    }
                    let (mean, inverse) = self.advantages;
                    let judged = Judged {
                        action: usize::from(way.actions[at]),
                        logarithm: way.logarithms[at],
                        advantage: (way.advantages[at] - mean) * inverse,
                    };
                    slopes[actions..].fill(0.0);
                    let (logits, slopes) = (&mut logits[..actions], &mut slopes[..actions]);
                    self.policy_row(judged, logits, probabilities, slopes, sums);
                }
            },
        );
        self.policy
            .backward(compute, rows, inputs, &mut scratch.policy, gradient);
    }

    /// The slope of the loss by each logit. The logits are normalised on the way.
    #[inline(always)]
    fn policy_row(
        &self,
        judged: Judged,
        logits: &mut [f32],
        probabilities: &mut [f32],
        slopes: &mut [f32],
        sums: &mut Sums,
    ) {
        categorical::normalise(logits, probabilities);
        let change = logits[judged.action] - judged.logarithm;
        let ratio = crate::math::exp(change);
        let (low, high) = (1.0 - self.config.clip, 1.0 + self.config.clip);
        let held = if ratio < low { low } else { ratio };
        let held = if held > high { high } else { held };
        let (free, bounded) = (ratio * judged.advantage, held * judged.advantage);
        let clipped = bounded < free;
        let mut entropy = 0.0;
        for (probability, logarithm) in probabilities.iter().zip(logits.iter()) {
            entropy -= probability * logarithm;
        }
        let pull = if clipped { 0.0 } else { free };
        let share = 1.0 / self.minibatch as f32;
        let each = slopes
            .iter_mut()
            .zip(probabilities.iter().zip(logits.iter()));
        for (slope, (probability, logarithm)) in each {
            let spread = self.config.entropy * (logarithm + entropy);
            *slope = probability * (pull + spread) * share;
        }
        slopes[judged.action] -= pull * share;
        sums.chosen += 1;
        sums.policy -= f64::from(if clipped { bounded } else { free });
        sums.entropy += f64::from(entropy);
        sums.divergence += f64::from(ratio) - 1.0 - f64::from(change);
        sums.clipped += u64::from(clipped);
    }

    fn value_rows(
        &self,
        scratch: &mut Scratch,
        samples: &[u32],
        gradient: &mut [f32],
        sums: &mut Sums,
    ) {
        let (compute, rows) = (self.compute, samples.len());
        let inputs = match self.config.critic {
            Critic::Own => &scratch.observations,
            Critic::Central => &scratch.states,
        };
        self.value
            .forward(compute, rows, inputs, &mut scratch.value);
        let stride = self.value.output_stride();
        let share = 1.0 / self.minibatch as f32;
        let (values, slopes) = scratch.value.outputs();
        let both = values
            .chunks_exact(stride)
            .zip(slopes.chunks_exact_mut(stride));
        for (sample, (values, slopes)) in samples.iter().zip(both) {
            let (way, at) = self.find(*sample);
            let error = values[0] - way.targets[at];
            slopes.fill(0.0);
            slopes[0] = error * share;
            sums.samples += 1;
            sums.value += 0.5 * f64::from(error) * f64::from(error);
        }
        self.value
            .backward(compute, rows, inputs, &mut scratch.value, gradient);
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use proptest::prelude::*;

    use super::*;
    use crate::config::Hidden;

    /// The loss of one sample as the paper has it, in `f64`.
    fn loss(config: &Config, judged: Judged, logits: &[f64]) -> f64 {
        let sum: f64 = logits.iter().map(|l| libm::exp(*l)).sum();
        let logarithms: Vec<f64> = logits.iter().map(|l| l - libm::log(sum)).collect();
        let ratio = libm::exp(logarithms[judged.action] - f64::from(judged.logarithm));
        let clip = f64::from(config.clip);
        let advantage = f64::from(judged.advantage);
        let objective = (ratio * advantage).min(ratio.clamp(1.0 - clip, 1.0 + clip) * advantage);
        let entropy: f64 = logarithms.iter().map(|l| -l * libm::exp(*l)).sum();
        -objective - f64::from(config.entropy) * entropy
    }

    proptest! {
        #[test]
        fn slopes_are_what_finite_differences_say(
            logits in prop::collection::vec(-3.0_f32..3.0, 2..10),
            action in 0_usize..10,
            logarithm in -3.0_f32..0.0,
            advantage in -3.0_f32..3.0,
            entropy in 0.0_f32..0.5,
        ) {
            let config = Config { entropy, ..Config::default() };
            let actions = logits.len();
            let interface = Interface { agents: 1, observation: 1, state: 0, actions };
            let policy = Network::zero(Hidden::default().shape(1, actions));
            let value = Network::zero(Hidden::default().shape(1, 1));
            let compute = Compute::new(NonZeroUsize::MIN);
            let objective = Objective {
                config: &config, interface, compute: &compute, policy: &policy, value: &value,
                ways: &[], advantages: (0.0, 1.0), minibatch: 4,
            };
            let judged = Judged { action: action % actions, logarithm, advantage };
            let (mut normal, mut probabilities) = (logits.clone(), vec![0.0; actions]);
            let mut slopes = vec![0.0; actions];
            let mut sums = Sums::default();
            objective.policy_row(judged, &mut normal, &mut probabilities, &mut slopes, &mut sums);
            let exact: Vec<f64> = logits.iter().map(|l| f64::from(*l)).collect();
            let own = sums.policy - f64::from(entropy) * sums.entropy;
            prop_assert!((own - loss(&config, judged, &exact)).abs() < 1e-4 * (1.0 + own.abs()));
            for (place, slope) in slopes.iter().enumerate() {
                let at = |step: f64| {
                    let mut moved = exact.clone();
                    moved[place] += step;
                    loss(&config, judged, &moved)
                };
                // At the bend of the objective there is no derivative.
                prop_assume!((at(1e-5) + at(-1e-5) - 2.0 * at(0.0)).abs() < 1e-7);
                let expected = (at(1e-5) - at(-1e-5)) / 2e-5 / 4.0;
                prop_assert!((f64::from(*slope) - expected).abs() < 1e-4 * (1.0 + expected.abs()));
            }
        }
    }
}
