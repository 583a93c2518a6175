//! What the numbers that come out mean.

/// The best of some values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Best {
    /// Which one; the first of equals.
    pub index: usize,
    /// How much larger than the second best it is, in steps of the output. 0 to 255.
    pub margin: u8,
}

/// Index of the largest value, the first of equals; 0 when there is none.
pub fn argmax(values: &[i8]) -> usize {
    best(values).index
}

/// The largest value and its lead. A decision by lead needs no exponentials.
pub fn best(values: &[i8]) -> Best {
    let (mut index, mut first, mut second) = (0, i16::from(i8::MIN), i16::from(i8::MIN));
    for (at, &value) in values.iter().enumerate() {
        let value = i16::from(value);
        if at == 0 || value > first {
            second = if at == 0 { second } else { first };
            (index, first) = (at, value);
        } else if value > second {
            second = value;
        }
    }
    Best {
        index,
        margin: (first - second) as u8,
    }
}

/// Probabilities out of logits of `2^exponent` a step, into `probabilities`; as many as the shorter
/// of the two has. The same on every machine.
pub fn softmax(logits: &[i8], exponent: i8, probabilities: &mut [f32]) {
    let step = libm::ldexpf(1.0, i32::from(exponent));
    let most = logits.iter().copied().max().unwrap_or(0);
    let mut sum = 0.0;
    for (probability, &logit) in probabilities.iter_mut().zip(logits) {
        *probability = libm::expf(step * f32::from(i16::from(logit) - i16::from(most)));
        sum += *probability;
    }
    for (probability, _) in probabilities.iter_mut().zip(logits) {
        *probability /= sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_first_of_equals_leads_by_nothing() {
        assert_eq!(
            best(&[3, 9, 9]),
            Best {
                index: 1,
                margin: 0
            }
        );
        assert_eq!(
            best(&[-128, 127]),
            Best {
                index: 1,
                margin: 255
            }
        );
        assert_eq!(argmax(&[]), 0);
    }

    proptest! {
        #[test]
        fn the_lead_is_that_over_the_runner_up(values in proptest::collection::vec(any::<i8>(), 2..9)) {
            let best = best(&values);
            let mut sorted = values.clone();
            sorted.sort_unstable_by(|a, b| b.cmp(a));
            prop_assert_eq!(values[best.index], sorted[0]);
            prop_assert_eq!(i16::from(best.margin), i16::from(sorted[0]) - i16::from(sorted[1]));
        }

        #[test]
        fn probabilities_are_some(logits in proptest::collection::vec(any::<i8>(), 1..9), exponent in -7_i8..=0) {
            let mut probabilities = std::vec![0.0; logits.len()];
            softmax(&logits, exponent, &mut probabilities);
            let sum: f32 = probabilities.iter().sum();
            prop_assert!((sum - 1.0).abs() < 1e-5, "{}", sum);
            for (a, p) in logits.iter().zip(&probabilities) {
                for (b, q) in logits.iter().zip(&probabilities) {
                    prop_assert!(a <= b || p >= q);
                }
            }
        }
    }
}
