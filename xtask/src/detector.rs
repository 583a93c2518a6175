//! From pictures to the detector that robots carry, a step each.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::run::{self, Failure, Outcome};

/// The data set, where [`crate::dataset`] writes it.
const DATASET: &str = "data/detector";
/// What training makes, and quantising takes.
const WEIGHTS: &str = "data/detector.npz";
/// What its first part makes.
const FIRST: &str = "data/detector-first.npz";
const ONNX: &str = "models/detector/detector.onnx";
const BLOB: &str = "models/detector/detector.tcmm";

/// The program that runs another engine: a workspace of its own.
pub(crate) const COMPARE: &str = "models/compare/Cargo.toml";

/// `cargo xtask detector train|quantise|convert|compare`
///
/// # Errors
/// When Python or one of its modules is missing, or a step fails.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let usage =
        || Failure("cargo xtask detector train|quantise|convert|compare [OPTIONS]".to_owned());
    let (step, options) = arguments.split_first().ok_or_else(usage)?;
    match step.as_str() {
        "train" => {
            exists(DATASET, "cargo xtask dataset")?;
            train(options)
        }
        "quantise" => {
            exists(WEIGHTS, "cargo xtask detector train")?;
            let modules = ["torch", "onnx"];
            python("quantise.py", &modules, &[DATASET, WEIGHTS, ONNX], options)
        }
        "convert" if options.is_empty() => {
            let program =
                "run --release --locked --quiet --package crawler-convert --example convert";
            let mut words: Vec<&str> = program.split(' ').collect();
            words.extend(["--", ONNX, BLOB]);
            run::cargo(&words)
        }
        "compare" => compare(options),
        _ => Err(usage()),
    }
}

/// Lints the program that runs another engine, and runs it.
///
/// # Errors
/// When it cannot be built, or the engines differ, or one of them from the file that tests read.
pub(crate) fn compare(options: &[String]) -> Outcome {
    let strict = ["--all-targets", "--", "--deny", "warnings"];
    run::run_command(of_compare("clippy", &strict))?;
    let options = options.iter().map(String::as_str);
    let words: Vec<&str> = std::iter::once("--").chain(options).collect();
    run::run_command(of_compare("run", &words))
}

/// Cargo's `subcommand` in [`COMPARE`].
pub(crate) fn of_compare(subcommand: &str, words: &[&str]) -> Command {
    let mut command = run::cargo_command(subcommand);
    command
        .args([
            "--locked",
            "--quiet",
            "--manifest-path",
            COMPARE,
            "--target-dir",
        ])
        .arg(run::target_dir().join("compare"))
        .args(words);
    command
}

/// With options one run of the script; without, the two that made the detector of the repository.
fn train(options: &[String]) -> Outcome {
    let run = |out: &str, words: &[&str]| {
        let words: Vec<String> = words.iter().map(|&word| word.to_owned()).collect();
        python("train.py", &["torch"], &[DATASET, out], &words)
    };
    if !options.is_empty() {
        return python("train.py", &["torch"], &[DATASET, WEIGHTS], options);
    }
    run(FIRST, &["--frames", "30000", "--epochs", "14"])?;
    run(
        WEIGHTS,
        &[
            "--from", FIRST, "--epochs", "4", "--rate", "1.5e-3", "--seed", "2",
        ],
    )
}

fn exists(path: &str, made_by: &str) -> Outcome {
    if run::root().join(path).exists() {
        return Ok(());
    }
    Err(Failure(format!("{path} is missing: `{made_by}` makes it")))
}

/// Runs a script of the detector on files of the repository.
fn python(script: &str, modules: &[&str], files: &[&str], options: &[String]) -> Outcome {
    for module in modules {
        if run::output("python3", &["-c", &format!("import {module}")]).is_none() {
            return Err(Failure(format!(
                "Python has no module '{module}': on Debian `apt install python3-{module}`"
            )));
        }
    }
    let folder = Path::new("models/detector/training");
    let mut words: Vec<PathBuf> = vec![PathBuf::from("-u"), folder.join(script)];
    words.extend(files.iter().map(PathBuf::from));
    words.extend(options.iter().map(PathBuf::from));
    run::run(&run::root(), "python3", &words)
}
