//! The search for a run that breaks something.

use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use crawler_sim::evaluate::{Search, shrink};
use crawler_sim::scenario::Scenario;
use crawler_system::cli_error::CliError;

use super::progress::Progress;
use super::{EvaluateArgs, quoted, threads_or_all, write_file};

/// Searches, shrinks, and writes what was found. Failure when something was.
pub(super) fn run(
    args: &EvaluateArgs,
    scenario: Scenario,
    stop: &AtomicBool,
) -> Result<ExitCode, CliError> {
    let search = Search {
        scenario,
        seed: args.seed,
        budget: args.budget as usize,
        hunted: args.hunt.clone(),
    };
    let budget = search.budget;
    let found = {
        let progress = Progress::new();
        search.run(threads_or_all(args.threads), stop, &|runs| {
            progress.tell(|| format!("searching: {runs} of {budget} runs"));
        })
    };
    let Some(find) = found else {
        if stop.load(Ordering::Relaxed) {
            eprintln!("terracrawler: interrupted; nothing was found so far");
            return Ok(ExitCode::from(130));
        }
        println!("nothing was broken in {budget} runs");
        return Ok(ExitCode::SUCCESS);
    };
    println!(
        "after {} runs, seed {}: {}",
        find.runs, find.seed, find.failure
    );
    let shrunk = {
        let progress = Progress::new();
        shrink(&find, budget, stop, &|runs| {
            progress.tell(|| format!("shrinking: {runs} of {budget} runs"));
        })
    };
    let text = shrunk.scenario.to_toml()?;
    let path = args.out.display().to_string();
    let head = format!(
        "# Found by a search and shrunk. Fails with seed {}:\n# {}\n",
        shrunk.seed, shrunk.failure
    );
    write_file(&args.out, &format!("{head}{text}"))?;
    println!(
        "shrunk in {} runs to {} robots, {} obstacles, {} faults, {} s: {}\n  written to {path}; again:",
        shrunk.runs,
        shrunk.scenario.robots,
        shrunk.scenario.arena.obstacles.len(),
        shrunk.scenario.faults.len(),
        shrunk.scenario.duration_s,
        shrunk.failure
    );
    let file = quoted(&path);
    println!(
        "    terracrawler evaluate --scenario {file} --seeds 1 --seed {}",
        shrunk.seed
    );
    println!(
        "    terracrawler replay --scenario {file} --seed {}",
        shrunk.seed
    );
    Ok(ExitCode::FAILURE)
}
