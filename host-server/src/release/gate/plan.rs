//! What a release is to be tried on: a file with scenarios and recordings.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crawler_experiments::scenarios::{self, Changes, Randomisation};
use crawler_sim::scenario::{Scenario, Threshold};
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_updates::gate::{MAX_ITEMS, MAX_NAME, MAX_REASON, rounded};
use serde::Deserialize;

/// Most seeds of a scenario.
const MOST_SEEDS: u32 = 1_000_000;
/// The last seed.
const LAST_SEED: u64 = (1 << 53) - 1;
/// Outputs of a robot that can part from a recording, as `replay` calls them. Nobody expects a panic.
const OUTPUTS: [&str; 6] = ["duty", "lamp", "message", "ranger", "reset", "state"];

/// The file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlanFile {
    #[serde(default)]
    evaluate: Vec<EvaluateTable>,
    #[serde(default)]
    replay: Vec<ReplayTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EvaluateTable {
    scenario: String,
    seeds: u32,
    #[serde(default = "first_seed")]
    seed: u64,
    robots: Option<u32>,
    randomisation: Option<String>,
    difficulty: Option<String>,
    #[serde(default)]
    set: Vec<String>,
    #[serde(default)]
    thresholds: Vec<Threshold>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ReplayTable {
    recording: PathBuf,
    #[serde(default)]
    expected: Vec<ExpectedTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ExpectedTable {
    robot: String,
    output: String,
    at_s: f64,
    why: String,
}

const fn first_seed() -> u64 {
    1
}

/// A plan, whose scenarios are there. Recordings are looked at when their turn comes.
pub(super) struct Plan {
    pub(super) tasks: Vec<Task>,
    pub(super) recordings: Vec<Recorded>,
}

/// A scenario to run.
#[derive(Debug)]
pub(super) struct Task {
    pub(super) scenario: Scenario,
    pub(super) seed: u64,
    pub(super) seeds: u32,
    /// Beside those of the scenario.
    pub(super) thresholds: Vec<Threshold>,
}

/// A recording to run.
#[derive(Debug)]
pub(super) struct Recorded {
    pub(super) path: PathBuf,
    pub(super) name: String,
    pub(super) expected: Vec<Expectation>,
}

/// Where a robot is expected to part from its recording.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Expectation {
    pub(super) robot: String,
    pub(super) output: String,
    pub(super) at_us: u64,
    pub(super) why: String,
}

impl Plan {
    /// Reads the text of a plan; files that it names are in `folder` unless it says otherwise.
    ///
    /// # Errors
    /// What is wrong with it, and where.
    pub(super) fn read(text: &[u8], folder: &Path) -> Result<Self, CliError> {
        let text = std::str::from_utf8(text).or_say(|_| "not UTF-8".to_owned())?;
        let file: PlanFile =
            toml::from_str(text).or_say(|error| error.to_string().trim_end().to_owned())?;
        let counts = [
            ("evaluate", file.evaluate.len()),
            ("replay", file.replay.len()),
        ];
        for (name, count) in counts {
            if count > MAX_ITEMS {
                return Err(CliError::new(format!("`{name}`: at most {MAX_ITEMS}")));
            }
        }
        if file.evaluate.is_empty() {
            return Err(CliError::new(
                "no scenario: a release is evaluated on one at least",
            ));
        }
        let tasks = file.evaluate.into_iter().map(|table| {
            let scenario = table.scenario.clone();
            task(table, folder).map_err(|error| error.of(scenario))
        });
        let recordings = file.replay.into_iter().map(|table| {
            let recording = table.recording.display().to_string();
            recorded(table, folder).map_err(|error| error.of(recording))
        });
        Ok(Self {
            tasks: tasks.collect::<Result<_, _>>()?,
            recordings: recordings.collect::<Result<_, _>>()?,
        })
    }
}

fn task(table: EvaluateTable, folder: &Path) -> Result<Task, CliError> {
    if !(1..=MOST_SEEDS).contains(&table.seeds) {
        return Err(CliError::new(format!("seeds: 1 to {MOST_SEEDS}")));
    }
    let last = table.seed.checked_add(u64::from(table.seeds) - 1);
    if last.is_none_or(|last| last > LAST_SEED) {
        return Err(CliError::new(format!(
            "seed: the last one is at most {LAST_SEED}"
        )));
    }
    let randomisation = table.randomisation.as_deref().map(|name| {
        let known = Randomisation::by_name(name);
        known.ok_or_else(|| CliError::new("randomisation: none, mild or wild"))
    });
    let changes = Changes {
        robots: table.robots,
        randomisation: randomisation.transpose()?,
        difficulty: table.difficulty.as_deref(),
        set: &table.set,
    };
    let comes_along = Scenario::names().any(|name| name == table.scenario);
    let name = if comes_along {
        table.scenario.clone()
    } else {
        folder.join(&table.scenario).display().to_string()
    };
    let scenario = changes.apply(scenarios::scenario(Some(&name))?)?;
    if scenario.robots == 0 {
        return Err(CliError::new("a world without robots cannot fail"));
    }
    if scenario.name.is_empty() || scenario.name.len() > MAX_NAME {
        return Err(CliError::new(format!("name: 1 to {MAX_NAME} bytes")));
    }
    let thresholds = scenario.thresholds.iter().chain(&table.thresholds);
    if !(1..=MAX_ITEMS).contains(&thresholds.clone().count()) {
        return Err(CliError::new(format!(
            "thresholds: 1 to {MAX_ITEMS}, or nothing is asked of the release"
        )));
    }
    let written = |value: f64| rounded(value).to_bits() == (value + 0.0).to_bits();
    if let Some(threshold) = thresholds.clone().find(|one| !written(one.value)) {
        return Err(CliError::new(format!(
            "{threshold}: at most six places behind the point"
        )));
    }
    Ok(Task {
        scenario,
        seed: table.seed,
        seeds: table.seeds,
        thresholds: table.thresholds,
    })
}

fn recorded(table: ReplayTable, folder: &Path) -> Result<Recorded, CliError> {
    let name = table.recording.file_name().and_then(|name| name.to_str());
    let fits = |name: &&str| name.len() <= MAX_NAME && !name.chars().any(char::is_control);
    let name = name.filter(fits);
    let name = name.ok_or_else(|| CliError::new(format!("a name of at most {MAX_NAME} bytes")))?;
    if table.expected.len() > MAX_ITEMS {
        return Err(CliError::new(format!(
            "expected: at most {MAX_ITEMS} differences"
        )));
    }
    let mut robots = BTreeSet::new();
    for one in &table.expected {
        // From there on it is another robot, and where it parts again means nothing.
        if !robots.insert(&one.robot) {
            return Err(CliError::new(format!("{}: a robot parts once", one.robot)));
        }
    }
    let expected = table.expected.iter().map(expectation);
    Ok(Recorded {
        name: name.to_owned(),
        expected: expected.collect::<Result<_, _>>()?,
        path: folder.join(table.recording),
    })
}

fn expectation(table: &ExpectedTable) -> Result<Expectation, CliError> {
    let wrong = |what: &str| Err(CliError::new(format!("{}: {what}", table.robot)));
    if !OUTPUTS.contains(&table.output.as_str()) {
        return wrong(&format!("output: one of {}", OUTPUTS.join(", ")));
    }
    if !(0.0..=1e9).contains(&table.at_s) {
        return wrong("at_s: seconds of the recording");
    }
    let robot = (1..=MAX_NAME).contains(&table.robot.len());
    let why = (1..=MAX_REASON).contains(&table.why.len());
    if !robot
        || !why
        || [&table.robot, &table.why]
            .iter()
            .any(|text| text.chars().any(char::is_control))
    {
        return wrong(&format!(
            "a robot has a name, and a reason 1 to {MAX_REASON} bytes on one line"
        ));
    }
    Ok(Expectation {
        robot: table.robot.clone(),
        output: table.output.clone(),
        // As `replay` prints it: to the microsecond.
        at_us: (table.at_s * 1e6).round() as u64,
        why: table.why.clone(),
    })
}
