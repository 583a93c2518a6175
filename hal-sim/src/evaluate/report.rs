//! What many runs came to, for people and for programs.

use std::fmt::Write as _;

use serde_json::{Map, Value, json};

use super::metrics::Measured;
use super::statistics::{Estimate, of_mean, of_share};
use super::trial::Trial;
use crate::scenario::{Metric, Scenario, Threshold};

/// What the runs of one scenario came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// Name of the scenario.
    pub scenario: String,
    /// Robots in each run.
    pub robots: u32,
    /// The runs, in the order of their seeds.
    pub trials: Vec<Trial>,
    /// Means over the runs.
    pub lines: Vec<Line>,
    /// What was asked of them.
    pub verdicts: Vec<Verdict>,
}

/// One metric over all runs that have it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Which.
    pub metric: Metric,
    /// Its mean and its interval: Wilson's for [`Metric::Success`], Student's for the others.
    pub estimate: Estimate,
}

/// A threshold, and whether it is met.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// What was asked.
    pub threshold: Threshold,
    /// The mean, where there is one.
    pub mean: Option<f64>,
    /// Whether it is enough.
    pub met: bool,
}

impl Line {
    /// Every metric that at least one run has, in the order of [`Metric::ALL`].
    #[must_use]
    pub fn all(runs: &[Measured]) -> Vec<Self> {
        let line = |metric: Metric| {
            let values: Vec<f64> = runs.iter().filter_map(|run| run.get(metric)).collect();
            let estimate = if metric == Metric::Success {
                let successes = values.iter().filter(|&&value| value > 0.5);
                of_share(successes.count(), values.len())
            } else {
                of_mean(&values)
            };
            Some(Self {
                metric,
                estimate: estimate?,
            })
        };
        Metric::ALL.into_iter().filter_map(line).collect()
    }
}

impl Verdict {
    /// What `lines` come to against the thresholds of the scenario and some more; one that both have
    /// counts once.
    #[must_use]
    pub fn all(scenario: &Scenario, lines: &[Line], more: &[Threshold]) -> Vec<Self> {
        let judge = |&threshold: &Threshold| {
            let line = lines.iter().find(|line| line.metric == threshold.metric);
            let mean = line.map(|line| line.estimate.mean);
            Self {
                threshold,
                mean,
                met: threshold.is_met(mean),
            }
        };
        let own = &scenario.thresholds;
        let others = more.iter().filter(|threshold| !own.contains(threshold));
        own.iter().chain(others).map(judge).collect()
    }
}

impl Evaluation {
    /// Sums runs up, against the thresholds of the scenario and some more.
    #[must_use]
    pub fn new(scenario: &Scenario, trials: Vec<Trial>, more: &[Threshold]) -> Self {
        let measured: Vec<Measured> = trials.iter().map(|trial| trial.measured).collect();
        let lines = Line::all(&measured);
        let verdicts = Verdict::all(scenario, &lines, more);
        Self {
            scenario: scenario.name.clone(),
            robots: scenario.robots,
            verdicts,
            lines,
            trials,
        }
    }

    /// Whether every threshold is met.
    #[must_use]
    pub fn is_met(&self) -> bool {
        self.verdicts.iter().all(|verdict| verdict.met)
    }

    /// The mean of a metric.
    #[must_use]
    pub fn mean(&self, metric: Metric) -> Option<f64> {
        let line = self.lines.iter().find(|line| line.metric == metric);
        line.map(|line| line.estimate.mean)
    }

    /// The runs that failed.
    pub fn failed(&self) -> impl Iterator<Item = &Trial> {
        self.trials.iter().filter(|trial| !trial.is_success())
    }

    /// A table for people.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = format!(
            "{}: {} robots, {} runs\n\n  {:<20} {:>10}   {:^23} {:>10} {:>10} {:>5}\n",
            self.scenario,
            self.robots,
            self.trials.len(),
            "metric",
            "mean",
            "95 % interval",
            "least",
            "most",
            "runs"
        );
        for Line { metric, estimate } in &self.lines {
            // Writing to a String does not fail.
            let _ = writeln!(
                text,
                "  {:<20} {:>10.4}   {:>10.4} … {:>10.4} {:>10.4} {:>10.4} {:>5}",
                metric.name(),
                estimate.mean,
                estimate.low,
                estimate.high,
                estimate.least,
                estimate.most,
                estimate.count
            );
        }
        text.push_str("\n  intervals: Wilson's for success, Student's t for the others\n");
        for verdict in &self.verdicts {
            let mean = verdict.mean.map_or_else(
                || "nothing was measured".to_owned(),
                |mean| format!("{mean:.4}"),
            );
            let word = if verdict.met { "met" } else { "NOT MET" };
            let _ = writeln!(text, "  threshold {}: {word} ({mean})", verdict.threshold);
        }
        text
    }

    /// A line for each run, with a head.
    #[must_use]
    pub fn csv(&self) -> String {
        let names: Vec<_> = Metric::ALL.iter().map(|metric| metric.name()).collect();
        let mut text = format!("seed,{},ran_s,history,failures\n", names.join(","));
        for trial in &self.trials {
            let _ = write!(text, "{}", trial.seed);
            for metric in Metric::ALL {
                match trial.measured.get(metric) {
                    Some(value) => {
                        let _ = write!(text, ",{value}");
                    }
                    None => text.push(','),
                }
            }
            let failures: Vec<_> = trial.failures.iter().map(ToString::to_string).collect();
            let failures = failures.join("; ").replace('"', "\"\"");
            let _ = writeln!(
                text,
                ",{},{:016x},\"{failures}\"",
                trial.ran_s, trial.history
            );
        }
        text
    }

    /// Everything.
    #[must_use]
    pub fn json(&self) -> Value {
        let metrics: Map<String, Value> = self
            .lines
            .iter()
            .map(|Line { metric, estimate }| {
                let value = json!({
                    "mean": estimate.mean,
                    "low": estimate.low,
                    "high": estimate.high,
                    "least": estimate.least,
                    "most": estimate.most,
                    "runs": estimate.count,
                });
                (metric.name().to_owned(), value)
            })
            .collect();
        let thresholds: Vec<_> = self
            .verdicts
            .iter()
            .map(|verdict| {
                json!({
                    "threshold": verdict.threshold.to_string(),
                    "mean": verdict.mean,
                    "met": verdict.met,
                })
            })
            .collect();
        let trials: Vec<_> = self.trials.iter().map(of_trial).collect();
        json!({
            "scenario": self.scenario,
            "robots": self.robots,
            "confidence": 0.95,
            "intervals": { "success": "Wilson", "others": "Student's t" },
            "metrics": metrics,
            "thresholds": thresholds,
            "met": self.is_met(),
            "trials": trials,
        })
    }
}

fn of_trial(trial: &Trial) -> Value {
    let measured: Map<String, Value> = Metric::ALL
        .into_iter()
        .map(|metric| (metric.name().to_owned(), json!(trial.measured.get(metric))))
        .collect();
    let failures: Vec<_> = trial
        .failures
        .iter()
        .map(|failure| json!({ "criterion": failure.criterion.name(), "what": failure.what }))
        .collect();
    json!({
        "seed": trial.seed,
        "measured": measured,
        "failures": failures,
        "ran_s": trial.ran_s,
        "history": format!("{:016x}", trial.history),
    })
}
