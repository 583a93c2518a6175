//! Where results come from: enough to make them again, and to see why others differ.

use std::fmt::Write as _;

use crawler_sim::evaluate::Driver;
use crawler_sim::scenario::{Scenario, Trained};
use serde_json::{Value, json};

use super::{EvaluateArgs, repeat};
use crate::BUILD;

/// The program, and what it was asked for.
pub(super) struct Provenance<'a> {
    args: &'a EvaluateArgs,
    /// As it ran, with every change.
    scenario: &'a Scenario,
    /// The options that make the same runs again.
    options: String,
}

impl<'a> Provenance<'a> {
    /// Of runs of `scenario`, which `args` have made.
    pub(super) fn new(args: &'a EvaluateArgs, scenario: &'a Scenario) -> Self {
        let mut options = repeat(args, args.randomisation, &[]);
        for axis in &args.sweep {
            let _ = write!(options, " --sweep {}", super::quoted(&axis.to_string()));
        }
        if let Some(runs) = args.monte_carlo {
            let _ = write!(options, " --monte-carlo {runs}");
        } else {
            let _ = write!(options, " --seeds {}", args.seeds);
        }
        let _ = write!(options, " --seed {}", args.seed);
        if args.driver != Driver::Program {
            let _ = write!(options, " --driver {}", args.driver.name());
        }
        if let Some(path) = &args.policy {
            let path = path.display().to_string();
            let _ = write!(options, " --policy {}", super::quoted(&path));
        }
        if let Some(other) = &args.against {
            let other = super::quoted(&other.to_string());
            let _ = write!(options, " --against {other} --error {}", args.error);
        }
        Self {
            args,
            scenario,
            options,
        }
    }

    /// The scenario as it ran, in the form of its files.
    fn text(&self) -> String {
        // What was read can be written.
        self.scenario.to_toml().unwrap_or_default()
    }

    /// Lines that begin with `#`, for the head of a table.
    pub(super) fn comment(&self) -> String {
        let mut text = format!(
            "# terracrawler {BUILD}\n# terracrawler evaluate{}\n# randomisation {}; the \
             scenario as it ran:\n",
            self.options, self.scenario.randomisation
        );
        for line in self.text().lines() {
            // Writing to a String does not fail.
            let _ = writeln!(text, "#   {line}");
        }
        text
    }

    /// The same for programs.
    pub(super) fn json(&self) -> Value {
        let args = self.args;
        let sweep: Vec<_> = args.sweep.iter().map(ToString::to_string).collect();
        json!({
            "build": BUILD,
            "options": self.options.trim_start(),
            "scenario": args.scenario,
            "robots": args.robots,
            "difficulty": args.difficulty,
            "set": args.set,
            "sweep": sweep,
            "randomisation": self.scenario.randomisation.name(),
            "seed": args.seed,
            "driver": args.driver.name(),
            "policy": self.scenario.policy.as_ref().map(Trained::checksum),
            "text": self.text(),
        })
    }
}
