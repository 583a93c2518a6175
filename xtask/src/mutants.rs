//! Mutation testing: do the tests of the crates that everything rests on notice a wrong program?

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::run::{self, Failure, Outcome};

/// The crates whose mistakes cost most, and whose tests need neither a server nor a clock.
const CRATES: [&str; 5] = [
    "crawler-app",
    "crawler-drivers",
    "crawler-protocol",
    "crawler-delivery",
    "crawler-micromodel",
];

/// Mutants in a sample, about.
const SAMPLE: usize = 300;

/// So many of a hundred mutants that compile must be noticed: five fewer than of the sample in
/// `docs/mutants.md`.
const FLOOR_PERCENT: usize = 84;

/// Tests that run so many seconds with a mutant hang: those of a crate take ten on a busy machine.
const TIMEOUT_SECONDS: &str = "60";

/// `cargo xtask mutants [--seed N]`
///
/// # Errors
/// When an argument is none, cargo-mutants cannot be had, or too many mutants survive.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let usage = || Failure("cargo xtask mutants [--seed N]".to_owned());
    match arguments {
        [] => sample(run::fresh_seed()),
        [name, seed] if name == "--seed" => sample(seed.parse().map_err(|_| usage())?),
        _ => Err(usage()),
    }
}

/// Tests one of the samples that the mutants of [`CRATES`] are dealt out to, the one that `seed`
/// chooses, and prints those that no test noticed.
///
/// # Errors
/// When cargo-mutants cannot be had, the tests fail without any mutant, or fewer than
/// [`FLOOR_PERCENT`] are noticed.
pub(crate) fn sample(seed: u64) -> Outcome {
    if run::output("cargo", &["mutants", "--version"]).is_none() {
        println!("installing cargo-mutants");
        run::cargo(&["install", "--quiet", "--locked", "cargo-mutants"])?;
    }
    let listed = run::output_of(mutants(&["--list"]))
        .ok_or_else(|| Failure("cargo mutants --list failed".to_owned()))?;
    let all = listed.lines().count();
    let samples = all.div_ceil(SAMPLE).max(1);
    let shard = format!("{}/{samples}", seed % samples as u64);
    println!("{all} mutants; seed {seed}: sample {shard}");
    let folder = run::root().join(run::target_dir()).join("mutants");
    fs::create_dir_all(&folder)
        .map_err(|error| Failure(format!("{}: {error}", folder.display())))?;
    let output = folder.to_string_lossy().into_owned();
    let mut command = mutants(&[
        "--shard",
        &shard,
        "--sharding",
        "round-robin",
        "--test-tool",
        "nextest",
        "--minimum-test-timeout",
        TIMEOUT_SECONDS,
        "--output",
        &output,
    ]);
    let status = command
        .status()
        .map_err(|error| Failure(format!("cannot run cargo-mutants: {error}")))?;
    // 2: some were missed; 3: some hang, which is noticed too.
    if !matches!(status.code(), Some(0 | 2 | 3)) {
        return Err(Failure(format!("cargo mutants ended with {status}")));
    }
    judge(&folder.join("mutants.out"))
}

fn mutants(arguments: &[&str]) -> Command {
    let mut command = Command::new(run::cargo_program());
    command
        .current_dir(run::root())
        .stdin(Stdio::null())
        // A mutant changes one function: building the rest again takes five times as long.
        .env("CARGO_INCREMENTAL", "1")
        // What one interrupted build leaves behind may not link with the next otherwise.
        .env("CARGO_PROFILE_DEV_LTO", "off")
        // A counter-example of one mutant must not help to notice the next, and nobody reads it.
        .env("PROPTEST_DISABLE_FAILURE_PERSISTENCE", "true")
        .env("PROPTEST_MAX_SHRINK_ITERS", "0")
        // Without a feature, nothing can notice the mutants of its code.
        .args(["mutants", "--all-features"]);
    for name in CRATES {
        command.args(["--package", name]);
    }
    command.args(arguments);
    command
}

/// Holds the lists that cargo-mutants wrote against the floor.
fn judge(folder: &Path) -> Outcome {
    let lines = |name: &str| -> Vec<String> {
        let text = fs::read_to_string(folder.join(name)).unwrap_or_default();
        text.lines().map(str::to_owned).collect()
    };
    let missed = lines("missed.txt");
    let noticed = lines("caught.txt").len() + lines("timeout.txt").len();
    let tested = noticed + missed.len();
    for mutant in &missed {
        println!("not noticed: {mutant}");
    }
    let unviable = lines("unviable.txt").len();
    println!("{noticed} of {tested} noticed; {unviable} do not compile");
    if tested == 0 {
        return Err(Failure("no mutant was tested".to_owned()));
    }
    // A quarter is usual: not every type has a default.
    if unviable > tested {
        return Err(Failure(format!(
            "most mutants do not compile: see {}",
            folder.join("log").display()
        )));
    }
    if noticed * 100 < tested * FLOOR_PERCENT {
        return Err(Failure(format!(
            "fewer than {FLOOR_PERCENT} of 100 mutants are noticed"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::{command, judge};

    #[test]
    fn survivors_are_held_against_the_floor() {
        let name = format!("xtask-mutants-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        fs::create_dir_all(&folder).expect("a folder");
        let write = |name: &str, count: usize| {
            fs::write(folder.join(name), "mutant\n".repeat(count)).expect("written");
        };
        assert!(judge(&folder).is_err(), "nothing was tested");
        write("caught.txt", 74);
        write("timeout.txt", 10);
        write("missed.txt", 16);
        assert!(judge(&folder).is_ok());
        write("missed.txt", 17);
        assert!(judge(&folder).is_err());
        write("missed.txt", 0);
        write("unviable.txt", 84);
        assert!(judge(&folder).is_ok());
        write("unviable.txt", 85);
        assert!(judge(&folder).is_err(), "the builds are what failed");
        fs::remove_dir_all(&folder).expect("removed");
    }

    #[test]
    fn arguments_that_are_none_are_refused() {
        for bad in [&["--seed"][..], &["--seed", "x"], &["--more", "1"]] {
            let words: Vec<String> = bad.iter().map(|&word| word.to_owned()).collect();
            assert!(command(&words).is_err(), "{bad:?}");
        }
    }
}
