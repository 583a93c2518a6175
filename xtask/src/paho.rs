//! The interoperability suite of Eclipse Paho against the embedded broker. What may fail, and why, stands in
//! `docs/conformance.md`: a test that fails otherwise fails this command, and so does one that passes though
//! it stands there.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::run::{self, Failure, Outcome};
use crate::server::Server;

const SOURCE: &str = "https://github.com/eclipse/paho.mqtt.testing";
/// The version that the page is about.
const COMMIT: &str = "9d7bb80bb8b9d9cfc0b52f8cb4c1916401281103";
const PAGE: &str = "docs/conformance.md";
/// Its programs: for MQTT 5 and for MQTT 3.1.1.
const PROGRAMS: [&str; 2] = ["client_test5", "client_test"];
/// For one of them. It sleeps for more than two minutes.
const PATIENCE: Duration = Duration::from_mins(15);
const DOWNLOAD: Duration = Duration::from_mins(3);
/// Runs one program against a port of this machine and prints `NAME passed` or `NAME failed` for each test.
/// The names are set here because the programs set them only where they are run by themselves. What the server
/// has to say to its fleet comes every few seconds, and is not what the tests wait for. Some of the tests count
/// what is under way without end once they have counted wrong: each has two minutes.
const RUNNER: &str = r##"
import importlib, logging, signal, sys, unittest
name, port = sys.argv[1], int(sys.argv[2])
logging.disable(logging.CRITICAL)
program = importlib.import_module(name)
program.host, program.port = "127.0.0.1", port
program.topics = ("TopicA", "TopicA/B", "Topic/C", "TopicA/C", "/TopicA")
program.wildtopics = ("TopicA/+", "+/C", "#", "/#", "/+", "+/+", "TopicA/#")
program.nosubscribe_topics = ("test/nosubscribe",)
program.topic_prefix = "client_test5/"
arrived = program.Callbacks.publishArrived
program.Callbacks.publishArrived = lambda self, topic, *rest, **more: \
    topic.startswith("swarm/") or arrived(self, topic, *rest, **more)
def late(number, frame):
    raise TimeoutError("it does not come to its end")
signal.signal(signal.SIGALRM, late)
run = program.Test.run
def bounded(self, result=None):
    signal.alarm(120)
    try:
        return run(self, result)
    finally:
        signal.alarm(0)
program.Test.run = bounded
loader = unittest.defaultTestLoader
print_, sys.stdout = sys.stdout, sys.stderr
result = unittest.TextTestRunner().run(loader.loadTestsFromModule(program))
failed = {test.id().rsplit(".")[-1] for test, _ in result.failures + result.errors}
names = loader.getTestCaseNames(program.Test)
if result.testsRun != len(names) or failed - set(names):
    sys.exit("not every test could be run")
for test in names:
    print(test, "failed" if test in failed else "passed", file=print_)
"##;

/// `cargo xtask paho [DIRECTORY]`: with the suite in this folder, or in one that is fetched.
///
/// # Errors
/// When the suite cannot be had, or a test comes out otherwise than the page says.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let suite = match arguments {
        [] => fetched()?,
        [directory] => PathBuf::from(directory),
        _ => return Err(Failure("cargo xtask paho [DIRECTORY]".to_owned())),
    };
    run::build_beside_tests(&["--bin", "terracrawler"])?;
    against(&suite)
}

/// The step of the deep tier. A machine without Python, git or network leaves it out.
///
/// # Errors
/// When a test comes out otherwise than the page says.
pub(crate) fn step() -> Outcome {
    match fetched() {
        Ok(suite) => {
            run::build_beside_tests(&["--bin", "terracrawler"])?;
            against(&suite)
        }
        Err(Failure(reason)) => {
            println!("skipped: {reason}");
            Ok(())
        }
    }
}

/// The suite under the target directory, fetched if need be.
fn fetched() -> Outcome<PathBuf> {
    let tools = run::root().join(run::target_dir()).join("tools");
    let folder = tools.join(format!("paho.mqtt.testing-{COMMIT}"));
    if folder.join("interoperability").is_dir() {
        return Ok(folder);
    }
    println!("fetching {SOURCE}");
    let git = |arguments: &[&str]| {
        let mut git = Command::new("git");
        git.arg("-C").arg(&folder).args(arguments);
        git.env("GIT_TERMINAL_PROMPT", "0").stdin(Stdio::null());
        run::within(git, DOWNLOAD)
    };
    let made = fs::create_dir_all(&folder).is_ok()
        && git(&["init", "--quiet"])
        && git(&["fetch", "--quiet", "--depth", "1", SOURCE, COMMIT])
        && git(&["checkout", "--quiet", "FETCH_HEAD"]);
    if !made {
        // Half of it would be taken for all of it.
        let _ = fs::remove_dir_all(&folder);
        return Err(Failure(format!(
            "the suite of Eclipse Paho is missing and cannot be fetched here: get {SOURCE} and run \
             `cargo xtask paho DIRECTORY`"
        )));
    }
    Ok(folder)
}

fn against(suite: &Path) -> Outcome {
    let page = run::root().join(PAGE);
    let page = fs::read_to_string(&page)
        .map_err(|error| Failure(format!("{}: {error}", page.display())))?;
    let server = Server::start(&["serve", "--open"], |_, _| Ok(()))?;
    let mut surprises = Vec::new();
    for program in PROGRAMS {
        let expected = listed(&page, program);
        println!("{program}, with {} that differ on purpose", expected.len());
        let results = run(&server, suite, program)?;
        for (test, passed) in &results {
            let word = match (*passed, expected.contains(test)) {
                (true, false) => "passed",
                (false, true) => "differs",
                (false, false) => {
                    surprises.push(format!("{program} {test} fails"));
                    "FAILED"
                }
                (true, true) => {
                    surprises.push(format!("{program} {test} passes, but stands in {PAGE}"));
                    "PASSED"
                }
            };
            println!("  {word:8} {test}");
        }
        let known: BTreeSet<_> = results.into_iter().map(|(test, _)| test).collect();
        for unknown in expected.difference(&known) {
            surprises.push(format!(
                "{program} has no {unknown}, which stands in {PAGE}"
            ));
        }
    }
    if surprises.is_empty() {
        return Ok(());
    }
    println!("{}", server.log());
    Err(Failure(surprises.join("; ")))
}

/// The tests of a program that stand in the table of the page: rows of program, test and reason.
fn listed(page: &str, program: &str) -> BTreeSet<String> {
    let quoted = format!("`{program}`");
    let rows = page.lines().filter_map(|line| {
        let mut cells = line.strip_prefix('|')?.split('|').map(str::trim);
        (cells.next()? == quoted).then(|| cells.next())?
    });
    rows.map(|test| test.trim_matches('`').to_owned()).collect()
}

/// Runs a program of the suite; each test, and whether it passed.
fn run(server: &Server, suite: &Path, program: &str) -> Outcome<Vec<(String, bool)>> {
    let path = |name: &str| server.folder().join(format!("{program}.{name}"));
    let file = |name| {
        let path = path(name);
        File::create(&path).map_err(|error| Failure(format!("{}: {error}", path.display())))
    };
    let port = server.mqtt().port().to_string();
    let mut python = Command::new("python3");
    python
        .args(["-B", "-c", RUNNER, program, &port])
        .env("PYTHONPATH", suite.join("interoperability"))
        .current_dir(server.folder())
        .stdin(Stdio::null())
        .stdout(file("results")?)
        .stderr(file("log")?);
    let mut child = python
        .spawn()
        .map_err(|error| Failure(format!("python3: {error}")))?;
    let end = std::time::Instant::now() + PATIENCE;
    let succeeded = loop {
        match child.try_wait() {
            Ok(Some(status)) => break status.success(),
            Ok(None) if std::time::Instant::now() < end => {
                std::thread::sleep(Duration::from_millis(200));
            }
            Ok(None) | Err(_) => {
                let _ = child.kill();
                let _ = child.wait();
                break false;
            }
        }
    };
    let read = |name| fs::read_to_string(path(name)).unwrap_or_default();
    println!("{}", read("log"));
    if !succeeded {
        return Err(Failure(format!("{program} did not come to its end")));
    }
    let results = read("results");
    let results = results.lines().filter_map(|line| line.split_once(' '));
    Ok(results
        .map(|(test, outcome)| (test.to_owned(), outcome == "passed"))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_says_what_differs_and_why() {
        let page = run::root().join(PAGE);
        let page = fs::read_to_string(page).expect("a page");
        assert!(page.contains(COMMIT), "another version");
        for program in PROGRAMS {
            let tests = listed(&page, program);
            assert!(!tests.is_empty() && tests.iter().all(|test| test.starts_with("test")));
        }
        let rows = page
            .lines()
            .filter(|line| line.starts_with("| `client_test"));
        for row in rows {
            let reason = row.split('|').nth(3).expect("a reason").trim();
            assert!(reason.len() > 20, "{row}");
        }
    }
}
