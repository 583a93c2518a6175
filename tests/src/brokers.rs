//! Mosquitto, as broker and as clients: tools that nobody here wrote.

use std::fmt::Write as _;
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use tempfile::TempDir;

use crate::wait_for;

/// A `mosquitto` broker on a loopback port.
#[derive(Debug)]
pub struct Mosquitto {
    child: Child,
    /// Holds its configuration for as long as it runs.
    _folder: TempDir,
}

impl Mosquitto {
    /// Starts a broker on `port` for everybody and waits until it accepts connections.
    ///
    /// # Panics
    /// When mosquitto is not installed or does not come up within 10 s.
    pub fn start(port: u16) -> Self {
        let folder = tempfile::tempdir().expect("a folder for its configuration");
        Self::start_with(port, folder, &["allow_anonymous true"])
    }

    /// Starts a broker on `port` that lets nobody in but `user` with `password`.
    ///
    /// # Panics
    /// As [`Mosquitto::start`].
    pub fn start_guarded(port: u16, user: &str, password: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder for its configuration");
        let file = folder.path().join("passwords");
        let made = Command::new("mosquitto_passwd")
            .args(["-b", "-c"])
            .arg(&file)
            .args([user, password])
            .status()
            .expect("mosquitto_passwd is missing: cargo xtask setup");
        assert!(made.success(), "mosquitto_passwd: {made}");
        // As root the broker becomes a user of its own before it reads the file.
        let open = Command::new("chmod")
            .args(["a+rX"])
            .args([folder.path(), &file])
            .status();
        assert!(open.expect("chmod").success());
        let named = format!("password_file {}", file.display());
        Self::start_with(port, folder, &["allow_anonymous false", &named])
    }

    /// Starts a broker on `port` for everybody who speaks TLS 1.3, with this certificate and key in
    /// PEM.
    ///
    /// # Panics
    /// As [`Mosquitto::start`].
    pub fn start_encrypted(port: u16, certificate: &str, key: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder for its configuration");
        let file = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).expect(name);
            path
        };
        let (certificate, key) = (file("server.pem", certificate), file("server.key", key));
        // As root the broker becomes a user of its own before it reads the files.
        let open = Command::new("chmod")
            .args(["a+rX"])
            .args([folder.path(), &certificate, &key])
            .status();
        assert!(open.expect("chmod").success());
        let lines = [
            "allow_anonymous true".to_owned(),
            format!("certfile {}", certificate.display()),
            format!("keyfile {}", key.display()),
            "tls_version tlsv1.3".to_owned(),
        ];
        Self::start_with(port, folder, &lines.each_ref().map(String::as_str))
    }

    fn start_with(port: u16, folder: TempDir, access: &[&str]) -> Self {
        let configuration = folder.path().join("mosquitto.conf");
        let mut text = String::new();
        for line in [
            &format!("listener {port} 127.0.0.1"),
            &access.join("\n"),
            "persistence false",
            // Its defaults drop messages of a busy fleet.
            "max_queued_messages 100000",
            "max_inflight_messages 1000",
        ] {
            writeln!(text, "{line}").expect("writing to a string");
        }
        std::fs::write(&configuration, text).expect("a configuration");
        // Debian keeps servers where a user's search path does not look.
        let program = ["/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto"]
            .into_iter()
            .find(|path| Path::new(path).exists())
            .unwrap_or("mosquitto");
        let child = Command::new(program)
            .arg("-c")
            .arg(&configuration)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("mosquitto is missing: cargo xtask setup");
        let broker = Self {
            child,
            _folder: folder,
        };
        wait_for("mosquitto accepts", Duration::from_secs(10), || {
            TcpStream::connect(("127.0.0.1", port)).ok()
        });
        broker
    }

    /// Its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Ends it, as a power cut would. Start another one on the same port to bring it back.
    ///
    /// # Panics
    /// When the process cannot be ended.
    pub fn kill(mut self) {
        self.child.kill().expect("our own process");
        self.child.wait().expect("our own process");
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Publishes with `mosquitto_pub` at QoS 1.
///
/// # Panics
/// When the tool is missing or reports a failure.
pub fn publish(port: u16, topic: &str, payload: &str) {
    let output = Command::new("mosquitto_pub")
        .args(["-V", "mqttv5", "-h", "127.0.0.1", "-p", &port.to_string()])
        .args(["-q", "1", "-t", topic, "-m", payload])
        .output()
        .expect("mosquitto_pub is missing: cargo xtask setup");
    assert!(
        output.status.success(),
        "mosquitto_pub: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Collects with `mosquitto_sub` what arrives on `filter` until `count` messages or `seconds`,
/// as `(topic, payload)`; retained messages count.
///
/// # Panics
/// When the tool is missing.
pub fn subscribe(port: u16, filter: &str, count: usize, seconds: u32) -> Vec<(String, String)> {
    subscribe_with(port, &[], filter, count, seconds)
}

/// The same with further `arguments`, such as `-u` and `-P`.
///
/// # Panics
/// When the tool is missing.
pub fn subscribe_with(
    port: u16,
    arguments: &[&str],
    filter: &str,
    count: usize,
    seconds: u32,
) -> Vec<(String, String)> {
    let output = Command::new("mosquitto_sub")
        .args(["-V", "mqttv5", "-h", "127.0.0.1", "-p", &port.to_string()])
        .args(["-q", "1", "-t", filter, "-F", "%t %p"])
        .args(arguments)
        .args(["-C", &count.to_string(), "-W", &seconds.to_string()])
        .output()
        .expect("mosquitto_sub is missing: cargo xtask setup");
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| line.split_once(' '))
        .map(|(topic, payload)| (topic.to_owned(), payload.to_owned()))
        .collect()
}
