//! The API from its own description: a server with accounts in a folder of its own, and Schemathesis
//! signed in as its administrator.

use std::fs::{self, File};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::run::{self, Failure, Outcome};

/// The release that is known to get along with the description.
const VERSION: &str = "4.32.5";
/// Cases for each operation where none are asked for.
const EXAMPLES: u32 = 50;
/// In CI.
const FEW: u32 = 10;
/// One user may make 50 requests a second.
const RATE: &str = "45/s";
const CHECKS: &str = "not_a_server_error,status_code_conformance,content_type_conformance,\
                      response_headers_conformance,response_schema_conformance,\
                      negative_data_rejection,positive_data_acceptance";
/// Where these do not hold, and why.
const EXCEPTIONS: &str = include_str!("fuzz_api.toml");
/// These end the session that the others need, so they come last.
const LAST: [&str; 2] = ["delete_session", "delete_sessions_id"];
/// Half of the cases are about a robot that is there.
const KNOWN: &str = "[[operations]]\ninclude-path-regex = \"^/api/v1/robots/\"\n\
                     parameters = { id = \"sim-0001\" }\n";
const USER: &str = "fuzz";
const PASSWORD: &str = "only for as long as this runs";
const PATIENCE: Duration = Duration::from_mins(1);

/// Runs Schemathesis; installs it under the target directory if it can.
///
/// # Errors
/// When an argument is none, the tool cannot be had, or it finds something.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let usage = || Failure("cargo xtask fuzz api [--examples N] [--seed N]".to_owned());
    let mut seed = run::fresh_seed();
    let mut examples = EXAMPLES;
    for pair in arguments.chunks(2) {
        let [name, value] = pair else {
            return Err(usage());
        };
        let value: u64 = value.parse().map_err(|_| usage())?;
        match name.as_str() {
            "--examples" => examples = u32::try_from(value).map_err(|_| usage())?,
            "--seed" => seed = value,
            _ => return Err(usage()),
        }
    }
    thorough(examples, seed)
}

/// So many cases for each operation, with the binary that a build for tests makes.
///
/// # Errors
/// When the tool cannot be had, or it finds something.
pub(crate) fn thorough(examples: u32, seed: u64) -> Outcome {
    let tool = tool()?;
    run::build_beside_tests(&["--bin", "terracrawler"])?;
    fuzz(&tool, examples, seed)
}

/// The step of CI: few cases with a fixed seed; a machine without Python or network leaves it out.
///
/// # Errors
/// When something is found.
pub(crate) fn step() -> Outcome {
    match tool() {
        Ok(tool) => fuzz(&tool, FEW, 1),
        Err(Failure(reason)) => {
            println!("skipped: {reason}");
            Ok(())
        }
    }
}

/// Schemathesis in an environment of its own, installed if need be.
fn tool() -> Outcome<PathBuf> {
    let folder = run::root()
        .join(run::target_dir())
        .join("tools")
        .join(format!("schemathesis-{VERSION}"));
    let program = folder.join("bin/schemathesis");
    if program.is_file() {
        return Ok(program);
    }
    println!("installing schemathesis {VERSION}");
    let python = |program: &Path, arguments: &[&str]| {
        let mut command = Command::new(program);
        command.args(arguments).arg(&folder);
        run::within(command, Duration::from_mins(1))
    };
    let mut install = Command::new(folder.join("bin/pip"));
    install.args(["install", "--disable-pip-version-check", "--quiet"]);
    install.arg(format!("schemathesis=={VERSION}"));
    let made = python(Path::new("python3"), &["-m", "venv"])
        && run::within(install, Duration::from_mins(3))
        && program.is_file();
    if !made {
        // Half of it would be taken for all of it.
        let _ = fs::remove_dir_all(&folder);
        return Err(Failure(format!(
            "schemathesis {VERSION} is missing (for fuzzing the API) and cannot be installed here: it \
             takes python3-venv and pypi.org"
        )));
    }
    Ok(program)
}

/// A server that ends with this, and its folder with it.
struct Server {
    child: Child,
    folder: PathBuf,
    http: SocketAddr,
}

impl Drop for Server {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// A part of the cases, on a server of its own.
struct Part {
    what: &'static str,
    /// What Schemathesis is told besides.
    config: &'static str,
    /// Whether it is the end of sessions, and nothing else.
    ends: bool,
}

/// Each takes one core at most: one after the other, the other cores would wait.
const PARTS: [&[Part]; 2] = [
    &[Part {
        what: "robots that are there",
        config: KNOWN,
        ends: false,
    }],
    &[
        Part {
            what: "robots that are not",
            config: "",
            ends: false,
        },
        Part {
            what: "ends of sessions",
            config: "",
            ends: true,
        },
    ],
];

fn fuzz(tool: &Path, examples: u32, seed: u64) -> Outcome {
    println!("{examples} cases for each operation, seed {seed}");
    let mut failed = Vec::new();
    std::thread::scope(|scope| {
        let threads = PARTS.map(|parts| {
            scope.spawn(move || {
                let server = start()?;
                server.fuzz(tool, parts, examples, seed)
            })
        });
        for thread in threads {
            match thread.join() {
                Ok(Ok(())) => {}
                Ok(Err(Failure(reason))) => failed.push(reason),
                Err(_) => failed.push("a thread of this program has panicked".to_owned()),
            }
        }
    });
    if failed.is_empty() {
        Ok(())
    } else {
        Err(Failure(format!("seed {seed}: {}", failed.join(", "))))
    }
}

/// Starts a server with an administrator and two robots.
fn start() -> Outcome<Server> {
    static NUMBER: AtomicU32 = AtomicU32::new(1);
    let failed = |what: &str, error: std::io::Error| Failure(format!("{what}: {error}"));
    let program = run::root()
        .join(run::target_dir())
        .join("debug/terracrawler");
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let name = format!("terracrawler-fuzz-{}-{number}", std::process::id());
    let folder = std::env::temp_dir().join(name);
    fs::create_dir_all(&folder).map_err(|error| failed("a folder", error))?;
    let data = folder.join("data");
    let mut adding = Command::new(&program)
        .args(["user", "add", USER, "--role", "admin", "--data"])
        .arg(&data)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .map_err(|error| failed(&program.display().to_string(), error))?;
    if let Some(mut input) = adding.stdin.take() {
        writeln!(input, "{PASSWORD}").map_err(|error| failed("the password", error))?;
    }
    let added = adding.wait().map_err(|error| failed("an account", error))?;
    if !added.success() {
        return Err(Failure(format!("no account could be made: {added}")));
    }
    let log = folder.join("log");
    let errors = File::create(&log).map_err(|error| failed("a log", error))?;
    let mut child = Command::new(&program)
        .args(["up", "--robots", "2", "--scenario", "empty"])
        .args(["--http", "127.0.0.1:0", "--mqtt", "127.0.0.1:0"])
        .arg("--data")
        .arg(&data)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(errors)
        .spawn()
        .map_err(|error| failed(&program.display().to_string(), error))?;
    let output = child.stdout.take();
    let mut server = Server {
        child,
        folder,
        http: SocketAddr::from(([127, 0, 0, 1], 0)),
    };
    server.http = output
        .and_then(address)
        .ok_or_else(|| Failure(format!("no server:\n{}", server.log())))?;
    Ok(server)
}

/// Where a server says that it listens. What it says after that is read by a thread, so that it never
/// waits for a reader.
fn address(output: ChildStdout) -> Option<SocketAddr> {
    let mut lines = BufReader::new(output).lines();
    let address = lines.by_ref().map_while(Result::ok).find_map(|line| {
        let (_, rest) = line.split_once("http://")?;
        rest.split(['/', ' ']).next()?.parse().ok()
    })?;
    std::thread::spawn(move || lines.map_while(Result::ok).for_each(drop));
    Some(address)
}

impl Server {
    /// Sends it `parts` of the cases, one after the other, and prints what each came to.
    fn fuzz(&self, tool: &Path, parts: &[Part], examples: u32, seed: u64) -> Outcome {
        let token = self.sign_in()?;
        let mut failed = Vec::new();
        for part in parts {
            let mut command = self.schemathesis(tool, part, &token)?;
            command
                .args(["--seed", &seed.to_string()])
                .args(["--max-examples", &examples.to_string()]);
            // At once, so that what two say does not get mixed up.
            let output = command
                .output()
                .map_err(|error| Failure(format!("cannot run {}: {error}", tool.display())))?;
            let said = String::from_utf8_lossy(&output.stdout);
            let complained = String::from_utf8_lossy(&output.stderr);
            println!("\n-- {}\n{said}{complained}", part.what);
            if !output.status.success() {
                failed.push(part.what);
            }
        }
        let log = self.log();
        if log.contains("panicked") {
            println!("{log}");
            failed.push("the server's log has a panic");
        }
        if failed.is_empty() {
            Ok(())
        } else {
            Err(Failure(failed.join(", ")))
        }
    }

    /// The command for one part.
    fn schemathesis(&self, tool: &Path, part: &Part, token: &str) -> Outcome<Command> {
        let config = self.folder.join("schemathesis.toml");
        fs::write(&config, format!("{EXCEPTIONS}\n{}", part.config))
            .map_err(|error| Failure(format!("{}: {error}", config.display())))?;
        let mut command = Command::new(tool);
        command
            .arg("--config-file")
            .arg(&config)
            .args(["run", "--no-color", "--warnings", "off"])
            .args(["--checks", CHECKS, "--phases", "examples,coverage,fuzzing"])
            .args(["--rate-limit", RATE, "--continue-on-failure"])
            .args(["--header", &format!("authorization: Bearer {token}")])
            .arg(format!("http://{}/api/v1/openapi.json", self.http))
            .current_dir(&self.folder)
            .stdin(Stdio::null());
        let which = if part.ends {
            "--include-operation-id"
        } else {
            "--exclude-operation-id"
        };
        command.args(LAST.iter().flat_map(|name| [which, name]));
        Ok(command)
    }

    /// What it complained of.
    fn log(&self) -> String {
        fs::read_to_string(self.folder.join("log")).unwrap_or_default()
    }

    /// An administrator's token, as soon as the server gives one.
    fn sign_in(&self) -> Outcome<String> {
        let began = Instant::now();
        loop {
            if let Some(token) = self.try_sign_in() {
                return Ok(token);
            }
            if began.elapsed() > PATIENCE {
                let log = self.log();
                return Err(Failure(format!("the server lets nobody in:\n{log}")));
            }
            std::thread::sleep(Duration::from_millis(500));
        }
    }

    fn try_sign_in(&self) -> Option<String> {
        let body = format!("{{\"user\": \"{USER}\", \"password\": \"{PASSWORD}\"}}");
        let mut stream = TcpStream::connect(self.http).ok()?;
        stream.set_read_timeout(Some(PATIENCE)).ok()?;
        write!(
            stream,
            "POST /api/v1/session HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
            self.http,
            body.len()
        )
        .ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        token(&answer).map(str::to_owned)
    }
}

/// The token in the answer to a login.
fn token(answer: &str) -> Option<&str> {
    let (_, rest) = answer.split_once("\"token\"")?;
    rest.split('"').nth(1).filter(|token| !token.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_found_in_an_answer() {
        let answer = "HTTP/1.1 200 OK\r\n\r\n{\"token\": \"abc.def\",\"user\":\"x\"}";
        assert_eq!(token(answer), Some("abc.def"));
        assert_eq!(token("HTTP/1.1 401 Unauthorized\r\n\r\n{}"), None);
    }

    #[test]
    fn arguments_that_are_none_are_refused() {
        for bad in [&["--seed"][..], &["--seed", "x"], &["--more", "1"]] {
            let words: Vec<String> = bad.iter().map(|&word| word.to_owned()).collect();
            assert!(command(&words).is_err(), "{bad:?}");
        }
    }
}
