//! Everything a change must pass, in one command for laptop and CI.

use std::time::Instant;

use crate::boards::{self, C3, C6, PROGRAM, VIRT};
use crate::run::{self, Failure, Outcome};
use crate::{check_s3, counts, cross, fuzz_api, histories, image, size, tools, ui};

/// What is done, and what does it.
type Step = (&'static str, fn() -> Outcome);

/// Runs every step, also after a failed one, and closes with a count.
///
/// # Errors
/// Names the steps that failed.
pub(crate) fn all() -> Outcome {
    let steps: [Step; 14] = [
        ("tools", tools::setup),
        ("format", format),
        ("control room", || ui::check().and_then(|()| ui::build())),
        ("clippy", clippy),
        // The tests start it in QEMU.
        ("emulated board", || image::image(&VIRT)),
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
        // Sends to the server that the tests have built.
        ("API from its description", fuzz_api::step),
        ("histories on other targets", || histories::command(&[])),
        ("instruction counts", || counts::command(&[])),
        // Builds the images of the boards.
        ("sizes", || size::command(&[])),
        ("clippy of boards", clippy_of_boards),
        ("check of the S3 board", || check_s3::command(&[])),
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

/// The host's workspace, and those of the boards.
fn format() -> Outcome {
    run::cargo(&["fmt", "--all", "--check"])?;
    for name in boards::WORKSPACES {
        let manifest = boards::manifest(name);
        run::cargo(&["fmt", "--manifest-path", &manifest, "--check"])?;
    }
    Ok(())
}

/// What is built for the host there is also tested; the others by their compiler alone, since
/// the two RISC-V chips differ in little more than their names.
fn clippy_of_boards() -> Outcome {
    for board in [&PROGRAM, &VIRT, &C3, &C6] {
        let mut command = cross::compiler(board)?.cargo(board, "clippy");
        command.args(["--", "--deny", "warnings"]);
        run::run_command(command)?;
    }
    for workspace in ["image", "log"] {
        image::tool(workspace, "test", &[])?;
        let strict = ["--all-targets", "--", "--deny", "warnings"];
        image::tool(workspace, "clippy", &strict)?;
    }
    Ok(())
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
    run::cargo(&["deny", "--all-features", "check"])?;
    for name in boards::WORKSPACES {
        let manifest = boards::manifest(name);
        run::cargo(&[
            "deny",
            "--manifest-path",
            &manifest,
            "check",
            "--config",
            "deny.toml",
        ])?;
    }
    Ok(())
}
