//! The server under load, and in trouble: programs of `tests/examples` beside a server built for
//! release.

use crate::run::{self, Failure, Outcome};

/// The embedded broker beside Mosquitto, and telemetry into the history.
///
/// # Errors
/// When something cannot be built, or the measurement fails.
pub(crate) fn load(arguments: &[String]) -> Outcome {
    example("server_load", arguments)
}

/// Real processes, and everything between them going wrong; fails on a count that must be zero.
///
/// # Errors
/// When something cannot be built, or a count is wrong.
pub(crate) fn chaos(arguments: &[String]) -> Outcome {
    example("live_chaos", arguments)
}

/// Halts while the disk of the server is slow; fails when one is lost.
///
/// # Errors
/// When something cannot be built, or a count is wrong.
pub(crate) fn disk(arguments: &[String]) -> Outcome {
    example("slow_disk", arguments)
}

/// An hour of everything at once; fails when the server does not come back to what it was.
///
/// # Errors
/// When something cannot be built, or a rule does not hold.
pub(crate) fn soak(arguments: &[String]) -> Outcome {
    example("soak", arguments)
}

/// Updates of a whole fleet; fails when a robot is left without a program that it has proven.
///
/// # Errors
/// When something cannot be built, or a robot is.
pub(crate) fn updates(arguments: &[String]) -> Outcome {
    example("updates", arguments)
}

/// How often twins find something wrong with robots that have nothing.
///
/// # Errors
/// When something cannot be built, or the measurement fails.
pub(crate) fn alarms(arguments: &[String]) -> Outcome {
    example("false_alarms", arguments)
}

/// Builds server and program with the same features, so that nothing is built twice.
fn example(name: &str, arguments: &[String]) -> Outcome {
    let words = "build --release --locked --quiet --package crawler-server --bin terracrawler \
                 --package crawler-tests --example";
    let words: Vec<&str> = words.split_whitespace().chain([name]).collect();
    run::cargo(&words)?;
    let program = run::root()
        .join(run::target_dir())
        .join("release/examples")
        .join(name);
    let program = program
        .to_str()
        .ok_or_else(|| Failure("the target directory has no name that can be written".into()))?;
    run::run(&run::root(), program, arguments)
}
