//! What a release was tried on, and what came of it.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// The format of reports that is read and written here.
pub const GATE_FORMAT: u8 = 1;
/// Most evaluations, most replays, most thresholds of an evaluation, and most differences that are named of a replay.
pub const MAX_ITEMS: usize = 32;
/// Longest name in a report, in bytes: of a scenario, a recording, a metric, a robot, an output.
pub const MAX_NAME: usize = 64;
/// Longest reason for a difference, in bytes.
pub const MAX_REASON: usize = 160;
/// The output of a robot whose program panicked in a replay, which is never expected.
pub const PANIC: &str = "panic";
/// Largest number, either way, of a metric.
const MOST: f64 = 1e9;
/// Last seed that every reader of JSON has to the last digit.
const MAX_SEED: u64 = (1 << 53) - 1;

/// What is wrong with a report: the name of a field that is outside of its limits, or contradicts another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReportFault(pub &'static str);

impl fmt::Display for ReportFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "`{}` is outside of its limits, or contradicts another field",
            self.0
        )
    }
}

impl std::error::Error for ReportFault {}

/// A SHA-256; in JSON 64 hexadecimal digits in lower case.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Digest(pub [u8; 32]);

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::str::FromStr for Digest {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const EXPECTED: &str = "must be 64 hexadecimal digits in lower case";
        let digit = |digit: u8| match digit {
            b'0'..=b'9' => Some(digit - b'0'),
            b'a'..=b'f' => Some(digit - b'a' + 10),
            _ => None,
        };
        let digits: &[u8; 64] = text.as_bytes().try_into().map_err(|_| EXPECTED)?;
        let (pairs, _) = digits.as_chunks::<2>();
        let mut bytes = [0; 32];
        for (byte, [high, low]) in bytes.iter_mut().zip(pairs) {
            let (high, low) = digit(*high).zip(digit(*low)).ok_or(EXPECTED)?;
            *byte = high << 4 | low;
        }
        Ok(Self(bytes))
    }
}

impl Serialize for Digest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(de::Error::custom)
    }
}

/// A report on a release.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GateReport {
    /// [`GATE_FORMAT`].
    pub format: u8,
    /// Id of the release, which is a hash of its manifest, and so names its image and its build.
    pub release: String,
    /// Build id of the release, for people.
    pub build: String,
    /// When the report was made, Unix time in seconds.
    pub made: u64,
    /// What was run.
    pub evaluator: Evaluator,
    /// SHA-256 of the file that said what to run.
    pub plan: Digest,
    /// Scenarios, each on many seeds. At least one.
    pub evaluations: Vec<Evaluated>,
    /// Recordings.
    pub replays: Vec<Replayed>,
    /// Whether everything came out as it should: [`GateReport::outcome`].
    pub passed: bool,
}

/// The program that was run: that of the command line that made the report.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Evaluator {
    /// Version of the command line.
    pub version: String,
    /// Version of the protocol that its robots speak.
    pub protocol: u8,
    /// SHA-256 of the sources of the robot program in it. `cargo xtask image` prints that of an image.
    pub program: Digest,
}

/// A scenario on many seeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Evaluated {
    /// Its name.
    pub scenario: String,
    /// SHA-256 of the whole scenario, as it was run.
    pub sha256: Digest,
    /// Robots in each run.
    pub robots: u32,
    /// The first seed.
    pub seed: u64,
    /// How many seeds.
    pub seeds: u32,
    /// Runs in which everything came out as the scenario wants it.
    pub successes: u32,
    /// What the runs had to come to together. At least one.
    pub thresholds: Vec<Threshold>,
}

/// What the runs of a scenario had to come to, and have come to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Threshold {
    /// Of which metric.
    pub metric: String,
    /// How much was asked for.
    pub bound: Bound,
    /// What came of it; `None` where no run has this metric.
    pub measured: Option<Estimate>,
}

/// A bound of a mean.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(clippy::exhaustive_enums)] // there are two sides
pub enum Bound {
    /// It must be at least this.
    AtLeast(f64),
    /// It must be at most this.
    AtMost(f64),
}

/// A mean, and the interval in which the true one lies with 95 % confidence: Wilson's for shares of runs that
/// succeed, Student's for others. Numbers have at most six places behind the point, see [`rounded`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
    /// Runs that have the metric.
    pub runs: u32,
}

/// A recording that was replayed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Replayed {
    /// Name of its file, without folders.
    pub recording: String,
    /// SHA-256 of the file.
    pub sha256: Digest,
    /// Robots in it.
    pub robots: u32,
    /// Robots that do what they did.
    pub same: u32,
    /// Where others part from what they did, and what was expected to.
    pub differences: Vec<Parted>,
    /// Robots that part from what they did and are not named, for want of room.
    pub more: u32,
}

/// Where a robot parts from what it did in a recording, for the first time.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parted {
    /// The robot.
    pub robot: String,
    /// Which output: `duty`, `lamp`, `state`, `message`, `ranger`, `reset`, or [`PANIC`].
    pub output: String,
    /// When, in microseconds of the recording; 0 for a panic.
    pub at_us: u64,
    /// Whether that was expected.
    pub finding: Finding,
    /// Why it was, as the plan says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// What a difference is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(clippy::exhaustive_enums)] // found or not, expected or not
pub enum Finding {
    /// It was expected, and found.
    Expected,
    /// It was found, and not expected.
    Unexpected,
    /// It was expected, and not found.
    Missing,
}

/// A number as a report has it: to six places behind the point, so that every reader of JSON reads what was written.
#[must_use]
pub fn rounded(number: f64) -> f64 {
    // Adding zero leaves no negative one.
    (number * 1e6).round() / 1e6 + 0.0
}

fn fits(fits: bool, field: &'static str) -> Result<(), ReportFault> {
    if fits {
        Ok(())
    } else {
        Err(ReportFault(field))
    }
}

/// Whether a text is one of at most so many bytes that a terminal and a page can show.
fn is_text(text: &str, most: usize) -> bool {
    (1..=most).contains(&text.len()) && !text.chars().any(char::is_control)
}

fn is_number(number: f64) -> bool {
    // In the bits, so that there is one zero.
    number.abs() <= MOST && rounded(number).to_bits() == number.to_bits()
}

impl Threshold {
    /// Whether what came of it is enough.
    #[must_use]
    pub fn is_met(&self) -> bool {
        self.measured.is_some_and(|measured| match self.bound {
            Bound::AtLeast(least) => measured.mean >= least,
            Bound::AtMost(most) => measured.mean <= most,
        })
    }

    fn validate(&self, seeds: u32) -> Result<(), ReportFault> {
        fits(is_text(&self.metric, MAX_NAME), "metric")?;
        let (Bound::AtLeast(bound) | Bound::AtMost(bound)) = self.bound;
        fits(is_number(bound), "bound")?;
        let Some(Estimate {
            mean,
            low,
            high,
            runs,
        }) = self.measured
        else {
            return Ok(());
        };
        let numbers = [mean, low, high].into_iter().all(is_number);
        let ordered = low <= mean && mean <= high && (1..=seeds).contains(&runs);
        fits(numbers && ordered, "measured")
    }
}

impl Evaluated {
    /// Whether every threshold is met.
    #[must_use]
    pub fn is_met(&self) -> bool {
        self.thresholds.iter().all(Threshold::is_met)
    }

    fn validate(&self) -> Result<(), ReportFault> {
        fits(is_text(&self.scenario, MAX_NAME), "scenario")?;
        fits(self.robots > 0, "robots")?;
        fits(self.seeds > 0, "seeds")?;
        let last = self.seed.checked_add(u64::from(self.seeds) - 1);
        fits(last.is_some_and(|last| last <= MAX_SEED), "seed")?;
        fits(self.successes <= self.seeds, "successes")?;
        fits(
            (1..=MAX_ITEMS).contains(&self.thresholds.len()),
            "thresholds",
        )?;
        self.thresholds
            .iter()
            .try_for_each(|threshold| threshold.validate(self.seeds))
    }
}

impl Replayed {
    /// Whether every robot did what it did, but for what was expected, and all of that.
    #[must_use]
    pub fn is_as_expected(&self) -> bool {
        let mut differences = self.differences.iter();
        self.more == 0 && differences.all(|one| one.finding == Finding::Expected)
    }

    fn validate(&self) -> Result<(), ReportFault> {
        fits(is_text(&self.recording, MAX_NAME), "recording")?;
        fits(self.robots > 0, "robots")?;
        fits(self.differences.len() <= MAX_ITEMS, "differences")?;
        self.differences.iter().try_for_each(Parted::validate)?;
        let found = self.differences.iter();
        let found = found.filter(|one| one.finding != Finding::Missing).count() as u64;
        let all = u64::from(self.same) + found + u64::from(self.more);
        fits(all == u64::from(self.robots), "same")
    }
}

impl Parted {
    fn validate(&self) -> Result<(), ReportFault> {
        fits(is_text(&self.robot, MAX_NAME), "robot")?;
        fits(is_text(&self.output, MAX_NAME), "output")?;
        fits(self.at_us <= MAX_SEED, "at_us")?;
        let expected = self.finding != Finding::Unexpected;
        fits(!(expected && self.output == PANIC), "finding")?;
        match &self.why {
            Some(why) => fits(expected && is_text(why, MAX_REASON), "why"),
            None => fits(!expected, "why"),
        }
    }
}

impl GateReport {
    /// Whether everything came out as it should: every threshold is met, and every recording gives what it did but
    /// for the differences that were expected, all of which are there.
    #[must_use]
    pub fn outcome(&self) -> bool {
        self.evaluations.iter().all(Evaluated::is_met)
            && self.replays.iter().all(Replayed::is_as_expected)
    }

    /// Whether the report is within its limits, and its parts fit each other.
    ///
    /// # Errors
    /// [`ReportFault`] names the field that is not.
    pub fn validate(&self) -> Result<(), ReportFault> {
        fits(self.format == GATE_FORMAT, "format")?;
        let digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        let id = self.release.len() == 16 && self.release.bytes().all(digit);
        fits(id, "release")?;
        fits(is_text(&self.build, MAX_NAME), "build")?;
        fits(self.made <= MAX_SEED, "made")?;
        fits(is_text(&self.evaluator.version, MAX_NAME), "version")?;
        let count = self.evaluations.len();
        fits((1..=MAX_ITEMS).contains(&count), "evaluations")?;
        self.evaluations.iter().try_for_each(Evaluated::validate)?;
        fits(self.replays.len() <= MAX_ITEMS, "replays")?;
        self.replays.iter().try_for_each(Replayed::validate)?;
        fits(self.passed == self.outcome(), "passed")
    }
}
