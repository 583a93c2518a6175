//! Instructions of a control step of a simulated robot, against the committed table.
//!
//! The program is the one that the tests have built, in their profile: the figures say whether a change
//! made a step dearer, on any machine and beside any load. How fast it is without is for `cargo xtask bench sim`.

use std::fs;

use crate::bench_sim;
use crate::counts::{self, Column, Count};
use crate::files;
use crate::run::{self, Failure, Outcome};
use crate::tools;

/// The page with the table.
const PAGE: &str = "docs/simulator-speed.md";

/// Robots of the world that every run of the tests counts.
const SMALL: u32 = 100;

/// Of all worlds that are counted. The large one takes a minute.
const SIZES: [u32; 2] = [SMALL, 1_000];

/// `cargo xtask counts --simulator [--update]`
///
/// # Errors
/// When valgrind is missing, the program fails, or a figure rose by more than 5 %.
pub(crate) fn command(update: bool) -> Outcome {
    tools::VALGRIND.require()?;
    let measured = measure(&SIZES)?;
    if !update {
        return judge(&SIZES, &measured);
    }
    let path = run::root().join(PAGE);
    let text = read()?;
    let compiler = run::output("rustc", &["--version"]).unwrap_or_default();
    let column = Column::Delivered;
    files::write(
        &path,
        &counts::rewritten(&text, &measured, column, compiler.trim()),
    )
}

/// The same for a small world, where there is valgrind.
///
/// # Errors
/// See [`command`].
pub(crate) fn step() -> Outcome {
    count_and_judge(&[SMALL])
}

/// The same for all worlds.
///
/// # Errors
/// See [`command`].
pub(crate) fn thorough_step() -> Outcome {
    count_and_judge(&SIZES)
}

fn count_and_judge(sizes: &[u32]) -> Outcome {
    if let Err(Failure(missing)) = tools::VALGRIND.require() {
        println!("skipped: {missing}");
        return Ok(());
    }
    judge(sizes, &measure(sizes)?)
}

fn name(robots: u32) -> String {
    format!("lockstep_{robots}")
}

fn measure(sizes: &[u32]) -> Outcome<Vec<Count>> {
    run::build_beside_tests(&["--example", "sim_bench"])?;
    let program = run::root()
        .join(run::target_dir())
        .join("debug/examples/sim_bench");
    let mut measured = Vec::new();
    for &robots in sizes {
        let count = bench_sim::callgrind(&program, "lockstep", robots)?;
        let instructions = count
            .instructions
            .ok_or_else(|| Failure("valgrind counted nothing".to_owned()))?;
        measured.push(Count {
            name: name(robots),
            instructions: instructions as u64,
            limit: None,
        });
    }
    Ok(measured)
}

fn judge(sizes: &[u32], measured: &[Count]) -> Outcome {
    let mut committed = counts::read_table(&read()?, Column::Delivered);
    committed.retain(|count| {
        let asked = sizes.iter().any(|&robots| count.name == name(robots));
        // What no world is named after is told as not measured.
        asked || !SIZES.iter().any(|&robots| count.name == name(robots))
    });
    let (report, complaints) = counts::compare(&committed, measured);
    print!("{report}");
    if complaints.is_empty() {
        Ok(())
    } else {
        Err(Failure(format!(
            "{}\nIf that is meant: `cargo xtask counts --simulator --update`, and the reason in the commit.",
            complaints.join("\n")
        )))
    }
}

fn read() -> Outcome<String> {
    let path = run::root().join(PAGE);
    fs::read_to_string(&path).map_err(|error| Failure(format!("{}: {error}", path.display())))
}
