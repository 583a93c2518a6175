//! What trials come to together, by the same means as on the console.

use std::sync::Arc;

use crawler_records::{ExperimentState, NewTrials, StoredTrial};
use crawler_sim::evaluate::{Line, Measured, Trial, Verdict};
use crawler_sim::scenario::{Metric, Scenario, Threshold};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::worker::Plan;

/// Something that is measured of every trial.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = ExperimentMetric)]
pub struct MetricView {
    /// Its name.
    pub name: String,
    /// What its values are in.
    pub unit: String,
    /// Which way is better: `more`, `less` or `neither`.
    pub better: String,
}

impl MetricView {
    /// What this program measures.
    pub(super) fn all() -> Vec<Self> {
        let view = |metric: Metric| Self {
            name: metric.name().to_owned(),
            unit: metric.unit().to_owned(),
            better: metric.better().name().to_owned(),
        };
        Metric::ALL.into_iter().map(view).collect()
    }
}

/// One metric over all trials that have it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = ExperimentSummary)]
pub struct Summary {
    /// Its name.
    pub metric: String,
    /// What its values are in.
    pub unit: String,
    /// The mean.
    pub mean: f64,
    /// Lower end of the 95 % interval: Wilson's of `success`, Student's t of the others.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// How many trials have it.
    pub count: u32,
}

/// A threshold, and whether it is met.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = ExperimentVerdict)]
pub struct Judged {
    /// What was asked, by the scenario or by whoever made the experiment.
    pub threshold: String,
    /// Whether it is met.
    pub met: bool,
    /// The mean, where a trial has it.
    pub value: Option<f64>,
}

/// What the trials that are done come to.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// A line for each metric that a trial has.
    pub summary: Vec<Summary>,
    /// Only of an experiment that is complete.
    pub verdict: Option<Vec<Judged>>,
}

impl Results {
    /// What the records have of an experiment.
    #[must_use]
    pub fn read(text: &str) -> Self {
        // There are none before the first trial.
        serde_json::from_str(text).unwrap_or_default()
    }
}

/// An experiment that runs, and what its trials measured.
#[derive(Debug)]
pub(super) struct Tally {
    pub(super) name: String,
    /// When it was made: after a backup was put back, another may have its number.
    pub(super) created: i64,
    pub(super) scenario: Arc<Scenario>,
    pub(super) thresholds: Vec<Threshold>,
    pub(super) seeds: u32,
    /// Of the trials that are counted, in their order.
    pub(super) measured: Vec<Measured>,
}

impl Tally {
    /// Nothing is counted yet.
    pub(super) fn new(plan: &Plan) -> Self {
        Self {
            name: plan.name.clone(),
            created: plan.created,
            scenario: Arc::clone(&plan.scenario),
            thresholds: plan.thresholds.clone(),
            seeds: plan.seeds,
            measured: Vec::new(),
        }
    }

    /// Counts the next trials, which measured `measured`, and makes of them what is stored.
    pub(super) fn extend(
        &mut self,
        experiment: i64,
        trials: Vec<StoredTrial>,
        measured: Vec<Measured>,
        now: i64,
    ) -> NewTrials {
        self.measured.extend(measured);
        let complete = self.measured.len() >= self.seeds as usize;
        let results = self.results(complete);
        NewTrials {
            experiment,
            trials,
            // What is made of numbers and names of ours can be written.
            results: serde_json::to_string(&results).unwrap_or_default(),
            completed: complete.then_some(now),
        }
    }

    fn results(&self, complete: bool) -> Results {
        let lines = Line::all(&self.measured);
        let verdict = complete.then(|| {
            let verdicts = Verdict::all(&self.scenario, &lines, &self.thresholds);
            let judged = |verdict: Verdict| Judged {
                threshold: verdict.threshold.to_string(),
                met: verdict.met,
                value: verdict.mean,
            };
            verdicts.into_iter().map(judged).collect()
        });
        let summary = lines.iter().map(|Line { metric, estimate }| Summary {
            metric: metric.name().to_owned(),
            unit: metric.unit().to_owned(),
            mean: estimate.mean,
            low: estimate.low,
            high: estimate.high,
            count: estimate.count as u32,
        });
        Results {
            summary: summary.collect(),
            verdict,
        }
    }

    /// How it ended, for people.
    pub(super) fn farewell(&self, state: ExperimentState) -> String {
        let done = self.measured.len();
        let successes = self
            .measured
            .iter()
            .filter(|measured| measured.get(Metric::Success) == Some(1.0))
            .count();
        let name = &self.name;
        format!("experiment “{name}” is {state}: {successes} of {done} trials succeeded")
    }
}

/// A trial as it is stored, under its number within the experiment.
pub(super) fn stored(number: u32, trial: &Trial) -> StoredTrial {
    let failures: Vec<_> = trial.failures.iter().map(ToString::to_string).collect();
    StoredTrial {
        number,
        seed: trial.seed,
        success: trial.is_success(),
        reason: (!trial.is_success()).then(|| failures.join("; ")),
        measured: trial.measured.values().to_vec(),
    }
}

/// What was measured of a trial, as it is stored. What this program has learned to measure since is
/// missing; `None` when a newer one has measured more.
pub(super) fn measured(trial: &StoredTrial) -> Option<Measured> {
    let mut values = [None; Metric::COUNT];
    let known = values.get_mut(..trial.measured.len())?;
    known.copy_from_slice(&trial.measured);
    Some(Measured::of(values))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trial_of_an_older_program_is_read_and_one_of_a_newer_is_not() {
        let trial = |measured| StoredTrial {
            number: 0,
            seed: 1,
            success: true,
            reason: None,
            measured,
        };
        let read = |count| measured(&trial(vec![Some(1.0); count]));
        let older = read(12).expect("read");
        assert_eq!(older.get(Metric::DistanceM), Some(1.0));
        assert_eq!(older.get(Metric::Stranded), None);
        assert!(read(Metric::COUNT).is_some());
        assert_eq!(read(Metric::COUNT + 1), None);
    }
}
