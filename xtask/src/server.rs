//! A server of its own, for a suite that others have written.

use std::fs::{self, File};
use std::io::{BufRead as _, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

use crate::run::{self, Failure, Outcome};

/// A server that ends with this, and its folder with it.
pub(crate) struct Server {
    child: Child,
    folder: PathBuf,
    http: SocketAddr,
    mqtt: SocketAddr,
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
    /// Starts the binary that the tests have built with `arguments`, on ports of its own, after `prepare` has
    /// had the binary and the data directory.
    ///
    /// # Errors
    /// When it cannot be started, or ends before it listens; with its log.
    pub(crate) fn start(
        arguments: &[&str],
        prepare: impl FnOnce(&Path, &Path) -> Outcome,
    ) -> Outcome<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(1);
        let program = run::root()
            .join(run::target_dir())
            .join("debug/terracrawler");
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("terracrawler-xtask-{}-{number}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        fs::create_dir_all(&folder).map_err(|error| failed(&folder, &error))?;
        let data = folder.join("data");
        let log = folder.join("log");
        let child = prepare(&program, &data).and_then(|()| {
            let errors = File::create(&log).map_err(|error| failed(&log, &error))?;
            Command::new(&program)
                .args(arguments)
                .args(["--http", "127.0.0.1:0", "--mqtt", "127.0.0.1:0", "--data"])
                .arg(&data)
                .stdin(Stdio::null())
                .stdout(Stdio::piped())
                .stderr(errors)
                .spawn()
                .map_err(|error| failed(&program, &error))
        });
        let mut child = match child {
            Ok(child) => child,
            Err(failure) => {
                let _ = fs::remove_dir_all(&folder);
                return Err(failure);
            }
        };
        let addresses = child.stdout.take().and_then(addresses);
        let nowhere = SocketAddr::from(([127, 0, 0, 1], 0));
        let (http, mqtt) = addresses.unwrap_or((nowhere, nowhere));
        let server = Self {
            child,
            folder,
            http,
            mqtt,
        };
        if addresses.is_none() {
            return Err(Failure(format!("no server:\n{}", server.log())));
        }
        Ok(server)
    }

    /// Where its API listens.
    pub(crate) const fn http(&self) -> SocketAddr {
        self.http
    }

    /// Where its broker listens.
    pub(crate) const fn mqtt(&self) -> SocketAddr {
        self.mqtt
    }

    /// Room for files that go with it.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// What it complained of.
    pub(crate) fn log(&self) -> String {
        fs::read_to_string(self.folder.join("log")).unwrap_or_default()
    }
}

fn failed(what: &Path, error: &std::io::Error) -> Failure {
    Failure(format!("{}: {error}", what.display()))
}

/// Where a server says that its API and its broker listen. What it says after that is read by a thread, so
/// that it never waits for a reader.
fn addresses(output: ChildStdout) -> Option<(SocketAddr, SocketAddr)> {
    let mut lines = BufReader::new(output).lines().map_while(Result::ok);
    let http = lines.by_ref().find_map(|line| address(&line, "http://"))?;
    let mqtt = lines.by_ref().find_map(|line| address(&line, "mqtt://"))?;
    std::thread::spawn(move || lines.for_each(drop));
    Some((http, mqtt))
}

fn address(line: &str, scheme: &str) -> Option<SocketAddr> {
    let (_, rest) = line.split_once(scheme)?;
    rest.split(['/', ' ']).next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_found_in_what_a_server_says() {
        let page = "  control room  http://127.0.0.1:18411/";
        let broker = "  MQTT broker   mqtt://127.0.0.1:18412 (embedded), fleet `swarm`";
        let at = |port| Some(SocketAddr::from(([127, 0, 0, 1], port)));
        assert_eq!(address(page, "http://"), at(18_411));
        assert_eq!(address(broker, "mqtt://"), at(18_412));
        assert_eq!(address(broker, "http://"), None);
        assert_eq!(address("http://nowhere", "http://"), None);
    }

    #[test]
    fn a_server_that_cannot_be_prepared_leaves_nothing() {
        let mut folder = PathBuf::new();
        let failed = Server::start(&["serve"], |_, data| {
            folder = data.parent().expect("its folder").to_owned();
            assert!(folder.is_dir());
            Err(Failure("no account".to_owned()))
        });
        assert_eq!(
            failed.err().map(|failure| failure.0).as_deref(),
            Some("no account")
        );
        assert!(!folder.exists());
    }
}
