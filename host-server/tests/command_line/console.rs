//! The console as a person or a script uses it: accounts, credentials, audit log, backups.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use crate::scratch::Scratch;

pub(crate) const PASSWORD: &str = "correct horse battery";

pub(crate) fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terracrawler"));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("TERRACRAWLER_") {
            command.env_remove(name);
        }
    }
    command
        .env("USER", "tester")
        .env_remove("SUDO_USER")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// A data directory and the console on it.
pub(crate) struct Place(Scratch);

impl Place {
    pub(crate) fn new() -> Self {
        Self(Scratch::new())
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0.0
    }

    pub(crate) fn command(&self, arguments: &[&str]) -> Command {
        let mut command = program();
        command.args(arguments).arg("--data").arg(self.path());
        command
    }

    pub(crate) fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("runs")
    }

    pub(crate) fn typed(&self, arguments: &[&str], input: &str) -> Output {
        let mut child = self
            .command(arguments)
            .stdin(Stdio::piped())
            .spawn()
            .expect("starts");
        let mut stdin = child.stdin.take().expect("stdin");
        // A program that has seen enough closes its end.
        let _ = stdin.write_all(input.as_bytes());
        drop(stdin);
        child.wait_with_output().expect("runs")
    }

    /// What a command that must do prints.
    #[track_caller]
    pub(crate) fn ok(&self, arguments: &[&str]) -> String {
        done(&self.run(arguments))
    }

    /// What a command that must not do complains.
    #[track_caller]
    pub(crate) fn refused(&self, arguments: &[&str]) -> String {
        complaint(&self.run(arguments), 1)
    }

    pub(crate) fn with_admin() -> Self {
        let place = Self::new();
        done(&place.typed(&["user", "add", "ada", "--role", "admin"], PASSWORD));
        place
    }
}

#[track_caller]
pub(crate) fn done(output: &Output) -> String {
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {error}", output.status);
    String::from_utf8(output.stdout.clone()).expect("UTF-8")
}

#[track_caller]
pub(crate) fn complaint(output: &Output, code: i32) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(text.starts_with("terracrawler: "), "{text}");
    text
}

/// The line of a table that begins with `name`.
#[track_caller]
pub(crate) fn row<'a>(table: &'a str, name: &str) -> &'a str {
    table
        .lines()
        .find(|line| line.split_whitespace().next() == Some(name))
        .unwrap_or_else(|| panic!("no {name} in:\n{table}"))
}

#[test]
fn an_account_lives_and_ends() {
    let place = Place::with_admin();
    done(&place.typed(&["user", "add", "bob"], &format!("{PASSWORD}\n")));
    let list = place.ok(&["user", "list"]);
    assert!(row(&list, "ada").contains("admin"), "{list}");
    assert!(row(&list, "bob").contains("viewer"), "{list}");
    assert!(!list.contains("argon2"), "{list}");

    place.ok(&["user", "role", "bob", "operator"]);
    place.ok(&["user", "disable", "bob"]);
    let list = place.ok(&["user", "list"]);
    assert!(row(&list, "bob").contains("operator"), "{list}");
    assert!(row(&list, "bob").contains("locked"), "{list}");
    place.ok(&["user", "enable", "bob"]);
    done(&place.typed(&["user", "passwd", "bob"], "another one entirely"));
    place.ok(&["user", "remove", "bob"]);
    assert!(!place.ok(&["user", "list"]).contains("bob"));
    assert!(
        place
            .refused(&["user", "passwd", "bob"])
            .contains("no account")
    );

    // All of it is in the log, under the name of whoever did it.
    let log = place.ok(&["audit", "list"]);
    for action in [
        "user.add",
        "user.role",
        "user.disable",
        "user.enable",
        "user.password",
        "user.remove",
    ] {
        assert!(log.contains(action), "{action} in {log}");
    }
    assert!(
        log.lines().all(|line| line.contains("console:tester")),
        "{log}"
    );
    assert!(
        !log.contains(PASSWORD) && !log.contains("another one"),
        "{log}"
    );
}

#[test]
fn weak_passwords_and_wrong_names_are_refused() {
    let place = Place::with_admin();
    for (password, why) in [
        ("short", "fewer than 10"),
        ("", "no password"),
        ("\n", "fewer"),
    ] {
        let text = complaint(&place.typed(&["user", "add", "bob"], password), 1);
        assert!(text.contains(why), "{password:?}: {text}");
    }
    // A password that is no argument: the option does not exist.
    assert_eq!(
        place.run(&["user", "add", "bob", "secret"]).status.code(),
        Some(2)
    );
    for name in ["Bob", "server", "simulator-1", "learner-1", "a b", ""] {
        let output = place.typed(&["user", "add", name], PASSWORD);
        assert_eq!(output.status.code(), Some(2), "{name}");
    }
    let text = complaint(&place.typed(&["user", "add", "ada"], PASSWORD), 1);
    assert!(text.contains("already"), "{text}");
    assert_eq!(place.ok(&["user", "list"]).lines().count(), 2);
}

#[test]
fn the_last_administrator_stays() {
    let place = Place::with_admin();
    for arguments in [
        &["user", "remove", "ada"][..],
        &["user", "disable", "ada"],
        &["user", "role", "ada", "viewer"],
    ] {
        place.refused(arguments);
    }
    assert!(row(&place.ok(&["user", "list"]), "ada").contains("active"));
    // The attempts are in the log as well.
    let log = place.ok(&["audit", "list"]);
    assert_eq!(log.matches("refused").count(), 3, "{log}");
}

#[test]
fn an_invitation_is_a_link() {
    let place = Place::with_admin();
    let link = place.ok(&["user", "invite", "--role", "operator"]);
    let code = link.trim().strip_prefix("http://127.0.0.1:8080/#invite=");
    assert_eq!(code.map(str::len), Some(43), "{link}");
    let other = place.ok(&["user", "invite", "--role", "operator"]);
    assert_ne!(link, other);
    assert!(!place.ok(&["audit", "list"]).contains(code.unwrap_or("?")));
}

#[test]
fn a_robot_is_enrolled_and_revoked() {
    let place = Place::with_admin();
    let output = place.run(&[
        "robot",
        "enroll",
        "rover-1",
        "--address",
        "robots.example:1900",
    ]);
    let url = done(&output);
    let secret = url
        .trim()
        .strip_prefix("mqtt://rover-1:")
        .and_then(|rest| rest.strip_suffix("@robots.example:1900"))
        .unwrap_or_else(|| panic!("{url}"));
    assert_eq!(secret.len(), 43);
    let advice = String::from_utf8_lossy(&output.stderr).into_owned();
    for text in [
        "Address",
        "robots.example:1900",
        "Name of this robot",
        secret,
    ] {
        assert!(advice.contains(text), "{text} in {advice}");
    }
    let simulator = place.ok(&["robot", "enroll", "--simulator", "lab"]);
    assert!(
        simulator.starts_with("mqtt://simulator-lab:"),
        "{simulator}"
    );
    let learner = place.run(&["robot", "enroll", "--learner", "desk"]);
    let url = done(&learner);
    assert!(url.starts_with("mqtt://learner-desk:"), "{url}");
    let advice = String::from_utf8_lossy(&learner.stderr).into_owned();
    let start = format!(
        "TERRACRAWLER_BROKER='{}' terracrawler learn-node\n",
        url.trim()
    );
    assert!(advice.contains(&start), "{advice}");

    // Only the digest is kept.
    let kept = std::fs::read(place.path().join("records.sqlite")).expect("records");
    assert!(!kept.windows(43).any(|window| window == secret.as_bytes()));

    let again = done(&place.run(&["robot", "enroll", "rover-1"]));
    assert!(!again.contains(secret), "the same secret twice");
    place.ok(&["robot", "revoke", "rover-1"]);
    place.ok(&["robot", "revoke", "--simulator", "lab"]);
    place.ok(&["robot", "revoke", "--learner", "desk"]);
    let list = place.ok(&["robot", "list"]);
    assert!(row(&list, "rover-1").contains("revoked"), "{list}");
    for name in ["simulator-lab", "learner-desk"] {
        assert!(row(&list, name).contains("revoked"), "{list}");
    }

    // Names that others go by at the broker, and nobody's.
    for robot in ["ada", "simulator-lab", "server-1", "learner-desk"] {
        place.refused(&["robot", "enroll", robot]);
    }
    place.refused(&["robot", "revoke", "stranger"]);
    for arguments in [
        &["robot", "enroll"][..],
        &["robot", "enroll", "Rover"],
        &["robot", "enroll", "a/b"],
        &["robot", "enroll", "rover-2", "--simulator", "lab"],
        &["robot", "enroll", "rover-2", "--learner", "desk"],
        &["robot", "enroll", "--simulator", "lab", "--learner", "desk"],
    ] {
        assert_eq!(place.run(arguments).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn a_wrong_directory_is_no_empty_server() {
    let place = Place::new();
    for arguments in [
        &["user", "list"][..],
        &["robot", "list"],
        &["audit", "verify"],
        &["backup", "/nowhere/at/all"],
    ] {
        let text = place.refused(arguments);
        assert!(text.contains("--data"), "{arguments:?}: {text}");
    }
    assert!(!place.path().exists(), "nothing was made");
}

#[test]
fn the_chain_is_verified_and_exported() {
    let place = Place::with_admin();
    place.ok(&["robot", "enroll", "rover-1"]);
    assert!(place.ok(&["audit", "verify"]).contains("2 entries"));
    let export = place.ok(&["audit", "export"]);
    let entries: Vec<serde_json::Value> = export
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON lines"))
        .collect();
    assert_eq!(entries.len(), 2);
    assert_eq!(entries[0]["action"], "user.add");
    assert_eq!(entries[1]["target"], "rover-1");

    let file = place.path().join("export.jsonl");
    let name = file.to_str().expect("UTF-8");
    place.ok(&["audit", "export", name]);
    assert_eq!(std::fs::read_to_string(&file).expect("file"), export);
    // It does not write over anything.
    place.refused(&["audit", "export", name]);

    let listed = place.ok(&["audit", "list", "--limit", "1"]);
    assert!(
        listed.contains("robot.enroll") && listed.lines().count() == 1,
        "{listed}"
    );
    let earlier = place.ok(&["audit", "list", "--before", "2"]);
    assert!(
        earlier.contains("user.add") && earlier.lines().count() == 1,
        "{earlier}"
    );
    assert_eq!(place.ok(&["audit", "list", "--who", "nobody"]), "");
}

/// A backup of `place` beside it.
pub(crate) fn back_up(place: &Place) -> (Scratch, PathBuf) {
    let folder = Scratch::new();
    std::fs::create_dir_all(&folder.0).expect("directory");
    let file = folder.0.join("backup.tar");
    place.ok(&["backup", file.to_str().expect("UTF-8")]);
    (folder, file)
}

#[test]
fn a_backup_comes_back_elsewhere() {
    let place = Place::with_admin();
    place.ok(&["robot", "enroll", "rover-1"]);
    // Keys of TLS lie beside the records; without them every robot would have to be set up anew.
    std::fs::create_dir_all(place.path().join("tls")).expect("directory");
    std::fs::write(place.path().join("tls/ca.key"), "a key").expect("file");
    let (_folder, file) = back_up(&place);
    let name = file.to_str().expect("UTF-8");
    // What happens afterwards is not in it.
    place.ok(&["robot", "revoke", "rover-1"]);
    place.refused(&["backup", name]);

    let other = Place::new();
    let said = other.ok(&["restore", name]);
    assert!(said.contains("log in again"), "{said}");
    assert!(row(&other.ok(&["user", "list"]), "ada").contains("admin"));
    assert!(row(&other.ok(&["robot", "list"]), "rover-1").contains("valid"));
    let key = std::fs::read_to_string(other.path().join("tls/ca.key"));
    assert_eq!(key.expect("the key"), "a key");
    let log = other.ok(&["audit", "list"]);
    assert!(log.contains("restore"), "{log}");
    other.ok(&["audit", "verify"]);

    // What is there is not written over, unless told so, and then it is put aside.
    other.ok(&["user", "invite"]);
    assert!(other.refused(&["restore", name]).contains("--replace"));
    other.ok(&["restore", "--replace", name]);
    let aside = std::fs::read_dir(other.path())
        .expect("directory")
        .flatten()
        .find(|entry| {
            entry
                .file_name()
                .to_string_lossy()
                .starts_with("before-restore-")
        })
        .expect("put aside");
    assert!(aside.path().join("records.sqlite").is_file());
    assert!(!other.ok(&["audit", "list"]).contains("user.invite"));
}

#[test]
fn what_is_no_backup_changes_nothing() {
    let place = Place::with_admin();
    let (folder, file) = back_up(&place);
    let whole = std::fs::read(&file).expect("backup");
    let broken = folder.0.join("broken.tar");
    let name = broken.to_str().expect("UTF-8");
    let mut damaged = whole.clone();
    // Inside the database, which is the first file: a page in its middle.
    for byte in damaged.iter_mut().skip(512 + 4096).take(4096) {
        *byte = 0xff;
    }
    for (what, bytes) in [
        ("nothing", &b""[..]),
        ("text", b"this is no archive, whatever its name says"),
        ("half", &whole[..whole.len() / 3]),
        ("damaged", &damaged),
    ] {
        std::fs::write(&broken, bytes).expect("file");
        place.refused(&["restore", "--replace", name]);
        let list = place.ok(&["user", "list"]);
        assert!(row(&list, "ada").contains("active"), "{what}: {list}");
    }
    let left: Vec<_> = std::fs::read_dir(place.path())
        .expect("directory")
        .flatten()
        .map(|entry| entry.file_name().into_string().expect("UTF-8"))
        .filter(|name| name.starts_with('.') || name.starts_with("before"))
        .collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn it_works_beside_a_running_server() {
    let place = Place::new();
    let server = Server::start(&place);
    done(&place.typed(&["user", "add", "ada", "--role", "admin"], PASSWORD));
    place.ok(&["robot", "enroll", "rover-1"]);
    let (_folder, file) = back_up(&place);
    place.ok(&["audit", "verify"]);
    // But nothing is put below a server that runs.
    let text = place.refused(&["restore", "--replace", file.to_str().expect("UTF-8")]);
    assert!(text.contains("in use"), "{text}");
    drop(server);
}

/// A running server on the place, ended with the value.
pub(crate) struct Server(pub(crate) std::process::Child);

impl Server {
    pub(crate) fn start(place: &Place) -> Self {
        use std::io::BufRead as _;
        let mut child = place
            .command(&["serve", "--http", "127.0.0.1:0", "--mqtt", "127.0.0.1:0"])
            .stderr(Stdio::null())
            .spawn()
            .expect("starts");
        let mut lines = std::io::BufReader::new(child.stdout.take().expect("stdout"));
        let mut greeting = String::new();
        while !greeting.contains("Ctrl-C") {
            let read = lines.read_line(&mut greeting).expect("reads");
            assert!(read > 0, "ended after {greeting}");
        }
        Self(child)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
