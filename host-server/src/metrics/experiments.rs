//! How experiments are doing.

use std::fmt::Write as _;

use crawler_records::ExperimentState;

use super::observed::family;
use crate::experiments::ExperimentNumbers;

/// Every state has a line, also one that no experiment is in.
pub(super) fn write(out: &mut String, numbers: ExperimentNumbers) {
    let states = ExperimentState::ALL.map(ExperimentState::name);
    let counts = numbers.states.map(|count| count as usize);
    family(
        out,
        "terracrawler_experiments",
        "Experiments of this server, by state",
        "state",
        states.into_iter().zip(counts),
    );
    let name = "terracrawler_experiment_trials";
    // Writing to a String does not fail.
    let _ = write!(
        out,
        "# HELP {name} Trials of experiments that were stored, by what they came to.\n\
         # TYPE {name} counter\n\
         {name}_total{{outcome=\"success\"}} {}\n\
         {name}_total{{outcome=\"failure\"}} {}\n",
        numbers.succeeded, numbers.failed
    );
}
