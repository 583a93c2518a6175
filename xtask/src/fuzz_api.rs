//! The API from its own description: servers with accounts, and Schemathesis signed in as their
//! administrator.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::run::{self, Failure, Outcome};
use crate::server::Server;

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

/// A part of the cases, on a server of its own.
struct Part {
    what: &'static str,
    /// Which operations, in options of Schemathesis.
    which: &'static [&'static str],
    /// What Schemathesis is told besides.
    config: &'static str,
}

/// What is about one robot.
const ROBOTS: &str = "_robots_id";
/// What is about worlds.
const WORLDS: &str = "_(experiments|fences|simulator)";
/// These end the session that the others need.
const ENDS: &str = "^delete_sessions?(_id)?$";
/// The longest ones first.
const PARTS: [Part; 5] = [
    Part {
        what: "experiments and simulations",
        which: &["--include-operation-id-regex", WORLDS],
        config: "",
    },
    Part {
        what: "accounts, records and the fleet",
        which: &[
            "--exclude-operation-id-regex",
            "_(experiments|fences|robots_id|simulator)|^delete_sessions?(_id)?$",
        ],
        config: "",
    },
    Part {
        what: "robots that are there",
        which: &["--include-operation-id-regex", ROBOTS],
        config: KNOWN,
    },
    Part {
        what: "robots that are not",
        which: &["--include-operation-id-regex", ROBOTS],
        config: "",
    },
    Part {
        what: "ends of sessions",
        which: &["--include-operation-id-regex", ENDS],
        config: "",
    },
];

/// Schemathesis takes one core at most, and a part sends no more than [`RATE`] a second.
const AT_ONCE: usize = 2;

fn fuzz(tool: &Path, examples: u32, seed: u64) -> Outcome {
    println!("{examples} cases for each operation, seed {seed}");
    let next = AtomicUsize::new(0);
    let failed = Mutex::new(Vec::new());
    // Operations that were sent to, and all there are.
    let sent_to = Mutex::new((0, 0));
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some(part) = PARTS.get(next.fetch_add(1, Ordering::Relaxed)) {
                    match send(tool, part, examples, seed) {
                        Ok((selected, total)) => {
                            let mut sent_to =
                                sent_to.lock().unwrap_or_else(PoisonError::into_inner);
                            // Robots that are there are a second time the same operations.
                            let again = !part.config.is_empty();
                            sent_to.0 += if again { 0 } else { selected };
                            sent_to.1 = total;
                        }
                        Err(Failure(reason)) => {
                            let mut failed = failed.lock().unwrap_or_else(PoisonError::into_inner);
                            failed.push(format!("{}: {reason}", part.what));
                        }
                    }
                }
            });
        }
    });
    let failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
    if !failed.is_empty() {
        return Err(Failure(format!("seed {seed}: {}", failed.join(", "))));
    }
    let (sent_to, all) = sent_to.into_inner().unwrap_or_else(PoisonError::into_inner);
    if sent_to == all {
        Ok(())
    } else {
        Err(Failure(format!(
            "{sent_to} of {all} operations are in a part"
        )))
    }
}

/// A server with an administrator and two robots.
fn start() -> Outcome<Server> {
    Server::start(
        &["up", "--robots", "2", "--scenario", "empty"],
        |program, data| {
            let mut adding = Command::new(program)
                .args(["user", "add", USER, "--role", "admin", "--data"])
                .arg(data)
                .stdin(Stdio::piped())
                .stdout(Stdio::null())
                .spawn()
                .map_err(|error| Failure(format!("{}: {error}", program.display())))?;
            if let Some(mut input) = adding.stdin.take() {
                writeln!(input, "{PASSWORD}")
                    .map_err(|error| Failure(format!("the password: {error}")))?;
            }
            match adding.wait() {
                Ok(status) if status.success() => Ok(()),
                status => Err(Failure(format!("no account could be made: {status:?}"))),
            }
        },
    )
}

/// Sends a part of the cases to a server of its own, and prints what it came to. To how many operations, and
/// of how many.
fn send(tool: &Path, part: &Part, examples: u32, seed: u64) -> Outcome<(u32, u32)> {
    let server = start()?;
    let token = sign_in(&server)?;
    // At once, so that what two say does not get mixed up.
    let output = schemathesis(tool, &server, part, &token)?
        .args(["--seed", &seed.to_string()])
        .args(["--max-examples", &examples.to_string()])
        .output()
        .map_err(|error| Failure(format!("cannot run {}: {error}", tool.display())))?;
    let said = String::from_utf8_lossy(&output.stdout);
    let complained = String::from_utf8_lossy(&output.stderr);
    println!("\n-- {}\n{said}{complained}", part.what);
    let log = server.log();
    if log.contains("panicked") {
        return Err(Failure(format!("the server's log has a panic:\n{log}")));
    }
    if !output.status.success() {
        return Err(Failure(output.status.to_string()));
    }
    operations(&said).ok_or_else(|| Failure("it does not say to how many operations".to_owned()))
}

/// How many operations Schemathesis says it has selected, and of how many.
fn operations(said: &str) -> Option<(u32, u32)> {
    let line = said.lines().find(|line| line.contains(" selected / "))?;
    let mut numbers = line.split_whitespace().filter_map(|word| word.parse().ok());
    Some((numbers.next()?, numbers.next()?))
}

/// The command for one part.
fn schemathesis(tool: &Path, server: &Server, part: &Part, token: &str) -> Outcome<Command> {
    let config = server.folder().join("schemathesis.toml");
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
        .args(part.which)
        .arg(format!("http://{}/api/v1/openapi.json", server.http()))
        .current_dir(server.folder())
        .stdin(Stdio::null());
    Ok(command)
}

/// An administrator's token, as soon as the server gives one.
fn sign_in(server: &Server) -> Outcome<String> {
    let began = Instant::now();
    loop {
        if let Some(token) = try_sign_in(server.http()) {
            return Ok(token);
        }
        if began.elapsed() > PATIENCE {
            let log = server.log();
            return Err(Failure(format!("the server lets nobody in:\n{log}")));
        }
        std::thread::sleep(Duration::from_millis(500));
    }
}

fn try_sign_in(http: SocketAddr) -> Option<String> {
    let body = format!("{{\"user\": \"{USER}\", \"password\": \"{PASSWORD}\"}}");
    let mut stream = TcpStream::connect(http).ok()?;
    stream.set_read_timeout(Some(PATIENCE)).ok()?;
    write!(
        stream,
        "POST /api/v1/session HTTP/1.1\r\nHost: {http}\r\nContent-Type: application/json\r\n\
         Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
        body.len()
    )
    .ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    token(&answer).map(str::to_owned)
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
    fn what_was_sent_to_is_found_in_what_it_says() {
        let said = "\n     Specification:    Open API 3.1.0\n     Operations:       51 selected / 53 total\n";
        assert_eq!(operations(said), Some((51, 53)));
        assert_eq!(operations("     Operations:       53 total"), None);
    }

    #[test]
    fn arguments_that_are_none_are_refused() {
        for bad in [&["--seed"][..], &["--seed", "x"], &["--more", "1"]] {
            let words: Vec<String> = bad.iter().map(|&word| word.to_owned()).collect();
            assert!(command(&words).is_err(), "{bad:?}");
        }
    }
}
