//! The doctor, on a place that is well and on places where one thing is broken.

mod support;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use support::Scratch;
use support::port::ReservedPort;

fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terracrawler"));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("TERRACRAWLER_") {
            command.env_remove(name);
        }
    }
    command
}

/// Any port: nobody has to find one that is free.
const ANY: &str = "127.0.0.1:0";

/// A data directory with an administrator, and where its server listens.
struct Place {
    scratch: Scratch,
    http: String,
    mqtt: String,
}

impl Place {
    fn new() -> Self {
        let place = Self {
            scratch: Scratch::new(),
            http: ANY.into(),
            mqtt: ANY.into(),
        };
        let mut child = program()
            .args(["user", "add", "ada", "--role", "admin", "--data"])
            .arg(place.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .expect("starts");
        let mut stdin = child.stdin.take().expect("stdin");
        stdin.write_all(b"correct horse battery\n").expect("read");
        drop(stdin);
        assert!(child.wait().expect("runs").success());
        place
    }

    fn path(&self) -> &Path {
        &self.scratch.0
    }

    /// What the doctor says, and whether it is content.
    fn examined(&self, more: &[&str]) -> (String, bool) {
        let mut command = program();
        command.arg("doctor").arg("--data").arg(self.path());
        for (option, value) in [("--http", &self.http), ("--mqtt", &self.mqtt)] {
            // An outside broker takes the place of our own.
            let replaced =
                more.contains(&option) || option == "--mqtt" && more.contains(&"--broker");
            if !replaced {
                command.args([option, value]);
            }
        }
        let output = command.args(more).output().expect("runs");
        let text = String::from_utf8(output.stdout).expect("UTF-8");
        assert!(
            !text.is_empty(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        (text, output.status.success())
    }

    /// Examines and wants a line of this grade about this thing, with advice below it.
    #[track_caller]
    fn finds(&self, more: &[&str], grade: &str, what: &str, words: &[&str]) {
        let (text, content) = self.examined(more);
        assert_eq!(content, grade == "warn", "{text}");
        let mut lines = text.lines();
        let line = lines
            .find(|line| line.starts_with(&format!("{grade:<4}  {what}")))
            .unwrap_or_else(|| panic!("no `{grade} {what}` in:\n{text}"));
        let advice = lines.next().unwrap_or_default();
        assert!(
            advice.trim_start().starts_with('→'),
            "no advice in:\n{text}"
        );
        for word in words {
            assert!(
                line.contains(word) || advice.contains(word),
                "no `{word}` in:\n{line}\n{advice}"
            );
        }
    }
}

#[test]
fn a_healthy_place_is_called_so() {
    // Ports that nobody listens at, nor can in between.
    let (http, mqtt) = (ReservedPort::new(), ReservedPort::new());
    let place = Place {
        http: http.address().to_string(),
        mqtt: mqtt.address().to_string(),
        ..Place::new()
    };
    let (text, content) = place.examined(&[]);
    assert!(content, "{text}");
    for what in [
        "program",
        "data directory",
        "rights",
        "HTTP port",
        "MQTT port",
        "records",
        "audit log",
        "accounts",
        "robots",
        "access",
    ] {
        let line = format!("ok    {what}");
        assert!(text.contains(&line), "no `{line}` in:\n{text}");
    }
    assert!(text.contains(" 0 failed"), "{text}");
}

#[test]
fn nothing_is_made_where_nothing_is() {
    let place = Place {
        scratch: Scratch::new(),
        http: ANY.into(),
        mqtt: ANY.into(),
    };
    place.finds(&[], "warn", "data directory", &["not there", "--data"]);
    assert!(!place.path().exists());
}

#[test]
fn a_port_in_use_is_found() {
    let place = Place::new();
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("address").to_string();
    place.finds(
        &["--http", &address],
        "fail",
        "HTTP port",
        &["--http", &address, "ss -ltnp"],
    );
    place.finds(
        &["--mqtt", &address],
        "fail",
        "MQTT port",
        &["--mqtt", &address],
    );
    // An address of a network that is kept for documentation.
    place.finds(
        &["--http", "192.0.2.1:8080"],
        "fail",
        "HTTP port",
        &["no such address"],
    );
}

#[test]
fn a_broker_that_is_not_there_is_found() {
    let place = Place::new();
    let nobody = ReservedPort::new();
    let url = format!("mqtt://{}", nobody.address());
    place.finds(&["--broker", &url], "fail", "broker", &[&url, "reachable"]);
}

#[test]
fn an_open_server_on_the_network_is_found() {
    let place = Place::new();
    place.finds(
        &["--open", "--http", "0.0.0.0:0"],
        "fail",
        "access",
        &["everybody can steer"],
    );
    place.finds(&["--open"], "warn", "access", &["--open"]);
}

#[test]
fn rights_that_let_others_in_are_found() {
    let place = Place::new();
    let mode = |mode| {
        let permissions = std::fs::Permissions::from_mode(mode);
        std::fs::set_permissions(place.path(), permissions).expect("chmod");
    };
    mode(0o755);
    place.finds(&[], "warn", "rights", &["755", "chmod 700"]);
    mode(0o700);
    assert!(place.examined(&[]).0.contains("ok    rights"));
}

#[test]
fn what_is_no_directory_is_found() {
    let place = Place::new();
    let file = place.path().join("file");
    std::fs::write(&file, "").expect("file");
    let output = program()
        .args([
            "doctor",
            "--http",
            "127.0.0.1:0",
            "--mqtt",
            "127.0.0.1:0",
            "--data",
        ])
        .arg(&file)
        .output()
        .expect("runs");
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("fail  data directory"), "{text}");
}

/// Puts the records into one file without a log beside it, changed by `change`.
fn tamper(place: &Place, change: impl FnOnce(&mut Vec<u8>)) {
    // A backup is such a file.
    let folder = Scratch::new();
    std::fs::create_dir_all(&folder.0).expect("directory");
    let backup = folder.0.join("backup.tar");
    let made = program()
        .arg("backup")
        .arg(&backup)
        .arg("--data")
        .arg(place.path())
        .output()
        .expect("runs");
    assert!(made.status.success());
    let mut archive = tar::Archive::new(std::fs::File::open(&backup).expect("backup"));
    let mut bytes = Vec::new();
    for entry in archive.entries().expect("entries") {
        let mut entry = entry.expect("entry");
        if entry.path().expect("path").as_ref() == Path::new("records.sqlite") {
            entry.read_to_end(&mut bytes).expect("records");
        }
    }
    change(&mut bytes);
    let file = place.path().join("records.sqlite");
    std::fs::write(file, bytes).expect("records");
    for log in ["records.sqlite-wal", "records.sqlite-shm"] {
        let _ = std::fs::remove_file(place.path().join(log));
    }
}

#[test]
fn a_forged_entry_is_found() {
    let place = Place::new();
    tamper(&place, |bytes| {
        let (from, to) = (b"user.add", b"user.nop");
        let at = bytes
            .windows(from.len())
            .position(|window| window == from)
            .expect("it is in the records");
        bytes[at..at + to.len()].copy_from_slice(to);
    });
    place.finds(&[], "fail", "audit log", &["changed", "backup"]);
}

#[test]
fn damaged_records_are_found() {
    let place = Place::new();
    tamper(&place, |bytes| {
        bytes.iter_mut().skip(4_096).for_each(|byte| *byte = 0xff);
    });
    place.finds(&[], "fail", "records", &["restore"]);
    let file = place.path().join("records.sqlite");
    std::fs::write(file, "this is no database").expect("records");
    place.finds(&[], "fail", "records", &["restore"]);
}

#[test]
fn nobody_who_can_administer_is_found() {
    let place = Place {
        scratch: Scratch::new(),
        ..Place::new()
    };
    let invited = program()
        .args(["user", "invite", "--data"])
        .arg(place.path())
        .output()
        .expect("runs");
    assert!(invited.status.success());
    place.finds(&[], "warn", "accounts", &["--role admin"]);
}

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_running_server_is_asked() {
    let mut place = Place::new();
    let mut child = program()
        .args(["serve", "--http", ANY, "--mqtt", ANY, "--data"])
        .arg(place.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts");
    let mut lines = BufReader::new(child.stdout.take().expect("stdout"));
    let _running = Running(child);
    let mut greeting = String::new();
    while !greeting.contains("Ctrl-C") {
        let read = lines.read_line(&mut greeting).expect("reads");
        assert!(read > 0, "ended after {greeting}");
    }
    let told = |scheme: &str| {
        let (_, rest) = greeting.split_once(scheme).expect("an address");
        rest.split(['/', ' ']).next().expect("its end").to_owned()
    };
    place.http = told("http://");
    place.mqtt = told("mqtt://");
    let (text, content) = place.examined(&[]);
    assert!(content, "{text}");
    for line in ["ok    API", "ok    broker"] {
        assert!(text.contains(line), "no `{line}` in:\n{text}");
    }
    assert!(text.contains("a server is running"), "{text}");
    // With other options than the server's the doctor looks elsewhere, and says so.
    let nobody = ReservedPort::new();
    let other = nobody.address().to_string();
    place.finds(&["--http", &other], "fail", "API", &["--http"]);
    place.finds(&["--mqtt", &other], "fail", "broker", &["--mqtt"]);
}
