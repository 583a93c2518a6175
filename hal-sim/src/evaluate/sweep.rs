//! Parameters over a grid, and parameters drawn at random: which of them matter.

use super::batch::Job;
use super::statistics::rank_correlation;
use super::trial::Trial;
use crate::scenario::{Metric, Scenario, ScenarioError};
use crate::world::{Parameters, Profile, TABLE, Vary};

/// Most points of one axis.
const MOST_POINTS: usize = 1_000;
/// Most points of a grid.
const MOST_CELLS: usize = 10_000;

/// One key of a scenario and its values, like `parameters.chassis.running_v=0.5:1.0:6`.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// The key.
    pub key: String,
    /// Its values.
    pub values: Vec<f64>,
}

impl std::fmt::Display for Axis {
    /// In the form with every value, which is read again as the same.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.key)?;
        for (index, value) in self.values.iter().enumerate() {
            write!(f, "{}{value}", if index == 0 { '=' } else { ',' })?;
        }
        Ok(())
    }
}

/// Why a text is no [`Axis`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NoAxis {
    /// This is not like one.
    Shape(String),
    /// This is no number that a key can have.
    Infinite(String),
    /// A range of this has too many points, or none.
    Range(String),
    /// A list of this has too many points.
    List(String),
}

impl std::fmt::Display for NoAxis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Shape(text) => {
                write!(f, "`{text}` is not like key=least:most:points or key=1,2,5")
            }
            Self::Infinite(text) => write!(f, "`{text}` is not a finite number"),
            Self::Range(text) => write!(f, "`{text}`: 1 to {MOST_POINTS} points"),
            Self::List(text) => write!(f, "`{text}`: at most {MOST_POINTS} points"),
        }
    }
}

impl std::error::Error for NoAxis {}

impl std::str::FromStr for Axis {
    type Err = NoAxis;

    fn from_str(text: &str) -> Result<Self, NoAxis> {
        let shape = || NoAxis::Shape(text.to_owned());
        let (key, range) = text.split_once('=').ok_or_else(shape)?;
        let number = |text: &str| {
            let number = text.trim().parse::<f64>().map_err(|_| shape())?;
            if number.is_finite() {
                Ok(number)
            } else {
                Err(NoAxis::Infinite(text.to_owned()))
            }
        };
        let parts: Vec<&str> = range.split(':').collect();
        let values = match parts[..] {
            [least, most, points] => {
                let (least, most) = (number(least)?, number(most)?);
                let points: usize = points.trim().parse().map_err(|_| shape())?;
                if !(1..=MOST_POINTS).contains(&points) {
                    return Err(NoAxis::Range(text.to_owned()));
                }
                let step = (most - least) / (points.max(2) - 1) as f64;
                (0..points)
                    .map(|point| least + step * point as f64)
                    .collect()
            }
            [list] => list.split(',').map(number).collect::<Result<Vec<_>, _>>()?,
            _ => return Err(shape()),
        };
        if values.len() > MOST_POINTS {
            return Err(NoAxis::List(text.to_owned()));
        }
        Ok(Self {
            key: key.trim().to_owned(),
            values,
        })
    }
}

/// A point of a grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// The value on each axis.
    pub at: Vec<f64>,
    /// The scenario there.
    pub scenario: Scenario,
}

/// The points of the grid that `axes` span, the last axis varying fastest.
///
/// # Errors
/// When the scenario cannot be so at some point, or there are too many.
pub fn grid(scenario: &Scenario, axes: &[Axis]) -> Result<Vec<Cell>, ScenarioError> {
    let size = axes
        .iter()
        .try_fold(1_usize, |size, axis| size.checked_mul(axis.values.len()))
        .filter(|&size| size <= MOST_CELLS)
        .ok_or_else(|| ScenarioError::NoRoom(format!("more than {MOST_CELLS} points")))?;
    (0..size)
        .map(|number| {
            let mut rest = number;
            let mut at = vec![0.0; axes.len()];
            for (value, axis) in at.iter_mut().zip(axes).rev() {
                *value = axis.values[rest % axis.values.len()];
                rest /= axis.values.len();
            }
            let mut changed = scenario.clone();
            for (value, axis) in at.iter().zip(axes) {
                changed = changed.with_value(&axis.key, &number_text(*value))?;
            }
            Ok(Cell {
                at,
                scenario: changed,
            })
        })
        .collect()
}

/// A number as TOML has it; whole ones may be meant for keys that are whole.
fn number_text(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 1e15 {
        format!("{}", value as i64)
    } else {
        format!("{value}")
    }
}

/// The scenario of run number `number` of a Monte Carlo evaluation: parameters drawn from the
/// ranges of `profile`, and stated from then on.
#[must_use]
pub fn drawn(scenario: &Scenario, profile: Profile, seed: u64) -> Scenario {
    let mut drawn = scenario.clone();
    drawn.parameters = scenario.parameters.randomised(profile, seed);
    drawn.randomisation = Profile::None;
    drawn
}

/// How a parameter goes with failure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Influence {
    /// Key of the parameter.
    pub key: &'static str,
    /// Rank correlation with failure, −1 to 1: positive when large values fail.
    pub with_failure: Option<f64>,
    /// The same with the time to the goal, over the runs that have one.
    pub with_time: Option<f64>,
}

/// How the parameters that `profile` varies go with failure, the strongest first.
#[must_use]
pub fn influences(profile: Profile, runs: &[(Parameters, &Trial)]) -> Vec<Influence> {
    let mut influences: Vec<Influence> = TABLE
        .iter()
        .filter(|row| row.variation(profile) != Vary::Fixed)
        .map(|row| {
            let failures: Vec<_> = runs
                .iter()
                .map(|(parameters, trial)| {
                    let failed = if trial.is_success() { 0.0 } else { 1.0 };
                    (f64::from(row.value(parameters)), failed)
                })
                .collect();
            let times: Vec<_> = runs
                .iter()
                .filter_map(|(parameters, trial)| {
                    let time = trial.measured.get(Metric::TimeToGoalS)?;
                    Some((f64::from(row.value(parameters)), time))
                })
                .collect();
            Influence {
                key: row.key,
                with_failure: rank_correlation(&failures),
                with_time: rank_correlation(&times),
            }
        })
        .collect();
    let strength = |influence: &Influence| {
        let either = influence.with_failure.or(influence.with_time);
        either.map_or(0.0, f64::abs)
    };
    influences.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    influences
}

/// One run for each scenario, each with a seed of its own.
#[must_use]
pub fn jobs(scenarios: &[Scenario], seed: u64) -> Vec<Job<'_>> {
    scenarios
        .iter()
        .zip(0..)
        .map(|(scenario, number)| Job {
            scenario,
            seed: seed.wrapping_add(number),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_ranges_or_lists() {
        let axis: Axis = "parameters.chassis.running_v=0.5:1.0:6".parse().unwrap();
        assert_eq!(axis.key, "parameters.chassis.running_v");
        let expected = [0.5, 0.6, 0.7, 0.8, 0.9, 1.0];
        assert_eq!(axis.values.len(), 6);
        for (value, expected) in axis.values.iter().zip(expected) {
            assert!((value - expected).abs() < 1e-12);
        }
        assert_eq!(
            "robots=1,2,5".parse::<Axis>().unwrap().values,
            [1.0, 2.0, 5.0]
        );
        assert_eq!("robots=3:9:1".parse::<Axis>().unwrap().values, [3.0]);
        for wrong in [
            "robots",
            "robots=1:2",
            "robots=a:b:c",
            "robots=1:2:0",
            "x=nan",
            "x=1:2:9999",
        ] {
            assert!(wrong.parse::<Axis>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_grid_has_every_pair_once() {
        let scenario = Scenario::built_in("empty").unwrap();
        let axes = [
            "robots=1,2".parse().unwrap(),
            "duration_s=5:15:3".parse().unwrap(),
        ];
        let cells = grid(&scenario, &axes).unwrap();
        let pairs: Vec<_> = cells
            .iter()
            .map(|cell| (cell.scenario.robots, cell.scenario.duration_s))
            .collect();
        let expected = [
            (1, 5.0),
            (1, 10.0),
            (1, 15.0),
            (2, 5.0),
            (2, 10.0),
            (2, 15.0),
        ];
        assert_eq!(pairs, expected);
        let wrong = grid(&scenario, &["colour=1,2".parse().unwrap()]);
        assert!(wrong.unwrap_err().to_string().contains("unknown field"));
        let many: Vec<Axis> = vec!["robots=1:9:1000".parse().unwrap(); 2];
        assert!(grid(&scenario, &many).is_err());
    }

    #[test]
    fn the_parameter_that_decides_comes_first() {
        let scenario = Scenario::built_in("empty").unwrap();
        let runs: Vec<_> = (1..=60)
            .map(|seed| {
                let parameters = drawn(&scenario, Profile::Wild, seed).parameters;
                let mut trial = Trial::broken(seed, super::super::Criterion::Reach, String::new());
                if parameters.chassis.running_v < 0.7 {
                    trial.failures.clear();
                }
                (parameters, trial)
            })
            .collect();
        let runs: Vec<_> = runs.iter().map(|(p, trial)| (*p, trial)).collect();
        let influences = influences(Profile::Wild, &runs);
        assert_eq!(influences[0].key, "chassis.running_v");
        assert!(influences[0].with_failure.unwrap() > 0.8);
        assert_eq!(influences[0].with_time, None);
    }
}
