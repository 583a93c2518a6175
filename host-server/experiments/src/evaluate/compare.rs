//! Runs held against earlier ones of the same seeds.
//!
//! Two runs of one seed have the same arena, the same places and the same noise; what differs between them is what
//! was changed. Their differences vary less than the runs do, so that fewer of them show it.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::Path;

use crawler_sim::evaluate::{Driver, Estimate, Trial, of_mean, of_paired_shares};
use crawler_sim::scenario::{Better, Metric};
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_system::text::read_text_up_to;
use serde::Deserialize;
use serde_json::{Map, Value};

/// Most bytes of a file of results: a million runs have some 600 MB.
const MAX_FILE: u64 = 1 << 30;

/// An earlier file of `--json`. What is not needed here is not looked at.
#[derive(Debug, Deserialize)]
struct File {
    scenario: String,
    provenance: Option<Map<String, Value>>,
    trials: Vec<Earlier>,
}

#[derive(Debug, Deserialize)]
struct Earlier {
    seed: u64,
    measured: HashMap<String, Option<f64>>,
    history: String,
}

/// Earlier runs, by seed.
#[derive(Debug)]
pub(super) struct Baseline {
    path: String,
    scenario: String,
    provenance: Map<String, Value>,
    trials: HashMap<u64, Earlier>,
}

impl Baseline {
    /// Reads what `evaluate --json` has written.
    ///
    /// # Errors
    /// One line: it cannot be read, or is something else.
    pub(super) fn read(path: &Path) -> Result<Self, CliError> {
        let told = |why: &dyn std::fmt::Display| format!("--compare {}: {why}", path.display());
        let text = read_text_up_to(path, MAX_FILE).or_say(|error| told(error))?;
        let file: File = serde_json::from_str(&text)
            .or_say(|error| told(&format!("not a file of `evaluate --json`: {error}")))?;
        if file.trials.is_empty() {
            return Err(CliError::new(told(&"there is no run in it")));
        }
        let mut trials = HashMap::new();
        for trial in file.trials {
            if let Some(twice) = trials.insert(trial.seed, trial) {
                let text = told(&format!("seed {} is in it twice", twice.seed));
                return Err(CliError::new(text));
            }
        }
        Ok(Self {
            path: path.display().to_string(),
            scenario: file.scenario,
            provenance: file.provenance.unwrap_or_default(),
            trials,
        })
    }

    /// A table of differences, for people.
    pub(super) fn table(&self, scenario: &str, provenance: &Value, trials: &[Trial]) -> String {
        let pairs: Vec<(&Earlier, &Trial)> = trials
            .iter()
            .filter_map(|trial| Some((self.trials.get(&trial.seed)?, trial)))
            .collect();
        let same = pairs.iter().filter(|(earlier, trial)| {
            u64::from_str_radix(&earlier.history, 16) == Ok(trial.history)
        });
        let mut text = format!(
            "\ncompared with {}: {} pairs of runs of one seed, {} of them with the same history\n",
            self.path,
            pairs.len(),
            same.count()
        );
        if self.scenario != scenario {
            // Writing to a String does not fail.
            let _ = writeln!(text, "  it is of another scenario: {}", self.scenario);
        }
        let differing: Vec<String> = KEYS
            .into_iter()
            .filter_map(|key| differing(key, self.provenance.get(key), provenance.get(key)))
            .collect();
        if !differing.is_empty() {
            let _ = writeln!(text, "  differing in: {}", differing.join(", "));
        }
        if pairs.is_empty() {
            return text;
        }
        let _ = writeln!(
            text,
            "\n  {:<20} {:>10} {:>10} {:>10}   {:^23} {:>5}",
            "metric", "earlier", "now", "change", "95 % interval", "pairs"
        );
        for metric in Metric::ALL {
            if let Some(line) = line(metric, &pairs) {
                text.push_str(&line);
            }
        }
        text.push_str(
            "\n  intervals: Bonett and Price's for success, Student's t for the others\n",
        );
        text
    }
}

/// What of the provenance may explain a difference.
const KEYS: [&str; 4] = ["driver", "build", "randomisation", "text"];

/// What differs in `key`, where something does; what fits into the line is told with what it was and is.
fn differing(key: &str, before: Option<&Value>, now: Option<&Value>) -> Option<String> {
    // Files from before there were drivers do not name any.
    let program = Value::from(Driver::Program.name());
    let before = before.or((key == "driver").then_some(&program));
    if before == now {
        return None;
    }
    let shown = |value: Option<&Value>| value.and_then(Value::as_str).map(str::to_owned);
    let (before, now) = (shown(before), shown(now)?);
    Some(match before {
        _ if key == "text" => "the scenario".to_owned(),
        Some(before) => format!("{key} ({before}, now {now})"),
        None => format!("{key} (now {now})"),
    })
}

/// One metric of the pairs of which both have it.
fn line(metric: Metric, pairs: &[(&Earlier, &Trial)]) -> Option<String> {
    let both: Vec<(f64, f64)> = pairs
        .iter()
        .filter_map(|(earlier, trial)| {
            let before = earlier.measured.get(metric.name()).copied().flatten()?;
            Some((before, trial.measured.get(metric)?))
        })
        .collect();
    let change = change(metric, &both)?;
    let mean = |of: fn(&(f64, f64)) -> f64| both.iter().map(of).sum::<f64>() / both.len() as f64;
    Some(format!(
        "  {:<20} {:>10.4} {:>10.4} {:>+10.4}   {:>+10.4} … {:>+10.4} {:>5}{}\n",
        metric.name(),
        mean(|pair| pair.0),
        mean(|pair| pair.1),
        change.mean,
        change.low,
        change.high,
        change.count,
        verdict(metric.better(), &change)
    ))
}

fn change(metric: Metric, both: &[(f64, f64)]) -> Option<Estimate> {
    if metric == Metric::Success {
        let count = |from: bool, to: bool| {
            let as_asked = |&&(before, now): &&(f64, f64)| (before > 0.5, now > 0.5) == (from, to);
            both.iter().filter(as_asked).count()
        };
        return of_paired_shares(count(false, true), count(true, false), both.len());
    }
    let changes: Vec<f64> = both.iter().map(|(before, now)| now - before).collect();
    of_mean(&changes)
}

/// Whether it is better, where the interval leaves no doubt; one pair always does.
fn verdict(better: Better, change: &Estimate) -> &'static str {
    let sure = change.count > 1 && (change.low > 0.0 || change.high < 0.0);
    match better {
        Better::More | Better::Less if !sure => "",
        Better::Neither => "",
        Better::More if change.mean > 0.0 => "  better",
        Better::Less if change.mean < 0.0 => "  better",
        Better::More | Better::Less => "  worse",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_differs_is_named_with_what_it_was() {
        let text = |text: &str| Value::from(text);
        let of = |key, before: Option<&str>, now: &str| {
            differing(key, before.map(text).as_ref(), Some(&text(now)))
        };
        assert_eq!(of("driver", Some("wander"), "wander"), None);
        assert_eq!(of("driver", None, "program"), None);
        let driver = of("driver", Some("wander"), "program");
        assert_eq!(driver.as_deref(), Some("driver (wander, now program)"));
        assert_eq!(
            of("driver", None, "ideal").as_deref(),
            Some("driver (program, now ideal)")
        );
        assert_eq!(
            of("build", None, "0.3.0 (a-b)").as_deref(),
            Some("build (now 0.3.0 (a-b))")
        );
        let scenario = of("text", Some("a\nb"), "a\nc");
        assert_eq!(scenario.as_deref(), Some("the scenario"));
    }

    #[test]
    fn a_change_counts_where_its_interval_has_one_sign() {
        let pairs: Vec<(f64, f64)> = (0..10)
            .map(|i| (f64::from(i), f64::from(i) + 2.0))
            .collect();
        let time = change(Metric::TimeToGoalS, &pairs).expect("pairs");
        assert_eq!((time.mean, time.low, time.high), (2.0, 2.0, 2.0));
        assert_eq!(verdict(Metric::TimeToGoalS.better(), &time), "  worse");
        assert_eq!(verdict(Metric::Reached.better(), &time), "  better");
        assert_eq!(verdict(Metric::DistanceM.better(), &time), "");
        let one = change(Metric::TimeToGoalS, &pairs[..1]).expect("a pair");
        assert_eq!(verdict(Metric::TimeToGoalS.better(), &one), "");
        // Three of four gained are too few to be sure of.
        let few = [(0.0, 1.0), (0.0, 1.0), (0.0, 1.0), (1.0, 1.0)];
        let success = change(Metric::Success, &few).expect("pairs");
        assert_eq!(success.mean, 0.75);
        let many: Vec<_> = few.iter().copied().cycle().take(40).collect();
        let success = change(Metric::Success, &many).expect("pairs");
        assert_eq!(verdict(Metric::Success.better(), &success), "  better");
        assert_eq!(change(Metric::Success, &[]), None);
    }
}
