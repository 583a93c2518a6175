//! The tests of the workspace, run by cargo-nextest: all or some, once or again and again, on a quiet
//! machine or a busy one.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read as _;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::report::Report;
use crate::run::{self, Failure, Outcome};

/// The hidden command that keeps one core busy.
pub(crate) const BUSY: &str = "keep-a-core-busy";

/// How often the power is cut during an update of the emulated board, where properties are looked at deeply.
const DEEP_POWER_CUTS: &str = "300";

/// The suite that is every test of [`TIMED`].
const ALL_TIMED: &str = "timed";

/// Everything that has to do with sockets, processes or real time: what a busy machine could upset. Those are
/// the server's crates that have a runtime, and what starts them.
const TIMED: &str = "package(crawler-tests) | package(crawler-hil) | package(crawler-server) \
    | package(crawler-accounts) | package(crawler-api) | package(crawler-broker) \
    | package(crawler-calibrations) | package(crawler-cluster) | package(crawler-commands) \
    | package(crawler-counterfactuals) | package(crawler-database) \
    | package(crawler-experiments) | package(crawler-federation) | package(crawler-fleet) | package(crawler-history) \
    | package(crawler-passwords) | package(crawler-records) | package(crawler-rollouts) \
    | package(crawler-server-tls) | package(crawler-simulations) | package(crawler-system) \
    | package(crawler-timeseries) \
    | (package(crawler-sim) & kind(test))";

/// Which tests, how often, and beside what.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Selection {
    /// Each test runs so often.
    repeat: u32,
    /// Other processes keep every core busy meanwhile.
    under_load: bool,
    /// All of it has to do with one core.
    one_core: bool,
    /// Names of test programs, or parts of them, or of the paths of tests; all where there are none.
    suites: Vec<String>,
    /// The seed of property tests, and how many cases each of them tries; else those of
    /// `.cargo/config.toml`.
    properties: Option<(u64, u32)>,
}

impl Default for Selection {
    fn default() -> Self {
        Self {
            repeat: 1,
            under_load: false,
            one_core: false,
            suites: Vec::new(),
            properties: None,
        }
    }
}

impl Selection {
    /// Reads `[--repeat N] [--under-load] [--one-core] [SUITE]…`.
    ///
    /// # Errors
    /// When an argument is unknown or has no value.
    pub(crate) fn parse(arguments: &[String]) -> Outcome<Self> {
        let mut selection = Self::default();
        let mut words = arguments.iter();
        while let Some(word) = words.next() {
            match word.as_str() {
                "--repeat" => {
                    selection.repeat = words
                        .next()
                        .and_then(|count| count.parse().ok())
                        .filter(|&count| count > 0)
                        .ok_or_else(|| Failure("--repeat N, a number from 1".to_owned()))?;
                }
                "--under-load" => selection.under_load = true,
                "--one-core" => selection.one_core = true,
                option if option.starts_with('-') => {
                    return Err(Failure(format!("'{option}' is not understood")));
                }
                suite if suite.chars().all(is_plain) => selection.suites.push(suite.to_owned()),
                other => return Err(Failure(format!("'{other}' is no name of a suite"))),
            }
        }
        Ok(selection)
    }

    /// Everything that has to do with time, `repeat` times, on a busy machine.
    pub(crate) fn timed_under_load(repeat: u32) -> Self {
        Self {
            repeat,
            under_load: true,
            suites: vec![ALL_TIMED.to_owned()],
            ..Self::default()
        }
    }

    /// Everything, with `cases` for each property, drawn from `seed`; one that says a number of its own tries as many times
    /// more as the others.
    pub(crate) fn drawn_from(seed: u64, cases: u32) -> Self {
        Self {
            properties: Some((seed, cases)),
            ..Self::default()
        }
    }

    /// Builds the tests, and what they start.
    ///
    /// # Errors
    /// When one does not compile, or cargo-nextest is missing.
    pub(crate) fn build(&self) -> Outcome {
        run::run_command(self.command(&["run", "--no-run"], false))
    }

    /// Runs the tests, and tells `report` how long each program took.
    ///
    /// # Errors
    /// When a test fails, or cargo-nextest is missing.
    pub(crate) fn run(&self, report: &mut Report) -> Outcome {
        // Before other processes take the cores.
        self.build()?;
        let filter = self.filter()?;
        let _load = self.under_load.then(Load::start).transpose()?;
        let count = self.repeat.to_string();
        // Most of the time most tests wait for processes and sockets. Emulated boards run in real time:
        // where they cannot come first, less may run beside them.
        let in_time = run::output("chrt", &["--rr", "1", "true"]).is_some();
        let for_each_core = if in_time { 3 } else { 2 };
        let cores = if self.one_core { 1 } else { cores() };
        let at_once = (for_each_core * cores).to_string();
        let mut more = vec!["run", "--test-threads", &at_once];
        if let Some(filter) = &filter {
            more.extend(["--filterset", filter.as_str()]);
        }
        if self.repeat > 1 {
            more.extend(["--stress-count", count.as_str()]);
        }
        // Wherever cargo builds; what an earlier run left must not be taken for this one.
        let path = run::root().join("target/nextest/default/junit.xml");
        let _ = fs::remove_file(&path);
        let outcome = run::run_command(self.command(&more, self.one_core));
        if let Ok(text) = fs::read_to_string(path) {
            report.modules(module_times(&text));
        }
        outcome
    }

    fn command(&self, arguments: &[&str], one_core: bool) -> Command {
        let cargo = run::cargo_program();
        let mut command = if one_core {
            let mut command = Command::new("taskset");
            command.args(["--cpu-list", "0", &cargo]);
            command
        } else {
            Command::new(cargo)
        };
        command
            .current_dir(run::root())
            .stdin(Stdio::null())
            .arg("nextest")
            .args(arguments)
            .args(["--locked", "--workspace", "--all-features"]);
        if let Some((seed, cases)) = self.properties {
            command.env("PROPTEST_RNG_SEED", seed.to_string());
            command.env("PROPTEST_CASES", cases.to_string());
            command.env("CRAWLER_POWER_CUTS", DEEP_POWER_CUTS);
        }
        command
    }

    /// The tests whose program or path has the name of a suite, as cargo-nextest is told.
    fn filter(&self) -> Outcome<Option<String>> {
        if self.suites.is_empty() {
            return Ok(None);
        }
        let list = self.command(&["list", "--list-type", "binaries-only"], false);
        let programs =
            run::output_of(list).ok_or_else(|| Failure("cargo nextest list failed".to_owned()))?;
        Ok(Some(filter(&self.suites, &programs)))
    }
}

/// What names consist of, and no filter's syntax.
fn is_plain(letter: char) -> bool {
    letter.is_ascii_alphanumeric() || "-_:".contains(letter)
}

/// A filter for `suites`, where these are the test programs. cargo-nextest refuses one that names a
/// program that is none.
fn filter(suites: &[String], programs: &str) -> String {
    let one = |suite: &String| {
        if suite == ALL_TIMED {
            format!("({TIMED})")
        } else if programs.contains(suite.as_str()) {
            format!("binary_id(~{suite}) | test(~{suite})")
        } else {
            format!("test(~{suite})")
        }
    };
    suites.iter().map(one).collect::<Vec<_>>().join(" | ")
}

/// How long the tests of each module of each program took together, from a report in the form of `JUnit`.
fn module_times(junit: &str) -> BTreeMap<String, Duration> {
    let mut times = BTreeMap::new();
    for suite in junit.split("<testsuite ").skip(1) {
        let Some(program) = attribute(suite, "name") else {
            continue;
        };
        for case in suite.split("<testcase ").skip(1) {
            let time = attribute(case, "time").and_then(|time| time.parse::<f64>().ok());
            let took = time.and_then(|time| Duration::try_from_secs_f64(time).ok());
            let (Some(name), Some(took)) = (attribute(case, "name"), took) else {
                continue;
            };
            let of = match name.split_once("::") {
                Some((module, _)) => format!("{program} {module}"),
                None => program.to_owned(),
            };
            *times.entry(of).or_default() += took;
        }
    }
    times
}

/// The attribute `name` of the element that `text` begins within.
fn attribute<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let (element, _) = text.split_once('>')?;
    let (_, value) = element.split_once(&format!("{name}=\""))?;
    value.split('"').next()
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// A process for each core that does nothing but work, until this is dropped.
#[derive(Debug)]
struct Load(Vec<Child>);

impl Load {
    fn start() -> Outcome<Self> {
        let failed = |error| Failure(format!("cannot keep the cores busy: {error}"));
        let program = run::this_program()?;
        let cores = cores();
        let mut load = Self(Vec::new());
        for _ in 0..cores {
            let mut command = Command::new(program);
            command.arg(BUSY).stdin(Stdio::piped());
            load.0.push(command.spawn().map_err(failed)?);
        }
        println!("{cores} other processes keep the cores busy");
        Ok(load)
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for child in &mut self.0 {
            // Already ended is fine.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Keeps one core busy until whoever started it ends, however it ends: then its standard input does.
pub(crate) fn keep_a_core_busy() {
    std::thread::spawn(|| {
        loop {
            std::hint::spin_loop();
        }
    });
    // Nothing is ever written there.
    let _ = std::io::stdin().read(&mut [0]);
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Selection, TIMED, filter, module_times};
    use crate::run::root;

    fn parse(words: &[&str]) -> crate::run::Outcome<Selection> {
        let words: Vec<String> = words.iter().map(|&word| word.to_owned()).collect();
        Selection::parse(&words)
    }

    #[test]
    fn arguments_say_which_tests_how_often_and_beside_what() {
        assert_eq!(parse(&[]).expect("nothing"), Selection::default());
        let selection = parse(&["--repeat", "20", "--under-load", "link"]).expect("some");
        assert_eq!((selection.repeat, selection.under_load), (20, true));
        assert_eq!(selection.suites, ["link"]);
        for wrong in [
            &["--repeat"][..],
            &["--repeat", "0"],
            &["--quick"],
            &["a) | all("],
        ] {
            assert!(parse(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn every_crate_of_the_server_with_a_runtime_is_held_to_be_timed() {
        let crates = std::fs::read_dir(root().join("host-server")).expect("the server's crates");
        let mut seen = 0;
        for found in crates {
            let manifest = found.expect("an entry").path().join("Cargo.toml");
            let Ok(text) = std::fs::read_to_string(manifest) else {
                continue;
            };
            if !text.lines().any(|line| line.starts_with("tokio")) {
                continue;
            }
            let name = text.split('"').nth(1).expect("a name comes first");
            assert!(TIMED.contains(&format!("package({name})")), "{name}");
            seen += 1;
        }
        assert!(seen > 10, "{seen} crates with a runtime found");
    }

    #[test]
    fn a_name_is_that_of_a_program_or_of_a_test() {
        let programs = "crawler-sim\ncrawler-sim::live\n";
        let asked = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(|&word| word.to_owned()).collect();
            filter(&words, programs)
        };
        assert_eq!(asked(&["live"]), "binary_id(~live) | test(~live)");
        assert_eq!(asked(&["gyroscope"]), "test(~gyroscope)");
        assert!(asked(&["timed", "gyroscope"]).ends_with(") | test(~gyroscope)"));
    }

    #[test]
    fn times_are_added_up_for_each_module() {
        let junit = "<testsuites name=\"nextest-run\" time=\"9\">\n\
            <testsuite name=\"crawler-sim::suite\" tests=\"3\">\n\
            <testcase name=\"live::a\" classname=\"crawler-sim::suite\" time=\"1.25\">\n</testcase>\n\
            <testcase name=\"live::deep::b\" classname=\"crawler-sim::suite\" time=\"0.500\"/>\n\
            <testcase name=\"c\" classname=\"crawler-sim::suite\" time=\"2\"/></testsuite>\n\
            <testsuite name=\"crawler-hil\" tests=\"0\"></testsuite></testsuites>";
        let expected = [
            ("crawler-sim::suite", 2_000),
            ("crawler-sim::suite live", 1_750),
        ];
        let expected = expected.map(|(name, ms)| (name.to_owned(), Duration::from_millis(ms)));
        assert_eq!(module_times(junit), expected.into());
    }
}
