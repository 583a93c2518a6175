//! Measurements, as tables.

use crate::bench_server;
use crate::bench_sim;
use crate::bench_vision;
use crate::run::{self, Failure, Outcome};
use crate::ui;

/// Runs the measurements named, or all of them but the soak, which takes an hour.
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
        "ui" => control_room(rest),
        "server" => bench_server::load(rest),
        "chaos" => bench_server::chaos(rest),
        "disk" => bench_server::disk(rest),
        "soak" => bench_server::soak(rest),
        "updates" => bench_server::updates(rest),
        "twin" => twin(rest),
        "what-if" => what_if(rest),
        "federated" => federated(rest),
        "alarms" => bench_server::alarms(rest),
        "all" => bench_sim::table(&[])
            .and_then(|()| fleet(&[]))
            .and_then(|()| bench_vision::tables(&[]))
            .and_then(|()| control_room(&[]))
            .and_then(|()| bench_server::load(&[]))
            .and_then(|()| bench_server::chaos(&[]))
            .and_then(|()| bench_server::disk(&[]))
            .and_then(|()| bench_server::updates(&[]))
            .and_then(|()| twin(&[]))
            .and_then(|()| what_if(&[]))
            .and_then(|()| federated(&[]))
            .and_then(|()| bench_server::alarms(&[])),
        other => Err(Failure(format!(
            "there is no measurement '{other}': sim, fleet, vision, ui, server, chaos, disk, soak, \
             updates, twin, what-if, federated, alarms"
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

/// Twins of hidden robots: what they are found to be, how well what they do is foretold, and what those of a large fleet
/// cost a server.
fn twin(arguments: &[String]) -> Outcome {
    example("crawler-twin", "study", arguments)?;
    example("crawler-twins", "live", arguments)
}

/// How often what happened lies where a counterfactual has it that changes nothing.
fn what_if(arguments: &[String]) -> Outcome {
    example("crawler-counterfactuals", "null_test", arguments)
}

/// What nodes come to that learn together: by every rule, with drop-outs, and with hostile ones.
fn federated(arguments: &[String]) -> Outcome {
    example("crawler-learning", "federated", arguments)
}

/// Runs an example of a package, built for release.
fn example(package: &str, name: &str, arguments: &[String]) -> Outcome {
    let mut line = vec!["run", "--release", "--locked", "--quiet", "--package"];
    line.extend([package, "--example", name, "--"]);
    line.extend(arguments.iter().map(String::as_str));
    run::cargo(&line)
}

/// The control room in a real browser: what it costs the page's main thread.
fn control_room(arguments: &[String]) -> Outcome {
    ui::build()?;
    let mut line = vec!["run", "--silent", "bench", "--"];
    line.extend(arguments.iter().map(String::as_str));
    run::run(&ui::folder(), "npm", &line)
}
