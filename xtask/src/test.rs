//! Everything a change must pass, in one command for laptop and CI.

use std::time::Instant;

use crate::run::{self, Failure, Outcome};
use crate::{tools, ui};

/// What is done, and what does it.
type Step = (&'static str, fn() -> Outcome);

/// Runs every step, also after a failed one, and closes with a count.
///
/// # Errors
/// Names the steps that failed.
pub(crate) fn all() -> Outcome {
    let steps: [Step; 8] = [
        ("tools", tools::setup),
        ("format", || run::cargo(&["fmt", "--all", "--check"])),
        ("control room", || ui::check().and_then(|()| ui::build())),
        ("clippy", clippy),
        // Builds the server too, which the end-to-end tests start.
        ("tests", || {
            run::cargo(&[
                "test",
                "--locked",
                "--workspace",
                "--all-features",
                "--no-fail-fast",
            ])
        }),
        ("bare target", bare_target),
        ("documentation", documentation),
        ("advisories", advisories),
    ];
    let mut failed = Vec::new();
    for (name, step) in steps {
        println!("\n== {name}");
        let began = Instant::now();
        let outcome = step();
        let seconds = began.elapsed().as_secs();
        match outcome {
            Ok(()) => println!("== {name}: passed in {seconds} s"),
            Err(Failure(reason)) => {
                println!("== {name}: FAILED after {seconds} s: {reason}");
                failed.push(name);
            }
        }
    }
    println!(
        "\n{} passed, {} failed",
        steps.len() - failed.len(),
        failed.len()
    );
    if failed.is_empty() {
        Ok(())
    } else {
        Err(Failure(format!("failed: {}", failed.join(", "))))
    }
}

fn clippy() -> Outcome {
    run::cargo(&[
        "clippy",
        "--locked",
        "--workspace",
        "--all-targets",
        "--all-features",
        "--",
        "--deny",
        "warnings",
    ])
}

/// Compiles the robot program for a microcontroller that has neither std nor an allocator, where
/// the toolchain has that target.
fn bare_target() -> Outcome {
    const TARGET: &str = "riscv32imac-unknown-none-elf";
    let libraries = run::output("rustc", &["--print", "target-libdir", "--target", TARGET]);
    if !libraries.is_some_and(|folder| std::path::Path::new(&folder).is_dir()) {
        println!("skipped: rustup target add {TARGET}");
        return Ok(());
    }
    run::cargo(&[
        "check",
        "--locked",
        "--package",
        "crawler-app",
        "--target",
        TARGET,
    ])
}

/// Broken links in the documentation are errors.
fn documentation() -> Outcome {
    run::run_with_env(
        &run::root(),
        "cargo",
        &["doc", "--locked", "--workspace", "--no-deps", "--quiet"],
        &[("RUSTDOCFLAGS", "--deny warnings")],
    )
}

/// Licences are checked by a test of ours; known vulnerabilities by cargo-deny, where the user
/// has it and its database, which needs the network.
fn advisories() -> Outcome {
    if run::output("cargo", &["deny", "--version"]).is_none() {
        println!("skipped: cargo-deny is not installed (cargo install cargo-deny --locked)");
        return Ok(());
    }
    run::cargo(&["deny", "--all-features", "check"])
}
