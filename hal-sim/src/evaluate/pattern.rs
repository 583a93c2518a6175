//! What can be seen of where robots stand, at one moment.

use std::collections::BTreeMap;

use crate::scenario::apart;

/// Neighbours in a lattice are no farther apart than this times its spacing: less than the √2
/// sides that lead to the one across in a lattice of squares, and the √3 in one of triangles.
const LATTICE_REACH: f32 = 1.3;

/// See the [module](self).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pattern {
    /// Groups of robots that are near to each other, over any number of others.
    pub(super) clusters: usize,
    /// Robots in the largest of them.
    pub(super) largest: usize,
    /// Least distance of two robots, metres.
    pub(super) least_m: f64,
    /// Pairs of neighbours in the lattice.
    pub(super) links: usize,
    /// How far their distances are from the spacing, metres, all together.
    pub(super) off_m: f64,
}

/// The length of the mean direction: 1 when all head the same way, near 0 when they head anywhere
/// (Vicsek et al. 1995). Nobody heads nowhere.
pub(super) fn order(headings: &[f32]) -> Option<f64> {
    if headings.is_empty() {
        return None;
    }
    let (x, y) = headings.iter().fold((0.0, 0.0), |(x, y), &heading| {
        let (sin, cos) = libm::sincos(f64::from(heading));
        (x + cos, y + sin)
    });
    Some(libm::hypot(x, y) / headings.len() as f64)
}

impl Pattern {
    /// The pattern of two robots or more; fewer have none. Robots no farther apart than `near_m`
    /// are near to each other.
    ///
    /// Takes time in proportion to the number of pairs that are near.
    pub(super) fn of(places: &[[f32; 2]], near_m: f32, spacing_m: f32) -> Option<Self> {
        if places.len() < 2 {
            return None;
        }
        let reach = LATTICE_REACH * spacing_m;
        let mut groups = Groups::new(places.len());
        let (mut links, mut off_m) = (0, 0.0);
        let mut least_m = f64::INFINITY;
        each_pair(places, near_m.max(reach), |a, b, distance| {
            if distance <= near_m {
                groups.join(a, b);
            }
            if distance <= reach {
                links += 1;
                off_m += f64::from((distance - spacing_m).abs());
            }
            least_m = least_m.min(f64::from(distance));
        });
        // Two that are farther apart than that are looked for farther away.
        let mut reach = near_m.max(reach);
        while least_m.is_infinite() && reach.is_finite() {
            reach *= 2.0;
            each_pair(places, reach, |_, _, distance| {
                least_m = least_m.min(f64::from(distance));
            });
        }
        let sizes = groups.sizes();
        Some(Self {
            clusters: sizes.len(),
            largest: sizes.into_values().max().unwrap_or(0),
            least_m,
            links,
            off_m,
        })
    }
}

/// Every pair no farther apart than `reach`, once, with its distance.
fn each_pair(places: &[[f32; 2]], reach: f32, mut see: impl FnMut(usize, usize, f32)) {
    let square = |along: f32| libm::floorf(along / reach) as i64;
    let mut squares: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
    for (number, &[x, y]) in places.iter().enumerate() {
        let at = (square(x), square(y));
        squares.entry(at).or_default().push(number);
    }
    for (&(x, y), here) in &squares {
        for (rank, &a) in here.iter().enumerate() {
            let mut meet = |b: usize| {
                let distance = apart(places[a], places[b]);
                if distance <= reach {
                    see(a, b, distance);
                }
            };
            here[rank + 1..].iter().for_each(|&b| meet(b));
            // Half of those around; the other half meets this one.
            for there in [(x + 1, y - 1), (x + 1, y), (x + 1, y + 1), (x, y + 1)] {
                let there = squares.get(&there).into_iter().flatten();
                there.for_each(|&b| meet(b));
            }
        }
    }
}

/// Who belongs together (Tarjan 1975, with halved paths).
struct Groups {
    above: Vec<usize>,
}

impl Groups {
    fn new(count: usize) -> Self {
        Self {
            above: (0..count).collect(),
        }
    }

    fn top(&mut self, mut one: usize) -> usize {
        while self.above[one] != one {
            self.above[one] = self.above[self.above[one]];
            one = self.above[one];
        }
        one
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.top(a), self.top(b));
        self.above[a.max(b)] = a.min(b);
    }

    fn sizes(mut self) -> BTreeMap<usize, usize> {
        let mut sizes = BTreeMap::new();
        for one in 0..self.above.len() {
            *sizes.entry(self.top(one)).or_insert(0) += 1;
        }
        sizes
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn order_is_of_directions() {
        use core::f32::consts::{FRAC_PI_2, PI};
        let near = |headings: &[f32], expected: f64| {
            let order = order(headings).unwrap();
            assert!((order - expected).abs() < 1e-6, "{order}");
        };
        near(&[1.0, 1.0 + 2.0 * PI, 1.0 - 2.0 * PI], 1.0);
        near(&[0.0, PI], 0.0);
        near(&[0.0, FRAC_PI_2], 0.5_f64.sqrt());
        assert_eq!(order(&[]), None);
    }

    #[test]
    fn a_lattice_of_triangles_has_six_neighbours_inside() {
        let side = 0.8;
        let mut places = vec![[3.0, 1.0]];
        for sixth in 0..6_u8 {
            let (sin, cos) = libm::sincosf(f32::from(sixth) * core::f32::consts::FRAC_PI_3);
            places.push([3.0 + side * cos, 1.0 + side * sin]);
        }
        let seen = Pattern::of(&places, 1.2, side).unwrap();
        // Six spokes, and a ring of six.
        assert_eq!((seen.clusters, seen.largest, seen.links), (1, 7, 12));
        assert!(seen.off_m < 1e-5 && (seen.least_m - 0.8).abs() < 1e-6);
        // Far from the spacing that was wanted, and no lattice at half of it.
        let wide = Pattern::of(&places, 1.2, 0.7).unwrap();
        assert_eq!(wide.links, 12);
        assert!((wide.off_m - 1.2).abs() < 1e-5, "{wide:?}");
        assert_eq!(Pattern::of(&places, 0.5, 0.4).unwrap().links, 0);
        assert_eq!(Pattern::of(&places[..1], 1.2, side), None);
    }

    #[test]
    fn robots_far_from_each_other_have_a_distance() {
        let seen = Pattern::of(&[[-200.0, -150.0], [200.0, 150.0]], 1.2, 0.8).unwrap();
        assert_eq!((seen.clusters, seen.largest, seen.least_m), (2, 1, 500.0));
    }

    proptest! {
        #[test]
        fn the_grid_sees_what_all_pairs_show(
            places in prop::collection::vec([-4.0_f32..4.0, -4.0_f32..4.0], 2..40),
            near_m in 0.05_f32..3.0,
            spacing_m in 0.05_f32..2.0,
        ) {
            let seen = Pattern::of(&places, near_m, spacing_m).unwrap();
            let pairs = (0..places.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
            let distances: Vec<_> = pairs
                .map(|(a, b)| (a, b, apart(places[a], places[b])))
                .collect();
            let least = distances.iter().map(|pair| pair.2).fold(f32::INFINITY, f32::min);
            prop_assert_eq!(seen.least_m, f64::from(least));
            let links = distances.iter().filter(|pair| pair.2 <= LATTICE_REACH * spacing_m);
            prop_assert_eq!(seen.links, links.clone().count());
            let off: f64 = links.map(|pair| f64::from((pair.2 - spacing_m).abs())).sum();
            prop_assert!((seen.off_m - off).abs() < 1e-6);
            // Spread a mark from each robot that has none.
            let mut marks = vec![None; places.len()];
            let mut clusters = 0;
            for first in 0..places.len() {
                if marks[first].is_some() {
                    continue;
                }
                let mut open = vec![first];
                while let Some(one) = open.pop() {
                    if marks[one].replace(clusters).is_none() {
                        let near = (0..places.len())
                            .filter(|&other| apart(places[one], places[other]) <= near_m);
                        open.extend(near.filter(|&other| marks[other].is_none()));
                    }
                }
                clusters += 1;
            }
            prop_assert_eq!(seen.clusters, clusters);
            let size = |cluster| marks.iter().filter(|&&mark| mark == Some(cluster)).count();
            prop_assert_eq!(Some(seen.largest), (0..clusters).map(size).max());
        }
    }
}
