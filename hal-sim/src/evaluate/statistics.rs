//! How sure one can be of what few runs show.

/// The 97.5 % point of the normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// The 97.5 % points of Student's distribution for 1 to 30 degrees of freedom.
const T: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056,
    2.052, 2.048, 2.045, 2.042,
];

/// A mean, and the interval in which the true one lies with 95 % confidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Mean of the sample.
    pub mean: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Smallest value of the sample.
    pub least: f64,
    /// Largest value of the sample.
    pub most: f64,
    /// Size of the sample.
    pub count: usize,
}

/// The share of successes, with the interval of Wilson (1927), which holds for small samples and
/// near 0 and 1 too.
#[must_use]
pub fn of_share(successes: usize, count: usize) -> Option<Estimate> {
    if count == 0 {
        return None;
    }
    let n = count as f64;
    let p = successes as f64 / n;
    let z2 = Z * Z / n;
    let middle = (p + z2 / 2.0) / (1.0 + z2);
    let half = Z / (1.0 + z2) * (p * (1.0 - p) / n + z2 / (4.0 * n)).sqrt();
    Some(Estimate {
        mean: p,
        low: (middle - half).max(0.0),
        high: (middle + half).min(1.0),
        least: if successes == count { 1.0 } else { 0.0 },
        most: if successes == 0 { 0.0 } else { 1.0 },
        count,
    })
}

/// The mean of a sample, with Student's t interval; of one value the interval is that value, and
/// says nothing.
#[must_use]
pub fn of_mean(values: &[f64]) -> Option<Estimate> {
    let first = *values.first()?;
    let count = values.len();
    let n = count as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
    let half = if count > 1 {
        let t = T.get(count - 2).copied().unwrap_or_else(|| {
            // Cornish and Fisher's expansion (1938): off by less than 0.001 from here on.
            let degrees = n - 1.0;
            Z + (Z * Z * Z + Z) / (4.0 * degrees)
        });
        t * (squares / (n - 1.0) / n).sqrt()
    } else {
        0.0
    };
    Some(Estimate {
        mean,
        low: mean - half,
        high: mean + half,
        least: values.iter().copied().fold(first, f64::min),
        most: values.iter().copied().fold(first, f64::max),
        count,
    })
}

/// The difference of two shares of the same `count` things, of which `gained` count only the second time and `lost`
/// only the first: the adjusted Wald interval of Bonett and Price (2012), which holds for small samples and where
/// nothing or everything changes.
#[must_use]
pub fn of_paired_shares(gained: usize, lost: usize, count: usize) -> Option<Estimate> {
    if count == 0 {
        return None;
    }
    let n = count as f64;
    let (more, less) = (
        (gained as f64 + 1.0) / (n + 2.0),
        (lost as f64 + 1.0) / (n + 2.0),
    );
    let middle = more - less;
    let half = Z * ((more + less - middle * middle) / (n + 2.0)).sqrt();
    Some(Estimate {
        mean: (gained as f64 - lost as f64) / n,
        low: (middle - half).max(-1.0),
        high: (middle + half).min(1.0),
        least: if lost > 0 {
            -1.0
        } else if gained < count {
            0.0
        } else {
            1.0
        },
        most: if gained > 0 {
            1.0
        } else if lost < count {
            0.0
        } else {
            -1.0
        },
        count,
    })
}

/// Spearman's rank correlation (1904) of pairs, −1 to 1; `None` where one side does not vary.
#[must_use]
pub fn rank_correlation(pairs: &[(f64, f64)]) -> Option<f64> {
    let (a, b): (Vec<f64>, Vec<f64>) = pairs.iter().copied().unzip();
    let (a, b) = (ranks(&a), ranks(&b));
    let middle = f64::midpoint(pairs.len() as f64, 1.0);
    let sum = |one: &[f64], two: &[f64]| -> f64 {
        let products = one
            .iter()
            .zip(two)
            .map(|(x, y)| (x - middle) * (y - middle));
        products.sum()
    };
    let spread = sum(&a, &a) * sum(&b, &b);
    (spread > 0.0).then(|| sum(&a, &b) / spread.sqrt())
}

/// Ranks from 1; equal values share the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut start = 0;
    while start < order.len() {
        let same = order[start..]
            .iter()
            .take_while(|&&index| values[index] == values[order[start]])
            .count()
            .max(1);
        for &index in &order[start..start + same] {
            ranks[index] = start as f64 + f64::midpoint(same as f64, 1.0);
        }
        start += same;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(value: f64, expected: f64) -> bool {
        (value - expected).abs() < 5e-4
    }

    #[test]
    fn shares_have_the_interval_of_wilson() {
        // By hand: p = 0.9, n = 10, z² / n = 0.384146.
        // (0.9 + 0.192073) / 1.384146 = 0.788987; 1.959964 / 1.384146 · √(0.009 + 0.009604) =
        // 0.193140.
        let nine = of_share(9, 10).unwrap();
        assert!(
            near(nine.low, 0.5958) && near(nine.high, 0.9821),
            "{nine:?}"
        );
        let all = of_share(100, 100).unwrap();
        assert!(near(all.low, 0.9630) && near(all.high, 1.0), "{all:?}");
        let none = of_share(0, 100).unwrap();
        assert!(near(none.low, 0.0) && near(none.high, 0.0370), "{none:?}");
        assert_eq!(of_share(0, 0), None);
    }

    #[test]
    fn shares_of_the_same_things_have_the_interval_of_bonett_and_price() {
        // 40 pairs, 10 gained, 2 lost: (11 − 3) / 42 = 0.190476; (14 / 42 − 0.036281) / 42 = 0.007073, whose root
        // is 0.084100; times 1.959964 is 0.164833.
        let change = of_paired_shares(10, 2, 40).unwrap();
        assert_eq!((change.mean, change.least, change.most), (0.2, -1.0, 1.0));
        assert!(
            near(change.low, 0.0256) && near(change.high, 0.3553),
            "{change:?}"
        );
        let none = of_paired_shares(0, 0, 100).unwrap();
        assert!(none.low < 0.0 && none.high > 0.0 && near(none.low, -none.high));
        assert_eq!((none.least, none.most), (0.0, 0.0));
        let all = of_paired_shares(3, 0, 3).unwrap();
        assert_eq!((all.mean, all.least, all.most), (1.0, 1.0, 1.0));
        assert_eq!(of_paired_shares(0, 0, 0), None);
    }

    #[test]
    fn means_have_the_interval_of_student() {
        // Mean 3, variance 2.5, standard error √0.5 = 0.70711; t(4) = 2.776.
        let five = of_mean(&[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert_eq!((five.mean, five.least, five.most), (3.0, 1.0, 5.0));
        assert!(near(five.low, 3.0 - 1.9629) && near(five.high, 3.0 + 1.9629));
        let one = of_mean(&[7.0]).unwrap();
        assert_eq!((one.low, one.high), (7.0, 7.0));
        assert_eq!(of_mean(&[]), None);
        // t(99) is 1.9842 in every table.
        let many: Vec<f64> = (0..100).map(|i| f64::from(i % 2)).collect();
        let many = of_mean(&many).unwrap();
        let error = (0.25_f64 * 100.0 / 99.0 / 100.0).sqrt();
        assert!(near((many.high - many.mean) / error, 1.9842), "{many:?}");
    }

    #[test]
    fn ranks_correlate_whatever_the_scale() {
        let rising = [(1.0, 1.0), (2.0, 10.0), (3.0, 100.0), (4.0, 1e6)];
        assert_eq!(rank_correlation(&rising), Some(1.0));
        let falling: Vec<_> = rising.iter().map(|&(a, b)| (a, -b)).collect();
        assert_eq!(rank_correlation(&falling), Some(-1.0));
        assert_eq!(rank_correlation(&[(1.0, 2.0), (2.0, 2.0)]), None);
        assert_eq!(rank_correlation(&[]), None);
        // Ranks 1 2.5 2.5 4 against 1 2 3 4: 4.5 / √(4.5 · 5).
        let tied = [(1.0, 1.0), (2.0, 2.0), (2.0, 3.0), (9.0, 4.0)];
        assert!(near(rank_correlation(&tied).unwrap(), 0.9487));
    }
}
