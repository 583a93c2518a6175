//! A choice among actions, by unnormalised logarithms of their probabilities (logits).

use crate::math::exp;

/// Turns logits into logarithms of probabilities, and writes the probabilities.
#[inline(always)]
pub(crate) fn normalise(logits: &mut [f32], probabilities: &mut [f32]) {
    let mut most = f32::NEG_INFINITY;
    for logit in logits.iter() {
        most = if *logit > most { *logit } else { most };
    }
    for (logit, probability) in logits.iter_mut().zip(probabilities.iter_mut()) {
        *logit -= most;
        *probability = exp(*logit);
    }
    let mut sum = 0.0;
    for probability in probabilities.iter() {
        sum += probability;
    }
    let (logarithm, inverse) = (libm::logf(sum), 1.0 / sum);
    for (logit, probability) in logits.iter_mut().zip(probabilities.iter_mut()) {
        *logit -= logarithm;
        *probability *= inverse;
    }
}

/// The action at which the sum of probabilities passes `uniform`, a number from 0 to 1.
pub(crate) fn sample(probabilities: &[f32], uniform: f32) -> usize {
    let mut sum = 0.0;
    let passed = probabilities.iter().position(|probability| {
        sum += probability;
        uniform < sum
    });
    // Probabilities may sum up to a little less than one.
    passed.unwrap_or(probabilities.len() - 1)
}

/// The first of the largest.
pub(crate) fn best(values: &[f32]) -> usize {
    let mut best = 0;
    for (action, value) in values.iter().enumerate() {
        if *value > values[best] {
            best = action;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn probabilities_are_those_of_the_definition(
            logits in prop::collection::vec(-20.0_f32..20.0, 1..17),
            uniform in 0.0_f32..1.0,
        ) {
            let mut logarithms = logits.clone();
            let mut probabilities = vec![0.0; logits.len()];
            normalise(&mut logarithms, &mut probabilities);
            let powers: Vec<f64> = logits.iter().map(|l| libm::exp(f64::from(*l))).collect();
            let sum: f64 = powers.iter().sum();
            for ((power, probability), logarithm) in powers.iter().zip(&probabilities).zip(&logarithms) {
                prop_assert!((power / sum - f64::from(*probability)).abs() < 1e-6);
                prop_assert!((libm::log(power / sum) - f64::from(*logarithm)).abs() < 1e-5);
            }
            let action = sample(&probabilities, uniform);
            let before: f64 = powers[..action].iter().sum::<f64>() / sum;
            let after: f64 = powers[..=action].iter().sum::<f64>() / sum;
            prop_assert!(before - 1e-6 <= f64::from(uniform) && f64::from(uniform) <= after + 1e-6);
        }
    }

    #[test]
    fn the_best_is_the_first_of_equals() {
        assert_eq!(best(&[1.0, 3.0, 3.0]), 1);
        assert_eq!(best(&[f32::NAN, 3.0]), 0);
        assert_eq!(sample(&[0.5, 0.499_999], 0.999_999_94), 1);
    }
}
