//! How often twins find something wrong with robots that have nothing: simulated robots with bodies that nobody knows are
//! calibrated, drive about for half an hour each, and are followed. `cargo xtask bench alarms [HOURS]` runs it, by the
//! commands that a user has.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, ExitCode};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Robot-hours of each scenario, unless somebody says otherwise.
const HOURS: f64 = 10.0;
/// What one robot drives, seconds.
const DRIVE_S: u32 = 1_800;
/// Longer than the drive that a robot is calibrated by, seconds.
const CALIBRATION_S: u32 = 126;

/// What robots with bodies and links as wild as these do come to.
const RIGHT: [&str; 2] = ["stuck: ", "late: "];

/// A place to drive about in.
struct Place {
    name: &'static str,
    /// Robots that drive about; the first one is followed.
    robots: u32,
    /// Fixes of the tracker, a second and a robot.
    fixes: u32,
    ground: &'static str,
}

const PLACES: [Place; 3] = [
    Place {
        name: "alone in 8 × 4 m, fixes 10 Hz",
        robots: 1,
        fixes: 10,
        ground: "width = 8.0\nheight = 4.0\n",
    },
    Place {
        name: "alone in 8 × 4 m, fixes 2 Hz",
        robots: 1,
        fixes: 2,
        ground: "width = 8.0\nheight = 4.0\n",
    },
    Place {
        name: "four among boxes in 6 × 4 m, fixes 20 Hz",
        robots: 4,
        fixes: 20,
        ground: "width = 6.0\nheight = 4.0\nobstacles = [\n  \
                 { shape = \"box\", x = 1.2, y = 0.8, w = 0.6, h = 0.4, theta = 0.5 },\n  \
                 { shape = \"circle\", x = -1.4, y = -0.7, r = 0.25 },\n  \
                 { shape = \"box\", x = 0.0, y = -1.2, w = 0.3, h = 0.8, theta = 0.0 },\n]\n",
    },
];

impl Place {
    fn scenario(&self) -> String {
        let poses: Vec<String> = (0..self.robots)
            .map(|robot| {
                let x = -2.0 + 1.3 * f64::from(robot);
                format!("{{ x = {x}, y = 0.2, theta = 0.4 }}")
            })
            .collect();
        // Robots whose link is as bad as links can be connect late, and miss some of it.
        format!(
            "name = \"about\"\nabout = \"Robots drive about.\"\nrobots = {}\nduration_s = {DRIVE_S}\n\n\
             [arena]\n{}\n[spawn]\nposes = [{}]\n\n[tracker]\nrate_hz = {}\n\n[[commands]]\nat_s = 8.0\n\
             every_s = 10.0\nuntil_s = 100.0\ncommand = \"behave\"\nparameters = {{ behaviour = \"wander\" }}\n",
            self.robots,
            self.ground,
            poses.join(", "),
            self.fixes
        )
    }
}

/// What came of a place.
#[derive(Debug, Default)]
struct Tally {
    hours: f64,
    /// Robots that got no certificate, by why.
    refused: BTreeMap<String, u32>,
    /// Seeds with what was named and is not there.
    alarms: Vec<(u64, String)>,
    /// What was named and is there: robots that rub along a wall until they stand, and links that hold messages up.
    right: u32,
}

/// Runs `terracrawler`; what it printed.
fn terracrawler(program: &Path, folder: &Path, line: &str) -> Result<String, String> {
    let mut command = Command::new(program);
    command.current_dir(folder).args(line.split(' '));
    let output = command.output().map_err(|error| error.to_string())?;
    let (out, err) = (&output.stdout, &output.stderr);
    let text = String::from_utf8_lossy(out).into_owned();
    match output.status.code() {
        Some(0 | 1) => Ok(text),
        _ => Err(format!("{line}: {}", String::from_utf8_lossy(err))),
    }
}

/// The drive of one seed in one place.
fn drive(program: &Path, folder: &Path, place: usize, seed: u64) -> Result<Tally, String> {
    let run = |line: String| terracrawler(program, folder, &line);
    let mut tally = Tally::default();
    let to = |name: &str| format!("{name}-{place}-{seed}");
    let (course, certificate, about) = (to("course.mcap"), to("certificate"), to("about.mcap"));
    let world = format!("--randomisation wild --seed {seed}");
    run(format!(
        "replay --scenario calibration.toml {world} --until {CALIBRATION_S} --record {course}"
    ))?;
    let told = run(format!("twin calibrate {course} --out {certificate}"))?;
    remove(&folder.join(&course))?;
    if !folder.join(&certificate).is_file() {
        let reason = told
            .split_once("no certificate (")
            .and_then(|(_, rest)| rest.split_once(')'));
        let reason = reason.map_or(told.as_str(), |(reason, _)| reason);
        *tally.refused.entry(reason.to_owned()).or_default() += 1;
        return Ok(tally);
    }
    run(format!(
        "replay --scenario about-{place}.toml {world} --until {DRIVE_S} --record {about}"
    ))?;
    let told = run(format!(
        "twin follow {about} --robot sim-0001 --certificate {certificate}"
    ))?;
    remove(&folder.join(&about))?;
    remove(&folder.join(&certificate))?;
    tally.hours = f64::from(DRIVE_S) / 3_600.0;
    for line in told.lines().skip(1) {
        // "  304.4 s  both_weak: 5 % is missing"
        if let Some((_, named)) = line.split_once(" s  ")
            && named.contains(": ")
            && line.starts_with(' ')
        {
            if RIGHT.iter().any(|name| named.starts_with(name)) {
                tally.right += 1;
            } else {
                tally.alarms.push((seed, line.trim().to_owned()));
            }
        }
    }
    Ok(tally)
}

fn remove(file: &Path) -> Result<(), String> {
    fs::remove_file(file).map_err(|error| format!("{}: {error}", file.display()))
}

/// Drives until a place has had so many robot-hours, on all processors.
fn measure(program: &Path, folder: &Path, place: usize, hours: f64) -> Result<Tally, String> {
    let (next, all) = (AtomicU64::new(1), Mutex::new(Tally::default()));
    let work = || -> Result<(), String> {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if all.lock().expect("a tally").hours >= hours {
                return Ok(());
            }
            let one = drive(program, folder, place, seed)?;
            let mut all = all.lock().expect("a tally");
            all.hours += one.hours;
            all.right += one.right;
            for (reason, count) in one.refused {
                *all.refused.entry(reason).or_default() += count;
            }
            all.alarms.extend(one.alarms);
        }
    };
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let ends = workers.into_iter().map(std::thread::ScopedJoinHandle::join);
        ends.map(|end| end.expect("a worker"))
            .collect::<Result<Vec<()>, _>>()
    })?;
    Ok(all.into_inner().expect("a tally"))
}

fn table(hours: f64) -> Result<(), String> {
    let program = crawler_tests::terracrawler();
    let name = format!("terracrawler-alarms-{}", std::process::id());
    let folder = std::env::temp_dir().join(name);
    fs::create_dir_all(&folder).map_err(|error| error.to_string())?;
    let script = terracrawler(&program, &folder, "twin script")?;
    let write = |name: String, text: &str| {
        fs::write(folder.join(name), text).map_err(|error| error.to_string())
    };
    write("calibration.toml".to_owned(), &script)?;
    println!(
        "Robots with bodies of the profile wild, calibrated, then driving about for {} min each.\n",
        DRIVE_S / 60
    );
    println!(
        "| where | robot-hours | false alarms | in 100 h | stuck or late | without a certificate |"
    );
    println!("|---|---:|---:|---:|---:|---|");
    let mut named = String::new();
    for (number, place) in PLACES.iter().enumerate() {
        write(format!("about-{number}.toml"), &place.scenario())?;
        let tally = measure(&program, &folder, number, hours)?;
        let refused: Vec<String> = tally
            .refused
            .iter()
            .map(|(reason, count)| format!("{count} {reason}"))
            .collect();
        let count = tally.alarms.len();
        println!(
            "| {} | {:.0} | {count} | {:.1} | {} | {} |",
            place.name,
            tally.hours,
            count as f64 * 100.0 / tally.hours,
            tally.right,
            refused.join(", ")
        );
        for (seed, alarm) in tally.alarms {
            let _ = writeln!(named, "{}, seed {seed}: {alarm}", place.name);
        }
    }
    println!("\n{named}");
    fs::remove_dir_all(&folder).map_err(|error| error.to_string())
}

fn main() -> ExitCode {
    let hours = match std::env::args().nth(1).map(|text| text.parse::<f64>()) {
        None => HOURS,
        Some(Ok(hours)) if hours > 0.0 => hours,
        Some(_) => {
            eprintln!("robot-hours of each scenario are a number");
            return ExitCode::from(2);
        }
    };
    match table(hours) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
