//! The binary `terracrawler`, started as a user would.

use std::fs::File;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use serde_json::Value;
use tempfile::TempDir;

use crate::{ReservedPort, wait_for, wait_for_with};

/// For an answer over HTTP: a machine that is busy may take its time.
const ANSWER: Duration = Duration::from_mins(1);
/// Takes everybody in.
const OPEN: &str = "--open";

/// A running `terracrawler` with ports and data directory of its own.
#[derive(Debug)]
pub struct Terracrawler {
    child: Child,
    http: ReservedPort,
    mqtt: ReservedPort,
    folder: TempDir,
    /// What was started, and with what.
    program: PathBuf,
    arguments: Vec<String>,
    /// So much longer its disk takes, from the next start on.
    slow: Duration,
}

/// The binary that cargo built next to the running test.
///
/// # Panics
/// When it was not built.
pub fn binary() -> PathBuf {
    let test = std::env::current_exe().expect("the path of this test");
    let built = test
        .ancestors()
        .nth(2)
        .expect("target/<profile>/deps/<test>")
        .join("terracrawler");
    assert!(
        built.is_file(),
        "{} is missing: cargo build --package crawler-server",
        built.display()
    );
    built
}

/// Starts a program; what it says goes behind what is in the log already.
fn spawn(program: &Path, arguments: &[String], folder: &TempDir, slow: Duration) -> Child {
    let log = File::options()
        .create(true)
        .append(true)
        .open(folder.path().join("log"))
        .expect("a log file");
    let mut command = Command::new(program);
    if !slow.is_zero() {
        command.env("LD_PRELOAD", slow_disk(folder));
        command.env("SLOW_DISK_MS", slow.as_millis().to_string());
    }
    command
        .args(arguments)
        .arg("--data")
        .arg(folder.path().join("data"))
        .stdin(Stdio::null())
        .stdout(log.try_clone().expect("a log file"))
        .stderr(log)
        .spawn()
        .expect("terracrawler")
}

/// The library that makes a disk slow, built where it was not yet.
fn slow_disk(folder: &TempDir) -> PathBuf {
    let library = folder.path().join("slow_disk.so");
    if !library.is_file() {
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/src/slow_disk.c");
        let built = Command::new("cc")
            .args(["-shared", "-fPIC", "-O1", "-o"])
            .arg(&library)
            .arg(source)
            .status();
        assert!(built.expect("a C compiler").success(), "{source}");
    }
    library
}

impl Terracrawler {
    /// Starts `terracrawler` with `arguments` (the subcommand first), open to everyone, and waits
    /// until it is ready.
    ///
    /// # Panics
    /// When it ends, or is not ready within 60 s; shows its log.
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_program(&binary(), arguments)
    }

    /// As [`Terracrawler::start`], a `program` of another version.
    ///
    /// # Panics
    /// As [`Terracrawler::start`].
    pub fn start_program(program: &Path, arguments: &[&str]) -> Self {
        let mut server = Self::launch(program, arguments, &[OPEN]);
        server.wait_ready();
        server
    }

    /// As [`Terracrawler::start`], closed to who has no account.
    ///
    /// # Panics
    /// As [`Terracrawler::start`].
    pub fn start_closed(arguments: &[&str]) -> Self {
        let mut server = Self::launch(&binary(), arguments, &[]);
        server.wait_ready();
        server
    }

    /// The code with which the first administrator of a closed server makes an account.
    ///
    /// # Panics
    /// When it is not told within a minute.
    pub fn first_invitation(&self) -> String {
        // The link is printed when the server is ready, and a moment after it says so.
        wait_for("an invitation", Duration::from_mins(1), || {
            let log = self.log();
            let (_, rest) = log.split_once("/#invite=")?;
            let (code, _) = rest.split_once(char::is_whitespace)?;
            Some(code.to_owned())
        })
    }

    /// Starts `terracrawler` with TLS at all its listeners, which takes no request of ours over HTTP
    /// then, and waits until its broker listens.
    ///
    /// # Panics
    /// When it ends, or does not listen within 60 s; shows its log.
    pub fn start_encrypted(arguments: &[&str]) -> Self {
        let mut server = Self::launch(&binary(), arguments, &[OPEN, "--tls", "on"]);
        wait_for("the broker listens", Duration::from_mins(1), || {
            server.check();
            TcpStream::connect(("127.0.0.1", server.mqtt())).ok()
        });
        server
    }

    /// The certificate of its own authority.
    pub fn authority(&self) -> PathBuf {
        self.folder.path().join("data/tls/ca.pem")
    }

    /// Fails the test when it has ended.
    fn check(&mut self) {
        if let Ok(Some(status)) = self.child.try_wait() {
            panic!("terracrawler ended with {status}:\n{}", self.log());
        }
    }

    fn launch(program: &Path, arguments: &[&str], more: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a data directory");
        // They stay ours while it is down.
        let (http, mqtt) = (ReservedPort::new(), ReservedPort::new());
        let words = arguments.iter().chain(more);
        let mut arguments: Vec<String> = words.map(|&word| word.to_owned()).collect();
        arguments.extend(["--http".to_owned(), format!("127.0.0.1:{}", http.number())]);
        // An outside broker leaves no port of ours to name.
        if !arguments.iter().any(|word| word == "--broker") {
            arguments.extend(["--mqtt".to_owned(), format!("127.0.0.1:{}", mqtt.number())]);
        }
        Self {
            child: spawn(program, &arguments, &folder, Duration::ZERO),
            program: program.to_owned(),
            slow: Duration::ZERO,
            arguments,
            http,
            mqtt,
            folder,
        }
    }

    /// Starts it again, with the data and at the ports that it had, and waits until it is ready.
    ///
    /// # Panics
    /// As [`Terracrawler::start`].
    pub fn resume(&mut self) {
        self.restart();
        self.wait_ready();
    }

    /// Ends it, as a power cut would. Its data and its ports are kept for [`Terracrawler::restart`].
    ///
    /// # Panics
    /// When the process cannot be ended.
    pub fn kill(&mut self) {
        self.child.kill().expect("our own process");
        self.child.wait().expect("our own process");
    }

    /// Starts it again on the same data and ports; it need not be ready when this returns.
    ///
    /// # Panics
    /// When it still runs, or cannot be started.
    pub fn restart(&mut self) {
        let ended = self.child.try_wait().expect("our own process");
        assert!(ended.is_some(), "it still runs");
        self.child = spawn(&self.program, &self.arguments, &self.folder, self.slow);
    }

    /// From the next start on every `fsync` and `fdatasync` takes so much longer: a library that is preloaded
    /// holds them up, which takes a C compiler and Linux.
    pub const fn slow_disk(&mut self, by: Duration) {
        self.slow = by;
    }

    /// Its data directory.
    pub fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    /// Waits until it is ready.
    ///
    /// # Panics
    /// When it ends, or is not ready within 60 s; shows its log.
    pub fn wait_ready(&mut self) {
        wait_for("the server is ready", Duration::from_mins(1), || {
            self.check();
            (self.try_get("/readyz")?.0 == 200).then_some(())
        });
    }

    /// The port of its API.
    pub fn http(&self) -> u16 {
        self.http.number()
    }

    /// The port of its broker.
    pub fn mqtt(&self) -> u16 {
        self.mqtt.number()
    }

    /// Where its pages and its API are.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.http())
    }

    /// Its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Everything it wrote so far.
    pub fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    /// Status and body of a GET; a body that is not JSON becomes a string.
    ///
    /// # Panics
    /// When there is no answer within a minute.
    pub fn get(&self, path: &str) -> (u16, Value) {
        self.try_get(path)
            .unwrap_or_else(|| panic!("no answer to GET {path}:\n{}", self.log()))
    }

    /// As [`Terracrawler::get`]; `None` when there is no answer within a minute.
    pub fn try_get(&self, path: &str) -> Option<(u16, Value)> {
        read(agent().get(format!("{}{path}", self.url())).call().ok()?)
    }

    /// Status and body of a POST of JSON.
    ///
    /// # Panics
    /// When there is no answer within a minute.
    pub fn post(&self, path: &str, body: &Value) -> (u16, Value) {
        agent()
            .post(format!("{}{path}", self.url()))
            .send_json(body)
            .ok()
            .and_then(read)
            .unwrap_or_else(|| panic!("no answer to POST {path}:\n{}", self.log()))
    }

    /// The robots that the server reports as online.
    ///
    /// # Panics
    /// As [`Terracrawler::get`].
    pub fn online(&self) -> Vec<Value> {
        let (status, body) = self.get("/api/v1/robots");
        assert_eq!(status, 200, "{body}");
        let robots = body["robots"].as_array().or_else(|| body.as_array());
        robots
            .expect("a list of robots")
            .iter()
            .filter(|robot| robot["presence"] == "online")
            .cloned()
            .collect()
    }

    /// Waits until `count` robots are online and have told what they are.
    ///
    /// A heartbeat (QoS 0) can overtake the status (QoS 1) that was sent before it.
    ///
    /// # Panics
    /// When `limit` passes first.
    pub fn wait_online(&self, count: usize, limit: Duration) {
        let mut last = Vec::new();
        let what = format!("{count} robots online");
        wait_for_with(&what, limit, &mut last, |last| {
            *last = self.online();
            let told = last.iter().all(|robot| !robot["boot"].is_null());
            (last.len() == count && told).then_some(())
        });
    }

    /// Asks it to end, as Ctrl-C does, and waits for it. Its ports stay ours.
    ///
    /// # Panics
    /// When it has not ended within a minute.
    pub fn end(&mut self) -> ExitStatus {
        interrupt(&mut self.child, Duration::from_mins(1))
    }

    /// Asks it to end, as Ctrl-C does, waits for it, and gives its log as well.
    ///
    /// # Panics
    /// As [`Terracrawler::end`].
    pub fn interrupt(mut self) -> (ExitStatus, String) {
        (self.end(), self.log())
    }
}

/// Asks a process to end, as Ctrl-C does, and waits for it.
fn interrupt(child: &mut Child, limit: Duration) -> ExitStatus {
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-INT", &id]).status();
    assert!(sent.expect("kill").success());
    wait_for("the process ends", limit, || {
        child.try_wait().expect("our own process")
    })
}

/// A running `terracrawler sim`: simulated robots without a server.
#[derive(Debug)]
pub struct Simulated {
    child: Child,
    folder: TempDir,
}

impl Simulated {
    /// Starts robots on the broker at `port` of loopback. `arguments` follow the subcommand.
    ///
    /// # Panics
    /// When the program cannot be started.
    pub fn start(port: u16, arguments: &[&str]) -> Self {
        Self::start_program(&binary(), port, arguments)
    }

    /// As [`Simulated::start`], of a `program` of another version.
    ///
    /// # Panics
    /// As [`Simulated::start`].
    pub fn start_program(program: &Path, port: u16, arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder for its log");
        let log = std::fs::File::create(folder.path().join("log")).expect("a log file");
        let child = Command::new(program)
            .arg("sim")
            .args(["--broker", &format!("mqtt://127.0.0.1:{port}")])
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(log.try_clone().expect("a log file"))
            .stderr(log)
            .spawn()
            .expect("terracrawler starts");
        Self { child, folder }
    }

    /// Its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Asks it to end, as Ctrl-C does, and waits for it; a recording is whole then.
    ///
    /// # Panics
    /// When it has not ended within a minute, or says that something went wrong.
    pub fn interrupt(mut self) {
        let status = interrupt(&mut self.child, Duration::from_mins(1));
        assert!(status.success(), "the robots ended with {status}");
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            let log = std::fs::read_to_string(self.folder.path().join("log"));
            eprintln!("--- log of the robots ---\n{}", log.unwrap_or_default());
        }
    }
}

impl Drop for Terracrawler {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            eprintln!("--- log of terracrawler ---\n{}", self.log());
        }
    }
}

/// A client for HTTP that waits a minute for an answer, and takes 4xx and 5xx for answers.
pub fn agent() -> ureq::Agent {
    ureq::Agent::config_builder()
        .timeout_global(Some(ANSWER))
        .http_status_as_error(false)
        .build()
        .into()
}

fn read(mut response: ureq::http::Response<ureq::Body>) -> Option<(u16, Value)> {
    let text = response.body_mut().read_to_string().ok()?;
    let body = serde_json::from_str(&text).unwrap_or(Value::String(text));
    Some((response.status().as_u16(), body))
}
