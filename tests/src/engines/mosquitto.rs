//! Mosquitto as a broker: for everybody, or as somebody runs it who has read its manual.

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use tempfile::TempDir;

use super::{PATIENCE, Process, program};
use crate::{ReservedPort, wait_for};

/// What it says when it has been told to read its configuration again.
const RELOADED: &str = "Reloading config.";

/// A broker on a loopback port. It ends with this value.
#[derive(Debug)]
pub struct Mosquitto {
    process: Process,
    port: u16,
    folder: Folder,
    /// Its port, where nobody else has it.
    _reserved: Option<ReservedPort>,
}

/// A subscriber that waits for one message. It ends with this value.
#[derive(Debug)]
pub struct Listener(Child);

impl Listener {
    /// Waits for the message: its topic and text, or nothing when none comes within a minute.
    ///
    /// # Panics
    /// When the text is not UTF-8.
    pub fn heard(mut self) -> String {
        let mut heard = String::new();
        let mut stdout = self.0.stdout.take().expect("it was piped");
        stdout.read_to_string(&mut heard).expect("a text");
        heard.truncate(heard.trim_end().len());
        heard
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// What its configuration is made of.
#[derive(Debug)]
pub struct Folder {
    place: TempDir,
    lines: Vec<String>,
    tls: bool,
}

impl Folder {
    /// Nothing yet.
    ///
    /// # Panics
    /// When there is no room for a folder.
    pub fn new() -> Self {
        Self {
            place: tempfile::tempdir().expect("a folder for its configuration"),
            lines: Vec::new(),
            tls: false,
        }
    }

    /// Lines of its configuration.
    #[must_use]
    pub fn with(mut self, lines: &str) -> Self {
        self.lines.push(lines.to_owned());
        self
    }

    /// Lets in these users alone, with these passwords.
    ///
    /// # Panics
    /// When `mosquitto_passwd` is missing.
    #[must_use]
    pub fn users(self, users: &[(&str, &str)]) -> Self {
        let file = self.passwords(users);
        let line = format!("allow_anonymous false\npassword_file {}", file.display());
        self.with(&line)
    }

    /// Lets everybody do what these rules say and nothing else.
    #[must_use]
    pub fn rules(self, text: &str) -> Self {
        let file = self.file("acl", text);
        let line = format!("acl_file {}", file.display());
        self.with(&line)
    }

    /// Lets everybody in.
    #[must_use]
    pub fn anybody(self) -> Self {
        self.with("allow_anonymous true")
    }

    /// Has it speak TLS 1.3 alone, with this certificate and key in PEM.
    ///
    /// # Panics
    /// When the files cannot be written.
    #[must_use]
    pub fn tls_with(mut self, certificate: &str, key: &str) -> Self {
        self.file("certificate.pem", certificate);
        let key = self.file("key.pem", key);
        self.tls = true;
        self.encrypted(&key).with("tls_version tlsv1.3")
    }

    fn encrypted(self, key: &Path) -> Self {
        let line = format!(
            "certfile {}\nkeyfile {}",
            self.certificate().display(),
            key.display()
        );
        self.with(&line)
    }

    /// Has it speak TLS, with a certificate for 127.0.0.1 that is made here.
    ///
    /// # Panics
    /// When `openssl` is missing.
    #[must_use]
    pub fn tls(mut self) -> Self {
        let key = self.place.path().join("key.pem");
        let made = Command::new(program("openssl"))
            .args(["req", "-x509", "-newkey", "ec", "-nodes", "-days", "2"])
            .args(["-pkeyopt", "ec_paramgen_curve:prime256v1"])
            .args(["-subj", "/CN=broker of a test"])
            .args(["-addext", "subjectAltName=IP:127.0.0.1"])
            .args(["-addext", "basicConstraints=critical,CA:FALSE"])
            .arg("-keyout")
            .arg(&key)
            .arg("-out")
            .arg(self.certificate())
            .output()
            .expect("openssl");
        assert!(made.status.success(), "{made:?}");
        self.tls = true;
        self.encrypted(&key)
    }

    /// As root it becomes a user of its own before it reads some of its files.
    fn open(&self) {
        let open = Command::new("chmod")
            .args(["-R", "a+rX"])
            .arg(self.place.path())
            .status();
        assert!(open.expect("chmod").success());
    }

    fn passwords(&self, users: &[(&str, &str)]) -> PathBuf {
        let file = self.file("passwords", "");
        for (user, password) in users {
            let made = Command::new(program("mosquitto_passwd"))
                .arg("-b")
                .arg(&file)
                .args([user, password])
                .status();
            assert!(made.expect("mosquitto_passwd").success(), "{user}");
        }
        file
    }

    fn certificate(&self) -> PathBuf {
        self.place.path().join("certificate.pem")
    }

    fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.place.path().join(name);
        std::fs::write(&path, text).expect("a file");
        path
    }

    /// Starts the broker on a port of its own.
    ///
    /// # Panics
    /// When Mosquitto is not installed or does not start.
    pub fn start(self) -> Mosquitto {
        let reserved = ReservedPort::new();
        self.run(reserved.number(), Some(reserved))
    }

    /// Starts the broker on `port`, a [`ReservedPort`], and waits until it accepts connections.
    ///
    /// # Panics
    /// As [`Folder::start`].
    pub fn start_on(self, port: u16) -> Mosquitto {
        self.run(port, None)
    }

    fn run(self, port: u16, reserved: Option<ReservedPort>) -> Mosquitto {
        // Its defaults drop messages of a busy fleet.
        let text = format!(
            "listener {port} 127.0.0.1\n{}\npersistence false\n\
             max_queued_messages 100000\nmax_inflight_messages 1000\n",
            self.lines.join("\n")
        );
        let configuration = self.file("mosquitto.conf", &text);
        self.open();
        let mut command = Command::new(program("mosquitto"));
        command.arg("-c").arg(configuration);
        let mut process = Process::start(command, &self.place.path().join("log"));
        process.wait_port(port);
        Mosquitto {
            process,
            port,
            folder: self,
            _reserved: reserved,
        }
    }
}

impl Default for Folder {
    fn default() -> Self {
        Self::new()
    }
}

impl Mosquitto {
    /// Starts a broker on `port` for everybody.
    ///
    /// # Panics
    /// As [`Folder::start`].
    pub fn start(port: u16) -> Self {
        Folder::new().anybody().start_on(port)
    }

    /// Starts a broker on `port` that lets in these users alone, with these passwords.
    ///
    /// # Panics
    /// As [`Folder::start`].
    pub fn start_guarded(port: u16, users: &[(&str, &str)]) -> Self {
        Folder::new().users(users).start_on(port)
    }

    /// Lets in these users alone from now on, and goes on with those that it still knows. Returns
    /// when it has read them.
    ///
    /// # Panics
    /// When `mosquitto_passwd` is missing, or the broker does not say that it has read them.
    pub fn change_users(&self, users: &[(&str, &str)]) {
        let before = self.log().matches(RELOADED).count();
        self.folder.passwords(users);
        self.folder.open();
        self.process.signal("HUP");
        wait_for("the broker reads its users again", PATIENCE, || {
            (self.log().matches(RELOADED).count() > before).then_some(())
        });
    }

    /// Starts a broker on `port` for everybody who speaks TLS 1.3, with this certificate and key in
    /// PEM.
    ///
    /// # Panics
    /// As [`Folder::start`].
    pub fn start_encrypted(port: u16, certificate: &str, key: &str) -> Self {
        let folder = Folder::new().anybody();
        folder.tls_with(certificate, key).start_on(port)
    }

    /// Its process.
    pub fn id(&self) -> u32 {
        self.process.id()
    }

    /// Ends it, as a power cut would. Start another one on the same port to bring it back.
    ///
    /// # Panics
    /// When the process cannot be ended.
    pub fn kill(mut self) {
        self.process.kill();
    }

    /// Its port.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// The certificate that it shows, if it speaks TLS.
    pub fn certificate(&self) -> PathBuf {
        self.folder.certificate()
    }

    /// Publishes as `user` at QoS 1 with `mosquitto_pub`, and returns what came of it.
    ///
    /// # Panics
    /// When the tool is missing.
    pub fn publish(&self, user: (&str, &str), topic: &str, text: &str) -> Output {
        let mut command = self.client("mosquitto_pub", user);
        command.args(["-t", topic, "-m", text]);
        command.output().expect("mosquitto_pub")
    }

    /// Has `user` wait for one message under `filter` with `mosquitto_sub`. Returns when the broker has taken
    /// the subscription.
    ///
    /// # Panics
    /// When the tool is missing, or the broker, which has to log everything, does not say that it has.
    pub fn listen(&self, user: (&str, &str), filter: &str) -> Listener {
        let taken = format!("Sending SUBACK to {}", user.0);
        let before = self.log().matches(&taken).count();
        let mut command = self.client("mosquitto_sub", user);
        command.args(["-v", "-C", "1", "-t", filter]);
        command.args(["-W", "60"]);
        let child = command.stdout(Stdio::piped()).spawn();
        let listener = Listener(child.expect("mosquitto_sub"));
        wait_for("the broker takes a subscription", PATIENCE, || {
            (self.log().matches(&taken).count() > before).then_some(())
        });
        listener
    }

    /// One of its tools, as a client of this name at QoS 1.
    fn client(&self, tool: &str, (user, password): (&str, &str)) -> Command {
        let mut command = Command::new(program(tool));
        command
            .args(["-V", "mqttv5", "-h", "127.0.0.1"])
            .args(["-p", &self.port.to_string(), "-i", user])
            .args(["-u", user, "-P", password, "-q", "1"]);
        if self.folder.tls {
            command.arg("--cafile").arg(self.certificate());
        }
        command
    }

    /// Everything that it said.
    pub fn log(&self) -> String {
        self.process.log()
    }
}
