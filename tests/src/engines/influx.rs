//! An `InfluxDB` 1 server from Debian's package.

use std::path::PathBuf;
use std::process::Command;

use tempfile::TempDir;

use super::{PATIENCE, Process, program};
use crate::{ReservedPort, wait_for};

/// The administrator of a guarded server, and the password.
pub const ADMIN: (&str, &str) = ("ada", "correct horse");

/// A server on a loopback port, which ends with this value.
#[derive(Debug)]
pub struct Influx {
    process: Option<Process>,
    port: ReservedPort,
    folder: TempDir,
}

impl Influx {
    /// Starts a server for everybody, without databases.
    ///
    /// # Panics
    /// When `InfluxDB` is not installed or does not start.
    pub fn start() -> Self {
        Self::start_with(false)
    }

    /// Starts a server that lets nobody in but [`ADMIN`].
    ///
    /// # Panics
    /// As [`Influx::start`].
    pub fn start_guarded() -> Self {
        let server = Self::start_with(true);
        let (name, password) = ADMIN;
        let made = server.statement(&format!(
            "CREATE USER {name} WITH PASSWORD '{password}' WITH ALL PRIVILEGES"
        ));
        assert_eq!(made.0, 200, "{}", made.1);
        server
    }

    fn start_with(guarded: bool) -> Self {
        let folder = tempfile::tempdir().expect("a folder for its data");
        let port = ReservedPort::new();
        let at = |name: &str| folder.path().join(name).display().to_string();
        let configuration = format!(
            "reporting-disabled = true\n\
             bind-address = \"127.0.0.1:0\"\n\
             [meta]\ndir = \"{}\"\n\
             [data]\ndir = \"{}\"\nwal-dir = \"{}\"\nquery-log-enabled = false\n\
             [http]\nbind-address = \"127.0.0.1:{}\"\nlog-enabled = false\nauth-enabled = {guarded}\n\
             [monitor]\nstore-enabled = false\n",
            at("meta"),
            at("data"),
            at("wal"),
            port.number(),
        );
        std::fs::write(folder.path().join("influxdb.conf"), configuration).expect("a file");
        let mut server = Self {
            process: None,
            port,
            folder,
        };
        server.resume();
        server
    }

    /// Starts it again, after [`Influx::kill`], at the port that it had.
    ///
    /// # Panics
    /// When it is running, or does not start.
    pub fn resume(&mut self) {
        assert!(self.process.is_none(), "it is running");
        let mut command = Command::new(program("influxd"));
        command
            .args(["run", "-config"])
            .arg(self.folder.path().join("influxdb.conf"));
        let log: PathBuf = self.folder.path().join("log");
        let mut process = Process::start(command, &log);
        process.wait_port(self.port.number());
        self.process = Some(process);
        wait_for("influxd answers", PATIENCE, || {
            let ping = ureq::get(format!("http://127.0.0.1:{}/ping", self.port.number())).call();
            ping.is_ok().then_some(())
        });
    }

    /// Ends it, as a power cut would.
    ///
    /// # Panics
    /// When it is not running.
    pub fn kill(&mut self) {
        self.process.take().expect("it is running").kill();
    }

    /// Its port.
    pub fn port(&self) -> u16 {
        self.port.number()
    }

    /// The id of its process.
    ///
    /// # Panics
    /// When it is not running.
    pub fn id(&self) -> u32 {
        self.process.as_ref().expect("it is running").id()
    }

    /// The address of the database `name` in it.
    pub fn url(&self, name: &str) -> String {
        format!("influx://127.0.0.1:{}/{name}", self.port.number())
    }

    /// Carries out a statement of `InfluxQL` without a user; gives status and answer.
    ///
    /// # Panics
    /// When there is no answer.
    pub fn statement(&self, statement: &str) -> (u16, String) {
        let url = format!("http://127.0.0.1:{}/query", self.port.number());
        let answer = agent().post(url).query("q", statement).send_empty();
        text(answer.expect("an answer"))
    }

    /// Writes a line into the database `name` without a user; gives status and answer.
    ///
    /// # Panics
    /// When there is no answer.
    pub fn write(&self, name: &str, line: &str) -> (u16, String) {
        let url = format!("http://127.0.0.1:{}/write", self.port.number());
        let answer = agent()
            .post(url)
            .query("db", name)
            .query("precision", "ms")
            .send(line);
        text(answer.expect("an answer"))
    }
}

fn agent() -> ureq::Agent {
    ureq::Agent::config_builder()
        .timeout_global(Some(PATIENCE))
        .http_status_as_error(false)
        .build()
        .into()
}

fn text(mut answer: ureq::http::Response<ureq::Body>) -> (u16, String) {
    let text = answer.body_mut().read_to_string().unwrap_or_default();
    (answer.status().as_u16(), text)
}
