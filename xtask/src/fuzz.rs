//! Fuzzing, bounded in time.

use std::fs;

use crate::fuzz_api;
use crate::run::{self, Failure, Outcome};

/// Seconds per target when none are given.
const DEFAULT_SECONDS: u32 = 30;

/// Longest input tried: a little beyond the longest message.
const LONGEST: &str = "-max_len=1100";

/// Runs every target of `fuzz/` for `--seconds N`.
///
/// The crates below `firmware/` forbid unsafe code, so no sanitizer is wanted, and the stable
/// toolchain is enough. New inputs go to the target directory; one that found something is worth
/// a place in `fuzz/corpus`, which the normal tests replay.
///
/// # Errors
/// When an argument is unknown, or as [`targets`].
pub(crate) fn all(arguments: &[String]) -> Outcome {
    if let Some((name, rest)) = arguments.split_first()
        && name == "api"
    {
        return fuzz_api::command(rest);
    }
    let seconds = match arguments {
        [] => DEFAULT_SECONDS,
        [name, value] if name == "--seconds" => value
            .parse()
            .map_err(|_| Failure(format!("'{value}' is not a number of seconds")))?,
        _ => {
            return Err(Failure(
                "cargo xtask fuzz [--seconds N], or fuzz api".to_owned(),
            ));
        }
    };
    targets(seconds)
}

/// Runs every target of `fuzz/` for so many seconds.
///
/// # Errors
/// When cargo-fuzz cannot be installed, or a target finds something.
pub(crate) fn targets(seconds: u32) -> Outcome {
    if run::output("cargo", &["fuzz", "--version"]).is_none() {
        println!("installing cargo-fuzz");
        run::cargo(&["install", "--quiet", "--locked", "cargo-fuzz"])?;
    }
    let folder = run::root().join("fuzz");
    let folder = folder.to_string_lossy();
    let targets = run::output("cargo", &["fuzz", "list", "--fuzz-dir", &folder])
        .ok_or_else(|| Failure("cargo fuzz finds no targets".to_owned()))?;
    let limit = format!("-max_total_time={seconds}");
    for target in targets.lines() {
        println!("\n== {target} for {seconds} s");
        let found = run::target_dir().join("fuzz-corpus").join(target);
        fs::create_dir_all(&found)
            .map_err(|error| Failure(format!("cannot make {}: {error}", found.display())))?;
        let found = found.to_string_lossy();
        let seeds = format!("fuzz/corpus/{target}");
        run::cargo(&[
            "fuzz",
            "run",
            "--fuzz-dir",
            &folder,
            "--sanitizer",
            "none",
            target,
            &found,
            &seeds,
            "--",
            &limit,
            LONGEST,
        ])?;
    }
    println!("\n{} passed, 0 failed", targets.lines().count());
    Ok(())
}
