//! A run that learns together with others: from weights that all of them have, to weights that are its own.

use std::error::Error;
use std::fmt;

use super::Ppo;
use crate::environment::Environment;
use crate::learner::Learner;

/// Weights are none that this run could have come to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WeightsError {
    /// There are so many, of so many.
    Count {
        /// How many there are.
        found: usize,
        /// How many the two networks have.
        wanted: usize,
    },
    /// One is no number, or infinite.
    NotFinite,
}

impl fmt::Display for WeightsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count { found, wanted } => {
                write!(f, "{found} weights where the networks have {wanted}")
            }
            Self::NotFinite => f.write_str("a weight is not finite"),
        }
    }
}

impl Error for WeightsError {}

impl<E: Environment> Ppo<E> {
    /// Weights and biases of policy and critic, one after the other: layer by layer, input by input, then the biases.
    pub fn weights(&self) -> Vec<f32> {
        let mut weights =
            Vec::with_capacity(self.policy.network.size() + self.value.network.size());
        self.policy.network.pack(&mut weights);
        self.value.network.pack(&mut weights);
        weights
    }

    /// Goes on from `weights`, in the form of [`weights`](Self::weights), as if `rounds` rounds were over. What the optimiser keeps stays, and
    /// so do the running episodes. From here on [`Config::proximal`](super::Config::proximal) pulls back to them; a checkpoint does
    /// not know of that, so whoever resumes adopts anew.
    ///
    /// # Errors
    /// When the weights are not those of such networks: nothing has changed then.
    pub fn adopt(&mut self, weights: &[f32], rounds: u64) -> Result<(), WeightsError> {
        let (policy, value) = (self.policy.network.size(), self.value.network.size());
        if weights.len() != policy + value {
            return Err(WeightsError::Count {
                found: weights.len(),
                wanted: policy + value,
            });
        }
        if !weights.iter().all(|weight| weight.is_finite()) {
            return Err(WeightsError::NotFinite);
        }
        let (of_policy, of_value) = weights.split_at(policy);
        self.policy.network.unpack(of_policy);
        self.value.network.unpack(of_value);
        self.round = rounds;
        if self.config.proximal > 0.0 {
            let learners = [&self.policy, &self.value];
            self.anchors = learners.map(|learner| learner.network.parameters().to_vec());
        }
        Ok(())
    }
}

/// Adds the slope of `proximal`/2 times the squared distance to `anchor`.
pub(super) fn pull_back(gradient: &mut [f32], proximal: f32, learner: &Learner, anchor: &[f32]) {
    let moved = learner.network.parameters().iter().zip(anchor);
    for (slope, (weight, anchor)) in gradient.iter_mut().zip(moved) {
        *slope += proximal * (weight - anchor);
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use super::*;
    use crate::compute::Compute;
    use crate::environment::{Interface, Seed, Status};
    use crate::ppo::Config;

    /// Whoever chooses the number that it sees is paid.
    #[derive(Debug, Default)]
    struct Echo(u64, u32);

    impl Environment for Echo {
        fn interface(&self) -> Interface {
            Interface {
                agents: 1,
                observation: 3,
                state: 0,
                actions: 3,
            }
        }

        fn reset(&mut self, seed: Seed) {
            *self = Self(seed.get(), 0);
        }

        fn observe(&self, _: usize, out: &mut [f32]) {
            out.fill(0.0);
            out[(self.0 % 3) as usize] = 1.0;
        }

        fn state(&self, _: usize, _: &mut [f32]) {}

        fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
            rewards[0] = f32::from(u8::from(u64::from(actions[0]) == self.0 % 3));
            *self = Self(crate::random::mix(self.0), self.1 + 1);
            if self.1 == 20 {
                Status::Terminated
            } else {
                Status::Running
            }
        }

        fn succeeded(&self) -> bool {
            false
        }
    }

    fn run(seed: u64, proximal: f32) -> Ppo<Echo> {
        let mut config = Config {
            seed,
            rounds: 10,
            steps: 64,
            minibatch: 32,
            proximal,
            ..Config::default()
        };
        config.hidden.units = vec![5, 7];
        let environments = (0..4).map(|_| Echo::default()).collect();
        Ppo::new(config, Compute::new(NonZeroUsize::MIN), environments).expect("sound")
    }

    fn distance(from: &[f32], to: &[f32]) -> f32 {
        let each = from.iter().zip(to).map(|(from, to)| (from - to).powi(2));
        each.sum::<f32>().sqrt()
    }

    #[test]
    fn weights_go_from_one_run_to_another() {
        let (mut one, mut other) = (run(1, 0.0), run(2, 0.0));
        one.round().expect("finite");
        let weights = one.weights();
        // 3-5-7-3 and 3-5-7-1, each with its biases.
        assert_eq!(weights.len(), 4 * 5 + 6 * 7 + 8 * 3 + 4 * 5 + 6 * 7 + 8);
        assert_ne!(other.weights(), weights);
        other.adopt(&weights, 6).expect("weights of such networks");
        assert_eq!(other.weights(), weights);
        assert_eq!(other.rounds(), 6);
        assert_eq!(other.policy().to_bytes(), one.policy().to_bytes());
        // Both learn on from there, each by what it meets.
        one.round().expect("finite");
        other.round().expect("finite");
        assert_ne!(other.weights(), one.weights());
        assert_ne!(other.weights(), weights);
    }

    #[test]
    fn other_weights_are_refused_and_change_nothing() {
        let mut own = run(1, 0.0);
        let before = own.weights();
        let wanted = before.len();
        let refused = own.adopt(&before[1..], 3);
        let found = wanted - 1;
        assert_eq!(refused, Err(WeightsError::Count { found, wanted }));
        for odd in [f32::NAN, f32::INFINITY] {
            let mut weights = vec![0.0; wanted];
            weights[wanted / 2] = odd;
            assert_eq!(own.adopt(&weights, 3), Err(WeightsError::NotFinite));
        }
        assert_eq!((own.weights(), own.rounds()), (before, 0));
    }

    #[test]
    fn who_is_pulled_back_stays_nearer() {
        let weights = run(3, 0.0).weights();
        let moved = [0.0, 0.1, 10.0].map(|proximal| {
            let mut own = run(1, proximal);
            own.adopt(&weights, 0).expect("weights of such networks");
            for _ in 0..3 {
                own.round().expect("finite");
            }
            distance(&weights, &own.weights())
        });
        assert!(
            moved[0] > moved[1] && moved[1] > 2.0 * moved[2],
            "{moved:?}"
        );
        assert!(moved[2] > 0.0);
    }
}
