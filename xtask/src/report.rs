//! The steps of a long command: run in order, also after a failed one, and told about at the end.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use crate::run::{Failure, Outcome};

/// How many lines each list of the slowest has.
const SLOWEST: usize = 10;

/// What a line about a step begins with, and what follows its name when it is over.
const MARK: &str = "== ";
const PASSED: &str = ": passed in ";
const FAILED: &str = ": FAILED after ";

/// What a command with several steps came to.
#[derive(Debug)]
pub(crate) struct Report {
    began: Instant,
    steps: Vec<(String, Duration)>,
    failed: Vec<String>,
    modules: Vec<(String, Duration)>,
}

impl Default for Report {
    fn default() -> Self {
        Self {
            began: Instant::now(),
            steps: Vec::new(),
            failed: Vec::new(),
            modules: Vec::new(),
        }
    }
}

impl Report {
    /// Runs one step and keeps how long it took.
    pub(crate) fn step(&mut self, name: &'static str, run: impl FnOnce(&mut Self) -> Outcome) {
        println!("\n{MARK}{name}");
        let began = Instant::now();
        let outcome = run(self);
        let took = began.elapsed();
        self.steps.push((name.to_owned(), took));
        let seconds = took.as_secs();
        match outcome {
            Ok(()) => println!("{MARK}{name}{PASSED}{seconds} s"),
            Err(Failure(reason)) => {
                println!("{MARK}{name}{FAILED}{seconds} s: {reason}");
                self.failed.push(name.to_owned());
            }
        }
    }

    /// Adds the steps of another process from what its report `printed`, and says whether one of them failed.
    pub(crate) fn steps_of(&mut self, printed: &str) -> bool {
        let before = self.failed.len();
        for line in printed.lines() {
            let Some(line) = line.strip_prefix(MARK) else {
                continue;
            };
            let passed = line.split_once(PASSED);
            let failed = || line.split_once(FAILED);
            let Some((name, rest)) = passed.or_else(failed) else {
                continue;
            };
            let digits = rest.split(' ').next().unwrap_or_default();
            let seconds = digits.parse().unwrap_or_default();
            self.steps
                .push((name.to_owned(), Duration::from_secs(seconds)));
            if passed.is_none() {
                self.failed.push(name.to_owned());
            }
        }
        self.failed.len() > before
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
        let steps = self.steps.iter();
        let steps = steps.map(|(name, took)| (name.as_str(), *took));
        print!("\n{}", slowest("steps", steps));
        if !self.modules.is_empty() {
            let modules = self.modules.iter();
            let modules = modules.map(|(name, took)| (name.as_str(), *took));
            let title = "modules of test programs, by the sum of their tests";
            print!("\n{}", slowest(title, modules));
        }
        println!("\n{} s in all", self.began.elapsed().as_secs());
        // Alone on its line, as other tools look for it.
        println!(
            "{} passed, {} failed",
            self.steps.len() - self.failed.len(),
            self.failed.len()
        );
        self.outcome()
    }

    /// The same without a word.
    ///
    /// # Errors
    /// Names the steps that failed.
    pub(crate) fn outcome(&self) -> Outcome {
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
    fn steps_of_another_process_count() {
        let mut report = Report::default();
        let printed = "\n== images\nlinked\n== images: passed in 160 s\n";
        assert!(!report.steps_of(printed));
        let printed = format!("{printed}== lints: FAILED after 4 s: `cargo: passed in` ended\n");
        assert!(report.steps_of(&printed));
        let names: Vec<_> = report.steps.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["images", "images", "lints"]);
        assert_eq!(report.steps[0].1, Duration::from_secs(160));
        let Err(Failure(reason)) = report.close() else {
            panic!("a failed step of another process is forgotten");
        };
        assert_eq!(reason, "failed: lints");
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
