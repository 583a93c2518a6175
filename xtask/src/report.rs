//! The steps of a long command: run in order, also after a failed one, and told about at the end.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use crate::run::{Failure, Outcome};

/// How many lines each list of the slowest has.
const SLOWEST: usize = 10;

/// What a command with several steps came to.
#[derive(Debug, Default)]
pub(crate) struct Report {
    steps: Vec<(&'static str, Duration)>,
    failed: Vec<&'static str>,
    modules: Vec<(String, Duration)>,
}

impl Report {
    /// Runs one step and keeps how long it took.
    pub(crate) fn step(&mut self, name: &'static str, run: impl FnOnce(&mut Self) -> Outcome) {
        println!("\n== {name}");
        let began = Instant::now();
        let outcome = run(self);
        let took = began.elapsed();
        self.steps.push((name, took));
        let seconds = took.as_secs();
        match outcome {
            Ok(()) => println!("== {name}: passed in {seconds} s"),
            Err(Failure(reason)) => {
                println!("== {name}: FAILED after {seconds} s: {reason}");
                self.failed.push(name);
            }
        }
    }

    /// Adds how long each test program took.
    pub(crate) fn modules(&mut self, times: impl IntoIterator<Item = (String, Duration)>) {
        self.modules.extend(times);
    }

    /// Prints what was slowest, and the count.
    ///
    /// # Errors
    /// Names the steps that failed.
    pub(crate) fn close(self) -> Outcome {
        let total: Duration = self.steps.iter().map(|(_, took)| *took).sum();
        let steps = self.steps.iter().map(|(name, took)| (*name, *took));
        print!("\n{}", slowest("steps", steps));
        if !self.modules.is_empty() {
            let modules = self.modules.iter();
            let modules = modules.map(|(name, took)| (name.as_str(), *took));
            let title = "modules of test programs, by the sum of their tests";
            print!("\n{}", slowest(title, modules));
        }
        println!("\n{} s in all", total.as_secs());
        // Alone on its line, as other tools look for it.
        println!(
            "{} passed, {} failed",
            self.steps.len() - self.failed.len(),
            self.failed.len()
        );
        if self.failed.is_empty() {
            Ok(())
        } else {
            Err(Failure(format!("failed: {}", self.failed.join(", "))))
        }
    }
}

/// The slowest of `times`, a line each.
fn slowest<'a>(what: &str, times: impl Iterator<Item = (&'a str, Duration)>) -> String {
    let mut times: Vec<_> = times.collect();
    times.sort_by_key(|(_, took)| std::cmp::Reverse(*took));
    let mut text = format!("slowest {what}:\n");
    for (name, took) in times.into_iter().take(SLOWEST) {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{:>7.1} s  {name}", took.as_secs_f64());
    }
    text
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Failure, Report, slowest};

    #[test]
    fn every_step_runs_and_failed_ones_are_named() {
        let mut report = Report::default();
        let mut ran = 0;
        report.step("first", |_| Err(Failure("broken".to_owned())));
        report.step("second", |_| {
            ran += 1;
            Ok(())
        });
        assert_eq!(ran, 1);
        let Err(Failure(reason)) = report.close() else {
            panic!("a failed step is forgotten");
        };
        assert_eq!(reason, "failed: first");
    }

    #[test]
    fn the_slowest_come_first_and_no_more_than_ten() {
        let names: Vec<String> = (0..12).map(|number| format!("step {number}")).collect();
        let times = names.iter().map(String::as_str);
        let text = slowest("steps", times.zip((0..12).map(Duration::from_secs)));
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 11);
        assert!(lines[1].ends_with("11.0 s  step 11"), "{text}");
        assert!(!text.contains("step 1\n") && !text.contains("step 0\n"));
    }
}
