//! Measurements, as tables.

use crate::bench_sim;
use crate::bench_vision;
use crate::run::{self, Failure, Outcome};

/// Runs the measurements named, or all of them.
///
/// # Errors
/// When a measurement is unknown or fails.
pub(crate) fn all(arguments: &[String]) -> Outcome {
    let (which, rest) = arguments
        .split_first()
        .map_or(("all", arguments), |(which, rest)| (which.as_str(), rest));
    match which {
        "sim" => bench_sim::table(rest),
        "fleet" => fleet(rest),
        "vision" => bench_vision::tables(rest),
        "all" => bench_sim::table(&[])
            .and_then(|()| fleet(&[]))
            .and_then(|()| bench_vision::tables(&[])),
        other => Err(Failure(format!(
            "there is no measurement '{other}': sim, fleet, vision"
        ))),
    }
}

/// Server, broker and robots over real sockets: so many robots, commanded for so long.
fn fleet(arguments: &[String]) -> Outcome {
    run::cargo(&[
        "build",
        "--release",
        "--locked",
        "--quiet",
        "--package",
        "crawler-server",
    ])?;
    let bench = "bench --locked --quiet --package crawler-tests --bench fleet --";
    let mut line: Vec<&str> = bench.split(' ').collect();
    line.extend(arguments.iter().map(String::as_str));
    run::cargo(&line)
}
