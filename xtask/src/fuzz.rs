//! Fuzzing, bounded in time.

use crate::run::{self, Failure, Outcome};

/// Seconds per target when none are given.
const DEFAULT_SECONDS: u32 = 30;

/// Runs every target of `fuzz/` for `--seconds N`.
///
/// # Errors
/// When an argument is unknown, cargo-fuzz or a nightly toolchain is missing, or a target finds
/// something.
pub(crate) fn all(arguments: &[String]) -> Outcome {
    let seconds = match arguments {
        [] => DEFAULT_SECONDS,
        [name, value] if name == "--seconds" => value
            .parse()
            .map_err(|_| Failure(format!("'{value}' is not a number of seconds")))?,
        _ => return Err(Failure("cargo xtask fuzz [--seconds N]".to_owned())),
    };
    let nightly = ["+nightly", "--version"];
    if run::output("cargo", &nightly).is_none() {
        return Err(Failure(
            "fuzzing needs a nightly toolchain: rustup toolchain install nightly".to_owned(),
        ));
    }
    if run::output("cargo", &["fuzz", "--version"]).is_none() {
        run::cargo(&["install", "--quiet", "--locked", "cargo-fuzz"])?;
    }
    let targets = run::output("cargo", &["+nightly", "fuzz", "list", "--fuzz-dir", "fuzz"])
        .ok_or_else(|| Failure("cargo fuzz finds no targets".to_owned()))?;
    for target in targets.lines() {
        println!("\n== {target} for {seconds} s");
        let limit = format!("-max_total_time={seconds}");
        run::run(
            &run::root(),
            "cargo",
            &[
                "+nightly",
                "fuzz",
                "run",
                "--fuzz-dir",
                "fuzz",
                target,
                "--",
                &limit,
            ],
        )?;
    }
    println!("\n{} passed, 0 failed", targets.lines().count());
    Ok(())
}
