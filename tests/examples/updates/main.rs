//! Updates of a whole fleet, by a server that is built for release.
//!
//! `cargo xtask bench updates [--robots N] [--parallel N] [--quick] [PART...]` runs it and prints the tables that
//! `docs/numbers.md` records. Its parts are `good`, a release for everybody while halts are given; `delta`, another
//! one behind it, as what has changed; `bytes`, what a release takes on the way, without loss and with; `bad`, a
//! release that stops itself; `killed`, server and broker ended as by a power cut. All of them without a word. It fails
//! when a robot is left without a program that it has proven, when a rollout does not come to its end, and when what
//! is counted is past its goal; times are printed beside theirs.

mod bad;
mod bytes;
mod delta;
mod fleet;
mod good;
mod halts;
mod killed;

use std::process::ExitCode;

/// How much is measured.
#[derive(Debug, Clone, Copy)]
struct Size {
    /// Robots of the good release, and of them at once.
    robots: usize,
    parallel: usize,
    /// The same by delta: each is on trial for half a minute, of which ten, one behind the other, are five minutes.
    parallel_delta: usize,
    /// Robots whose bytes are counted.
    counted: usize,
    /// Robots of the bad release.
    bad: usize,
    /// Robots whose server is killed.
    killed: usize,
    /// How long halts are given before the rollout, in seconds.
    quiet_s: u64,
}

/// That of the goals.
const WHOLE: Size = Size {
    robots: 1_000,
    parallel: 100,
    parallel_delta: 250,
    counted: 100,
    bad: 200,
    killed: 100,
    quiet_s: 60,
};
/// To try it.
const QUICK: Size = Size {
    robots: 50,
    parallel: 25,
    parallel_delta: 25,
    counted: 10,
    bad: 50,
    killed: 20,
    quiet_s: 15,
};

const PARTS: [&str; 5] = ["good", "delta", "bytes", "bad", "killed"];

fn main() -> ExitCode {
    let (mut size, mut parts) = (WHOLE, Vec::new());
    let (mut robots, mut parallel) = (None, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(word) = arguments.next() {
        let mut number = || {
            let number = arguments.next().and_then(|text| text.parse().ok());
            let number = number.filter(|number| (1..=9_999).contains(number));
            number.unwrap_or_else(|| panic!("{word} takes a number from 1 to 9999"))
        };
        match word.as_str() {
            "--quick" => size = QUICK,
            "--robots" => robots = Some(number()),
            "--parallel" => parallel = Some(number()),
            part if PARTS.contains(&part) => parts.push(word),
            _ => panic!(
                "{word}: --robots N, --parallel N, --quick, {}",
                PARTS.join(", ")
            ),
        }
    }
    size.robots = robots.unwrap_or(size.robots);
    size.parallel = parallel.unwrap_or(size.parallel);
    size.parallel_delta = parallel.unwrap_or(size.parallel_delta);
    if let (Some(robots), false) = (robots, parts.is_empty()) {
        // Those of the parts that are named.
        (size.counted, size.bad, size.killed) = (robots, robots, robots);
    }
    rlimit::increase_nofile_limit(20 * size.robots as u64 + 2_000).expect("enough sockets");
    let wanted = |part: &str| parts.is_empty() || parts.iter().any(|word| word == part);
    let mut wrong = Vec::new();
    for (part, run) in [
        ("good", good::run as fn(&Size) -> Vec<String>),
        ("delta", delta::run),
        ("bytes", bytes::run),
        ("bad", bad::run),
        ("killed", killed::run),
    ] {
        if wanted(part) {
            wrong.extend(run(&size));
        }
    }
    for text in &wrong {
        println!("WRONG: {text}");
    }
    if wrong.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
