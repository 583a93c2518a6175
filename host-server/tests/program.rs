//! The program as a person starts it: what it says when it cannot, and how it ends.

mod support;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use support::port::ReservedPort;
use support::{LIMIT, Scratch};

fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terracrawler"));
    // The variables of whoever runs the tests stay outside.
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("TERRACRAWLER_") {
            command.env_remove(name);
        }
    }
    command
}

/// Runs the program, which must end by itself with an error in one line; returns the line.
fn complaint(arguments: &[&str], code: i32) -> String {
    let output = program().args(arguments).output().expect("runs");
    one_line(&output, code)
}

fn one_line(output: &Output, code: i32) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    assert!(text.starts_with("terracrawler: "), "{text}");
    text
}

const ANY: [&str; 4] = ["--http", "127.0.0.1:0", "--mqtt", "127.0.0.1:0"];

#[test]
fn a_port_in_use_is_said_in_one_line() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("address").to_string();
    let scratch = Scratch::new();
    let data = scratch.0.to_str().expect("UTF-8");
    for option in ["--http", "--mqtt"] {
        let other = if option == "--http" {
            "--mqtt"
        } else {
            "--http"
        };
        let text = complaint(
            &[
                "serve",
                "--data",
                data,
                option,
                &address,
                other,
                "127.0.0.1:0",
            ],
            1,
        );
        assert!(text.contains(&address) && text.contains("in use"), "{text}");
        assert!(text.contains(option), "{text}");
    }
}

#[test]
fn a_data_directory_that_cannot_be_is_said_in_one_line() {
    let scratch = Scratch::new();
    std::fs::create_dir_all(&scratch.0).expect("directory");
    let file = scratch.0.join("file");
    std::fs::write(&file, "").expect("file");
    let below = file.join("data");
    let below = below.to_str().expect("UTF-8");
    let text = complaint(&[&["serve", "--data", below], &ANY[..]].concat(), 1);
    assert!(
        text.contains("data directory") && text.contains(below),
        "{text}"
    );
}

#[test]
fn an_absent_broker_is_said_in_one_line() {
    let held = ReservedPort::new();
    let url = format!("mqtt://{}", held.address());
    let scratch = Scratch::new();
    let data = scratch.0.to_str().expect("UTF-8");
    let serve = [
        "serve",
        "--data",
        data,
        "--http",
        "127.0.0.1:0",
        "--broker",
        &url,
    ];
    for arguments in [&serve[..], &["sim", "--broker", &url]] {
        let text = complaint(arguments, 1);
        assert!(text.contains(&url), "{text}");
    }
}

#[test]
fn unknown_names_are_said() {
    let output = program()
        .args(["up", "--robot", "5"])
        .output()
        .expect("runs");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--robots"));

    let mut variable = program();
    variable.arg("up").env("TERRACRAWLER_ROBOT", "5");
    let text = one_line(&variable.output().expect("runs"), 2);
    assert!(text.contains("TERRACRAWLER_ROBOT;"), "{text}");

    let scratch = Scratch::new();
    std::fs::create_dir_all(&scratch.0).expect("directory");
    let file = scratch.0.join("options.toml");
    std::fs::write(&file, "robot = 5\n").expect("file");
    let file = file.to_str().expect("UTF-8");
    let text = complaint(&["up", "--config", file], 2);
    assert!(text.contains("line 1") && text.contains("robot"), "{text}");

    let scratch = Scratch::new();
    let data = ["--data", scratch.0.to_str().expect("UTF-8")];
    let text = complaint(
        &[&["up", "--scenario", "nowhere"], &data[..], &ANY[..]].concat(),
        1,
    );
    assert!(text.contains("nowhere"), "{text}");
}

#[test]
fn the_first_administrator_gets_a_link() {
    let closed = start(&["serve"]);
    let link = closed
        .greeting
        .lines()
        .find(|line| line.contains("/#invite="));
    let link = link.unwrap_or_else(|| panic!("{}", closed.greeting)).trim();
    assert!(link.starts_with("http://127.0.0.1:"), "{link}");
    assert!(closed.greeting.contains("People need an account"));
    let open = start(&["serve", "--open"]);
    assert!(!open.greeting.contains("#invite"), "{}", open.greeting);
    assert!(open.greeting.contains("whoever connects can steer"));
}

/// A running program and the lines it has said so far.
struct Running {
    child: Child,
    _scratch: Scratch,
    greeting: String,
}

fn start(arguments: &[&str]) -> Running {
    let scratch = Scratch::new();
    let mut child = program()
        .args(arguments)
        .args(ANY)
        .arg("--data")
        .arg(&scratch.0)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("starts");
    let mut lines = BufReader::new(child.stdout.take().expect("stdout"));
    let mut greeting = String::new();
    while !greeting.contains("Ctrl-C") {
        let read = lines.read_line(&mut greeting).expect("reads");
        assert!(read > 0, "ended after {greeting}");
    }
    Running {
        child,
        _scratch: scratch,
        greeting,
    }
}

impl Running {
    fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let sent = Command::new("kill").args([name, &id]).status();
        assert!(sent.expect("kill").success());
    }

    /// What the running program counts.
    fn metrics(&self) -> String {
        let (_, page) = self.greeting.split_once("http://").expect("a page");
        let address = page.split('/').next().expect("an address");
        let mut stream = TcpStream::connect(address).expect("connect");
        let request =
            format!("GET /metrics HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("sent");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        answer
    }

    /// Waits for the end and returns exit code and log.
    fn end(mut self) -> (Option<i32>, String) {
        let limit = Instant::now() + LIMIT;
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("our own process") {
                break status;
            }
            assert!(Instant::now() < limit, "does not end within {LIMIT:?}");
            std::thread::sleep(Duration::from_millis(20));
        };
        let mut log = String::new();
        let mut stderr = self.child.stderr.take().expect("stderr");
        stderr.read_to_string(&mut log).expect("reads");
        (status.code(), log)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn it_ends_in_order_when_told_to() {
    for signal in ["-INT", "-TERM"] {
        let running = start(&["serve"]);
        assert!(running.greeting.contains("Only this machine can connect"));
        running.signal(signal);
        let (code, log) = running.end();
        assert_eq!(code, Some(0), "{log}");
        assert!(log.contains("stopped"), "{log}");
    }
}

#[test]
fn robots_stop_first() {
    let running = start(&["up", "--robots", "3", "--log-format", "json"]);
    assert!(
        running.greeting.contains("3 simulated"),
        "{}",
        running.greeting
    );
    // They have to be there to stop.
    let limit = Instant::now() + LIMIT;
    loop {
        let metrics = running.metrics();
        if metrics.contains("\nterracrawler_simulation_connected 3") {
            break;
        }
        assert!(Instant::now() < limit, "not all are connected: {metrics}");
        std::thread::sleep(Duration::from_millis(50));
    }
    running.signal("-INT");
    let (code, log) = running.end();
    assert_eq!(code, Some(0), "{log}");
    let messages: Vec<_> = log
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON lines"))
        .map(|line| line["message"].as_str().unwrap_or_default().to_owned())
        .collect();
    let at = |text: &str| messages.iter().position(|message| message == text);
    let stand = at("all simulated robots stand");
    assert!(stand.is_some() && stand < at("stopped"), "{messages:?}");
}

#[test]
fn an_open_address_is_warned_about() {
    let scratch = Scratch::new();
    let mut child = program()
        .args([
            "serve",
            "--open",
            "--http",
            "0.0.0.0:0",
            "--mqtt",
            "127.0.0.1:0",
            "--data",
        ])
        .arg(&scratch.0)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("starts");
    let mut log = BufReader::new(child.stderr.take().expect("stderr"));
    let mut line = String::new();
    // What is said of certificates comes first.
    while !line.contains("WARN") {
        line.clear();
        assert!(log.read_line(&mut line).expect("a line") > 0, "no warning");
    }
    assert!(line.contains("no authentication"), "{line}");
    child.kill().expect("our own process");
    child.wait().expect("our own process");
}
