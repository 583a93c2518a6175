//! Measurements, as tables.

use crate::run::{self, Failure, Outcome};

/// Runs the measurements named, or all of them.
///
/// # Errors
/// When a measurement is unknown or fails.
pub(crate) fn all(arguments: &[String]) -> Outcome {
    let which = arguments.first().map_or("all", String::as_str);
    match which {
        "lockstep" => lockstep(),
        "fleet" => fleet(),
        "all" => lockstep().and_then(|()| fleet()),
        other => Err(Failure(format!(
            "there is no measurement '{other}': lockstep, fleet"
        ))),
    }
}

/// The simulator alone: robots times control steps per CPU-second, bytes per robot.
fn lockstep() -> Outcome {
    run::cargo(&[
        "run",
        "--release",
        "--locked",
        "--quiet",
        "--package",
        "crawler-sim",
        "--example",
        "lockstep_bench",
    ])
}

/// Server, broker and robots over real sockets.
fn fleet() -> Outcome {
    run::cargo(&[
        "build",
        "--release",
        "--locked",
        "--quiet",
        "--package",
        "crawler-server",
    ])?;
    run::cargo(&[
        "bench",
        "--locked",
        "--quiet",
        "--package",
        "crawler-tests",
        "--bench",
        "fleet",
    ])
}
