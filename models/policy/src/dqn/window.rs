//! Several steps of an agent as one (Sutton 1988): rewards of a few, then an estimate.

use std::collections::VecDeque;

use super::memory::Transition;

/// The last steps of one agent in its running episode.
#[derive(Debug, Clone, Default)]
pub(super) struct Window {
    steps: VecDeque<Step>,
}

#[derive(Debug, Clone)]
struct Step {
    observation: Vec<f32>,
    action: u8,
    reward: f32,
}

impl Window {
    /// Adds a step that was taken.
    pub(super) fn push(&mut self, observation: &[f32], action: u8, reward: f32) {
        self.steps.push_back(Step {
            observation: observation.to_vec(),
            action,
            reward,
        });
    }

    /// Takes out what is `horizon` steps old, `next` being what is observed now.
    pub(super) fn shift(
        &mut self,
        horizon: usize,
        gamma: f32,
        next: &[f32],
        out: &mut impl FnMut(&Transition<'_>),
    ) {
        if self.steps.len() >= horizon {
            self.take(gamma, true, next, out);
        }
    }

    /// Takes out everything at the end of an episode: `goes_on` when it was only broken off, with `next` to be
    /// seen.
    pub(super) fn drain(
        &mut self,
        gamma: f32,
        goes_on: bool,
        next: &[f32],
        out: &mut impl FnMut(&Transition<'_>),
    ) {
        while !self.steps.is_empty() {
            self.take(gamma, goes_on, next, out);
        }
    }

    /// Takes out the oldest step, with the rewards of all after it.
    fn take(
        &mut self,
        gamma: f32,
        goes_on: bool,
        next: &[f32],
        out: &mut impl FnMut(&Transition<'_>),
    ) {
        let (mut reward, mut discount) = (0.0, 1.0);
        for step in &self.steps {
            reward += discount * step.reward;
            discount *= gamma;
        }
        if let Some(step) = self.steps.pop_front() {
            out(&Transition {
                observation: &step.observation,
                action: step.action,
                reward,
                discount: if goes_on { discount } else { 0.0 },
                next,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Step `t` observes the number `t`, and gets a reward; after the last one the episode is over, or broken
        /// off.
        #[test]
        fn returns_are_those_of_the_formula(
            rewards in prop::collection::vec(-2.0_f32..2.0, 1..20),
            horizon in 1_usize..6,
            gamma in 0.5_f32..1.0,
            goes_on: bool,
        ) {
            let mut window = Window::default();
            let mut found: Vec<(f32, f32, f32, f32)> = Vec::new();
            let mut keep = |t: &Transition<'_>| found.push((t.observation[0], t.reward, t.discount, t.next[0]));
            for (t, reward) in rewards.iter().enumerate() {
                window.push(&[t as f32], 0, *reward);
                let next = [(t + 1) as f32];
                if t + 1 < rewards.len() {
                    window.shift(horizon, gamma, &next, &mut keep);
                } else {
                    window.drain(gamma, goes_on, &next, &mut keep);
                }
            }
            prop_assert_eq!(found.len(), rewards.len());
            for (t, (observation, reward, discount, next)) in found.into_iter().enumerate() {
                // As many steps as the horizon, as long as there are so many.
                let end = rewards.len().min(t + horizon);
                let expected: f64 = (t..end)
                    .map(|k| f64::from(gamma).powi((k - t) as i32) * f64::from(rewards[k]))
                    .sum();
                let over = end == rewards.len() && !goes_on;
                let count = if over { 0.0 } else { f64::from(gamma).powi((end - t) as i32) };
                prop_assert_eq!((observation, next), (t as f32, end as f32));
                prop_assert!((f64::from(reward) - expected).abs() < 1e-5);
                prop_assert!((f64::from(discount) - count).abs() < 1e-6);
            }
        }
    }
}
