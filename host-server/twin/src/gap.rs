//! How far a body is from its robot: the reality gap, measured, beside what the tracker's noise alone would show.
//!
//! Samples come from a shadow while its robot drives ([`crate::shadow::Shadow::gap`]). Each has what was seen, what the
//! body of the twin said, what the nominal body said, and what a *perfect copy* of the robot would have shown: one that is where
//! the body said, seen by a tracker with the noise that fixes state, and begun where such fixes say. All
//! lengths are metres.
//!
//! - Errors: distance between the prediction and the fix, 1 s and 10 s ahead; median, nine in ten, and the share of
//!   the nominal body's median.
//! - Coverage: share of innovations, and of predictions, within the regions that should hold 50 % and 95 % of them.
//! - [Energy distance][energy_distance] (G. J. Székely, M. L. Rizzo: Energy statistics, J. Stat. Plan. Inference 143,
//!   2013) between the displacements over two seconds that were seen and those that the body said.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::predict::quantile;

/// Horizons of predictions and of the forecast, seconds.
pub const HORIZONS_S: [f64; 2] = [1.0, 10.0];
/// Most predictions of each horizon, and most innovations, that are kept of a robot: the newest.
pub const MOST_PAIRS: usize = 256;
/// Most displacements that are kept of a robot.
pub const MOST_DISPLACEMENTS: usize = 128;
/// Time of a displacement at least, seconds.
pub const DISPLACEMENT_S: f64 = 2.0;
/// Fewest predictions of a horizon that a figure is made of.
pub const FEWEST_PAIRS: [usize; 2] = [20, 10];
/// Fewest displacements.
pub const FEWEST_DISPLACEMENTS: usize = 20;
/// Fewest innovations.
pub const FEWEST_INNOVATIONS: usize = 40;

/// Squares of two, and of three, normal numbers are below these in 50 and 95 of 100 cases.
const LEVELS: [[f64; 2]; 2] = [[1.386, 5.991], [2.366, 7.815]];
/// A distance between more displacements is that between as many of them, evenly taken.
const MOST_COMPARED: usize = 512;
/// A fleet is measured by so many predictions at most, as many of each robot.
const MOST_POOLED: usize = 16_384;

/// A prediction and what came, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// The tracker's time of the fix, seconds.
    pub at_s: f64,
    /// From the prediction by the body of the twin to the fix.
    pub own_m: f32,
    /// The same by the nominal body.
    pub nominal_m: f32,
    /// The same by a perfect copy.
    pub copy_m: f32,
    /// The error of the twin's own, normalised by the uncertainty that it gave, and squared.
    pub square: f32,
    /// Driven meanwhile.
    pub way_m: f32,
}

/// A displacement over two seconds, as from where the robot was: ahead and to the left, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displacement {
    /// The tracker's time of its end, seconds.
    pub at_s: f64,
    /// By the fixes.
    pub seen: [f32; 2],
    /// By the body of the twin.
    pub own: [f32; 2],
    /// By the nominal body.
    pub nominal: [f32; 2],
    /// Of a perfect copy.
    pub copy: [f32; 2],
}

/// Median, and what nine in ten are below, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quantiles {
    /// Half are below.
    pub median_m: f64,
    /// Nine in ten are.
    pub p90_m: f64,
}

/// Shares within the regions that should hold 50 and 95 of 100.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Should be about 0.5.
    pub within_50: f64,
    /// Should be about 0.95.
    pub within_95: f64,
}

/// Errors of predictions over a horizon.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Driven meanwhile, on average, metres.
    pub way_m: f64,
    /// By the body of the twin.
    pub own: Quantiles,
    /// By the nominal body.
    pub nominal: Quantiles,
    /// By a perfect copy: what of an error is noise.
    pub floor: Quantiles,
    /// Of the regions that the twin gave.
    pub coverage: Coverage,
}

impl Errors {
    /// Median of the twin's own against that of the nominal body: 1 where it is no better.
    #[must_use]
    pub fn ratio(&self) -> Option<f64> {
        let ratio = self.own.median_m / self.nominal.median_m;
        ratio.is_finite().then_some(ratio)
    }
}

/// Energy distances between displacements, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distances {
    /// From those seen to those of the body of the twin.
    pub own_m: f64,
    /// From those seen to those of the nominal body.
    pub nominal_m: f64,
    /// From those of a perfect copy to those of the body of the twin.
    pub floor_m: f64,
}

/// A measure with what it rests on; without it where that is too little.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Measure<T> {
    /// So many.
    pub count: usize,
    /// What they say.
    pub value: Option<T>,
}

/// The gap of a robot, or of a fleet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// For each of [`HORIZONS_S`].
    pub errors: [Measure<Errors>; 2],
    /// Of single fixes.
    pub innovations: Measure<Coverage>,
    /// Of displacements.
    pub displacements: Measure<Distances>,
}

impl Measures {
    /// Whether every one has enough to rest on.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.errors.iter().all(|errors| errors.value.is_some())
            && self.innovations.value.is_some()
            && self.displacements.value.is_some()
    }
}

/// What is measured: the newest of each kind.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    pairs: [VecDeque<Pair>; 2],
    innovations: VecDeque<f32>,
    displacements: VecDeque<Displacement>,
}

fn push<T>(ring: &mut VecDeque<T>, value: T, most: usize) {
    if ring.len() >= most {
        ring.pop_front();
    }
    ring.push_back(value);
}

impl Samples {
    /// Takes in a prediction over one of [`HORIZONS_S`]. What is no number is left out.
    pub fn pair(&mut self, horizon: usize, pair: Pair) {
        let numbers = [pair.own_m, pair.nominal_m, pair.copy_m, pair.square];
        if let Some(ring) = self.pairs.get_mut(horizon)
            && numbers.iter().all(|number| number.is_finite())
        {
            push(ring, pair, MOST_PAIRS);
        }
    }

    /// Takes in an innovation of position and heading, normalised and squared.
    pub fn innovation(&mut self, square: f64) {
        if square.is_finite() {
            push(&mut self.innovations, square as f32, MOST_PAIRS);
        }
    }

    /// Takes in a displacement.
    pub fn displacement(&mut self, displacement: Displacement) {
        let Displacement {
            seen,
            own,
            nominal,
            copy,
            ..
        } = displacement;
        let mut numbers = [seen, own, nominal, copy].into_iter().flatten();
        if numbers.all(f32::is_finite) {
            push(&mut self.displacements, displacement, MOST_DISPLACEMENTS);
        }
    }

    /// The tracker's time of the oldest, seconds; `None` where there are none.
    #[must_use]
    pub fn since_s(&self) -> Option<f64> {
        let pairs = self.pairs.iter().filter_map(|ring| ring.front());
        let first = self.displacements.front().map(|first| first.at_s);
        pairs
            .map(|pair| pair.at_s)
            .chain(first)
            .min_by(f64::total_cmp)
    }

    /// Those of many robots, as many of each at most.
    #[must_use]
    pub fn pool(robots: &[Self]) -> Self {
        let of_each = (MOST_POOLED / robots.len().max(1)).max(1);
        let mut all = Self::default();
        for robot in robots {
            for (all, ring) in all.pairs.iter_mut().zip(&robot.pairs) {
                all.extend(newest(ring, of_each));
            }
            all.innovations.extend(newest(&robot.innovations, of_each));
            let displacements = newest(&robot.displacements, of_each);
            all.displacements.extend(displacements);
        }
        all
    }

    /// What they say.
    #[must_use]
    pub fn measure(&self) -> Measures {
        Measures {
            errors: [0, 1].map(|horizon: usize| Measure {
                count: self.pairs[horizon].len(),
                value: errors(&self.pairs[horizon], FEWEST_PAIRS[horizon]),
            }),
            innovations: Measure {
                count: self.innovations.len(),
                value: (self.innovations.len() >= FEWEST_INNOVATIONS)
                    .then(|| coverage(self.innovations.iter().copied(), LEVELS[1])),
            },
            displacements: Measure {
                count: self.displacements.len(),
                value: self.distances(),
            },
        }
    }

    fn distances(&self) -> Option<Distances> {
        let count = self.displacements.len();
        if count < FEWEST_DISPLACEMENTS {
            return None;
        }
        let every = count.div_ceil(MOST_COMPARED);
        let of = |which: fn(&Displacement) -> [f32; 2]| -> Vec<[f64; 2]> {
            let some = self.displacements.iter().step_by(every);
            some.map(|one| which(one).map(f64::from)).collect()
        };
        let (seen, own) = (of(|one| one.seen), of(|one| one.own));
        Some(Distances {
            own_m: energy_distance(&seen, &own),
            nominal_m: energy_distance(&seen, &of(|one| one.nominal)),
            floor_m: energy_distance(&of(|one| one.copy), &own),
        })
    }
}

fn newest<T: Copy>(ring: &VecDeque<T>, most: usize) -> impl Iterator<Item = T> + '_ {
    ring.iter().skip(ring.len().saturating_sub(most)).copied()
}

fn errors(pairs: &VecDeque<Pair>, fewest: usize) -> Option<Errors> {
    if pairs.len() < fewest {
        return None;
    }
    let quantiles = |of: fn(&Pair) -> f32| {
        let mut all: Vec<f64> = pairs.iter().map(|pair| f64::from(of(pair))).collect();
        Quantiles {
            median_m: quantile(&mut all, 0.5),
            p90_m: quantile(&mut all, 0.9),
        }
    };
    let way: f64 = pairs.iter().map(|pair| f64::from(pair.way_m)).sum();
    Some(Errors {
        way_m: way / pairs.len() as f64,
        own: quantiles(|pair| pair.own_m),
        nominal: quantiles(|pair| pair.nominal_m),
        floor: quantiles(|pair| pair.copy_m),
        coverage: coverage(pairs.iter().map(|pair| pair.square), LEVELS[0]),
    })
}

fn coverage(squares: impl Iterator<Item = f32>, [half, most]: [f64; 2]) -> Coverage {
    let (mut count, mut within) = (0_usize, [0_usize; 2]);
    for square in squares.map(f64::from) {
        count += 1;
        within[0] += usize::from(square <= half);
        within[1] += usize::from(square <= most);
    }
    let share = |within: usize| within as f64 / count.max(1) as f64;
    Coverage {
        within_50: share(within[0]),
        within_95: share(within[1]),
    }
}

/// The energy distance of two samples of points, 2·E|X − Y| − E|X − X′| − E|Y − Y′|, in the unit of the points: 0 for the
/// same, and never less; 0 as well where one is empty. All pairs are looked at.
#[must_use]
pub fn energy_distance(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    if a.is_empty() || b.is_empty() {
        return 0.0;
    }
    let between = |a: &[[f64; 2]], b: &[[f64; 2]]| -> f64 {
        let rows = a.iter().map(|p| {
            let row = b.iter().map(|q| {
                let [x, y] = [p[0] - q[0], p[1] - q[1]];
                (x * x + y * y).sqrt()
            });
            row.sum::<f64>()
        });
        rows.sum::<f64>() / (a.len() as f64 * b.len() as f64)
    };
    // It is never less than 0 but for rounding.
    (2.0 * between(a, b) - between(a, a) - between(b, b)).max(0.0)
}

/// Seconds ahead of the predictions at a place of [`Measures::errors`].
#[must_use]
pub const fn ahead_s(horizon: usize) -> f64 {
    HORIZONS_S[if horizon == 0 { 0 } else { 1 }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::course::Random;
    use proptest::prelude::*;

    fn points(count: usize, random: &mut Random, about: f64) -> Vec<[f64; 2]> {
        let point = |_| [about + random.normal(), random.normal()];
        (0..count).map(point).collect()
    }

    #[test]
    fn the_distance_is_that_of_the_book() {
        // By hand: E|X − Y| = 3, E|X − X′| = 0, E|Y − Y′| = (0 + 2 + 2 + 0) / 4 = 1.
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        let (one, two) = (vec![[0.0, 0.0]], vec![[2.0, 0.0], [4.0, 0.0]]);
        assert!(near(energy_distance(&one, &two), 5.0));
        assert!(near(energy_distance(&[], &two), 0.0));
        // Who is shifted further is further away, and two draws of one thing are near.
        let random = &mut Random::new(3);
        let (a, b) = (points(400, random, 0.0), points(400, random, 0.0));
        let (c, d) = (points(400, random, 0.5), points(400, random, 1.5));
        let [same, near, far] = [&b, &c, &d].map(|other| energy_distance(&a, other));
        assert!(
            same < 0.02 && 3.0 * same < near && 3.0 * near < far,
            "{same} {near} {far}"
        );
    }

    #[test]
    fn coverage_of_what_is_true_is_near_its_level() {
        let mut random = Random::new(5);
        let mut samples = Samples::default();
        for second in 0..20_000 {
            let square = |random: &mut Random, of: usize| -> f64 {
                (0..of).map(|_| random.normal().powi(2)).sum()
            };
            samples.innovations.push_back(square(&mut random, 3) as f32);
            let pair = Pair {
                at_s: f64::from(second),
                own_m: 0.01,
                nominal_m: 0.02,
                copy_m: 0.01,
                square: square(&mut random, 2) as f32,
                way_m: 1.0,
            };
            samples.pairs[0].push_back(pair);
        }
        let told = samples.measure();
        let errors = told.errors[0].value.expect("enough");
        let innovations = told.innovations.value.expect("enough");
        for coverage in [errors.coverage, innovations] {
            assert!((coverage.within_50 - 0.5).abs() < 0.015, "{coverage:?}");
            assert!((coverage.within_95 - 0.95).abs() < 0.008, "{coverage:?}");
        }
        let ratio = errors.ratio().expect("a ratio");
        assert!((ratio - 0.5).abs() < 1e-6, "{ratio}");
    }

    #[test]
    fn with_too_little_nothing_is_said_and_no_more_is_kept_than_may_be() {
        let mut samples = Samples::default();
        assert_eq!(samples.since_s(), None);
        let pair = |at_s: f64, own_m: f32| Pair {
            at_s,
            own_m,
            nominal_m: 0.0,
            copy_m: 0.0,
            square: 1.0,
            way_m: 1.0,
        };
        for second in 0..FEWEST_PAIRS[1] {
            assert_eq!(samples.measure().errors[1].value, None);
            samples.pair(1, pair(second as f64, 0.1));
            samples.pair(1, pair(second as f64, f32::NAN));
        }
        let ten = samples.measure().errors[1];
        assert_eq!(ten.count, FEWEST_PAIRS[1]);
        // Where the nominal body errs by nothing there is no ratio.
        assert_eq!(ten.value.expect("enough").ratio(), None);
        assert!(!samples.measure().is_whole());
        for second in 0..1_000 {
            let at_s = 100.0 + f64::from(second);
            samples.pair(0, pair(at_s, 0.1));
            samples.pair(7, pair(at_s, 0.1));
            samples.innovation(1.0);
            samples.innovation(f64::INFINITY);
            let there = [second as f32, 0.0];
            samples.displacement(Displacement {
                at_s,
                seen: there,
                own: there,
                nominal: [0.0; 2],
                copy: there,
            });
        }
        let told = samples.measure();
        let kept = [
            told.errors[0].count,
            told.innovations.count,
            told.displacements.count,
        ];
        assert_eq!(kept, [MOST_PAIRS, MOST_PAIRS, MOST_DISPLACEMENTS]);
        assert!(told.is_whole());
        assert_eq!(samples.since_s(), Some(0.0));
        let distances = told.displacements.value.expect("enough");
        assert!(distances.own_m < 1e-9 && distances.floor_m < 1e-9 && distances.nominal_m > 100.0);
        // In a fleet no robot counts more than another.
        let many = vec![samples.clone(); 1_000];
        let pooled = Samples::pool(&many).measure();
        assert_eq!(pooled.errors[0].count, 1_000 * (MOST_POOLED / 1_000));
        assert_eq!(pooled.errors[1].count, 1_000 * FEWEST_PAIRS[1]);
    }

    prop_compose! {
        fn some()(points in prop::collection::vec([-5.0..5.0_f64, -5.0..5.0_f64], 1..40)) -> Vec<[f64; 2]> {
            points
        }
    }

    proptest! {
        #[test]
        fn a_distance_is_a_distance(a in some(), b in some(), shift in [-3.0..3.0_f64, -3.0..3.0_f64], seed in any::<u64>()) {
            let of = energy_distance(&a, &b);
            prop_assert!(of >= 0.0 && of.is_finite());
            prop_assert!((of - energy_distance(&b, &a)).abs() < 1e-9, "symmetric");
            prop_assert!(energy_distance(&a, &a) < 1e-9, "0 for the same");
            // In whatever order, however often, and wherever the origin is.
            let mut order = a.clone();
            let mut random = Random::new(seed);
            for i in (1..order.len()).rev() {
                order.swap(i, (random.share() * (i + 1) as f64) as usize);
            }
            order.extend(order.clone());
            prop_assert!(energy_distance(&a, &order) < 1e-9);
            let moved = |points: &[[f64; 2]]| -> Vec<[f64; 2]> {
                points.iter().map(|p| [p[0] + shift[0], p[1] + shift[1]]).collect()
            };
            prop_assert!((of - energy_distance(&moved(&a), &moved(&b))).abs() < 1e-9);
            // Its square root obeys the triangle.
            let c = moved(&a);
            let root = |a: &[[f64; 2]], b: &[[f64; 2]]| energy_distance(a, b).sqrt();
            prop_assert!(root(&a, &b) <= root(&a, &c) + root(&c, &b) + 1e-6);
        }

        #[test]
        fn whatever_was_seen_shares_are_shares(squares in prop::collection::vec(any::<f32>(), 0..300)) {
            let mut samples = Samples::default();
            for square in squares {
                samples.innovation(f64::from(square));
                let (own_m, at_s) = (square.abs(), 0.0);
                samples.pair(0, Pair { at_s, own_m, nominal_m: own_m, copy_m: 0.0, square, way_m: 0.1 });
            }
            let told = samples.measure();
            let coverages = [told.innovations.value, told.errors[0].value.map(|errors| errors.coverage)];
            for coverage in coverages.into_iter().flatten() {
                prop_assert!((0.0..=1.0).contains(&coverage.within_50));
                prop_assert!((coverage.within_50..=1.0).contains(&coverage.within_95));
            }
            if let Some(errors) = told.errors[0].value {
                prop_assert!(errors.own.median_m <= errors.own.p90_m);
            }
        }
    }
}
