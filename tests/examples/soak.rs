//! A server at work for an hour; see `crawler_tests::soak`.
//!
//! `cargo xtask bench soak [--minutes N] [--robots N] [--cycle SECONDS] [--out DIRECTORY]` runs it, prints the
//! table that `docs/numbers.md` records and writes it and a graph into the directory, and fails when a rule
//! does not hold.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use crawler_tests::soak::{Options, judge, run, table};

/// Besides the work of a cycle there is the rest behind it.
const REST: u64 = 30;

fn main() -> ExitCode {
    let (mut minutes, mut robots, mut cycle) = (60_u64, 500_usize, 240_u64);
    let mut out: Option<PathBuf> = None;
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().unwrap_or_default();
        let number = || {
            let number: Option<u32> = value.parse().ok();
            let number = number.filter(|number| *number > 0);
            number.unwrap_or_else(|| panic!("{name} takes a number above 0"))
        };
        match name.as_str() {
            "--minutes" => minutes = number().into(),
            "--robots" => robots = number() as usize,
            "--cycle" => cycle = u64::from(number()).max(2 * REST),
            "--out" => out = Some(value.into()),
            _ => panic!("{name}: --minutes N, --robots N, --cycle SECONDS or --out DIRECTORY"),
        }
    }
    rlimit::increase_nofile_limit(20 * robots as u64 + 2_000).expect("enough sockets");
    let cycles = (60 * minutes / cycle).max(1) as usize;
    println!(
        "{robots} robots in a process of their own, {cycles} cycles of {cycle} s, the server restarted in {} of them\n\n{}",
        cycles / 4,
        table()
    );
    let readings = run(&Options {
        robots,
        cycles,
        work: Duration::from_secs(cycle - REST),
        out,
    });
    println!("\n| rule | found | |\n|---|---|---|");
    let findings = judge(&readings);
    for finding in &findings {
        let verdict = if finding.holds { "holds" } else { "BROKEN" };
        println!("| {} | {} | {verdict} |", finding.rule, finding.found);
    }
    for lost in readings.iter().flat_map(|reading| &reading.lost).take(20) {
        println!("lost: {lost}");
    }
    if findings.iter().all(|finding| finding.holds) {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
