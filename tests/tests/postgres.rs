//! Servers whose records are in `PostgreSQL`, as programs of their own.

use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use crawler_tests::engines::Process;
use crawler_tests::engines::postgres::{PASSWORD, Postgres, QUOTED, USER};
use crawler_tests::{ReservedPort, binary, wait_for};
use serde_json::{Value, json};
use tempfile::TempDir;

const LONG: Duration = Duration::from_mins(2);

/// The program, told by its arguments alone.
fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(binary());
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("TERRACRAWLER_") {
            command.env_remove(name);
        }
    }
    command.args(arguments);
    command
}

/// What the console says, and whether it was content.
fn console(arguments: &[&str]) -> (bool, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = program(arguments).output().expect("the console");
    let text = [stdout, stderr].concat();
    let text = String::from_utf8(text).expect("UTF-8");
    assert!(!text.contains(PASSWORD) && !text.contains(QUOTED), "{text}");
    (status.success(), text)
}

/// A server that nobody may use without an account.
struct Server {
    process: Process,
    http: ReservedPort,
    _mqtt: ReservedPort,
    _folder: TempDir,
}

impl Server {
    fn start(database: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let (http, mqtt) = (ReservedPort::new(), ReservedPort::new());
        let mut command = program(&["serve", "--database", database]);
        command
            .args(["--http", &format!("127.0.0.1:{}", http.number())])
            .args(["--mqtt", &format!("127.0.0.1:{}", mqtt.number())])
            .arg("--data")
            .arg(folder.path().join("data"));
        let mut server = Self {
            process: Process::start(command, &folder.path().join("log")),
            http,
            _mqtt: mqtt,
            _folder: folder,
        };
        wait_for("the server is ready", LONG, || {
            assert!(server.process.runs(), "{}", server.process.log());
            server
                .try_call("GET", "/readyz", None, None)
                .filter(|(status, _)| *status == 200)
        });
        server
    }

    fn try_call(
        &self,
        method: &str,
        path: &str,
        token: Option<&str>,
        body: Option<&Value>,
    ) -> Option<(u16, Value)> {
        let agent: ureq::Agent = ureq::Agent::config_builder()
            .timeout_global(Some(LONG))
            .http_status_as_error(false)
            .build()
            .into();
        let mut request = ureq::http::Request::builder()
            .method(method)
            .uri(format!("http://127.0.0.1:{}{path}", self.http.number()));
        if let Some(token) = token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        let sent = match body {
            Some(body) => {
                let request = request.header("content-type", "application/json");
                agent.run(request.body(body.to_string()).expect("a request"))
            }
            None => agent.run(request.body(()).expect("a request")),
        };
        let mut response = sent.ok()?;
        let text = response.body_mut().read_to_string().ok()?;
        let body = serde_json::from_str(&text).unwrap_or(Value::String(text));
        Some((response.status().as_u16(), body))
    }

    fn call(
        &self,
        method: &str,
        path: &str,
        token: Option<&str>,
        body: Option<&Value>,
    ) -> (u16, Value) {
        self.try_call(method, path, token, body)
            .unwrap_or_else(|| panic!("no answer to {method} {path}:\n{}", self.process.log()))
    }

    /// Takes the invitation of the first administrator.
    fn become_admin(&self, name: &str, password: &str) -> String {
        // The link is printed when the server is ready, and a moment after it says so.
        let code = wait_for("an invitation", LONG, || {
            let log = self.process.log();
            let (_, rest) = log.split_once("/#invite=")?;
            let (code, _) = rest.split_once(char::is_whitespace)?;
            Some(code.to_owned())
        });
        let body = json!({ "code": code, "name": name, "password": password });
        let (status, body) = self.call("POST", "/api/v1/invitations", None, Some(&body));
        assert_eq!(status, 200, "{body}");
        token(&body)
    }

    fn login(&self, name: &str, password: &str) -> (u16, Value) {
        let body = json!({ "user": name, "password": password });
        self.call("POST", "/api/v1/session", None, Some(&body))
    }

    /// Waits until it answers `expected` to who has this token.
    fn wait_status(&self, token: &str, expected: u16) -> Duration {
        let began = Instant::now();
        wait_for(&format!("the token gets {expected}"), LONG, || {
            let (status, _) = self.call("GET", "/api/v1/users", Some(token), None);
            (status == expected).then_some(())
        });
        began.elapsed()
    }
}

fn token(body: &Value) -> String {
    body["token"].as_str().expect("a token").to_owned()
}

#[test]
fn servers_share_accounts_sessions_and_one_audit_log() {
    const SECRET: &str = "correct horse battery";
    let postgres = Postgres::shared();
    let url = postgres.database();
    let one = Server::start(&url);
    let first = one.become_admin("ada", SECRET);
    assert_eq!(one.call("GET", "/readyz", None, None).1["database"], true);

    // One that starts later knows the session; another session reaches it soon.
    let two = Server::start(&url);
    two.wait_status(&first, 200);
    let (status, body) = two.login("ada", SECRET);
    assert_eq!(status, 200, "{body}");
    let second = token(&body);
    let known = one.wait_status(&second, 200);
    let (status, _) = one.call("DELETE", "/api/v1/session", Some(&second), None);
    assert_eq!(status, 204);
    let revoked = two.wait_status(&second, 401);
    println!("known to the other server after {known:?}, revoked after {revoked:?}");
    two.wait_status(&first, 200);

    // The console needs the address of the database and no directory.
    let with = |arguments: &[&str]| console(&[arguments, &["--database", &url]].concat());
    let (ok, text) = with(&["user", "list"]);
    assert!(ok && text.contains("ada"), "{text}");
    let (ok, text) = with(&["robot", "enroll", "rover-1"]);
    assert!(ok && text.contains("rover-1"), "{text}");
    let (ok, text) = with(&["robot", "list"]);
    assert!(ok && text.contains("rover-1"), "{text}");
    let (ok, text) = with(&["user", "passwd", "ada"]);
    assert!(!ok, "no password was given: {text}");
    let (ok, text) = with(&["audit", "verify"]);
    assert!(ok, "{text}");
    let (_, log) = with(&["audit", "list"]);
    for what in ["invitation.take", "logout", "robot.enroll"] {
        assert!(log.contains(what), "{what}: {log}");
    }
    let (ok, text) = with(&["user", "invite", "bob", "--role", "admin"]);
    assert!(ok && text.contains("#invite="), "{text}");
    let metrics = one.call("GET", "/metrics", Some(&first), None).1;
    assert!(
        metrics
            .as_str()
            .expect("text")
            .contains("terracrawler_database_up 1")
    );
}

#[test]
fn an_experiment_is_shown_and_steered_by_all_servers() {
    const SECRET: &str = "correct horse battery";
    const ALL: &str = "/api/v1/experiments";
    let postgres = Postgres::shared();
    let url = postgres.database();
    let one = Server::start(&url);
    let admin = one.become_admin("ada", SECRET);
    let two = Server::start(&url);
    two.wait_status(&admin, 200);
    let admin = Some(admin.as_str());
    let body = json!({
        "name": "both", "scenario": "empty", "robots": 1, "seeds": 40, "set": ["duration_s=1.0"],
    });
    let (status, made) = one.call("POST", ALL, admin, Some(&body));
    assert_eq!(status, 201, "{made}");
    let whole = format!("{ALL}/{}", made["id"].as_str().expect("an id"));
    wait_for("the other server shows the end", LONG, || {
        let (status, seen) = two.call("GET", &whole, admin, None);
        assert_eq!(status, 200, "{seen}");
        (seen["state"] == "completed").then_some(())
    });
    let (_, page) = two.call("GET", &format!("{whole}/metrics"), admin, None);
    assert_eq!(page["trials"].as_array().map(Vec::len), Some(40));

    let mut endless = body.clone();
    endless["set"] = json!(["duration_s=2419200.0"]);
    let (_, made) = one.call("POST", ALL, admin, Some(&endless));
    let path = format!("{ALL}/{}", made["id"].as_str().expect("an id"));
    for (server, other, action, state) in [
        (&two, &one, "pause", "paused"),
        (&one, &two, "resume", "running"),
        (&two, &one, "stop", "stopped"),
    ] {
        let (status, done) = server.call("POST", &format!("{path}/{action}"), admin, None);
        assert_eq!((status, &done["state"]), (200, &json!(state)), "{done}");
        assert_eq!(other.call("GET", &path, admin, None).1["state"], state);
        let (status, refused) = other.call("POST", &format!("{path}/{action}"), admin, None);
        assert_eq!((status, &refused["code"]), (409, &json!("wrong_state")));
    }
    assert_eq!(two.call("DELETE", &path, admin, None).0, 204);
    assert_eq!(one.call("GET", &path, admin, None).0, 404);
}

#[test]
fn a_server_outlives_its_database() {
    const SECRET: &str = "correct horse battery";
    let mut postgres = Postgres::start();
    let url = postgres.database();
    let server = Server::start(&url);
    let admin = server.become_admin("ada", SECRET);
    postgres.kill();
    wait_for("the server tells", LONG, || {
        let (status, body) = server.call("GET", "/readyz", None, None);
        assert_eq!(status, 200, "robots are in reach: {body}");
        (body["database"] == false).then_some(())
    });
    let (status, body) = server.login("ada", SECRET);
    assert_eq!(
        (status, &body["code"]),
        (503, &json!("records_unavailable"))
    );
    assert!(body["retry_after"].as_u64().is_some(), "{body}");
    // Who is logged in can go on.
    let (status, body) = server.call("GET", "/api/v1/robots", Some(&admin), None);
    assert_eq!(status, 200, "{body}");
    let metrics = server.call("GET", "/metrics", Some(&admin), None).1;
    assert!(
        metrics
            .as_str()
            .expect("text")
            .contains("terracrawler_database_up 0")
    );

    postgres.resume();
    wait_for("the server recovers", LONG, || {
        (server.login("ada", SECRET).0 == 200).then_some(())
    });
    assert_eq!(
        server.call("GET", "/readyz", None, None).1["database"],
        true
    );
    let (ok, text) = console(&["audit", "verify", "--database", &url]);
    assert!(ok, "{text}");
}

#[test]
fn what_does_not_work_is_told_in_a_line() {
    let postgres = Postgres::shared();
    let nobody = ReservedPort::new();
    let (port, free) = (postgres.port(), nobody.number());
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().to_str().expect("UTF-8");
    let empty = postgres.database();
    for (url, says) in [
        (
            format!("postgres://{USER}:x@127.0.0.1:{free}/fleet"),
            "the database is not available",
        ),
        (
            format!("postgres://{USER}:x@127.0.0.1:{port}/postgres"),
            "lets `terracrawler` not in",
        ),
        (postgres.url("nowhere"), "there is no database `nowhere`"),
    ] {
        let any = ["--http", "127.0.0.1:0", "--mqtt", "127.0.0.1:0"];
        let serve = ["serve", "--database", &url, "--data", data];
        let (ok, text) = console(&[&serve[..], &any[..]].concat());
        let last = text.lines().last().unwrap_or_default();
        assert!(!ok && last.contains(says), "{text}");
        let (ok, text) = console(&["user", "list", "--database", &url]);
        assert!(
            !ok && text.lines().count() == 1 && text.contains(says),
            "{text}"
        );
        let (ok, text) = console(&["doctor", "--database", &url, "--data", data]);
        assert!(
            !ok && text.contains("fail  database") && text.contains('→'),
            "{text}"
        );
    }
    let (ok, text) = console(&["user", "list", "--database", &empty]);
    assert!(!ok && text.contains("holds no records"), "{text}");
}

#[test]
fn a_backup_carries_a_server_into_a_database() {
    let postgres = Postgres::shared();
    let url = postgres.database();
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let run = |arguments: &[&str]| {
        let (ok, text) = console(arguments);
        assert!(ok, "{arguments:?}: {text}");
        text
    };
    let (old, new, tar) = (path("old"), path("new"), path("backup.tar"));
    std::fs::create_dir(&old).expect("a directory");
    run(&["robot", "enroll", "rover-1", "--data", &old]);
    run(&["backup", &tar, "--data", &old]);
    let restore = ["restore", &tar, "--data", &new, "--database", &url];
    run(&restore);
    assert!(!Path::new(&new).join("records.sqlite").exists());
    let list = run(&["robot", "list", "--database", &url]);
    assert!(list.contains("rover-1"), "{list}");
    let doctor = console(&["doctor", "--database", &url, "--data", &new]).1;
    assert!(
        doctor.contains("ok    database") && doctor.contains("the chain is whole"),
        "{doctor}"
    );

    // Not over something, unless asked to.
    run(&["robot", "enroll", "rover-2", "--database", &url]);
    let (ok, text) = console(&restore);
    assert!(!ok && text.contains("--replace"), "{text}");
    let text = run(&[&restore[..], &["--replace"]].concat());
    assert!(text.contains("lies in"), "{text}");
    let list = run(&["robot", "list", "--database", &url]);
    assert!(
        list.contains("rover-1") && !list.contains("rover-2"),
        "{list}"
    );

    // And back into a file.
    let (again, tar) = (path("again"), path("again.tar"));
    run(&["backup", &tar, "--data", &new, "--database", &url]);
    run(&["restore", &tar, "--data", &again]);
    let list = run(&["robot", "list", "--data", &again]);
    assert!(list.contains("rover-1"), "{list}");
    run(&["audit", "verify", "--data", &again]);
}
