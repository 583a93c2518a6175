//! What `evaluate` says and writes.

use std::fs::OpenOptions;
use std::path::Path;

use crawler_sim::evaluate::Evaluation;
use crawler_system::cli_error::{CliError, OrSay as _};

use super::shown;

/// Names seeds that failed, and how to see them again: by `replay` and these options.
pub(super) fn explain(words: &str, evaluation: &Evaluation, most: usize) {
    let failed: Vec<_> = evaluation.failed().collect();
    if failed.is_empty() {
        return;
    }
    println!(
        "\n  failed: {} of {} runs",
        failed.len(),
        evaluation.trials.len()
    );
    for trial in failed.iter().take(most) {
        for failure in &trial.failures {
            println!("  seed {}: {failure}", trial.seed);
        }
        println!("    terracrawler replay{words} --seed {}", trial.seed);
    }
    if failed.len() > most {
        println!("  and {} more", failed.len() - most);
    }
}

/// Whether a file can be written, before hours go into what is to be in it. What is in it now stays.
pub(super) fn can_write(path: &Path) -> Result<(), CliError> {
    let is_new = !path.exists();
    let opened = OpenOptions::new().append(true).create(true).open(path);
    opened.or_say(|error| format!("cannot write {}: {error}", shown(path)))?;
    if is_new {
        // One that stays behind is empty, and will be written over.
        let _ = std::fs::remove_file(path);
    }
    Ok(())
}

/// Writes a file, or says why not.
pub(super) fn write_file(path: &Path, text: &str) -> Result<(), CliError> {
    std::fs::write(path, text).or_say(|error| format!("cannot write {}: {error}", shown(path)))
}
