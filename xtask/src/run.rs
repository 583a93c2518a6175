//! Running other programs, and saying plainly what went wrong.

use std::env;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// One line for the person at the terminal: what failed and what to do about it.
#[derive(Debug)]
pub(crate) struct Failure(pub(crate) String);

/// What a command came to.
pub(crate) type Outcome<T = ()> = Result<T, Failure>;

/// The root of the repository.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("xtask lies in the repository")
        .to_owned()
}

/// This program, for another process of it. `main` asks first: once cargo has built it anew beside the tests, the
/// system may say of the file that runs that it is deleted.
///
/// # Errors
/// When the system does not tell.
pub(crate) fn this_program() -> Outcome<&'static Path> {
    static PROGRAM: OnceLock<Option<PathBuf>> = OnceLock::new();
    let program = PROGRAM.get_or_init(|| env::current_exe().ok());
    program
        .as_deref()
        .ok_or_else(|| Failure("the system does not tell where this program lies".to_owned()))
}

/// Where cargo puts what it builds.
pub(crate) fn target_dir() -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// Runs `program` in `directory` and shows its output.
pub(crate) fn run<S: AsRef<OsStr>>(directory: &Path, program: &str, arguments: &[S]) -> Outcome {
    run_command(command(directory, program, arguments))
}

/// As [`run`], with extra environment variables.
pub(crate) fn run_with_env<S: AsRef<OsStr>>(
    directory: &Path,
    program: &str,
    arguments: &[S],
    variables: &[(&str, &str)],
) -> Outcome {
    let mut command = command(directory, program, arguments);
    command.envs(variables.iter().copied());
    run_command(command)
}

/// Runs cargo at the root of the repository.
pub(crate) fn cargo(arguments: &[&str]) -> Outcome {
    run(&root(), &cargo_program(), arguments)
}

/// Cargo's `subcommand` at the root of the repository, for whoever reads what it prints.
pub(crate) fn cargo_command(subcommand: &str) -> Command {
    let mut command = command(&root(), &cargo_program(), &[subcommand]);
    forget_this_package(&mut command);
    command
}

/// Builds an example of a crate, optimised, and returns where it is.
///
/// # Errors
/// When it cannot be built.
pub(crate) fn build_example(package: &str, example: &str) -> Outcome<PathBuf> {
    let words = ["build", "--release", "--locked", "--quiet"];
    cargo(&[&words[..], &["--package", package, "--example", example]].concat())?;
    let name = format!("{example}{}", env::consts::EXE_SUFFIX);
    let directory = target_dir().join("release").join("examples");
    Ok(root().join(directory).join(name))
}

/// Builds `targets` (`--bin NAME`, `--example NAME`) with the features that the whole workspace and its
/// tests ask for together: after the tests, nothing that they stand on is built once more.
///
/// # Errors
/// When they cannot be built.
pub(crate) fn build_beside_tests(targets: &[&str]) -> Outcome {
    // An example, and so no binary alone, brings in what tests ask of dependencies.
    let words = [
        "build",
        "--locked",
        "--quiet",
        "--workspace",
        "--all-features",
    ];
    cargo(&[&words[..], &["--example", "sight"], targets].concat())
}

/// A seed that no run before had, for whoever looks for what is rare. Whoever draws one prints it.
pub(crate) fn fresh_seed() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(1, |now| u64::from(now.subsec_nanos()) ^ now.as_secs())
}

/// The cargo that runs this program.
pub(crate) fn cargo_program() -> String {
    env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned())
}

/// What `program` prints, or `None` when it cannot be run or fails.
pub(crate) fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let mut command = Command::new(program);
    command.args(arguments);
    output_of(command)
}

/// What `command` prints, or `None` when it cannot be run or fails.
pub(crate) fn output_of(mut command: Command) -> Option<String> {
    forget_this_package(&mut command);
    let output = command.stdin(Stdio::null()).output().ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Becomes `program`, so that Ctrl-C and the exit code are its own.
pub(crate) fn replace_with(program: &Path, arguments: impl Iterator<Item = String>) -> Outcome {
    let mut command = Command::new(program);
    command.args(arguments).current_dir(root());
    #[cfg(unix)]
    {
        use std::os::unix::process::CommandExt as _;
        let error = command.exec();
        Err(Failure(format!(
            "cannot start {}: {error}",
            program.display()
        )))
    }
    #[cfg(not(unix))]
    run_command(command)
}

fn command<S: AsRef<OsStr>>(directory: &Path, program: &str, arguments: &[S]) -> Command {
    let mut command = Command::new(program);
    command
        .args(arguments)
        .current_dir(directory)
        .stdin(Stdio::null());
    command
}

/// Runs `command` quietly; whether it succeeded before `limit` was over.
pub(crate) fn within(mut command: Command, limit: Duration) -> bool {
    let quiet = command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let Ok(mut child) = quiet.spawn() else {
        return false;
    };
    let began = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return status.success(),
            Ok(None) if began.elapsed() < limit => std::thread::sleep(Duration::from_millis(50)),
            // It may end between the look and the kill; either way it is over.
            _ => {
                let _ = child.kill();
                let _ = child.wait();
                return false;
            }
        }
    }
}

/// Removes from the environment of `command` what cargo told this program about itself. Build scripts of
/// others look at it (that of `ring` does), and would be run again whenever cargo is called now from here
/// and now by hand, with all that depends on them.
fn forget_this_package(command: &mut Command) {
    for (name, _) in env::vars_os() {
        let own = name.to_str().is_some_and(|name| {
            name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_")
        });
        if own {
            command.env_remove(name);
        }
    }
}

/// Runs `command` and shows its output.
pub(crate) fn run_command(mut command: Command) -> Outcome {
    let shown = format!("{command:?}").replace('"', "");
    forget_this_package(&mut command);
    let status = command
        .status()
        .map_err(|error| Failure(format!("cannot run `{shown}`: {error}")))?;
    if status.success() {
        Ok(())
    } else {
        Err(Failure(format!("`{shown}` ended with {status}")))
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::process::Command;
    use std::time::{Duration, Instant};

    use super::within;

    #[test]
    fn what_hangs_is_ended() {
        let began = Instant::now();
        let mut hangs = Command::new("sleep");
        hangs.arg("60");
        assert!(!within(hangs, Duration::from_millis(200)));
        assert!(began.elapsed() < Duration::from_secs(30));
        assert!(within(Command::new("true"), Duration::from_secs(30)));
        assert!(!within(Command::new("false"), Duration::from_secs(30)));
        assert!(!within(
            Command::new("no-such-program"),
            Duration::from_secs(1)
        ));
    }
}
