//! Rollouts on a whole server, with its own broker, and robots that are MQTT clients.

mod commands;
mod models;
mod robot;

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::support::port::ReservedPort;
use crate::support::{Fixture, Scratch, eventually, settings};
use crawler_records::{NewRelease, Records};
use crawler_release::{Kind, Requires};
use crawler_server::config::{Layer, Settings};
use crawler_server::server::Server;
use crawler_updates::release::{SecretKey, SignOptions};
use robot::{Program, Release, Robot};
use serde_json::{Value, json};

/// A server that can be stopped and comes back, and the port of its broker.
struct Home {
    fixture: Option<Fixture>,
    settings: Settings,
    port: ReservedPort,
    _scratch: Scratch,
}

impl Home {
    async fn new() -> Self {
        Self::with(|_| {}).await
    }

    /// One with other options.
    async fn with(change: impl FnOnce(&mut Layer)) -> Self {
        let scratch = Scratch::new();
        let port = ReservedPort::new();
        let settings = settings(&scratch, |layer| {
            layer.mqtt = Some(port.address());
            change(layer);
        });
        let mut home = Self {
            fixture: None,
            settings,
            port,
            _scratch: scratch,
        };
        home.start().await;
        home
    }

    async fn start(&mut self) {
        let server = Server::start(&self.settings).await;
        let server = server.expect("the server starts");
        self.fixture = Some(Fixture::of(server, self.settings.clone()));
    }

    /// The server and its broker end; what they were at is found by those that come after them.
    async fn restart(&mut self) {
        self.stop().await;
        self.start().await;
    }

    async fn stop(&mut self) {
        let fixture = self.fixture.take().expect("a server");
        fixture.stop().await;
    }

    fn http(&self) -> &Fixture {
        self.fixture.as_ref().expect("a server")
    }

    /// Keeps a release of an image of so many bytes.
    async fn release(&self, sequence: u32, bytes: usize) -> Release {
        self.release_of(None, sequence, bytes).await
    }

    /// Keeps a release of a model, or of a program.
    async fn release_of(
        &self,
        model: Option<&'static str>,
        sequence: u32,
        bytes: usize,
    ) -> Release {
        let kind = model.map_or(Kind::Program, |_| Kind::Model);
        self.release_by_kind(kind, model, sequence, bytes).await
    }

    /// The same of a kind.
    async fn release_by_kind(
        &self,
        kind: Kind,
        model: Option<&'static str>,
        sequence: u32,
        bytes: usize,
    ) -> Release {
        let image: Vec<u8> = (0..bytes).map(|n| (n * 31 % 251) as u8).collect();
        let build = format!("{}-{sequence}", model.unwrap_or("build"));
        let options = SignOptions {
            kind,
            name: model,
            board: "virt",
            chip: None,
            version: "0.4.0",
            build: Some(&build),
            sequence,
            floor: 0,
            expires: None,
            requires: Requires::default(),
        };
        let key = SecretKey::generate().expect("random numbers");
        let envelope = options.sign(&image, &key).expect("signed");
        let new = NewRelease::of(&envelope, &image, "ada", 1).expect("an envelope");
        let id = new.id.clone();
        let records = Records::open(&self.settings.data).await.expect("records");
        records.releases().add(new).await.expect("kept");
        records.close().await;
        Release {
            id,
            build,
            model,
            image: Arc::new(image),
        }
    }

    /// Robots that are there.
    async fn robots(
        &self,
        count: usize,
        release: &Release,
        program: Program,
        loss: u32,
    ) -> Vec<Robot> {
        let id = |n| format!("r{n:02}");
        let robots = (0..count)
            .map(|n| Robot::start(self.port.port(), &id(n), release.clone(), program, loss))
            .collect();
        for n in 0..count {
            self.http().wait_told(&id(n)).await;
        }
        robots
    }

    async fn begin(&self, plan: &Value) -> String {
        let begun = self
            .http()
            .post("/api/v1/rollouts", &plan.to_string())
            .await;
        assert_eq!(begun.status, 201, "{}", begun.text());
        begun.json()["id"].as_str().expect("an id").to_owned()
    }

    async fn rollout(&self, id: &str) -> Value {
        self.http()
            .get(&format!("/api/v1/rollouts/{id}"))
            .await
            .json()
    }

    async fn act(&self, path: &str) -> Value {
        let done = self
            .http()
            .post(&format!("/api/v1/rollouts/{path}"), "")
            .await;
        assert_eq!(done.status, 200, "{}", done.text());
        done.json()
    }

    async fn wait_state(&self, id: &str, state: &str) {
        eventually(state, async || self.rollout(id).await["state"] == state).await;
    }

    async fn wait_count(&self, id: &str, state: &str, at_least: u64) {
        eventually(state, async || {
            let counts = &self.rollout(id).await["counts"]["robots"];
            counts[state].as_u64().unwrap_or(0) >= at_least
        })
        .await;
    }

    async fn rows(&self, id: &str) -> Vec<Value> {
        let path = format!("/api/v1/rollouts/{id}/robots");
        let rows = self.http().get(&path).await.json();
        rows["robots"].as_array().expect("robots").clone()
    }

    async fn audit(&self) -> Vec<Value> {
        let page = self.http().get("/api/v1/audit?limit=1000").await.json();
        page["entries"].as_array().expect("entries").clone()
    }

    async fn metric(&self, name: &str) -> f64 {
        let answer = self.http().get("/metrics").await;
        let line = answer
            .text()
            .lines()
            .find_map(|line| line.strip_prefix(name));
        line.unwrap_or_else(|| panic!("no {name}"))
            .trim()
            .parse()
            .expect("a number")
    }
}

/// Robots ask for no more once they have got so many chunks.
fn hold(robots: &[Robot], chunks: u32) {
    for robot in robots {
        robot.enough.store(chunks, Ordering::Relaxed);
    }
}

/// Phases by share, none of which is watched for long.
fn plan(release: &Release, shares: &[u8], limits: &Value) -> Value {
    let phases: Vec<_> = shares
        .iter()
        .map(|share| json!({"select": {"share": share}, "soak_s": 0}))
        .collect();
    json!({"releases": [{"release": release.id}], "phases": phases, "limits": limits,
        "retries": {"pause_s": 1, "deferred_s": 1}, "override_gate": OVERRIDE})
}

/// What robots of these tests get was tried on nothing.
const OVERRIDE: &str = "robots of a test";

#[tokio::test(flavor = "multi_thread")]
async fn a_good_release_reaches_every_robot_over_a_bad_radio() {
    let mut home = Home::new().await;
    let release = home.release(4, 70_000).await;
    let robots = home.robots(5, &release, Program::Good, 9).await;
    let id = home
        .begin(&plan(&release, &[20, 100], &json!({"parallel": 3})))
        .await;
    home.wait_state(&id, "done").await;
    let rows = home.rows(&id).await;
    assert_eq!(rows.len(), 5);
    for row in &rows {
        assert_eq!(row["state"], "confirmed", "{row}");
        assert_eq!(
            (&row["received"], &row["bytes"]),
            (&json!(70_000), &json!(70_000))
        );
    }
    let first = rows.iter().filter(|row| row["phase"] == 1).count();
    assert_eq!(first, 1, "{rows:?}");
    // 69 chunks and one of the manifest, and each ninth again: no robot got twice what it asked for once.
    for robot in &robots {
        let chunks = robot.chunks.load(Ordering::Relaxed);
        let asked = robot.asked.load(Ordering::Relaxed);
        assert!((78..=asked).contains(&chunks), "{chunks} of {asked}");
    }
    assert!(home.metric("terracrawler_updates_chunks_total").await >= 350.0);
    assert!(home.metric("terracrawler_updates_reports_total").await >= 50.0);
    let view = home.rollout(&id).await;
    let log: Vec<_> = view["log"]
        .as_array()
        .expect("a log")
        .iter()
        .map(|line| &line["what"])
        .collect();
    assert_eq!(
        log,
        [
            "started",
            "phase_began",
            "phase_passed",
            "phase_began",
            "phase_passed",
            "done"
        ]
    );
    let audit = home.audit().await;
    let confirmed: usize = audit
        .iter()
        .filter(|line| line["action"] == "rollout.robots" && line["detail"]["state"] == "confirmed")
        .map(|line| line["detail"]["robots"].as_array().map_or(0, Vec::len))
        .sum();
    assert_eq!(confirmed, 5);
    for action in [
        "rollout.create",
        "rollout.override_gate",
        "rollout.started",
        "rollout.done",
    ] {
        let count = audit.iter().filter(|line| line["action"] == action).count();
        assert_eq!(count, 1, "{action}");
    }
    // Nothing says that it passed anything, and who has sent it out all the same is kept, with the reason.
    let overridden = json!({"why": OVERRIDE, "releases": [release.id]});
    assert_eq!(view["plan"]["override_gate"], overridden);
    let line = audit
        .iter()
        .find(|line| line["action"] == "rollout.override_gate");
    let line = line.expect("a line");
    assert_eq!(
        (&line["who"], &line["target"], &line["detail"]),
        (&view["by"], &json!(id), &overridden)
    );
    let events = home.http().get("/api/v1/events").await.text().to_owned();
    let told = format!("without a gate that has passed; anonymous says: {OVERRIDE}");
    assert!(events.contains(&told), "{events}");
    // The session is given up when there is nothing to do.
    eventually("no session", async || {
        home.metric("terracrawler_updates_connected").await == 0.0
    })
    .await;
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bad_release_stops_itself_in_its_first_phase() {
    let mut home = Home::new().await;
    let release = home.release(4, 20_000).await;
    let _robots = home.robots(10, &release, Program::Panics, 0).await;
    let id = home
        .begin(&plan(&release, &[40, 100], &json!({"parallel": 1})))
        .await;
    home.wait_state(&id, "paused").await;
    let view = home.rollout(&id).await;
    assert_eq!(
        (&view["reason"], &view["phase"]),
        (&json!("failures"), &json!(1))
    );
    let rows = home.rows(&id).await;
    let failed: Vec<_> = rows
        .iter()
        .filter(|row| row["state"] == "rolled_back")
        .collect();
    assert_eq!(failed.len(), 2, "{rows:?}");
    assert!(
        failed
            .iter()
            .all(|row| row["reason"] == json!({"told": "panic"}))
    );
    assert_eq!(rows.iter().filter(|row| row["offers"] != 0).count(), 2);
    // Step by step, and why it ended so.
    let name = failed[0]["robot"].as_str().expect("a name");
    let path = |robot: &str| format!("/api/v1/rollouts/{id}/robots/{robot}");
    let one = home.http().get(&path(name)).await.json();
    assert_eq!(one["state"], "rolled_back");
    let log = one["log"].as_array().expect("a log");
    let states: Vec<_> = log.iter().map(|line| &line["state"]).collect();
    assert_eq!(
        (states.first(), states.last()),
        (Some(&&json!("offered")), Some(&&json!("rolled_back"))),
        "{log:?}"
    );
    assert!(states.contains(&&json!("staged")), "{log:?}");
    assert_eq!(
        log.last().map(|line| &line["reason"]),
        Some(&json!({"told": "panic"}))
    );
    let nobody = home.http().get(&path("nobody")).await;
    nobody.is_problem(404, "unknown_robot");
    for robot in ["r00", "r09"] {
        let runs = home
            .http()
            .get(&format!("/api/v1/robots/{robot}"))
            .await
            .json();
        assert_eq!(runs["build"], "old");
    }
    // A person has the last word.
    let aborted = home.act(&format!("{id}/abort")).await;
    assert_eq!(aborted["state"], "aborted");
    let again = home
        .http()
        .post(&format!("/api/v1/rollouts/{id}/resume"), "")
        .await;
    again.is_problem(409, "wrong_state");
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_goes_on_when_server_and_broker_come_back() {
    let mut home = Home::new().await;
    let release = home.release(4, 100_000).await;
    let robots = home.robots(3, &release, Program::Good, 0).await;
    hold(&robots, 1);
    let limits = json!({"bytes_per_second": 100_000});
    let id = home.begin(&plan(&release, &[100], &limits)).await;
    let got = |robot: &Robot| robot.chunks.load(Ordering::Relaxed);
    // They wait there, of the 99 chunks that each of them needs.
    for chunks in [1, 30, 60, 80] {
        hold(&robots, chunks);
        eventually("more chunks", async || {
            robots.iter().all(|robot| got(robot) >= chunks)
        })
        .await;
        home.restart().await;
    }
    hold(&robots, u32::MAX);
    home.wait_state(&id, "done").await;
    let rows = home.rows(&id).await;
    assert!(
        rows.iter().all(|row| row["state"] == "confirmed"),
        "{rows:?}"
    );
    let view = home.rollout(&id).await;
    let log = view["log"].as_array().expect("a log").clone();
    let count = |what: &str| log.iter().filter(|line| line["what"] == what).count();
    assert_eq!(
        (count("started"), count("taken_over"), count("done")),
        (1, 4, 1),
        "{log:?}"
    );
    // What was asked for is sent once, and nothing else: 98 chunks and a manifest for each, at least.
    for robot in &robots {
        let asked = robot.asked.load(Ordering::Relaxed);
        assert!(
            (99..=asked).contains(&got(robot)),
            "{} of {asked}",
            got(robot)
        );
    }
    let lines = home.http().get("/api/v1/audit/verify").await.json();
    assert_eq!(lines["intact"], true, "{lines}");
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn people_pause_leave_out_and_go_on() {
    let mut home = Home::new().await;
    let release = home.release(4, 60_000).await;
    let robots = home.robots(4, &release, Program::Good, 0).await;
    hold(&robots, 1);
    let limits = json!({"parallel": 1});
    let id = home.begin(&plan(&release, &[100], &limits)).await;
    home.wait_count(&id, "receiving", 1).await;
    let paused = home.act(&format!("{id}/pause")).await;
    assert_eq!(
        (&paused["state"], &paused["reason"]),
        (&json!("paused"), &json!("person"))
    );
    // Who was at it gives it up, and says so.
    eventually("given up", async || {
        let rows = home.rows(&id).await;
        rows.iter()
            .filter(|row| row["state"] == "deferred" || row["state"] == "waiting")
            .count()
            == 4
    })
    .await;
    home.act(&format!("{id}/robots/r03/skip")).await;
    let unknown = home
        .http()
        .post(&format!("/api/v1/rollouts/{id}/robots/x/skip"), "")
        .await;
    unknown.is_problem(404, "unknown_robot");
    let nothing = home
        .http()
        .post(&format!("/api/v1/rollouts/{id}/robots/r00/retry"), "")
        .await;
    nothing.is_problem(409, "wrong_state");
    home.act(&format!("{id}/robots/r03/retry")).await;
    home.act(&format!("{id}/robots/r03/skip")).await;
    hold(&robots, u32::MAX);
    home.act(&format!("{id}/resume")).await;
    home.wait_state(&id, "done").await;
    let rows = home.rows(&id).await;
    let skipped: Vec<_> = rows
        .iter()
        .filter(|row| row["state"] == "skipped")
        .collect();
    assert_eq!(skipped.len(), 1);
    assert_eq!(skipped[0]["robot"], "r03");
    let path = format!("/api/v1/rollouts/{id}/robots?state=confirmed&limit=2");
    let page = home.http().get(&path).await.json();
    assert_eq!(page["next"], "r01");
    // A page that is full to the brim may be the last one.
    let full = format!("/api/v1/rollouts/{id}/robots?state=confirmed&limit=1");
    for path in [path, full] {
        let page = home.http().get(&format!("{path}&after=r01")).await.json();
        assert_eq!(
            (page["robots"].as_array().map(Vec::len), &page["next"]),
            (Some(1), &Value::Null)
        );
    }
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_release_that_is_withdrawn_goes_no_further() {
    let mut home = Home::new().await;
    let release = home.release(4, 60_000).await;
    let robots = home.robots(2, &release, Program::Good, 0).await;
    hold(&robots, 1);
    let id = home
        .begin(&plan(&release, &[100], &json!({"parallel": 1})))
        .await;
    home.wait_count(&id, "receiving", 1).await;
    let path = format!("/api/v1/releases/{}/withdraw", release.id);
    let withdrawn = home.http().post(&path, r#"{"reason": "it is bad"}"#).await;
    assert_eq!(withdrawn.status, 200, "{}", withdrawn.text());
    let stands = home.rollout(&id).await;
    assert_eq!(stands["state"], "paused", "{stands}");
    // It can be ended, and not go on.
    for path in ["resume", "robots/r00/retry"] {
        let path = format!("/api/v1/rollouts/{id}/{path}");
        let refused = home.http().post(&path, "").await;
        refused.is_problem(422, "invalid_rollout");
    }
    let paused = |line: &&Value| line["action"] == "rollout.pause";
    let audit = home.audit().await;
    let line = audit.iter().find(paused).expect("a line");
    assert_eq!(line["detail"]["release"], release.id.as_str(), "{line}");
    assert_eq!(home.act(&format!("{id}/abort")).await["state"], "aborted");
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_newer_rollout_takes_the_robots_of_an_older_one() {
    let mut home = Home::new().await;
    let old = home.release(4, 90_000).await;
    let new = home.release(5, 30_000).await;
    // There is nobody yet.
    let none = home
        .http()
        .post(
            "/api/v1/rollouts",
            &plan(&old, &[100], &json!({})).to_string(),
        )
        .await;
    none.is_problem(422, "invalid_rollout");
    // They take the old one, and answer nothing to an offer of the new one.
    let robots = home.robots(2, &old, Program::Good, 0).await;
    hold(&robots, 1);
    let first = home.begin(&plan(&old, &[100], &json!({}))).await;
    home.wait_count(&first, "receiving", 2).await;
    home.act(&format!("{first}/pause")).await;
    let second = home
        .begin(&plan(&new, &[100], &json!({"parallel": 1})))
        .await;
    home.act(&format!("{second}/pause")).await;
    let rows = home.rows(&first).await;
    assert!(
        rows.iter().all(|row| row["state"] == "superseded"),
        "{rows:?}"
    );
    home.act(&format!("{first}/resume")).await;
    home.wait_state(&first, "done").await;
    // What was released before 5 goes out no more, but 5 itself may.
    let third = home
        .http()
        .post(
            "/api/v1/rollouts",
            &plan(&old, &[100], &json!({})).to_string(),
        )
        .await;
    third.is_problem(422, "invalid_rollout");
    let detail = third.json()["detail"].to_string();
    assert!(detail.contains("at least 6"), "{detail}");
    home.act(&format!("{second}/abort")).await;
    let listed = home.http().get("/api/v1/rollouts?limit=1").await.json();
    assert_eq!(listed["rollouts"][0]["id"], second);
    assert_eq!(listed["next"], second);
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_plan_is_refused_with_the_reason() {
    let mut home = Home::new().await;
    let release = home.release(4, 5_000).await;
    let good = plan(&release, &[100], &json!({}));
    let with = |change: &dyn Fn(&mut Value)| {
        let mut plan = good.clone();
        change(&mut plan);
        plan.to_string()
    };
    let cases: [(&str, String); 10] = [
        ("no phase selects", with(&|_| {})),
        (
            "there is no release",
            with(&|plan| plan["releases"][0]["release"] = json!("0123456789abcdef")),
        ),
        (
            "the name is empty",
            with(&|plan| plan["releases"][0]["release"] = json!("")),
        ),
        (
            "unknown field `mood`",
            with(&|plan| plan["mood"] = json!(1)),
        ),
        (
            "override_gate: a reason",
            with(&|plan| plan["override_gate"] = json!(" ")),
        ),
        (
            "invalid type",
            with(&|plan| plan["override_gate"] = json!(true)),
        ),
        (
            "missing field `phases`",
            json!({"releases": []}).to_string(),
        ),
        (
            "releases: at least one",
            with(&|plan| plan["releases"] = json!([])),
        ),
        (
            "limits.parallel",
            with(&|plan| plan["limits"]["parallel"] = json!(0)),
        ),
        (
            "adds no robot",
            with(&|plan| {
                plan["phases"] = json!([{"select": {"share": 50}}, {"select": {"share": 50}}]);
            }),
        ),
    ];
    for (text, body) in cases {
        let refused = home.http().post("/api/v1/rollouts", &body).await;
        refused.is_problem(422, "invalid_rollout");
        let detail = refused.json()["detail"].to_string();
        assert!(detail.contains(text), "{text}: {detail}");
    }
    home.http()
        .post("/api/v1/rollouts", "[")
        .await
        .is_problem(400, "malformed");
    for path in ["7", "x", "7/robots"] {
        let none = home.http().get(&format!("/api/v1/rollouts/{path}")).await;
        none.is_problem(404, "unknown_rollout");
    }
    home.http()
        .post("/api/v1/rollouts/7/pause", "")
        .await
        .is_problem(404, "unknown_rollout");
    for query in ["?limit=0", "?limit=51", "?before=x", "?mood=1"] {
        home.http()
            .get(&format!("/api/v1/rollouts{query}"))
            .await
            .is_problem(400, "bad_query");
    }
    for query in ["?limit=1001", "?state=flying", "?after=Not%20one"] {
        home.http()
            .get(&format!("/api/v1/rollouts/1/robots{query}"))
            .await
            .is_problem(400, "bad_query");
    }
    home.stop().await;
}
