//! Experiments over HTTP: from a recipe to numbers, which are those of the console.

use std::sync::atomic::AtomicBool;

use crate::support::closed::{ADMIN, OPERATOR, VIEWER};
use crate::support::{Fixture, eventually};
use crawler_server::config::Role;
use crawler_sim::evaluate::{Evaluation, Job, run_all};
use crawler_sim::scenario::Scenario;
use hyper::Method;
use serde_json::{Value, json};

const ALL: &str = "/api/v1/experiments";

/// A trial takes a few milliseconds: two robots that stand about for two seconds.
fn short(name: &str, seeds: u32) -> Value {
    json!({
        "name": name, "scenario": "simple-navigation", "robots": 2, "seeds": seeds, "first_seed": 40,
        "set": ["duration_s=2.0"], "randomisation": "mild", "thresholds": ["uptime>=0.1", "reached >= 0.99"],
    })
}

/// Nobody sees the end of this one.
fn endless(name: &str) -> Value {
    json!({ "name": name, "scenario": "empty", "robots": 1, "seeds": 3, "set": ["duration_s=2419200.0"] })
}

async fn made(fixture: &Fixture, body: &Value) -> String {
    let answer = fixture.post(ALL, &body.to_string()).await;
    assert_eq!(answer.status, 201, "{}", answer.text());
    answer.json()["id"].as_str().expect("an id").to_owned()
}

async fn one(fixture: &Fixture, id: &str) -> Value {
    let answer = fixture.get(&format!("{ALL}/{id}")).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    answer.json()
}

async fn act(fixture: &Fixture, id: &str, action: &str) -> crate::support::Answer {
    fixture
        .call(Method::POST, &format!("{ALL}/{id}/{action}"), &[], "")
        .await
}

async fn delete(fixture: &Fixture, id: &str) -> crate::support::Answer {
    let path = format!("{ALL}/{id}");
    fixture.call(Method::DELETE, &path, &[], "").await
}

/// Whether two numbers are the same but for what writing and reading them takes.
fn same(one: Option<f64>, other: Option<f64>) -> bool {
    match (one, other) {
        (Some(one), Some(other)) => (one - other).abs() <= 1e-12 * one.abs().max(1.0),
        (one, other) => one == other,
    }
}

async fn wait(fixture: &Fixture, id: &str, state: &str) -> Value {
    let mut seen = Value::Null;
    eventually(state, async || {
        seen = one(fixture, id).await;
        seen["state"] == state
    })
    .await;
    seen
}

async fn trials(fixture: &Fixture, id: &str) -> Vec<Value> {
    let mut all: Vec<Value> = Vec::new();
    let mut after = String::new();
    loop {
        let path = format!("{ALL}/{id}/metrics?limit=7{after}");
        let page = fixture.get(&path).await.json();
        all.extend(page["trials"].as_array().expect("trials").iter().cloned());
        match page["next"].as_u64() {
            Some(next) => after = format!("&after={next}"),
            None => return all,
        }
    }
}

/// What the library makes of the recipe of [`short`].
fn evaluated(seeds: u64) -> Evaluation {
    let scenario = Scenario::built_in("simple-navigation").expect("there");
    let set =
        |scenario: Scenario, key: &str, value: &str| scenario.with_value(key, value).expect(key);
    let scenario = set(scenario, "robots", "2");
    let scenario = set(scenario, "randomisation", "mild");
    let scenario = set(scenario, "duration_s", "2.0");
    let jobs: Vec<_> = (40..40 + seeds)
        .map(|seed| Job {
            scenario: &scenario,
            seed,
        })
        .collect();
    let trials = run_all(&jobs, 2, &AtomicBool::new(false), &|_| {});
    let trials = trials.into_iter().flatten().collect();
    let more = ["uptime>=0.1", "reached >= 0.99"].map(|text| text.parse().expect("a threshold"));
    Evaluation::new(&scenario, trials, &more)
}

#[tokio::test(flavor = "multi_thread")]
async fn its_numbers_are_those_of_the_console() {
    let fixture = Fixture::start().await;
    let answer = fixture.post(ALL, &short("twelve", 12).to_string()).await;
    assert_eq!(answer.status, 201, "{}", answer.text());
    let begun = answer.json();
    assert_eq!(
        (&begun["state"], &begun["robots"]),
        (&json!("running"), &json!(2))
    );
    assert_eq!(begun["by"], "anonymous");
    assert_eq!(begun["verdict"], Value::Null);
    let id = begun["id"].as_str().expect("an id");
    let done = wait(&fixture, id, "completed").await;
    assert_eq!((&done["done"], &done["seeds"]), (&json!(12), &json!(12)));
    assert!(done["ended_at"].as_i64() >= done["started_at"].as_i64());

    let wanted = evaluated(12);
    let summary = done["summary"].as_array().expect("a summary");
    assert_eq!(summary.len(), wanted.lines.len());
    for (line, told) in wanted.lines.iter().zip(summary) {
        let estimate = line.estimate;
        assert_eq!(told["metric"], line.metric.name());
        for (name, wanted) in [
            ("mean", estimate.mean),
            ("low", estimate.low),
            ("high", estimate.high),
        ] {
            assert!(same(told[name].as_f64(), Some(wanted)), "{name} of {told}");
        }
        assert_eq!(told["count"], estimate.count);
    }
    let verdict = done["verdict"].as_array().expect("a verdict");
    assert_eq!(verdict.len(), wanted.verdicts.len());
    for (asked, told) in wanted.verdicts.iter().zip(verdict) {
        assert_eq!(told["threshold"], asked.threshold.to_string());
        assert_eq!(told["met"], asked.met);
        assert!(same(told["value"].as_f64(), asked.mean), "{told}");
    }

    let metrics = fixture.get(&format!("{ALL}/{id}/metrics")).await.json();
    let names: Vec<_> = metrics["metrics"]
        .as_array()
        .expect("metrics")
        .iter()
        .map(|metric| metric["name"].as_str().expect("a name"))
        .collect();
    assert_eq!(
        metrics["metrics"][0],
        json!({"name": "success", "unit": "share", "better": "more"})
    );
    let told = trials(&fixture, id).await;
    assert_eq!(told.len(), 12);
    for (number, (trial, told)) in wanted.trials.iter().zip(&told).enumerate() {
        assert_eq!(
            (&told["number"], &told["seed"]),
            (&json!(number), &json!(trial.seed))
        );
        assert_eq!(told["success"], trial.is_success());
        assert_eq!(told["reason"].is_null(), trial.is_success());
        let values = told["values"].as_array().expect("values");
        let metrics = crawler_sim::scenario::Metric::ALL.len();
        assert_eq!((values.len(), names.len()), (metrics, metrics));
        for (told, wanted) in values.iter().zip(trial.measured.values()) {
            assert!(same(told.as_f64(), *wanted), "{told} for {wanted:?}");
        }
    }

    // And by the line that it names, as a person would type it.
    let command = done["command"].as_str().expect("a command");
    let file = std::env::temp_dir().join(format!("experiment-{}.json", std::process::id()));
    let words = command.strip_prefix("terracrawler ").expect("ours");
    let line = format!("\"$0\" {words} --json \"$1\"");
    let output = std::process::Command::new("sh")
        .args(["-c", &line, env!("CARGO_BIN_EXE_terracrawler")])
        .arg(&file)
        .output()
        .expect("it runs");
    // 1: a threshold was missed.
    assert_eq!(output.status.code(), Some(1), "{command}: {output:?}");
    let text = std::fs::read_to_string(&file).expect("written");
    let _ = std::fs::remove_file(&file);
    let console: Value = serde_json::from_str(&text).expect("JSON");
    for told in summary {
        let metric = told["metric"].as_str().expect("a name");
        let mean = console["metrics"][metric]["mean"].as_f64();
        assert!(same(mean, told["mean"].as_f64()), "{metric}: {mean:?}");
    }

    let text = fixture.get("/metrics").await.text().to_owned();
    assert!(
        text.contains("terracrawler_experiments{state=\"completed\"} 1"),
        "{text}"
    );
    assert!(
        text.contains("terracrawler_experiment_trials_total{outcome="),
        "{text}"
    );
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn it_is_started_paused_resumed_and_stopped() {
    let fixture = Fixture::start().await;
    let mut body = endless("long");
    body["start"] = json!(false);
    let id = made(&fixture, &body).await;
    let told = one(&fixture, &id).await;
    assert_eq!(
        (&told["state"], &told["started_at"]),
        (&json!("created"), &Value::Null)
    );
    for wrong in ["pause", "resume"] {
        act(&fixture, &id, wrong)
            .await
            .is_problem(409, "wrong_state");
    }
    for (action, state, wrong) in [
        ("start", "running", ["start", "resume"]),
        ("pause", "paused", ["pause", "start"]),
        ("resume", "running", ["start", "resume"]),
        ("stop", "stopped", ["stop", "resume"]),
    ] {
        let answer = act(&fixture, &id, action).await;
        assert_eq!(answer.status, 200, "{action}: {}", answer.text());
        assert_eq!(answer.json()["state"], state);
        assert_eq!(one(&fixture, &id).await["state"], state);
        for wrong in wrong {
            act(&fixture, &id, wrong)
                .await
                .is_problem(409, "wrong_state");
        }
        if state == "running" {
            delete(&fixture, &id).await.is_problem(409, "wrong_state");
        }
    }
    assert_eq!(delete(&fixture, &id).await.status, 204);
    delete(&fixture, &id)
        .await
        .is_problem(404, "unknown_experiment");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn four_run_and_others_wait_for_their_turn() {
    let fixture = Fixture::start_with(|layer| layer.experiment_threads = 2.try_into().ok()).await;
    let mut ids = Vec::new();
    for number in 0..4 {
        ids.push(made(&fixture, &endless(&format!("long {number}"))).await);
    }
    let last = made(&fixture, &short("short", 3)).await;
    let told = one(&fixture, &last).await;
    assert_eq!(
        (&told["state"], &told["waiting"]),
        (&json!("running"), &json!(true))
    );
    assert_eq!(one(&fixture, &ids[0]).await.get("waiting"), None);
    // All threads are busy with what never ends; pausing makes room at once.
    for id in &ids {
        assert_eq!(act(&fixture, id, "pause").await.status, 200);
    }
    wait(&fixture, &last, "completed").await;

    let page = fixture.get(&format!("{ALL}?limit=3")).await.json();
    let of = |page: &Value| -> Vec<String> {
        let list = page["experiments"].as_array().expect("experiments");
        let id = |one: &Value| one["id"].as_str().expect("an id").to_owned();
        list.iter().map(id).collect()
    };
    assert_eq!(of(&page), [&last, &ids[3], &ids[2]].map(Clone::clone));
    let next = page["next"].as_str().expect("another page");
    let page = fixture
        .get(&format!("{ALL}?limit=3&before={next}"))
        .await
        .json();
    assert_eq!(of(&page), [&ids[1], &ids[0]].map(Clone::clone));
    assert_eq!(page["next"], Value::Null);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn it_goes_on_after_a_restart_as_if_nothing_had_been() {
    const SEEDS: u32 = 60;
    let fixture = Fixture::closed_with(Role::Serve, |_| {}).await;
    let token = fixture.login(OPERATOR).await.token;
    let body = short("lasting", SEEDS).to_string();
    let answer = fixture.call_as(&token, Method::POST, ALL, &body).await;
    assert_eq!(answer.status, 201, "{}", answer.text());
    let id = answer.json()["id"].as_str().expect("an id").to_owned();
    let path = format!("{ALL}/{id}");
    eventually("something is stored", async || {
        fixture.get_as(&token, &path).await.json()["done"].as_u64() > Some(0)
    })
    .await;
    let scratch = fixture.leave().await;

    let fixture = Fixture::closed_at(scratch, Role::Serve, |_| {}).await;
    let token = fixture.login(OPERATOR).await.token;
    let mut done = Value::Null;
    eventually("it is complete", async || {
        done = fixture.get_as(&token, &path).await.json();
        done["state"] == "completed"
    })
    .await;
    let wanted = evaluated(SEEDS.into());
    let told = done["summary"].as_array().expect("a summary");
    assert_eq!(told.len(), wanted.lines.len());
    for (told, line) in told.iter().zip(&wanted.lines) {
        assert!(
            same(told["mean"].as_f64(), Some(line.estimate.mean)),
            "{told}"
        );
    }
    let page = fixture
        .get_as(&token, &format!("{path}/metrics"))
        .await
        .json();
    let seeds: Vec<_> = page["trials"]
        .as_array()
        .expect("trials")
        .iter()
        .map(|trial| trial["seed"].as_u64().expect("a seed"))
        .collect();
    assert_eq!(seeds, (40..40 + u64::from(SEEDS)).collect::<Vec<_>>());
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_recipe_is_told_field_by_field() {
    let fixture = Fixture::start().await;
    let wrong = json!({
        "name": "x", "scenario": "nowhere", "seeds": 0, "first_seed": "one", "robots": 0,
        "difficulty": 1, "randomisation": "much", "set": vec!["a"; 33], "thresholds": ["luck>=1"],
        "start": 1, "colour": "red",
    });
    let answer = fixture.post(ALL, &wrong.to_string()).await;
    answer.is_problem(422, "invalid_experiment");
    let errors = answer.json()["errors"].as_array().expect("errors").clone();
    for field in [
        "scenario",
        "seeds",
        "first_seed",
        "robots",
        "difficulty",
        "randomisation",
        "set",
        "thresholds",
        "start",
        "colour",
    ] {
        let at = |error: &&serde_json::Value| {
            let pointer = error["pointer"].as_str().expect("a pointer");
            pointer.split('/').nth(1) == Some(field)
        };
        let named = errors.iter().find(at);
        let named = named.unwrap_or_else(|| panic!("{field} is not in {errors:?}"));
        assert!(
            named["detail"]
                .as_str()
                .is_some_and(|text| !text.is_empty())
        );
    }
    let mut body = short("x", 3);
    body["set"] = json!(["duration_s=2.0", "arena.colour=1"]);
    let answer = fixture.post(ALL, &body.to_string()).await;
    answer.is_problem(422, "invalid_experiment");
    let errors = answer.json()["errors"].clone();
    assert_eq!(errors.as_array().map(Vec::len), Some(1), "{errors}");
    assert!(
        errors[0]["detail"]
            .as_str()
            .expect("why")
            .contains("arena.colour")
    );
    for (body, status, code) in [
        ("[]", 422, "invalid_body"),
        ("{", 400, "malformed"),
        (
            &*format!("{{\"name\":\"{}\"}}", "x".repeat(5_000)),
            413,
            "too_large",
        ),
    ] {
        fixture.post(ALL, body).await.is_problem(status, code);
    }
    assert_eq!(fixture.get(ALL).await.json()["experiments"], json!([]));
    for id in ["1", "0", "-1", "+1", "x", "99999999999999999999"] {
        fixture
            .get(&format!("{ALL}/{id}"))
            .await
            .is_problem(404, "unknown_experiment");
        act(&fixture, id, "start")
            .await
            .is_problem(404, "unknown_experiment");
    }
    for query in ["limit=0", "limit=201", "before=x", "colour=red"] {
        fixture
            .get(&format!("{ALL}?{query}"))
            .await
            .is_problem(400, "bad_query");
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn viewers_look_and_operators_act_and_both_are_known() {
    let fixture = Fixture::closed().await;
    let viewer = fixture.login(VIEWER).await.token;
    let operator = fixture.login(OPERATOR).await.token;
    let body = endless("shared").to_string();
    fixture
        .call_as(&viewer, Method::POST, ALL, &body)
        .await
        .is_problem(403, "forbidden");
    let answer = fixture.call_as(&operator, Method::POST, ALL, &body).await;
    assert_eq!(answer.status, 201, "{}", answer.text());
    let id = answer.json()["id"].as_str().expect("an id").to_owned();
    assert_eq!(answer.json()["by"], OPERATOR);
    let path = format!("{ALL}/{id}");
    assert_eq!(fixture.get_as(&viewer, &path).await.status, 200);
    let metrics = fixture.get_as(&viewer, &format!("{path}/metrics")).await;
    assert_eq!(metrics.json()["trials"], json!([]));
    for action in ["start", "pause", "resume", "stop"] {
        fixture
            .call_as(&viewer, Method::POST, &format!("{path}/{action}"), "")
            .await
            .is_problem(403, "forbidden");
    }
    fixture
        .call_as(&viewer, Method::DELETE, &path, "")
        .await
        .is_problem(403, "forbidden");
    let stopped = fixture
        .call_as(&operator, Method::POST, &format!("{path}/stop"), "")
        .await;
    assert_eq!(stopped.json()["state"], "stopped");
    let admin = fixture.login(ADMIN).await.token;
    let entries = fixture.audit(&admin).await;
    for action in ["experiment.create", "experiment.stop"] {
        let entry = entries.iter().find(|entry| entry["action"] == action);
        let entry = entry.unwrap_or_else(|| panic!("{action} is not in the audit log"));
        assert_eq!(
            (&entry["who"], &entry["target"]),
            (&json!(OPERATOR), &json!(id))
        );
        assert_eq!(entry["outcome"], "ok");
    }
    fixture.stop().await;
}
