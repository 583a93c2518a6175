//! Engines that a server can stand on, as Debian packages them: each a process of its own on
//! loopback, with its data in a folder of its own, ended by its id.

pub mod influx;
pub mod mosquitto;
pub mod postgres;
pub mod redis;
pub mod victoria;

use std::fs::File;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::wait_for;

/// How long an engine may take to start or to end.
pub const PATIENCE: Duration = Duration::from_mins(3);

/// Where the program `name` is. Debian puts servers where a user's search path does not look.
///
/// # Panics
/// When it is nowhere.
pub fn program(name: &str) -> PathBuf {
    std::env::var_os("PATH")
        .iter()
        .flat_map(std::env::split_paths)
        .chain(["/usr/sbin".into(), "/usr/local/sbin".into()])
        .map(|folder| folder.join(name))
        .find(|path| path.is_file())
        .unwrap_or_else(|| panic!("{name} is missing: cargo xtask setup"))
}

/// A process of ours with a log. It ends with this value.
#[derive(Debug)]
pub struct Process {
    child: Child,
    log: PathBuf,
}

impl Process {
    /// Starts `command`; what it says goes to the end of the file `log`.
    ///
    /// # Panics
    /// When it cannot be started.
    pub fn start(mut command: Command, log: &Path) -> Self {
        let file = File::options()
            .create(true)
            .append(true)
            .open(log)
            .expect("a log file");
        let child = command
            .stdin(Stdio::null())
            .stdout(file.try_clone().expect("a log file"))
            .stderr(file)
            .spawn()
            .unwrap_or_else(|error| panic!("{}: {error}", command.get_program().display()));
        Self {
            child,
            log: log.to_owned(),
        }
    }

    /// Its id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Everything it said so far.
    pub fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Whether it has not ended.
    ///
    /// # Panics
    /// When the operating system does not know.
    pub fn runs(&mut self) -> bool {
        self.child.try_wait().expect("our own process").is_none()
    }

    /// Waits until it accepts connections at `port` of loopback.
    ///
    /// # Panics
    /// With its log, when it ends or [`PATIENCE`] does.
    pub fn wait_port(&mut self, port: u16) {
        wait_for(&format!("port {port} accepts"), PATIENCE, || {
            assert!(self.runs(), "it ended:\n{}", self.log());
            TcpStream::connect(("127.0.0.1", port)).ok()
        });
    }

    /// Sends it a signal, like `INT`, `STOP` or `CONT`.
    ///
    /// # Panics
    /// When that is not possible.
    pub fn signal(&self, name: &str) {
        let sent = Command::new("kill")
            .args([&format!("-{name}"), &self.id().to_string()])
            .status();
        assert!(sent.expect("kill").success(), "kill -{name}");
    }

    /// Sends it a signal and waits until it has ended.
    ///
    /// # Panics
    /// When it has not ended within [`PATIENCE`].
    pub fn end(&mut self, signal: &str) {
        self.signal(signal);
        wait_for("it ends", PATIENCE, || {
            self.child.try_wait().expect("our own process")
        });
    }

    /// Ends it, as a power cut would.
    ///
    /// # Panics
    /// When the operating system refuses.
    pub fn kill(&mut self) {
        self.child.kill().expect("our own process");
        self.child.wait().expect("our own process");
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
