//! The interoperability suite of Eclipse Paho against the embedded broker. What may fail, and why, stands in
//! `docs/conformance.md`: a test that fails otherwise fails this command, and so does one that passes though
//! it stands there.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::run::{self, Failure, Outcome};

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
/// has to say to its fleet comes every few seconds, and is not what the tests wait for.
const RUNNER: &str = r##"
import importlib, logging, sys, unittest
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
    let server = Server::start()?;
    let mut surprises = Vec::new();
    for program in PROGRAMS {
        let expected = listed(&page, program);
        println!("{program}, with {} that differ on purpose", expected.len());
        let results = server.run(suite, program)?;
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

/// An open server that ends with this, and its folder with it.
struct Server {
    child: Child,
    folder: PathBuf,
    port: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = fs::remove_dir_all(&self.folder);
    }
}

impl Server {
    fn start() -> Outcome<Self> {
        let failed = |what: &str, error: std::io::Error| Failure(format!("{what}: {error}"));
        let program = run::root()
            .join(run::target_dir())
            .join("debug/terracrawler");
        let name = format!("terracrawler-paho-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        fs::create_dir_all(&folder).map_err(|error| failed("a folder", error))?;
        let errors = File::create(folder.join("log")).map_err(|error| failed("a log", error))?;
        let mut child = Command::new(&program)
            .args(["serve", "--open"])
            .args(["--http", "127.0.0.1:0", "--mqtt", "127.0.0.1:0", "--data"])
            .arg(folder.join("data"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(errors)
            .spawn()
            .map_err(|error| failed(&program.display().to_string(), error))?;
        let output = child.stdout.take();
        let mut server = Self {
            child,
            folder,
            port: String::new(),
        };
        // The rest of what it says fits into the pipe.
        let port = output.and_then(|output| {
            let lines = BufReader::new(output).lines();
            lines.map_while(Result::ok).find_map(|line| {
                let (_, rest) = line.split_once("mqtt://127.0.0.1:")?;
                rest.split(' ').next().map(str::to_owned)
            })
        });
        server.port = port.ok_or_else(|| Failure(format!("no server:\n{}", server.log())))?;
        Ok(server)
    }

    /// What it complained of.
    fn log(&self) -> String {
        fs::read_to_string(self.folder.join("log")).unwrap_or_default()
    }

    /// Runs a program of the suite; each test, and whether it passed.
    fn run(&self, suite: &Path, program: &str) -> Outcome<Vec<(String, bool)>> {
        let path = |name: &str| self.folder.join(format!("{program}.{name}"));
        let file = |name| {
            let path = path(name);
            File::create(&path).map_err(|error| Failure(format!("{}: {error}", path.display())))
        };
        let mut python = Command::new("python3");
        python
            .args(["-B", "-c", RUNNER, program, &self.port])
            .env("PYTHONPATH", suite.join("interoperability"))
            .current_dir(&self.folder)
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
