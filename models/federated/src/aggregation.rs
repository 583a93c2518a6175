//! From the updates of many nodes to one.
//!
//! | rule | |
//! |---|---|
//! | [`Mean`](Aggregation::Mean) | the mean, uniform over nodes (`McMahan` and others 2017, where all nodes have as many samples) |
//! | [`Success`](Aggregation::Success) | weighted by the share of episodes that reached their goal |
//! | [`Median`](Aggregation::Median) | the median of each weight (Yin and others 2018) |
//! | [`TrimmedMean`](Aggregation::TrimmedMean) | the mean of each weight without the largest and smallest (Yin and others 2018) |
//! | [`MultiKrum`](Aggregation::MultiKrum) | the mean of those that lie closest to others (Blanchard and others 2017) |
//! | [`NormClip`](Aggregation::NormClip) | the mean of updates that are shortened to the median length (Sun and others 2019) |
//!
//! The first two believe everybody. The others bear nodes that are broken or hostile, as many as each says. Sums are taken in `f64`
//! and in the order of the updates, so that the result has the same bytes everywhere.

use std::fmt;
use std::str::FromStr;

/// Least weight of a node by success, as a part of what a node has that always succeeds: who has not learned anything yet is heard
/// nevertheless.
const LEAST_SUCCESS: f64 = 0.25;

/// How updates become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Aggregation {
    /// The mean.
    #[default]
    Mean,
    /// The mean, weighted by success: a quarter for none, and one for all episodes.
    Success,
    /// The median of each weight. Bears fewer than half.
    Median,
    /// The mean of each weight without a quarter of the nodes, rounded down, at each end. Bears as many.
    TrimmedMean,
    /// The mean of all updates but those, a quarter of the nodes rounded down, that are farthest from others. Bears as many.
    MultiKrum,
    /// The mean of updates that are no longer than the median of all. Who is wrong gets no louder than others.
    NormClip,
}

impl Aggregation {
    /// Every one, with its name.
    pub const ALL: [(Self, &'static str); 6] = [
        (Self::Mean, "mean"),
        (Self::Success, "success"),
        (Self::Median, "median"),
        (Self::TrimmedMean, "trimmed-mean"),
        (Self::MultiKrum, "multi-krum"),
        (Self::NormClip, "norm-clip"),
    ];

    /// Its name.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        let found = Self::ALL.into_iter().find(|(rule, _)| *rule == self);
        found.map_or("", |(_, name)| name)
    }
}

impl fmt::Display for Aggregation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// A text names no rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AggregationError;

impl fmt::Display for AggregationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = Aggregation::ALL.map(|(_, name)| name).join(", ");
        write!(f, "one of {names}")
    }
}

impl std::error::Error for AggregationError {}

impl FromStr for Aggregation {
    type Err = AggregationError;

    fn from_str(text: &str) -> Result<Self, AggregationError> {
        let found = Self::ALL.into_iter().find(|(_, name)| *name == text);
        found.map(|(rule, _)| rule).ok_or(AggregationError)
    }
}

/// What a node has to say.
#[derive(Debug, Clone, PartialEq)]
pub struct Contribution {
    /// New weights less old ones; finite, and as many as those of every other node.
    pub change: Vec<f32>,
    /// Share of its episodes that reached their goal, 0 to 1.
    pub success: f32,
}

/// How many of so many nodes [`Aggregation::TrimmedMean`] and [`Aggregation::MultiKrum`] bear.
#[must_use]
pub const fn borne(nodes: usize) -> usize {
    nodes / 4
}

impl Aggregation {
    /// The one update; empty for no contributions.
    #[must_use]
    pub fn combine(self, all: &[Contribution]) -> Vec<f32> {
        match self {
            Self::Mean => mean(all, |_| 1.0),
            Self::Success => mean(all, |one| {
                LEAST_SUCCESS + (1.0 - LEAST_SUCCESS) * f64::from(one.success)
            }),
            Self::Median => each(all, |numbers| {
                let half = numbers.len() / 2;
                if numbers.len().is_multiple_of(2) {
                    f64::midpoint(f64::from(numbers[half - 1]), f64::from(numbers[half]))
                } else {
                    f64::from(numbers[half])
                }
            }),
            Self::TrimmedMean => each(all, |numbers| {
                let cut = borne(numbers.len());
                let kept = &numbers[cut..numbers.len() - cut];
                kept.iter().map(|number| f64::from(*number)).sum::<f64>() / kept.len() as f64
            }),
            Self::MultiKrum => {
                let kept: Vec<Contribution> = closest(all)
                    .into_iter()
                    .map(|index| all[index].clone())
                    .collect();
                mean(&kept, |_| 1.0)
            }
            Self::NormClip => {
                let lengths: Vec<f64> = all.iter().map(|one| length(&one.change)).collect();
                let most = lower_median(&lengths);
                let shares = lengths
                    .iter()
                    .map(|own| if *own > most { most / own } else { 1.0 });
                let shares: Vec<f64> = shares.collect();
                weighted(all, &shares, all.len() as f64)
            }
        }
    }
}

fn length(change: &[f32]) -> f64 {
    let squares = change
        .iter()
        .map(|number| f64::from(*number) * f64::from(*number));
    squares.sum::<f64>().sqrt()
}

/// The lower one of two in the middle: half of the nodes at least are no longer.
fn lower_median(numbers: &[f64]) -> f64 {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len().saturating_sub(1) / 2;
    sorted.get(middle).copied().unwrap_or(0.0)
}

/// The sum of all changes, each with its share, by `total`.
fn weighted(all: &[Contribution], shares: &[f64], total: f64) -> Vec<f32> {
    let Some(first) = all.first() else {
        return Vec::new();
    };
    let mut sums = vec![0.0_f64; first.change.len()];
    for (one, share) in all.iter().zip(shares) {
        for (sum, number) in sums.iter_mut().zip(&one.change) {
            *sum += f64::from(*number) * share;
        }
    }
    sums.into_iter().map(|sum| (sum / total) as f32).collect()
}

fn mean(all: &[Contribution], share: impl Fn(&Contribution) -> f64) -> Vec<f32> {
    let shares: Vec<f64> = all.iter().map(share).collect();
    weighted(all, &shares, shares.iter().sum())
}

/// One number for each weight, from those of all nodes in ascending order.
fn each(all: &[Contribution], one: impl Fn(&[f32]) -> f64) -> Vec<f32> {
    let Some(first) = all.first() else {
        return Vec::new();
    };
    let mut numbers = vec![0.0; all.len()];
    let places = 0..first.change.len();
    let combined = places.map(|place| {
        for (number, contribution) in numbers.iter_mut().zip(all) {
            *number = contribution.change[place];
        }
        numbers.sort_by(f32::total_cmp);
        one(&numbers) as f32
    });
    combined.collect()
}

/// All but [`borne`], those that lie closest to others, in their order: by the sum of squared distances to the nearest, as many as
/// there would be without those borne and one more.
fn closest(all: &[Contribution]) -> Vec<usize> {
    let faulty = borne(all.len());
    let near = all.len().saturating_sub(faulty + 2).max(1);
    let distance = |a: &Contribution, b: &Contribution| -> f64 {
        let both = a.change.iter().zip(&b.change);
        both.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
            .sum()
    };
    let mut scores: Vec<(f64, usize)> = all
        .iter()
        .enumerate()
        .map(|(index, own)| {
            let others = all.iter().enumerate().filter(|(other, _)| *other != index);
            let mut distances: Vec<f64> = others.map(|(_, other)| distance(own, other)).collect();
            distances.sort_by(f64::total_cmp);
            (distances.iter().take(near).sum(), index)
        })
        .collect();
    scores.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut kept: Vec<usize> = scores[..all.len() - faulty]
        .iter()
        .map(|(_, index)| *index)
        .collect();
    kept.sort_unstable();
    kept
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn contribution(change: &[f32], success: f32) -> Contribution {
        Contribution {
            change: change.to_vec(),
            success,
        }
    }

    fn of(changes: &[&[f32]]) -> Vec<Contribution> {
        changes
            .iter()
            .map(|change| contribution(change, 0.5))
            .collect()
    }

    #[test]
    fn by_hand() {
        let all = of(&[&[1.0, 0.0], &[2.0, 0.0], &[3.0, 0.0], &[100.0, 8.0]]);
        assert_eq!(Aggregation::Mean.combine(&all), [26.5, 2.0]);
        assert_eq!(Aggregation::Median.combine(&all), [2.5, 0.0]);
        assert_eq!(Aggregation::TrimmedMean.combine(&all), [2.5, 0.0]);
        assert_eq!(Aggregation::MultiKrum.combine(&all), [2.0, 0.0]);
        // Lengths 1, 2, 3 and some 100 are shortened to 2.
        let clipped = Aggregation::NormClip.combine(&all);
        assert!(
            (clipped[0] - (1.0 + 2.0 + 2.0 + 1.9936) / 4.0).abs() < 1e-4,
            "{clipped:?}"
        );
        let unlike = [contribution(&[1.0], 1.0), contribution(&[0.0], 0.0)];
        assert_eq!(Aggregation::Success.combine(&unlike), [0.8]);
        assert_eq!(Aggregation::Mean.combine(&unlike), [0.5]);
    }

    #[test]
    fn names_are_read_as_they_are_written() {
        for (rule, name) in Aggregation::ALL {
            assert_eq!(name.parse(), Ok(rule));
            assert_eq!(rule.to_string(), name);
        }
        assert_eq!("krum".parse::<Aggregation>(), Err(AggregationError));
        assert_eq!(
            AggregationError.to_string(),
            "one of mean, success, median, trimmed-mean, multi-krum, norm-clip"
        );
    }

    /// Some nodes that agree up to a little, and how many of them are hostile.
    fn any_nodes() -> impl Strategy<Value = (Vec<Vec<f32>>, usize)> {
        (4_usize..13, 1_usize..6).prop_flat_map(|(nodes, weights)| {
            let change = prop::collection::vec(-0.1_f32..0.1, weights);
            (prop::collection::vec(change, nodes), 0..=borne(nodes))
        })
    }

    proptest! {
        #[test]
        fn what_all_agree_on_stays(change in prop::collection::vec(-1.0_f32..1.0, 1..20), nodes in 1_usize..12) {
            let all = vec![contribution(&change, 0.3); nodes];
            for (rule, name) in Aggregation::ALL {
                for (own, wanted) in rule.combine(&all).iter().zip(&change) {
                    prop_assert!((own - wanted).abs() < 1e-6, "{}: {} {}", name, own, wanted);
                }
            }
        }

        /// However far hostile nodes go, each of the robust rules stays where the others are.
        #[test]
        fn the_robust_ones_bear_what_they_say(
            (nodes, hostile) in any_nodes(), how in prop::collection::vec(-1e6_f32..1e6, 3),
        ) {
            let all: Vec<Contribution> = nodes.iter().enumerate().map(|(index, change)| {
                // All the same, so that they lie close to each other as well; far away.
                let far = |(place, number): (usize, &f32)| {
                    let far = how[place % how.len()];
                    if index < hostile { far + 10.0_f32.copysign(far) } else { 1.0 + number }
                };
                let change: Vec<f32> = change.iter().enumerate().map(far).collect();
                contribution(&change, 1.0)
            }).collect();
            for rule in [Aggregation::Median, Aggregation::TrimmedMean] {
                for number in rule.combine(&all) {
                    prop_assert!((0.9..=1.1).contains(&number), "{}: {}", rule, number);
                }
            }
            // Krum needs two more than twice those that it bears.
            if nodes.len() >= 2 * hostile + 3 {
                for number in Aggregation::MultiKrum.combine(&all) {
                    prop_assert!((0.9..=1.1).contains(&number), "multi-krum: {}", number);
                }
            }
            let longest = all[hostile..].iter().map(|one| length(&one.change)).fold(0.0, f64::max);
            prop_assert!(length(&Aggregation::NormClip.combine(&all)) <= longest * 1.001);
        }

        #[test]
        fn finite_stays_finite_and_none_is_none(
            changes in prop::collection::vec(prop::collection::vec(-1e30_f32..1e30, 3), 0..9),
        ) {
            let all: Vec<Contribution> = changes.iter().map(|change| contribution(change, 0.0)).collect();
            for (rule, name) in Aggregation::ALL {
                let combined = rule.combine(&all);
                prop_assert_eq!(combined.len(), if all.is_empty() { 0 } else { 3 });
                prop_assert!(combined.iter().all(|number| number.is_finite()), "{}", name);
            }
        }
    }
}
