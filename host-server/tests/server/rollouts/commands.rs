//! `terracrawler rollout`, as a person or a script calls it beside a running server.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::{Value, json};

use super::robot::Program;
use super::{Home, hold, plan};
use crate::support::closed::{ADMIN, PASSWORD, VIEWER};
use crate::support::port::ReservedPort;
use crate::support::{Fixture, eventually};
use crawler_server::config::{Role, TlsMode};

/// Calls the program on the server of a data directory.
#[derive(Clone)]
struct Caller(PathBuf);

impl Caller {
    fn of(data: &Path) -> Self {
        Self(data.to_owned())
    }

    fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_terracrawler"));
        for (name, _) in std::env::vars_os() {
            if name.to_string_lossy().starts_with("TERRACRAWLER_") {
                command.env_remove(name);
            }
        }
        command
            .arg("rollout")
            .args(arguments.split(' '))
            .arg("--data")
            .arg(&self.0)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    /// Calls it with this on its standard input; the server goes on meanwhile.
    async fn typed(&self, arguments: &str, input: &str) -> Output {
        let mut child = self.command(arguments).spawn().expect("it starts");
        let mut stdin = child.stdin.take().expect("stdin");
        // A program that does not read closes its end.
        let _ = stdin.write_all(input.as_bytes());
        drop(stdin);
        let waited = tokio::task::spawn_blocking(move || child.wait_with_output());
        waited.await.expect("no panic").expect("it ends")
    }

    /// What it prints when it ends with this code.
    async fn ends(&self, code: i32, arguments: &str) -> String {
        let output = self.typed(arguments, "").await;
        let error = String::from_utf8_lossy(&output.stderr);
        let text = String::from_utf8(output.stdout).expect("UTF-8");
        assert_eq!(
            output.status.code(),
            Some(code),
            "{arguments}: {error}{text}"
        );
        text
    }

    async fn ok(&self, arguments: &str) -> String {
        self.ends(0, arguments).await
    }

    /// The line with which it is refused.
    async fn refused(&self, arguments: &str) -> String {
        one_line(&self.typed(arguments, "").await)
    }
}

#[track_caller]
fn one_line(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    assert!(text.starts_with("terracrawler: "), "{text}");
    text
}

/// The rest of the line of a table that begins so.
#[track_caller]
fn row<'t>(table: &'t str, name: &str) -> &'t str {
    let found = table.lines().find_map(|line| line.strip_prefix(name));
    found
        .unwrap_or_else(|| panic!("no {name} in {table}"))
        .trim()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_person_begins_a_rollout_pauses_it_and_has_it_go_on() {
    let mut home = Home::new().await;
    let caller = Caller::of(&home.settings.data);
    assert_eq!(caller.ok("show").await, "No rollouts yet.\n");
    let release = home.release(4, 60_000).await;
    let robots = home.robots(4, &release, Program::Good, 0).await;
    hold(&robots, 1);
    let start = format!(
        "start --release {} --group r03 --share 50,100 --soak 0 --parallel 1 --bytes-per-second 900000 \
         --override-gate test",
        release.id
    );
    let begun = caller.ok(&start).await;
    assert_eq!(row(&begun, "rollout "), "1");
    assert_eq!(
        row(&begun, "release "),
        format!("{} (0.4.0 for virt)", release.id)
    );
    let plan = &home.rollout("1").await["plan"];
    assert_eq!(
        (
            &plan["phases"][1]["select"],
            &plan["phases"][1]["soak_s"],
            &plan["limits"]
        ),
        (
            &json!({"share": 50}),
            &json!(0),
            &json!({"parallel": 1, "bytes_per_second": 900_000})
        )
    );
    home.wait_count("1", "receiving", 1).await;
    let paused = caller.ok("pause 1").await;
    assert_eq!(row(&paused, "state "), "paused by a person");
    // Who follows one that stands is told so at once.
    let followed = caller.ends(3, "show 1 --watch").await;
    assert!(followed.contains("paused: person\n"), "{followed}");
    eventually("given up", async || {
        home.rollout("1").await["counts"]["robots"]["receiving"].is_null()
    })
    .await;
    caller.ok("skip 1 r02").await;
    let left_out = caller.ok("robots 1 --state skipped").await;
    assert!(row(&left_out, "r02 ").ends_with("left_out"), "{left_out}");
    assert_eq!(left_out.lines().count(), 2, "{left_out}");
    caller.ok("retry 1 r02").await;
    assert_eq!(caller.ok("robots 1 --state skipped").await, "No robots.\n");
    let all: Value = serde_json::from_str(&caller.ok("robots 1 --json").await).expect("JSON");
    assert_eq!(all.as_array().map(Vec::len), Some(4), "{all}");
    hold(&robots, u32::MAX);
    let followed = caller.ok("resume 1 --watch").await;
    assert!(followed.contains("  resumed\n"), "{followed}");
    assert_eq!(row(&followed, "state "), "done");
    assert_eq!(row(&followed, "robots "), "4 confirmed");
    let one: Value = serde_json::from_str(&caller.ok("show 1 --json").await).expect("JSON");
    assert_eq!((&one["id"], &one["state"]), (&json!("1"), &json!("done")));
    let listed = caller.ok("show").await;
    assert!(row(&listed, "1 ").ends_with("done"), "{listed}");
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_is_a_file_or_comes_from_a_pipe_and_what_fails_is_told() {
    let mut home = Home::new().await;
    let caller = Caller::of(&home.settings.data);
    let release = home.release(4, 20_000).await;
    let _robots = home.robots(4, &release, Program::Panics, 0).await;
    let text = plan(&release, &[100], &json!({"parallel": 1})).to_string();
    let file = home.settings.data.join("plan.json");
    std::fs::write(&file, &text).expect("a file");
    let followed = caller
        .ends(3, &format!("start {} --watch", file.display()))
        .await;
    assert_eq!(
        row(&followed, "state "),
        "paused by itself: too many robots have failed (failures)"
    );
    let failed: Vec<_> = followed
        .lines()
        .filter(|line| line.ends_with("told panic"))
        .collect();
    assert_eq!(failed.len(), 2, "{followed}");
    assert!(
        failed.iter().all(|line| line.contains("rolled_back")),
        "{followed}"
    );
    assert_eq!(row(&caller.ok("abort 1").await, "state "), "aborted");
    caller.ends(4, "show 1 --watch").await;
    let second = caller.typed("start - --json", &text).await;
    let second: Value = serde_json::from_slice(&second.stdout).expect("JSON");
    assert_eq!(second["id"], "2");
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_server_refuses_is_a_sentence_with_its_code() {
    let mut home = Home::new().await;
    let caller = Caller::of(&home.settings.data);
    let release = home.release(4, 20_000).await;
    for (arguments, why) in [
        (
            "show 99".to_owned(),
            "there is no rollout of that id (unknown_rollout)",
        ),
        ("pause 99".to_owned(), "(unknown_rollout)"),
        ("robots 99".to_owned(), "(unknown_rollout)"),
        (
            format!("start --release {} --share 100", release.id),
            "(gate_missing)",
        ),
        (
            format!(
                "start --release {} --share 100 --override-gate test",
                release.id
            ),
            "no phase selects",
        ),
        (
            "start --release 0000000000000000 --share 100".to_owned(),
            "there is no release 0000000000000000 (invalid_rollout)",
        ),
        (format!("start --release {}", release.id), "--share 10,100"),
        (
            "start /nowhere/plan.json".to_owned(),
            "cannot read /nowhere/plan.json",
        ),
        ("start -".to_owned(), "standard input: no JSON"),
        (
            "show --server http://127.0.0.1:1".to_owned(),
            "http://127.0.0.1:1/ cannot be reached: ",
        ),
        (
            "show --ca /nowhere/ca.pem --server https://127.0.0.1:1".to_owned(),
            "/nowhere/ca.pem",
        ),
        ("start - --user ada".to_owned(), "--password-file"),
    ] {
        let text = caller.refused(&arguments).await;
        assert!(text.contains(why), "{arguments}: {text}");
    }
    let unknown = caller.typed("start -", r#"{"mood": 1}"#).await;
    let text = one_line(&unknown);
    assert!(
        text.contains("mood") && text.contains("(invalid_rollout)"),
        "{text}"
    );
    let robots = home.robots(1, &release, Program::Good, 0).await;
    hold(&robots, 1);
    caller
        .ok(&format!(
            "start --release {} --share 100 --override-gate test",
            release.id
        ))
        .await;
    for (arguments, why) in [
        ("skip 1 nobody", "(unknown_robot)"),
        ("retry 1 r00", "(wrong_state)"),
        ("resume 1", "(wrong_state)"),
    ] {
        let text = caller.refused(arguments).await;
        assert!(text.contains(why), "{arguments}: {text}");
    }
    home.stop().await;
    let text = caller.refused("show 1").await;
    assert!(
        text.contains("cannot be reached: ") && text.contains("does the server run?"),
        "{text}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn who_follows_a_rollout_waits_for_a_server_that_comes_back() {
    let http = ReservedPort::new();
    let mut home = Home::with(|layer| layer.http = Some(http.address())).await;
    let caller = Caller::of(&home.settings.data);
    let release = home.release(4, 60_000).await;
    let robots = home.robots(2, &release, Program::Good, 0).await;
    hold(&robots, 1);
    let begin = format!(
        "start --release {} --share 100 --soak 0 --watch --json --override-gate test",
        release.id
    );
    let following = tokio::spawn(async move { caller.typed(&begin, "").await });
    eventually("it begins", async || {
        !home.http().get("/api/v1/rollouts/1").await.json()["id"].is_null()
    })
    .await;
    home.wait_count("1", "receiving", 2).await;
    home.restart().await;
    hold(&robots, u32::MAX);
    let output = following.await.expect("no panic");
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{error}");
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let last: Value = serde_json::from_str(text.lines().last().expect("a line")).expect("JSON");
    assert_eq!(last["state"], "done");
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn people_log_in_over_tls_and_out_again() {
    let server = Fixture::closed_with(Role::Serve, |layer| layer.tls = Some(TlsMode::On)).await;
    let caller = Caller::of(&server.settings.data);
    let text = caller.refused("show").await;
    assert!(
        text.contains("(unauthenticated); --user names an account"),
        "{text}"
    );
    let file = server.settings.data.join("password");
    std::fs::write(&file, format!("{PASSWORD}\n")).expect("a file");
    let as_user =
        |user: &str, task: &str| format!("{task} --user {user} --password-file {}", file.display());
    assert_eq!(
        caller.ok(&as_user(ADMIN, "show")).await,
        "No rollouts yet.\n"
    );
    let typed = caller
        .typed(&format!("show --user {VIEWER}"), &format!("{PASSWORD}\n"))
        .await;
    assert!(typed.status.success(), "{}", one_line(&typed));
    let wrong = caller
        .typed(&format!("show --user {VIEWER}"), "not the password\n")
        .await;
    assert!(one_line(&wrong).contains("(bad_credentials)"));
    let start = as_user(VIEWER, "start --release 0000000000000000 --share 100");
    let text = caller.refused(&start).await;
    assert!(text.contains("(forbidden)"), "{text}");
    let text = caller.refused(&as_user(ADMIN, "show 1")).await;
    assert!(text.contains("(unknown_rollout)"), "{text}");
    // Its own authority is found in the data directory; elsewhere it has to be named.
    let address = server.server.http();
    let elsewhere = Caller::of(&server.settings.data.join("nowhere"));
    let url = format!(
        "show --server https://{address} --user {ADMIN} --password-file {}",
        file.display()
    );
    let text = elsewhere.refused(&url).await;
    assert!(
        text.contains("not trusted; name that with --ca") || text.contains("trusts no"),
        "{text}"
    );
    let ca = server.settings.data.join("tls/ca.pem");
    elsewhere.ok(&format!("{url} --ca {}", ca.display())).await;
    let records = crawler_records::Records::open(&server.settings.data)
        .await
        .expect("records");
    for user in [ADMIN, VIEWER] {
        let name = user.parse().expect("a name");
        let sessions = records.sessions().all(Some(&name));
        assert!(
            sessions.await.expect("sessions").is_empty(),
            "{user} is still in"
        );
    }
    records.close().await;
    server.stop().await;
}
