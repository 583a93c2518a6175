//! What comes of all draws.

use crawler_protocol::{RobotId, RobotState};
use crawler_sim::evaluate::{Estimate, of_mean};
use crawler_sim::world::{Arena, Pose};

use crate::bodies::{Body, Known};
use crate::past::{Past, PastRobot};
use crate::question::{Question, STEP_MS};
use crate::world::{Branch, apart};

/// Robots of both worlds that are farther from each other have parted, metres.
const PARTED_M: f32 = 0.05;
/// Share of the draws that a region holds.
const REGION: f64 = 0.95;
/// What history and tracker leave open of where a robot was, metres.
const BLUR_M: f32 = 0.03;
/// Fewest points of a record that are held against the draws.
const FEWEST_POINTS: usize = 2;

/// See the [module](self).
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The arena of the moment, where it was a simulated one.
    pub arena: Option<Arena>,
    /// Robots of which enough was recorded to hold it against the draws as it was.
    pub tested: usize,
    /// Those of them whose record lies where the draws have it.
    pub inside: usize,
    /// Numbers of the whole world.
    pub measures: Vec<Measure>,
    /// In the order of their names.
    pub robots: Vec<RobotAnswer>,
}

/// A number of the whole world, in both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measure {
    /// Its name.
    pub name: &'static str,
    /// Its unit; empty where it has none.
    pub unit: &'static str,
    /// As it was, the mean of the draws.
    pub was: f64,
    /// With the change.
    pub would: f64,
    /// What the change makes of it, draw by draw, with the interval that holds it with 95 %.
    pub difference: Estimate,
}

/// Where a robot goes in one of both worlds, a point every [`STEP_MS`].
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// By the bodies in the middle of all.
    pub places: Vec<Pose>,
    /// What it does meanwhile.
    pub states: Vec<RobotState>,
    /// Radius around it that holds 95 % of the draws, metres.
    pub within: Vec<f32>,
}

/// A robot in both worlds.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotAnswer {
    /// The robot.
    pub robot: RobotId,
    /// From what its body is known.
    pub known: Known,
    /// What it was told last before the moment; `None` where nobody knows of anything.
    pub doing: Option<String>,
    /// Whether that is supposed only, since it moved.
    pub supposed: bool,
    /// Where it was, as recorded.
    pub recorded: Vec<Option<Pose>>,
    /// As it was.
    pub was: Path,
    /// With the change.
    pub would: Path,
    /// Whether what was recorded lies in the region of the draws as it was; `None` where too little is.
    pub inside: Option<bool>,
    /// When it is first elsewhere, seconds; `None` when it never is.
    pub parted_s: Option<f64>,
    /// How far from where it would be it is in the end, metres; the mean of the draws.
    pub apart_m: f64,
    /// How often it touches something, as it was and with the change; the mean of the draws.
    pub contacts: [f64; 2],
}

/// Both worlds of a draw.
type Draw = [Branch; 2];

/// Puts the draws of a question together; the first has the bodies in the middle of all.
///
/// # Panics
/// When there is no draw.
pub(crate) fn answer(past: &Past, bodies: &[Body], question: &Question, draws: &[Draw]) -> Answer {
    let robots = past.robots.iter().zip(bodies).enumerate();
    let robots: Vec<RobotAnswer> = robots
        .map(|(robot, of)| robot_answer(robot, of, question, draws))
        .collect();
    let verdicts = || robots.iter().filter_map(|robot| robot.inside);
    Answer {
        arena: past.arena.clone(),
        tested: verdicts().count(),
        inside: verdicts().filter(|inside| *inside).count(),
        measures: measures(draws),
        robots,
    }
}

fn measures(draws: &[Draw]) -> Vec<Measure> {
    type Value = fn(&Branch) -> Option<f64>;
    let contacts: Value = |branch| {
        let all: Vec<f64> = branch.contacts.iter().copied().map(f64::from).collect();
        Some(of_mean(&all)?.mean)
    };
    let ways: Value = |branch| {
        let all: Vec<f64> = branch.ways.iter().copied().map(f64::from).collect();
        Some(of_mean(&all)?.mean)
    };
    let nearest: Value = |branch| branch.nearest.map(f64::from);
    let all = [
        ("contacts", "", contacts),
        ("way_m", "m", ways),
        ("nearest_m", "m", nearest),
    ];
    let measure = |(name, unit, value): (&'static str, &'static str, Value)| {
        let pairs = draws.iter();
        let pairs = pairs.filter_map(|[was, would]| Some([value(was)?, value(would)?]));
        let pairs: Vec<[f64; 2]> = pairs.collect();
        let of =
            |value: fn(&[f64; 2]) -> f64| of_mean(&pairs.iter().map(value).collect::<Vec<_>>());
        Some(Measure {
            name,
            unit,
            was: of(|pair| pair[0])?.mean,
            would: of(|pair| pair[1])?.mean,
            difference: of(|pair| pair[1] - pair[0])?,
        })
    };
    all.into_iter().filter_map(measure).collect()
}

fn robot_answer(
    robot: usize,
    (past, body): (&PastRobot, &Body),
    question: &Question,
    draws: &[Draw],
) -> RobotAnswer {
    let middle = &draws[0];
    let paths = [0, 1].map(|world| path(robot, world, question, draws));
    let both = middle[0].places.iter().zip(&middle[1].places);
    let parted = both
        .map(|(was, would)| apart(was[robot], would[robot]))
        .position(|apart| apart > PARTED_M);
    let ends = draws.iter().filter_map(|[was, would]| {
        let (was, would) = was.places.last().zip(would.places.last())?;
        Some(f64::from(apart(was[robot], would[robot])))
    });
    let contacts = |world: usize| {
        let all = draws
            .iter()
            .map(|draw| f64::from(draw[world].contacts[robot]));
        all.sum::<f64>() / draws.len() as f64
    };
    let mut told = past.orders.iter().filter(|order| order.at_ms <= 0);
    let (first, later) = (told.next(), told.next_back());
    let [was, would] = paths;
    RobotAnswer {
        robot: past.robot.clone(),
        known: body.known.clone(),
        doing: later.or(first).map(|order| words(&order.action)),
        supposed: past.supposed && later.is_none(),
        recorded: past.path.clone(),
        inside: inside(robot, &past.path, draws),
        was,
        would,
        parted_s: parted.map(|point| point as f64 * f64::from(STEP_MS) * 1e-3),
        apart_m: ends.sum::<f64>() / draws.len() as f64,
        contacts: [contacts(0), contacts(1)],
    }
}

/// A command in words.
fn words(action: &crawler_protocol::Action) -> String {
    let name = action.command().name();
    match action {
        crawler_protocol::Action::Behave(behaviour) => behaviour.name().to_owned(),
        crawler_protocol::Action::Goto { x, y } => format!("{name} {x:.2}, {y:.2}"),
        _ => name.to_owned(),
    }
}

fn path(robot: usize, world: usize, question: &Question, draws: &[Draw]) -> Path {
    let middle = &draws[0][world];
    let within = (0..question.points()).map(|point| {
        let own = middle.places[point][robot];
        let others = draws[1..].iter();
        region(
            others
                .map(|draw| apart(own, draw[world].places[point][robot]))
                .collect(),
        )
    });
    Path {
        places: middle.places.iter().map(|places| places[robot]).collect(),
        states: middle.states.iter().map(|states| states[robot]).collect(),
        within: within.collect(),
    }
}

/// The distance that so many of these are within that the next one is with 95 %, where it is one of them: the conformal
/// quantile (Vovk and others, 2005), or the greatest where they are too few.
fn region(mut distances: Vec<f32>) -> f32 {
    distances.sort_by(f32::total_cmp);
    let count = distances.len();
    let rank = (REGION * (count + 1) as f64).ceil() as usize;
    let at = rank.min(count).checked_sub(1);
    at.map_or(0.0, |at| distances[at])
}

/// Whether a record is at no point farther from the middle of the draws than they are from it on their whole way.
fn inside(robot: usize, recorded: &[Option<Pose>], draws: &[Draw]) -> Option<bool> {
    let middle = &draws[0][0].places;
    let known = || {
        let points = recorded.iter().zip(middle).enumerate();
        points.filter_map(|(point, (place, own))| Some((point, (*place)?, own[robot])))
    };
    if known().count() < FEWEST_POINTS {
        return None;
    }
    let farthest = |of: &dyn Fn(usize, Pose) -> Pose| {
        let far = known().map(|(point, place, own)| apart(of(point, place), own));
        far.fold(0.0, f32::max)
    };
    let others = draws[1..].iter();
    let others = others.map(|draw| farthest(&|point, _| draw[0].places[point][robot]));
    let far = farthest(&|_, place| place);
    Some(far <= region(others.collect()) + BLUR_M)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_holds_the_share_that_it_says() {
        let distances = |count: u16| (1..=count).map(f32::from).collect::<Vec<_>>();
        assert!((region(distances(99)) - 95.0).abs() < 1e-6);
        assert!((region(distances(199)) - 190.0).abs() < 1e-6);
        // Of few it is the greatest.
        assert!((region(distances(10)) - 10.0).abs() < 1e-6);
        assert!(region(Vec::new()).abs() < 1e-6);
    }
}
