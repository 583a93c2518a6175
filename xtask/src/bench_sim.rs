//! The simulator alone: robots times steps per second of processor time, and what else a robot
//! costs.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::run::{self, Failure, Outcome};

/// Sizes of the worlds measured unless others are named.
const SIZES: [u32; 3] = [100, 1_000, 10_000];
/// Instructions are counted in worlds up to this size; they hardly depend on it, and callgrind
/// takes fifty times as long as the processor.
const COUNTED: u32 = 1_000;

/// What is measured, as the program names it, and as the table does.
const KINDS: [(&str, &str); 3] = [
    ("world", "bodies and cones"),
    ("none", "whole program, no network"),
    ("lockstep", "whole program, lockstep"),
];

/// Figures of one run, by name.
pub(crate) type Figures = BTreeMap<String, f64>;

/// Prints the table.
///
/// # Errors
/// When an argument is no number, or a measurement fails.
pub(crate) fn table(arguments: &[String]) -> Outcome {
    let mut sizes = Vec::new();
    for argument in arguments {
        let robots: u32 = argument
            .parse()
            .ok()
            .filter(|robots| (1..=65_535).contains(robots))
            .ok_or_else(|| Failure(format!("'{argument}' is no number of robots")))?;
        sizes.push(robots);
    }
    if sizes.is_empty() {
        sizes = SIZES.to_vec();
    }
    let program = run::build_example("crawler-sim", "sim_bench")?;
    let counter = Counter::find();
    println!(
        "Steps are physics steps of 10 ms for bodies alone, and control steps of 20 ms for whole"
    );
    println!("programs. Instructions: {}.\n", counter.name());
    println!(
        "| what | robots | robots × steps per CPU-second | times real time | instructions per step \
         | allocations per step | polls per step | bytes per robot | spawn, s |"
    );
    println!("|---|---:|---:|---:|---:|---:|---:|---:|---:|");
    let mut ratios = Vec::new();
    for (kind, about) in KINDS {
        let mut rates = Vec::new();
        for &robots in &sizes {
            let figures = measure(&program, kind, robots)?;
            let count = if robots <= COUNTED {
                counter.count(&program, kind, robots)?
            } else {
                Count::default()
            };
            println!("{}", row(about, robots, &figures, count));
            rates.push((robots, get(&figures, "steps_per_cpu_s")));
        }
        if let (Some(&(few, fast)), Some(&(many, slow))) = (rates.first(), rates.last())
            && few < many
        {
            ratios.push(format!(
                "- {about}: a step of one of {many} robots costs {:.2} times as much as of one of {few}",
                fast / slow
            ));
        }
    }
    println!("\n{}\n", ratios.join("\n"));
    threads(sizes.get(sizes.len() / 2).copied().unwrap_or(1_000))
}

/// One world on one thread and on two. Only an idle machine with two cores says what it is worth.
fn threads(robots: u32) -> Outcome {
    run::cargo(&[
        "run",
        "--release",
        "--locked",
        "--quiet",
        "--package",
        "crawler-sim",
        "--example",
        "threads",
        "--",
        &robots.to_string(),
    ])
}

pub(crate) fn get(figures: &Figures, name: &str) -> f64 {
    figures.get(name).copied().unwrap_or(f64::NAN)
}

fn row(about: &str, robots: u32, figures: &Figures, count: Count) -> String {
    let optional = |name: &str, digits: usize| {
        figures
            .get(name)
            .map_or_else(String::new, |value| format!("{value:.digits$}"))
    };
    format!(
        "| {about} | {robots} | {:.0} | {:.1} | {} | {} | {} | {} | {} |",
        get(figures, "steps_per_cpu_s"),
        get(figures, "times_real_time"),
        count
            .instructions
            .map_or_else(String::new, |count| format!("{count:.0}")),
        count
            .allocations
            .map_or_else(String::new, |count| format!("{count:.2}")),
        optional("polls_per_step", 2),
        optional("bytes_per_robot", 0),
        optional("spawn_s", 3),
    )
}

/// One run in a process of its own.
fn measure(program: &Path, kind: &str, robots: u32) -> Outcome<Figures> {
    let mut command = Command::new(program);
    command.arg(kind).arg(robots.to_string());
    let output = command
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| Failure(format!("cannot run {}: {error}", program.display())))?;
    if !output.status.success() {
        let what = format!("measuring '{kind}' with {robots} robots");
        return Err(Failure(format!("{what} ended with {}", output.status)));
    }
    Ok(parse(&String::from_utf8_lossy(&output.stdout)))
}

/// Reads lines of a name and a number; the fingerprint of a run is no number and is left out.
pub(crate) fn parse(text: &str) -> Figures {
    text.lines()
        .filter_map(|line| {
            let (name, value) = line.split_once(' ')?;
            Some((name.to_owned(), value.trim().parse().ok()?))
        })
        .collect()
}

/// What was counted for each step.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Count {
    pub(crate) instructions: Option<f64>,
    /// Calls of the allocator that ask for memory. Callgrind alone sees them.
    allocations: Option<f64>,
}

/// What counts instructions on this machine.
enum Counter {
    /// The processor, through Linux.
    Perf,
    /// Valgrind.
    Callgrind,
    /// Nothing does.
    Nothing,
}

/// Virtual seconds before the counted span, and its length.
const COUNTED_SPAN: [&str; 2] = ["6", "1"];

impl Counter {
    fn find() -> Self {
        // A virtual machine often has no counter: asked for, it says so.
        let mut perf = Command::new("perf");
        perf.args(["stat", "-x", ",", "-e", "instructions:u", "true"]);
        let told = perf.stdin(Stdio::null()).output().ok();
        if told.is_some_and(|told| perf_count(&String::from_utf8_lossy(&told.stderr)).is_some()) {
            Self::Perf
        } else if run::output("valgrind", &["--version"]).is_some() {
            Self::Callgrind
        } else {
            Self::Nothing
        }
    }

    const fn name(&self) -> &'static str {
        match self {
            Self::Perf => "counted by the processor",
            Self::Callgrind => "counted by callgrind",
            Self::Nothing => "not counted, because neither perf nor valgrind can do it here",
        }
    }

    fn count(&self, program: &Path, kind: &str, robots: u32) -> Outcome<Count> {
        match self {
            Self::Nothing => Ok(Count::default()),
            Self::Perf => {
                // What set-up and warm-up take is in both runs, and cancels.
                let [warm_up, span] = COUNTED_SPAN;
                let short = perf(program, kind, robots, warm_up, "0.5")?;
                let long = perf(program, kind, robots, warm_up, span)?;
                let instructions = short.zip(long).map(|(short, long)| {
                    let steps = long.1 - short.1;
                    (long.0 - short.0) / steps
                });
                Ok(Count {
                    instructions,
                    allocations: None,
                })
            }
            Self::Callgrind => callgrind(program, kind, robots),
        }
    }
}

/// Instructions and steps of a run.
fn perf(
    program: &Path,
    kind: &str,
    robots: u32,
    warm_up: &str,
    span: &str,
) -> Outcome<Option<(f64, f64)>> {
    let mut command = Command::new("perf");
    command
        .args(["stat", "-x", ",", "-e", "instructions:u"])
        .arg(program)
        .args([kind, &robots.to_string(), warm_up, span]);
    let output = command
        .stdin(Stdio::null())
        .output()
        .map_err(|error| Failure(format!("cannot run perf: {error}")))?;
    let figures = parse(&String::from_utf8_lossy(&output.stdout));
    let count = perf_count(&String::from_utf8_lossy(&output.stderr));
    Ok(count.zip(figures.get("steps").copied()))
}

/// The count in what `perf stat -x ,` says; `None` for `<not supported>`.
fn perf_count(text: &str) -> Option<f64> {
    let line = text.lines().find(|line| line.contains("instructions"))?;
    line.split(',').next()?.parse().ok()
}

/// Counts a step of `robots` robots in `program`, which is the example `sim_bench`.
///
/// # Errors
/// When valgrind or the program fails.
pub(crate) fn callgrind(program: &Path, kind: &str, robots: u32) -> Outcome<Count> {
    let profile = program.with_extension("callgrind");
    let mut command = Command::new("valgrind");
    command
        .args([
            "--tool=callgrind",
            "--compress-strings=no",
            "--toggle-collect=*measured_part*",
        ])
        .arg(format!("--callgrind-out-file={}", profile.display()))
        .arg(program)
        .args([kind, &robots.to_string()])
        .args(COUNTED_SPAN);
    let output = command
        .stdin(Stdio::null())
        .output()
        .map_err(|error| Failure(format!("cannot run valgrind: {error}")))?;
    if !output.status.success() {
        let what = format!("counting '{kind}' with {robots} robots");
        return Err(Failure(format!("{what} ended with {}", output.status)));
    }
    let figures = parse(&String::from_utf8_lossy(&output.stdout));
    let steps = figures.get("steps").copied();
    let per_step = |count: Option<f64>| count.zip(steps).map(|(count, steps)| count / steps);
    let written = std::fs::read_to_string(&profile)
        .map_err(|error| Failure(format!("cannot read {}: {error}", profile.display())))?;
    Ok(Count {
        instructions: per_step(callgrind_count(&String::from_utf8_lossy(&output.stderr))),
        allocations: per_step(Some(allocations(&written))),
    })
}

/// Calls that ask for memory in a profile of callgrind: a line names the function that is called,
/// and the next one tells how often.
fn allocations(profile: &str) -> f64 {
    let mut asks = false;
    let mut calls = 0.0;
    for line in profile.lines() {
        if let Some(called) = line.strip_prefix("cfn=") {
            asks = matches!(called, "malloc" | "calloc" | "realloc" | "posix_memalign");
        } else if let Some(count) = line.strip_prefix("calls=")
            && asks
        {
            let count = count.split(' ').next().and_then(|count| count.parse().ok());
            calls += count.unwrap_or(0.0);
            asks = false;
        }
    }
    calls
}

/// The count in the line `==1234== Collected : 5678` of callgrind.
fn callgrind_count(text: &str) -> Option<f64> {
    let line = text.lines().find(|line| line.contains("Collected :"))?;
    line.rsplit(' ').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_read_from_lines() {
        let figures = parse("robots 100\nsteps_per_cpu_s 613932\nhistory 1af0xx\n\nnonsense\n");
        assert_eq!(figures.len(), 2);
        assert_eq!(get(&figures, "steps_per_cpu_s"), 613_932.0);
        assert!(get(&figures, "spawn_s").is_nan());
    }

    #[test]
    fn counts_are_read_from_what_the_tools_say() {
        let said = "==77== Events    : Ir\n==77== Collected : 4711\n";
        assert_eq!(callgrind_count(said), Some(4_711.0));
        assert_eq!(callgrind_count("==77== \n"), None);
        assert_eq!(perf_count("815,,instructions:u,1,100.00,,\n"), Some(815.0));
        assert_eq!(perf_count("<not supported>,,instructions:u,0,,,\n"), None);
    }

    #[test]
    fn allocations_are_read_from_a_profile() {
        let profile = "fn=grow\n12 5\ncob=/lib/libc.so.6\ncfi=malloc.c\ncfn=malloc\ncalls=3 40\n\
                       12 90\ncfn=free\ncalls=7 41\n12 20\ncfn=realloc\ncalls=2 1\n12 9\n";
        assert_eq!(allocations(profile), 5.0);
        assert_eq!(allocations("fn=malloc\n12 5\n"), 0.0);
    }

    #[test]
    fn sizes_that_are_none_are_refused() {
        for bad in ["0", "-1", "many", "65536"] {
            assert!(table(&[bad.to_owned()]).is_err(), "{bad}");
        }
    }
}
