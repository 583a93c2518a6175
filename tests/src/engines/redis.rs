//! A Redis server from Debian's package.

use std::net::TcpStream;
use std::path::Path;
use std::process::Command;

use tempfile::TempDir;

use super::{Process, program};
use crate::ReservedPort;

/// A server on a loopback port, which ends with this value. It keeps every write in a file.
#[derive(Debug)]
pub struct Redis {
    process: Process,
    port: ReservedPort,
    folder: TempDir,
}

impl Redis {
    /// Starts a server with nothing in it.
    ///
    /// # Panics
    /// When Redis is not installed or does not start.
    pub fn start() -> Self {
        let folder = tempfile::tempdir().expect("a folder for it");
        let port = ReservedPort::new();
        let process = run(port.number(), folder.path());
        Self {
            process,
            port,
            folder,
        }
    }

    /// Its address.
    pub fn url(&self) -> String {
        format!("redis://127.0.0.1:{}", self.port.number())
    }

    /// Its port.
    pub fn port(&self) -> u16 {
        self.port.number()
    }

    /// Ends it, as a power cut would.
    pub fn kill(&mut self) {
        self.process.kill();
    }

    /// Starts it again, with what it had kept.
    ///
    /// # Panics
    /// When it does not start.
    pub fn resume(&mut self) {
        self.process = run(self.port.number(), self.folder.path());
    }

    /// Forgets what it had kept, while it is not running.
    ///
    /// # Panics
    /// When the file system refuses.
    pub fn forget(&mut self) {
        let kept = self.folder.path().join("appendonlydir");
        std::fs::remove_dir_all(kept).expect("what it had kept");
    }

    /// Says one command with `redis-cli` and returns the answer.
    ///
    /// # Panics
    /// When it does not answer.
    pub fn say(&self, words: &[&str]) -> String {
        let output = Command::new(program("redis-cli"))
            .args(["-p", &self.port.number().to_string()])
            .args(words)
            .output()
            .expect("redis-cli");
        assert!(output.status.success(), "redis-cli {words:?}");
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    }
}

fn run(port: u16, folder: &Path) -> Process {
    let mut command = Command::new(program("redis-server"));
    command
        .args(["--port", &port.to_string(), "--bind", "127.0.0.1"])
        .args(["--dir", &folder.display().to_string()])
        .args([
            "--save",
            "",
            "--appendonly",
            "yes",
            "--appendfsync",
            "always",
        ]);
    let mut process = Process::start(command, &folder.join("log"));
    process.wait_port(port);
    // It accepts before it has read what it kept.
    crate::wait_for("redis answers", super::PATIENCE, || {
        use std::io::{Read as _, Write as _};
        let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
        stream.write_all(b"PING\r\n").ok()?;
        let mut answer = [0; 5];
        stream.read_exact(&mut answer).ok()?;
        (&answer == b"+PONG").then_some(())
    });
    process
}
