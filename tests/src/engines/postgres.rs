//! A `PostgreSQL` server from Debian's package.

use std::fs::Permissions;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, chown};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use tempfile::TempDir;

use super::{PATIENCE, Process};
use crate::{ReservedPort, wait_for};

/// The role that owns everything, and its password.
pub const USER: &str = "terracrawler";
/// A password that an address must quote.
pub const PASSWORD: &str = "not/so secret";
/// The same as an address has it.
pub const QUOTED: &str = "not%2Fso%20secret";
/// The account that a server runs under where the tests run as root, which it refuses to.
const NOBODY: u32 = 65_534;

/// A server on a loopback port, which ends with this value.
#[derive(Debug)]
pub struct Postgres {
    process: Option<Process>,
    port: ReservedPort,
    bin: PathBuf,
    folder: TempDir,
}

impl Postgres {
    /// Makes a cluster in a new folder and starts a server on it.
    ///
    /// # Panics
    /// When `PostgreSQL` is not installed or does not start.
    pub fn start() -> Self {
        let bin = bin();
        let folder = tempfile::tempdir().expect("a folder for a cluster");
        let password = folder.path().join("password");
        std::fs::write(&password, PASSWORD).expect("a file");
        if is_root() {
            for path in [folder.path(), &password] {
                chown(path, Some(NOBODY), Some(NOBODY)).expect("root may");
            }
        }
        let mut server = Self {
            process: None,
            port: ReservedPort::new(),
            bin,
            folder,
        };
        let made = server
            .command("initdb")
            .arg("--pgdata")
            .arg(server.cluster())
            .args(["--username", USER, "--auth", "scram-sha-256", "--no-sync"])
            // A log of a megabyte to begin with, in place of sixteen.
            .args(["--wal-segsize", "1"])
            .args(["--encoding", "UTF8", "--locale", "C.UTF-8", "--pwfile"])
            .arg(&password)
            .output()
            .expect("initdb");
        assert!(
            made.status.success(),
            "initdb: {}",
            String::from_utf8_lossy(&made.stderr)
        );
        server.resume();
        server
    }

    /// A server that tests which run at the same time share; the last one ends it.
    ///
    /// # Panics
    /// As [`Postgres::start`].
    pub fn shared() -> Arc<Self> {
        static SHARED: Mutex<Weak<Postgres>> = Mutex::new(Weak::new());
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        shared.upgrade().unwrap_or_else(|| {
            let server = Arc::new(Self::start());
            *shared = Arc::downgrade(&server);
            server
        })
    }

    /// Starts it again, after [`Postgres::kill`] or [`Postgres::stop`], at the port that it had.
    ///
    /// # Panics
    /// When it is running, or does not start.
    pub fn resume(&mut self) {
        assert!(self.process.is_none(), "it is running");
        let log = self.folder.path().join("log");
        let process = wait_for("postgres starts", PATIENCE, || {
            let mut command = self.command("postgres");
            command
                .arg("-D")
                .arg(self.cluster())
                .args(["-c", "listen_addresses=127.0.0.1"])
                .args(["-c", "unix_socket_directories="])
                // What a process has written outlives it; only a machine without power loses it.
                .args(["-c", "fsync=off"])
                .args(["-p", &self.port.number().to_string()]);
            let mut process = Process::start(command, &log);
            // Right after a kill its orphans may still have the shared memory: then it ends at once.
            wait_for("postgres is ready, or ends", PATIENCE, || {
                if !process.runs() {
                    return Some(false);
                }
                let asked = self
                    .command("pg_isready")
                    .args([
                        "-q",
                        "-h",
                        "127.0.0.1",
                        "-p",
                        &self.port.number().to_string(),
                    ])
                    .status();
                asked.expect("pg_isready").success().then_some(true)
            })
            .then_some(process)
        });
        self.process = Some(process);
    }

    /// Ends it, as a power cut would.
    ///
    /// # Panics
    /// When it is not running.
    pub fn kill(&mut self) {
        self.process.take().expect("it is running").kill();
    }

    /// Ends it in order, without waiting for its clients.
    ///
    /// # Panics
    /// When it is not running.
    pub fn stop(&mut self) {
        self.process.take().expect("it is running").end("INT");
    }

    /// Makes an empty database and returns its address.
    ///
    /// # Panics
    /// When that fails.
    pub fn database(&self) -> String {
        self.database_like("template1")
    }

    /// Makes a copy of the database that has this name or address and returns its address.
    ///
    /// # Panics
    /// When that fails, as it does while somebody is connected with the original.
    pub fn database_like(&self, original: &str) -> String {
        static NUMBER: AtomicU32 = AtomicU32::new(1);
        let name = format!("fleet_{}", NUMBER.fetch_add(1, Ordering::Relaxed));
        let original = name_of(original);
        self.sql(
            "postgres",
            &format!("CREATE DATABASE {name} TEMPLATE {original}"),
        );
        self.url(&name)
    }

    /// The address of the database `name`, without asking for TLS, which it does not have.
    pub fn url(&self, name: &str) -> String {
        let port = self.port.number();
        format!("postgres://{USER}:{QUOTED}@127.0.0.1:{port}/{name}")
    }

    /// Carries out `sql` in the database `name`, or that of an address, and returns what it prints.
    ///
    /// # Panics
    /// When the server refuses it.
    pub fn sql(&self, name: &str, sql: &str) -> String {
        let name = name_of(name);
        let output = self
            .command("psql")
            .args([
                "-h",
                "127.0.0.1",
                "-p",
                &self.port.number().to_string(),
                "-U",
                USER,
            ])
            .args(["-v", "ON_ERROR_STOP=1", "-XqAt", "-d", name, "-c", sql])
            .env("PGPASSWORD", PASSWORD)
            .output()
            .expect("psql");
        assert!(
            output.status.success(),
            "{sql}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    }

    /// Its port.
    pub fn port(&self) -> u16 {
        self.port.number()
    }

    /// Lets it speak TLS from its next start on.
    ///
    /// # Panics
    /// When its configuration cannot be written.
    pub fn configure_tls(&self, certificate: &str, key: &str) {
        let cluster = self.cluster();
        for (name, text) in [("server.crt", certificate), ("server.key", key)] {
            let path = cluster.join(name);
            std::fs::write(&path, text).expect("a file");
            std::fs::set_permissions(&path, Permissions::from_mode(0o600)).expect("our own file");
            if is_root() {
                chown(&path, Some(NOBODY), Some(NOBODY)).expect("root may");
            }
        }
        let file = cluster.join("postgresql.auto.conf");
        std::fs::write(file, "ssl = on\n").expect("its configuration");
    }

    fn cluster(&self) -> PathBuf {
        self.folder.path().join("cluster")
    }

    /// A program of the package, under an account that it accepts.
    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(self.bin.join(program));
        command.current_dir(self.folder.path()).env_remove("PGHOST");
        if is_root() {
            command.uid(NOBODY).gid(NOBODY);
        }
        command
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        if std::thread::panicking()
            && let Some(process) = &self.process
        {
            eprintln!("--- log of postgres ---\n{}", process.log());
        }
    }
}

/// The name of the database at an address, or that is its name already.
fn name_of(database: &str) -> &str {
    database.rsplit('/').next().unwrap_or(database)
}

fn is_root() -> bool {
    std::fs::metadata("/proc/self").is_ok_and(|own| own.uid() == 0)
}

/// Where the newest version that is installed has its programs. Debian keeps them off the search
/// path, since several versions may be installed.
fn bin() -> PathBuf {
    let mut found: Vec<(u32, PathBuf)> = std::fs::read_dir("/usr/lib/postgresql")
        .into_iter()
        .flatten()
        .filter_map(|entry| {
            let folder = entry.ok()?.path();
            let version = folder.file_name()?.to_str()?.parse().ok()?;
            let bin = folder.join("bin");
            bin.join("initdb").is_file().then_some((version, bin))
        })
        .collect();
    found.sort();
    found.pop().map_or_else(
        || {
            let initdb = super::program("initdb");
            initdb.parent().map(Path::to_owned).unwrap_or_default()
        },
        |(_, bin)| bin,
    )
}
