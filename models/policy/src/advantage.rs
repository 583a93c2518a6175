//! Generalised advantage estimation (Schulman and others 2016).

/// One agent's way through a rollout, step by step. Neighbouring steps lie `stride` apart, since agents of an
/// environment lie beside each other.
pub(crate) struct Steps<'a> {
    pub(crate) rewards: &'a [f32],
    /// What the critic expected before each step.
    pub(crate) values: &'a [f32],
    /// What it expected after it: nothing after an end, and after a truncation what would have come.
    pub(crate) next_values: &'a [f32],
    /// Whether an episode was over after a step; one for all agents.
    pub(crate) over: &'a [bool],
    pub(crate) stride: usize,
}

impl Steps<'_> {
    /// Writes the advantage of each step: `Σ (γλ)^l · δ` over the steps from it on to the end of its episode or
    /// of the rollout, with `δ = reward + γ · next value − value`.
    pub(crate) fn advantages(&self, gamma: f32, lambda: f32, out: &mut [f32]) {
        let mut later = 0.0;
        for (step, over) in self.over.iter().enumerate().rev() {
            let at = step * self.stride;
            let error = self.rewards[at] + gamma * self.next_values[at] - self.values[at];
            later = error + if *over { 0.0 } else { gamma * lambda * later };
            out[at] = later;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn advantages_are_those_of_the_formula(
            steps in prop::collection::vec((-2.0_f32..2.0, -2.0_f32..2.0, -2.0_f32..2.0, 0..5), 1..40),
            gamma in 0.5_f32..1.0,
            lambda in 0.0_f32..1.0,
            stride in 1_usize..3,
        ) {
            let spread = |pick: fn(&(f32, f32, f32, i32)) -> f32| -> Vec<f32> {
                steps.iter().flat_map(|step| vec![pick(step); stride]).collect()
            };
            let (rewards, values, next_values) = (spread(|s| s.0), spread(|s| s.1), spread(|s| s.2));
            let over: Vec<bool> = steps.iter().map(|s| s.3 == 0).collect();
            let mut out = vec![0.0; rewards.len()];
            let way = Steps {
                rewards: &rewards, values: &values, next_values: &next_values, over: &over, stride,
            };
            way.advantages(gamma, lambda, &mut out);
            for t in 0..steps.len() {
                let mut expected = 0.0;
                for l in t..steps.len() {
                    let (reward, value, next, _) = steps[l];
                    let error = f64::from(reward) + f64::from(gamma) * f64::from(next) - f64::from(value);
                    expected += (f64::from(gamma) * f64::from(lambda)).powi((l - t) as i32) * error;
                    if over[l] {
                        break;
                    }
                }
                prop_assert!((f64::from(out[t * stride]) - expected).abs() < 1e-4);
            }
        }
    }
}
