//! `VictoriaMetrics` from Debian's package.

use std::process::Command;

use tempfile::TempDir;

use super::{PATIENCE, Process, program};
use crate::{ReservedPort, wait_for};

/// A server on a loopback port, which ends with this value.
#[derive(Debug)]
pub struct Victoria {
    process: Option<Process>,
    port: ReservedPort,
    folder: TempDir,
}

impl Victoria {
    /// Starts a server for everybody.
    ///
    /// # Panics
    /// When `VictoriaMetrics` is not installed or does not start.
    pub fn start() -> Self {
        let mut server = Self {
            process: None,
            port: ReservedPort::new(),
            folder: tempfile::tempdir().expect("a folder for its data"),
        };
        server.resume();
        server
    }

    /// Starts it again, after [`Victoria::stop`], at the port that it had.
    ///
    /// # Panics
    /// When it is running, or does not start.
    pub fn resume(&mut self) {
        assert!(self.process.is_none(), "it is running");
        let mut command = Command::new(program("victoria-metrics"));
        command
            .arg(format!("-httpListenAddr=127.0.0.1:{}", self.port.number()))
            .arg(format!(
                "-storageDataPath={}",
                self.folder.path().join("data").display()
            ))
            .arg("-retentionPeriod=1y");
        let mut process = Process::start(command, &self.folder.path().join("log"));
        process.wait_port(self.port.number());
        self.process = Some(process);
        wait_for("victoria-metrics answers", PATIENCE, || {
            let health =
                ureq::get(format!("http://127.0.0.1:{}/health", self.port.number())).call();
            health.is_ok().then_some(())
        });
    }

    /// Ends it in order.
    ///
    /// # Panics
    /// When it is not running.
    pub fn stop(&mut self) {
        self.process.take().expect("it is running").end("INT");
    }

    /// The id of its process.
    ///
    /// # Panics
    /// When it is not running.
    pub fn id(&self) -> u32 {
        self.process.as_ref().expect("it is running").id()
    }

    /// The address of the database `name` in it, which is but a label.
    pub fn url(&self, name: &str) -> String {
        format!("influx://127.0.0.1:{}/{name}", self.port.number())
    }
}
