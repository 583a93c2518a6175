//! Pictures to learn from.

use crate::run::{self, Outcome};

/// Writes a data set into `data/detector` unless `--out` names another folder.
///
/// # Errors
/// When it cannot be built or written.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let mut words = vec![
        "run",
        "--release",
        "--locked",
        "--package",
        "crawler-sim",
        "--example",
        "dataset",
        "--",
    ];
    if !arguments.iter().any(|argument| argument == "--out") {
        words.extend(["--out", "data/detector"]);
    }
    words.extend(arguments.iter().map(String::as_str));
    run::cargo(&words)
}
