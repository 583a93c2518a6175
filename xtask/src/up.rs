//! The main job, from nothing: builds the control room and the server, and says how long that will take.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader, IsTerminal as _, Write as _};
use std::process::Stdio;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use crate::run::{self, Failure, Outcome};
use crate::ui;

/// What building takes, in seconds of one core; measured with `cargo build --timings`. It is the share that
/// counts: how fast this machine is, is seen while it builds.
const WEIGHTS: &[(&str, u32)] = &[
    ("crawler_api", 70),
    ("crawler_broker", 23),
    ("crawler_commands", 18),
    ("crawler_database", 11),
    ("crawler_experiments", 29),
    ("crawler_fleet", 13),
    ("crawler_history", 18),
    ("crawler_protocol", 15),
    ("crawler_records", 37),
    ("crawler_server", 45),
    ("crawler_sim", 140),
    ("crawler_simulations", 3),
    ("crawler_timeseries", 24),
    ("libsqlite3_sys", 44),
    ("redis", 18),
    ("regex_automata", 20),
    ("regex_syntax", 13),
    ("ring", 15),
    ("rmqtt", 30),
    ("rumqttc", 10),
    ("rustls", 24),
    ("sqlx_postgres", 24),
    ("sqlx_sqlite", 10),
    ("tokio", 11),
    ("utoipa", 13),
];

/// Of a crate that is not among [`WEIGHTS`].
const USUAL: u32 = 1;

/// Seconds for which the first guess, one second of weight in a second of each core, counts among what is
/// measured.
const GUESSED: f64 = 20.0;

/// What is done by then needs no word about it.
const PATIENCE: Duration = Duration::from_secs(2);

/// How often the line at a terminal is written anew.
const REFRESH: Duration = Duration::from_secs(1);

/// Starts the main job. The server still runs without a control room when Node.js is missing;
/// its page then says how to get it.
///
/// # Errors
/// When the server cannot be built or started.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    if let Err(Failure(reason)) = ui::build() {
        eprintln!("xtask up: starting without the control room: {reason}");
    }
    let words = ["--release", "--locked", "--package", "crawler-server"];
    build(&words)?;
    run::replace_with(
        &run::target_dir().join("release/terracrawler"),
        std::iter::once("up".to_owned()).chain(arguments.iter().cloned()),
    )
}

/// `cargo build` with `words`, and with what is left of it.
fn build(words: &[&str]) -> Outcome {
    let mut command = run::cargo_command("build");
    command
        .args(words)
        .args(["--quiet", "--message-format", "json-render-diagnostics"])
        .stdout(Stdio::piped());
    let failed = |error: std::io::Error| Failure(format!("cannot run cargo: {error}"));
    let mut child = command.spawn().map_err(failed)?;
    let (sender, built) = mpsc::channel();
    let output = child.stdout.take();
    let reader = thread::spawn(move || {
        let lines = output
            .into_iter()
            .flat_map(|out| BufReader::new(out).lines());
        for unit in lines
            .map_while(Result::ok)
            .filter_map(|line| Unit::of(&line))
        {
            // Whoever listened has failed and says so.
            let _ = sender.send(unit);
        }
    });
    let began = Instant::now();
    let mut seen = Vec::new();
    let mut progress: Option<Progress> = None;
    let mut shown = Shown::default();
    loop {
        let unit = match built.recv_timeout(REFRESH) {
            Ok(unit) => Some(unit),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => break,
        };
        let now = began.elapsed();
        seen.extend(unit);
        if progress.is_none() && now > PATIENCE {
            progress = Some(Progress::of(&packages(words), cores()));
        }
        if let Some(progress) = &mut progress {
            seen.drain(..).for_each(|unit| progress.take(unit, now));
            shown.tell(progress, now);
        }
    }
    shown.end();
    // It has no panic of its own.
    let _ = reader.join();
    let status = child.wait().map_err(failed)?;
    if status.success() {
        Ok(())
    } else {
        Err(Failure(format!(
            "the server cannot be built: cargo ended with {status}"
        )))
    }
}

fn cores() -> f64 {
    let cores = thread::available_parallelism().map_or(1, std::num::NonZero::get);
    u32::try_from(cores).map_or(1.0, f64::from)
}

/// The crates of a build with `words`: name, and how many versions of it.
fn packages(words: &[&str]) -> BTreeMap<String, u32> {
    let mut command = run::cargo_command("tree");
    let words = words.iter().filter(|word| **word != "--release");
    command.args(words).args([
        "--edges",
        "normal,build",
        "--prefix",
        "none",
        "--format",
        "{p}",
    ]);
    let listed = run::output_of(command).unwrap_or_default();
    let unique: BTreeSet<&str> = listed
        .lines()
        .map(|line| line.trim_end_matches(" (*)"))
        .collect();
    let mut packages = BTreeMap::new();
    for name in unique.iter().filter_map(|line| line.split(' ').next()) {
        *packages.entry(name.replace('-', "_")).or_default() += 1;
    }
    packages
}

fn weight(name: &str) -> f64 {
    let known = WEIGHTS.iter().find(|(known, _)| *known == name);
    f64::from(known.map_or(USUAL, |(_, weight)| *weight))
}

/// A crate that cargo has built, or found built.
#[derive(Debug, PartialEq, Eq)]
struct Unit {
    /// Name and version: what is for this machine and for build scripts alike, is built twice.
    package: String,
    name: String,
    fresh: bool,
}

impl Unit {
    /// Reads one of cargo's messages; none where it is about something else.
    fn of(line: &str) -> Option<Self> {
        let after = |mark: &str| Some(line.split_once(mark)?.1);
        let text = |mark: &str| Some(after(mark)?.split_once('"')?.0.to_owned());
        let artifact = line.starts_with("{\"reason\":\"compiler-artifact\"");
        let library = after("\"crate_types\":[\"").is_some_and(|kind| !kind.starts_with("bin"));
        (artifact && library).then_some(())?;
        let target = after("\"target\":{")?;
        Some(Self {
            package: text("\"package_id\":\"")?,
            name: target
                .split_once("\"name\":\"")?
                .1
                .split_once('"')?
                .0
                .replace('-', "_"),
            fresh: line.contains("\"fresh\":true"),
        })
    }
}

/// How far a build is.
#[derive(Debug)]
struct Progress {
    met: BTreeSet<String>,
    /// In seconds of weight, without what was there.
    all: f64,
    done: f64,
    cores: f64,
    /// What was left when the last crate was done, and when that was.
    left: Duration,
    at: Duration,
}

impl Progress {
    fn of(packages: &BTreeMap<String, u32>, cores: f64) -> Self {
        let weights = packages
            .iter()
            .map(|(name, count)| weight(name) * f64::from(*count));
        let all = weights.sum();
        Self {
            met: BTreeSet::new(),
            all,
            done: 0.0,
            cores,
            left: Duration::from_secs_f64(all / cores),
            at: Duration::ZERO,
        }
    }

    /// Counts a crate, `now` after the beginning.
    fn take(&mut self, unit: Unit, now: Duration) {
        if !self.met.insert(unit.package) {
            return;
        }
        let weight = weight(&unit.name).min(self.all - self.done);
        if unit.fresh {
            self.all -= weight;
        } else {
            self.done += weight;
        }
        let rate = (self.done + self.cores * GUESSED) / (now.as_secs_f64() + GUESSED);
        self.left = Duration::from_secs_f64((self.all - self.done) / rate);
        self.at = now;
    }

    /// Of the work, 0 to 100.
    fn percent(&self) -> u32 {
        let share = if self.all > 0.0 {
            self.done / self.all
        } else {
            1.0
        };
        // Between 0 and 100.
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let percent = (100.0 * share) as u32;
        percent
    }

    /// What is left `now` after the beginning. A large crate says nothing until it is done; what was
    /// expected of it passes meanwhile.
    fn left(&self, now: Duration) -> Duration {
        self.left.saturating_sub(now.saturating_sub(self.at))
    }

    fn line(&self, now: Duration) -> String {
        let mut line = format!("building the server: {} %", self.percent());
        let seconds = self.left(now).as_secs();
        // Writing to a string cannot fail.
        let _ = match seconds {
            0..5 => write!(line, ", nearly done"),
            5..60 => write!(line, ", about {} s left", seconds.div_ceil(10) * 10),
            _ => write!(line, ", about {} min left", seconds.div_ceil(60)),
        };
        line
    }
}

/// What the person at the terminal was told.
#[derive(Debug, Default)]
struct Shown {
    /// The last tenth that was told to a file.
    tenth: Option<u32>,
    open: bool,
}

impl Shown {
    fn tell(&mut self, progress: &Progress, now: Duration) {
        let mut terminal = std::io::stderr();
        if terminal.is_terminal() {
            // Nobody is there to read it any more, where this fails.
            let _ =
                write!(terminal, "\r\x1b[K{}", progress.line(now)).and_then(|()| terminal.flush());
            self.open = true;
        } else if self.tenth != Some(progress.percent() / 10) {
            self.tenth = Some(progress.percent() / 10);
            eprintln!("{}", progress.line(now));
        }
    }

    fn end(&mut self) {
        if self.open {
            eprint!("\r\x1b[K");
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::time::Duration;

    use super::{Progress, USUAL, Unit, weight};

    const fn seconds(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    fn unit(name: &str, fresh: bool) -> Unit {
        Unit {
            package: format!("registry#{name}@1.0.0"),
            name: name.to_owned(),
            fresh,
        }
    }

    fn ten() -> Progress {
        let packages: BTreeMap<String, u32> = (0..10).map(|n| (format!("crate_{n}"), 1)).collect();
        Progress::of(&packages, 2.0)
    }

    #[test]
    fn messages_of_cargo_are_read() {
        let line = r#"{"reason":"compiler-artifact","package_id":"registry+https://x#cfg-if@1.0.4","manifest_path":"/a","target":{"kind":["lib"],"crate_types":["lib"],"name":"cfg_if","src_path":"/b"},"features":[],"fresh":true}"#;
        assert_eq!(
            Unit::of(line),
            Some(Unit {
                package: "registry+https://x#cfg-if@1.0.4".to_owned(),
                name: "cfg_if".to_owned(),
                fresh: true,
            })
        );
        assert!(
            !Unit::of(&line.replace("true", "false"))
                .expect("a library")
                .fresh
        );
        for other in [
            line.replace("\"lib\"", "\"bin\""),
            line.replace("compiler-artifact", "build-script-executed"),
            String::new(),
            "warning".to_owned(),
            line[..60].to_owned(),
        ] {
            assert_eq!(Unit::of(&other), None, "{other}");
        }
    }

    #[test]
    fn what_is_left_follows_how_fast_it_goes() {
        let mut progress = ten();
        let first = progress.left(seconds(0));
        assert_eq!(first, seconds(u64::from(10 * USUAL) / 2));
        // Half of it, ten times slower than was thought.
        for n in 0..5 {
            progress.take(unit(&format!("crate_{n}"), false), seconds(50));
        }
        assert_eq!(progress.percent(), 50);
        assert!(progress.left(seconds(50)) > first / 2, "{progress:?}");
        // It passes while nothing is heard.
        let left = progress.left(seconds(50));
        assert_eq!(progress.left(seconds(51)) + seconds(1), left);
        assert_eq!(progress.left(seconds(5_000)), seconds(0));
    }

    #[test]
    fn what_was_there_does_not_count() {
        let mut progress = ten();
        for n in 0..8 {
            progress.take(unit(&format!("crate_{n}"), true), seconds(1));
        }
        assert_eq!(progress.percent(), 0);
        progress.take(unit("crate_8", false), seconds(2));
        // For build scripts as well.
        progress.take(unit("crate_8", false), seconds(2));
        assert_eq!(progress.percent(), 50);
        progress.take(unit("crate_9", false), seconds(3));
        assert_eq!(progress.percent(), 100);
        assert_eq!(progress.left(seconds(3)), seconds(0));
        assert_eq!(
            progress.line(seconds(3)),
            "building the server: 100 %, nearly done"
        );
    }

    #[test]
    fn more_than_was_listed_does_no_harm() {
        let mut progress = ten();
        for n in 0..30 {
            progress.take(unit(&format!("other_{n}"), n % 2 == 0), seconds(n));
        }
        assert_eq!(progress.percent(), 100);
        assert!(weight("crawler_server") > f64::from(USUAL));
    }
}
