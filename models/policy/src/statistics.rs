//! What several runs came to, and how sure that is (Agarwal and others, Deep Reinforcement Learning at the Edge of
//! the Statistical Precipice, 2021).

use crate::random::{self, Purpose};

/// The interquartile mean: of what is left when a quarter of the numbers, rounded down, is taken away at each end.
/// NaN for no numbers.
pub fn interquartile_mean(numbers: &[f64]) -> f64 {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    let cut = sorted.len() / 4;
    let middle = &sorted[cut..sorted.len() - cut];
    middle.iter().sum::<f64>() / middle.len() as f64
}

/// From where to where a number may lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
}

/// The percentile interval of `statistic` by the bootstrap (Efron 1979): runs are drawn anew from each stratum, as many
/// as it has and with replacement, and thrown together. `strata` are tasks, each with the results of its runs, and
/// `confidence` is 0.95 for an interval of 95 %. The draws follow from `seed`.
///
/// NaN at both ends where there are no resamples or a stratum has no runs.
pub fn bootstrap(
    strata: &[Vec<f64>],
    statistic: impl Fn(&[f64]) -> f64,
    resamples: u32,
    confidence: f64,
    seed: u64,
) -> Interval {
    if resamples == 0 || strata.iter().any(Vec::is_empty) {
        return Interval {
            low: f64::NAN,
            high: f64::NAN,
        };
    }
    let mut drawn = Vec::new();
    let mut found: Vec<f64> = (0..resamples)
        .map(|resample| {
            let mut rng = random::stream(seed, Purpose::Resample, (u64::from(resample), 0));
            drawn.clear();
            for runs in strata {
                let any = |_| runs[random::below(&mut rng, runs.len() as u32) as usize];
                drawn.extend((0..runs.len()).map(any));
            }
            statistic(&drawn)
        })
        .collect();
    found.sort_by(f64::total_cmp);
    let outside = (1.0 - confidence.clamp(0.0, 1.0)) / 2.0;
    Interval {
        low: percentile(&found, outside),
        high: percentile(&found, 1.0 - outside),
    }
}

/// The number below which `part` of the sorted numbers lie, between two of them in a straight line.
fn percentile(sorted: &[f64], part: f64) -> f64 {
    let place = part * (sorted.len() - 1) as f64;
    let below = sorted[libm::floor(place) as usize];
    let above = sorted[libm::ceil(place) as usize];
    below + (above - below) * (place - libm::floor(place))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_interquartile_mean_leaves_both_ends_out() {
        assert_eq!(interquartile_mean(&[9.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(interquartile_mean(&[4.0]), 4.0);
        // scipy.stats.trim_mean([3, 1, 4, 1, 5, 9, 2, 6, 5, 3, 5], 0.25)
        let pi = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0, 5.0, 3.0, 5.0];
        assert_eq!(interquartile_mean(&pi), 27.0 / 7.0);
        assert!(interquartile_mean(&[]).is_nan());
    }

    #[test]
    fn percentiles_lie_between_numbers() {
        assert_eq!(percentile(&[1.0, 2.0, 4.0], 0.5), 2.0);
        assert_eq!(percentile(&[1.0, 2.0, 4.0], 0.75), 3.0);
        assert_eq!(percentile(&[1.0, 2.0, 4.0], 1.0), 4.0);
    }

    /// The mean of 0 and 1 drawn evenly: its interval is that of the binomial distribution.
    #[test]
    fn an_interval_is_as_wide_as_theory_says() {
        let runs: Vec<f64> = (0..400).map(|n| f64::from(n % 2)).collect();
        let mean = |numbers: &[f64]| numbers.iter().sum::<f64>() / numbers.len() as f64;
        let interval = bootstrap(&[runs], mean, 4_000, 0.95, 1);
        let half = 1.96 * (0.25_f64 / 400.0).sqrt();
        assert!((interval.low - (0.5 - half)).abs() < 0.005, "{interval:?}");
        assert!((interval.high - (0.5 + half)).abs() < 0.005, "{interval:?}");
    }

    /// A stratum keeps its share in every resample, so between two constant ones nothing is left to chance.
    #[test]
    fn strata_are_drawn_from_one_by_one() {
        let mean = |numbers: &[f64]| numbers.iter().sum::<f64>() / numbers.len() as f64;
        let interval = bootstrap(&[vec![1.0; 30], vec![3.0; 10]], mean, 100, 0.95, 1);
        assert_eq!((interval.low, interval.high), (1.5, 1.5));
        assert!(bootstrap(&[vec![]], mean, 100, 0.95, 1).low.is_nan());
    }

    proptest! {
        #[test]
        fn an_interval_lies_within_the_numbers(
            strata in prop::collection::vec(prop::collection::vec(-9.0_f64..9.0, 1..8), 1..4),
            seed: u64,
        ) {
            let interval = bootstrap(&strata, interquartile_mean, 50, 0.9, seed);
            let all: Vec<f64> = strata.concat();
            let (low, high) = all.iter().fold((f64::MAX, f64::MIN), |(l, h), n| (l.min(*n), h.max(*n)));
            prop_assert!(low - 1e-9 <= interval.low && interval.low <= interval.high);
            prop_assert!(interval.high <= high + 1e-9);
            prop_assert_eq!(interval, bootstrap(&strata, interquartile_mean, 50, 0.9, seed));
        }
    }
}
