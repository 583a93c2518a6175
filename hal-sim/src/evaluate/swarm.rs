//! How a swarm stands and moves in the course of a run.

use std::collections::VecDeque;

use crawler_protocol::{Action, BehaviourSpec, Formation};

use super::metrics::{Measured, mean};
use super::pattern::{Pattern, order};
use super::shape::shape_error;
use crate::scenario::{Measure, Metric, Passable, Scenario, Threshold};
use crate::world::Arena;

/// How often a swarm is looked at, seconds.
pub(super) const EVERY_S: u32 = 1;
/// From when a swarm has settled, it is as it should be in this share of all looks.
const STEADY: f64 = 0.95;

/// The mean square of the distance to the middle of a hexagon, as a share of its area: 5 / (18 √3).
const HEXAGON: f64 = 0.160_375;

/// What is measured of a swarm as it is at one moment.
const SEEN: [Metric; 9] = [
    Metric::Order,
    Metric::Clusters,
    Metric::LargestCluster,
    Metric::PairDistanceM,
    Metric::Coverage,
    Metric::Evenness,
    Metric::LatticeDegree,
    Metric::SpacingErrorM,
    Metric::ShapeErrorM,
];

/// What one look showed, in the order of [`SEEN`].
type Look = [Option<f64>; SEEN.len()];

/// See the [module](self).
#[derive(Debug)]
pub(super) struct Swarm {
    measure: Measure,
    floor: Floor,
    /// What robots are told to form, where it has a shape.
    shape: Option<Formation>,
    /// What the scenario states of a swarm.
    wanted: Vec<Threshold>,
    /// The last looks, as many as fit the window.
    window: VecDeque<Look>,
    /// Of every look of the run: whether all that is wanted held.
    held: Vec<bool>,
}

impl Swarm {
    /// To look at the robots of a scenario, whose bodies have this radius.
    pub(super) fn new(scenario: &Scenario, arena: &Arena, radius: f32) -> Self {
        Self {
            measure: scenario.measure,
            floor: Floor::new(arena, radius, scenario.robots),
            shape: shape_of(scenario),
            wanted: scenario.success.of_swarm(),
            window: VecDeque::new(),
            held: Vec::new(),
        }
    }

    /// Takes in where the robots that work stand and head, as `places` and `headings` say.
    pub(super) fn look(&mut self, places: &[[f32; 2]], headings: &[f32]) {
        let look = self.seen(places, headings);
        let value = |metric| {
            let index = SEEN.iter().position(|&seen| seen == metric)?;
            look[index]
        };
        let mut wanted = self.wanted.iter();
        self.held
            .push(wanted.all(|threshold| threshold.is_met(value(threshold.metric))));
        let fits = libm::ceilf(self.measure.window_s / EVERY_S as f32) as usize;
        while self.window.len() >= fits.max(1) {
            self.window.pop_front();
        }
        self.window.push_back(look);
    }

    fn seen(&mut self, places: &[[f32; 2]], headings: &[f32]) -> Look {
        let Measure {
            near_m, spacing_m, ..
        } = self.measure;
        let Some(pattern) = Pattern::of(places, near_m, spacing_m) else {
            return Look::default();
        };
        let robots = places.len() as f64;
        let links = pattern.links as f64;
        [
            order(headings),
            Some(pattern.clusters as f64),
            Some(pattern.largest as f64 / robots),
            Some(pattern.least_m),
            self.floor.coverage(places),
            self.floor.evenness(places),
            Some(2.0 * links / robots),
            (pattern.links > 0).then(|| pattern.off_m / links),
            self.shape
                .as_ref()
                .and_then(|shape| shape_error(shape, places)),
        ]
    }

    /// Writes down what the run came to: the means over the window, and when the swarm settled.
    pub(super) fn measure(&self, measured: &mut Measured) {
        for (index, metric) in SEEN.into_iter().enumerate() {
            let values = self.window.iter().filter_map(|look| look[index]);
            measured.set(metric, mean(values));
        }
        if !self.wanted.is_empty() {
            let settled = settled(&self.held);
            let after_s = |looks: usize| (looks as u32 + 1) * EVERY_S;
            measured.set(Metric::SettleS, settled.map(|at| f64::from(after_s(at))));
        }
    }
}

/// The shape that the robots of `scenario` are told to form last.
fn shape_of(scenario: &Scenario) -> Option<Formation> {
    let first = scenario.action().ok().flatten();
    let timed = scenario.commands.iter().rev();
    let timed = timed.filter_map(|timed| timed.action().ok());
    let mut shapes = timed.chain(first).filter_map(|action| match action {
        Action::Behave(BehaviourSpec::Shaped(formation)) => Some(formation),
        _ => None,
    });
    shapes.next()
}

/// The first of these looks from which on nearly all are good, itself and the last one too.
fn settled(held: &[bool]) -> Option<usize> {
    held.last().filter(|&&good| good)?;
    let (mut good, mut first) = (0_usize, None);
    for (seen, (index, &held)) in (1_usize..).zip(held.iter().enumerate().rev()) {
        good += usize::from(held);
        if held && good as f64 >= STEADY * seen as f64 {
            first = Some(index);
        }
    }
    first
}

/// The floor on which a robot can stand, and who is near.
#[derive(Debug)]
struct Floor {
    map: Passable,
    /// Who is no farther away than this is near, metres.
    near_m: f32,
    seen: Vec<bool>,
}

impl Floor {
    /// For robots that share the floor evenly: each of them is to be near a part of it, round and
    /// as large as its share.
    fn new(arena: &Arena, radius: f32, robots: u32) -> Self {
        let map = Passable::new(arena, radius);
        let share = map.free_area() / robots.max(1) as f32;
        Self {
            near_m: (share / core::f32::consts::PI).sqrt(),
            seen: Vec::new(),
            map,
        }
    }

    fn coverage(&mut self, places: &[[f32; 2]]) -> Option<f64> {
        self.map.share_near(places, self.near_m, &mut self.seen)
    }

    /// The least mean square of the distance from the floor to the nearest of so many robots that there can be (that of
    /// a floor of hexagons: Fejes Tóth 1953), divided by what it is.
    fn evenness(&self, places: &[[f32; 2]]) -> Option<f64> {
        let share = f64::from(self.map.free_area()) / places.len() as f64;
        let square = self.map.mean_square(places)?;
        Some(HEXAGON * share / square)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenario(more: &str) -> Scenario {
        let text = format!(
            "name = \"a\"\nrobots = 4\n[arena]\nwidth = 4.2\nheight = 4.2\n[measure]\n\
             window_s = 3.0\n{more}"
        );
        Scenario::parse(&text).unwrap()
    }

    fn measured(more: &str, looks: &[&[[f32; 2]]]) -> Measured {
        let scenario = scenario(more);
        let mut swarm = Swarm::new(&scenario, &scenario.arena(1).unwrap(), 0.1);
        for places in looks {
            swarm.look(places, &vec![0.5; places.len()]);
        }
        let mut measured = Measured::default();
        swarm.measure(&mut measured);
        measured
    }

    const TOGETHER: &[[f32; 2]] = &[[0.0, 0.0], [0.8, 0.0], [0.0, 0.8], [0.8, 0.8]];
    const APART: &[[f32; 2]] = &[[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]];

    #[test]
    fn a_swarm_is_measured_over_the_window_at_the_end() {
        let seen = measured("", &[APART, TOGETHER, TOGETHER, TOGETHER]);
        for (metric, expected) in [
            (Metric::Order, 1.0),
            (Metric::Clusters, 1.0),
            (Metric::LargestCluster, 1.0),
            (Metric::LatticeDegree, 2.0),
            (Metric::PairDistanceM, 0.8),
            (Metric::SpacingErrorM, 0.0),
        ] {
            let value = seen.get(metric).unwrap();
            assert!((value - expected).abs() < 1e-5, "{metric:?} {value}");
        }
        assert_eq!(seen.get(Metric::SettleS), None, "nothing was wanted");
        let seen = measured("", &[TOGETHER, TOGETHER, APART]);
        assert_eq!(seen.get(Metric::Clusters), Some(2.0), "1, 1 and 4");
        assert_eq!(seen.get(Metric::LargestCluster), Some(0.75));
        // Nobody is at the spacing of a neighbour: there is nothing to be wrong.
        assert_eq!(measured("", &[APART]).get(Metric::SpacingErrorM), None);
        assert_eq!(measured("", &[&APART[..1]]), Measured::default());
        assert_eq!(measured("", &[]), Measured::default());
    }

    #[test]
    fn who_spreads_covers_more() {
        let cover = |places| measured("", &[places]).get(Metric::Coverage).unwrap();
        // Four circles of 4 m² in the corners of a square of 16 m²: all that is missing is what
        // reaches over the walls, √(4 / π) − 1 on two sides of each, and what two share.
        let (apart, together) = (cover(APART), cover(TOGETHER));
        assert!((0.88..0.93).contains(&apart), "{apart}");
        assert!((0.4..0.6).contains(&together), "{together}");
        assert!((cover(&APART[..2]) * 2.0 - apart).abs() < 0.03);
    }

    #[test]
    fn who_spreads_evenly_is_nearer_to_the_floor() {
        let even = |places| measured("", &[places]).get(Metric::Evenness).unwrap();
        // The middles of four squares of 2 m: the mean square is 4 m² / 6, and hexagons would have 0.160375 of 4 m².
        let apart = even(APART);
        assert!((apart - HEXAGON * 6.0).abs() < 0.02, "{apart}");
        let together = even(TOGETHER);
        assert!(together < 0.6 * apart, "{together}");
    }

    #[test]
    fn a_swarm_settles_when_what_is_wanted_holds_on() {
        let wanted = "[success]\nclusters = 1\nlargest_cluster = 1.0\npair_distance_m = 0.8\n";
        let settle = |looks: &[&[[f32; 2]]]| measured(wanted, looks).get(Metric::SettleS);
        assert_eq!(settle(&[APART, TOGETHER, TOGETHER]), Some(2.0));
        assert_eq!(settle(&[TOGETHER, APART]), None);
        assert_eq!(settle(&[]), None);
        let mut looks = vec![APART; 10];
        looks.extend([TOGETHER; 30]);
        assert_eq!(settle(&looks), Some(11.0));
        // To fall out of it once is not to start again.
        looks[25] = APART;
        assert_eq!(settle(&looks), Some(11.0));
        looks[26] = APART;
        looks[27] = APART;
        assert_eq!(settle(&looks), Some(29.0));
    }
}
