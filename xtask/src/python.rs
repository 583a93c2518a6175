//! The package for Python: its types, its lints, and its tests with the program, in an environment of its own.

use std::env;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::run::{self, Failure, Outcome};

/// What the tests take, in releases that are known to get along with each other.
const TOOLS: [&str; 8] = [
    "flit_core==4.2.0",
    "gymnasium==1.4.0",
    "mypy==2.4.1",
    "numpy==2.4.6",
    "pettingzoo==1.27.0",
    "pytest==9.2.0",
    "ruff==0.17.6",
    "tensorboard==2.21.0",
];
/// For installing them.
const PATIENCE: Duration = Duration::from_mins(5);
/// Below the root.
const PACKAGE: &str = "python";

/// `cargo xtask python`
///
/// # Errors
/// When an argument is none, the tools cannot be had, or they find something.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    if let Some(argument) = arguments.first() {
        return Err(Failure(format!("'{argument}' is not understood")));
    }
    Tools::get()?.test()
}

/// The step of the deep tier. A machine without Python or network leaves it out.
///
/// # Errors
/// When something is found.
pub(crate) fn step() -> Outcome {
    match Tools::get() {
        Ok(tools) => tools.test(),
        Err(Failure(reason)) => {
            println!("skipped: {reason}");
            Ok(())
        }
    }
}

/// An environment of Python below the target directory.
struct Tools(PathBuf);

impl Tools {
    /// Makes it if need be.
    fn get() -> Outcome<Self> {
        let tools = run::root().join(run::target_dir()).join("tools");
        let tools = Self(tools.join("python"));
        if tools.note().is_file() {
            return Ok(tools);
        }
        println!("installing {}", TOOLS.join(" "));
        // Of other releases, or half of it.
        let _ = fs::remove_dir_all(&tools.0);
        let mut venv = Command::new("python3");
        venv.args(["-m", "venv"]).arg(&tools.0);
        let mut pip = Command::new(tools.program("pip"));
        pip.args(["install", "--disable-pip-version-check", "--quiet"]);
        pip.args(TOOLS);
        let made = run::within(venv, PATIENCE) && run::within(pip, PATIENCE);
        if made && fs::write(tools.note(), "").is_ok() {
            return Ok(tools);
        }
        let _ = fs::remove_dir_all(&tools.0);
        Err(Failure(
            "what tests the package for Python is missing and cannot be installed here: it takes Python 3.11 or newer, \
             python3-venv and pypi.org"
                .to_owned(),
        ))
    }

    fn program(&self, name: &str) -> PathBuf {
        self.0.join("bin").join(name)
    }

    /// A file that says that these were installed, to the end.
    fn note(&self) -> PathBuf {
        self.0.join(TOOLS.join(" "))
    }

    fn test(&self) -> Outcome {
        let package = run::root().join(PACKAGE);
        let within = |program: &str, words: &[&str]| {
            let mut command = Command::new(self.program(program));
            command.args(words).current_dir(&package);
            command.stdin(Stdio::null());
            command
        };
        // As others get it: what is not in the package is missing.
        let words = "install --disable-pip-version-check --quiet --no-deps --no-build-isolation --force-reinstall .";
        let mut failed = Vec::new();
        for (program, words) in [
            ("pip", words),
            ("ruff", "check ."),
            ("ruff", "format --check ."),
            ("mypy", ""),
        ] {
            let words: Vec<&str> = words.split_whitespace().collect();
            if let Err(Failure(reason)) = run::run_command(within(program, &words)) {
                failed.push(reason);
            }
        }
        run::build_beside_tests(&["--bin", "terracrawler", "--example", "elsewhere"])?;
        let words = "--quiet --durations 3";
        let mut tests = within("pytest", &words.split(' ').collect::<Vec<_>>());
        tests.env("TERRACRAWLER", built("terracrawler"));
        tests.env("CRAWLER_CLASSIC", built("examples/elsewhere"));
        if let Err(Failure(reason)) = run::run_command(tests) {
            failed.push(reason);
        }
        if failed.is_empty() {
            Ok(())
        } else {
            Err(Failure(failed.join("; ")))
        }
    }
}

/// A program that a build for tests makes.
fn built(name: &str) -> PathBuf {
    let built = format!("debug/{name}{}", env::consts::EXE_SUFFIX);
    run::root().join(run::target_dir()).join(built)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_that_are_none_are_refused() {
        assert!(command(&["--quick".to_owned()]).is_err());
    }

    #[test]
    fn the_package_is_of_this_version_and_its_needs_are_told() {
        let root = run::root();
        let read = |path: &str| fs::read_to_string(root.join(path)).expect(path);
        let project = read("python/pyproject.toml");
        let version = format!("version = \"{}\"", env!("CARGO_PKG_VERSION"));
        assert!(project.lines().any(|line| line == version), "{version}");
        let module = read("python/src/terracrawler/__init__.py");
        let version = format!("__{version}").replacen("version", "version__", 1);
        assert!(module.lines().any(|line| line == version), "{version}");
        let page = read("docs/dependencies.md");
        for package in TOOLS {
            let name = package.split("==").next().unwrap_or_default();
            assert!(page.contains(&format!("`{name}`")), "{name}");
        }
    }
}
