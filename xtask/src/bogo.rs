//! The robot's TLS client under the tests of another library: `docs/tls.md`.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::run::{self, Failure, Outcome};

/// What of the tests does not apply, and how their errors are called here.
const CONFIG: &str = "firmware/tls/bogo/config.json";
/// Where the deep tier finds the runner.
const RUNNER: &str = "BOGO_RUNNER";

/// `cargo xtask bogo --runner FILE`
///
/// # Errors
/// When there is no runner there, a test fails, or none applies.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let [option, runner] = arguments else {
        return Err(Failure("cargo xtask bogo --runner FILE".to_owned()));
    };
    if option != "--runner" {
        return Err(Failure(format!("there is no option '{option}'")));
    }
    tests(Path::new(runner))
}

/// The same, where a runner is named by the environment.
///
/// # Errors
/// As [`command`].
pub(crate) fn if_there() -> Outcome {
    let Some(runner) = std::env::var_os(RUNNER) else {
        println!("skipped: {RUNNER} names no runner of BoringSSL's TLS tests (docs/tls.md)");
        return Ok(());
    };
    tests(Path::new(&runner))
}

fn tests(runner: &Path) -> Outcome {
    let runner = runner
        .canonicalize()
        .map_err(|error| Failure(format!("{}: {error}", runner.display())))?;
    let shim = run::build_example("crawler-tls", "bogo_shim")?;
    let output = Command::new(&runner)
        .args(["-allow-unimplemented", "-pipe", "-shim-path"])
        .arg(&shim)
        .arg("-shim-config")
        .arg(run::root().join(CONFIG))
        .current_dir(runner.parent().map_or_else(PathBuf::new, Path::to_owned))
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| Failure(format!("{}: {error}", runner.display())))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let [passed, failed, left_out] = counts(&text);
    // One line for each test that passed or does not apply, and all there is about those that failed.
    for line in text.lines().filter(|line| !is_quiet(line)) {
        println!("{line}");
    }
    println!("{passed} passed, {failed} failed, {left_out} do not apply");
    if failed > 0 || !output.status.success() {
        return Err(Failure(format!("{failed} tests failed")));
    }
    if passed == 0 {
        return Err(Failure("no test ran".to_owned()));
    }
    Ok(())
}

const PASSED: &str = "PASSED (";
const FAILED: &str = "FAILED (";
const LEFT_OUT: &str = "UNIMPLEMENTED (";

fn is_quiet(line: &str) -> bool {
    line.is_empty() || line.starts_with(PASSED) || line.starts_with(LEFT_OUT)
}

/// How many tests passed, failed, and asked for something that there is not.
fn counts(text: &str) -> [usize; 3] {
    [PASSED, FAILED, LEFT_OUT]
        .map(|what| text.lines().filter(|line| line.starts_with(what)).count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_runners_words_are_counted() {
        let text =
            "PASSED (A)\nUNIMPLEMENTED (B)\nFAILED (C)\nunexpected success\n\nPASSED (D)\nPASS\n";
        assert_eq!(counts(text), [2, 1, 1]);
        let loud: Vec<&str> = text.lines().filter(|line| !is_quiet(line)).collect();
        assert_eq!(loud, ["FAILED (C)", "unexpected success", "PASS"]);
    }
}
