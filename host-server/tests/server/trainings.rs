//! Trainings over HTTP: made, watched, paused, ended, and refused; what they come to is what the library comes to.

use std::fs;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

use crate::support::closed::{OPERATOR, VIEWER};
use crate::support::{Answer, Fixture, eventually, eventually_within};
use crawler_learning::{Options, Run, Spread};
use crawler_server::config::Role;
use hyper::Method;
use serde_json::{Value, json};

const ALL: &str = "/api/v1/experiments";
/// A training gives way to whatever else wants the processor.
const PATIENCE: Duration = Duration::from_mins(10);
/// Of a training that is over.
const FILES: [&str; 4] = ["policy.tcpo", "policy", "curve.csv", "run.json"];
/// The same as the curve for `TensorBoard`, with times in it.
const EVENTS: &str = "events.out.tfevents.terracrawler";

/// Three rounds of two small worlds each.
fn short(name: &str) -> Value {
    json!({
        "kind": "training", "name": name, "seed": 5, "steps": 3 * 2 * 3 * 128, "worlds": 2, "units": 4,
        "own_critic": true, "randomisation": "mild",
    })
}

/// Nobody sees the end of this one.
fn endless(name: &str) -> Value {
    json!({
        "kind": "training", "name": name, "steps": 1_000_000 * 3 - 1, "worlds": 1, "units": 4,
    })
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

async fn act(fixture: &Fixture, id: &str, action: &str) -> Answer {
    let path = format!("{ALL}/{id}/{action}");
    fixture.call(Method::POST, &path, &[], "").await
}

async fn done(fixture: &Fixture, id: &str, action: &str, state: &str) {
    let answer = act(fixture, id, action).await;
    assert_eq!(answer.status, 200, "{action}: {}", answer.text());
    assert_eq!(answer.json()["state"], state);
}

async fn wait(fixture: &Fixture, id: &str, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
    let mut seen = Value::Null;
    eventually_within(PATIENCE, what, async || {
        seen = one(fixture, id).await;
        holds(&seen)
    })
    .await;
    seen
}

async fn wait_for(fixture: &Fixture, id: &str, state: &str) -> Value {
    wait(fixture, id, state, |seen| seen["state"] == state).await
}

fn rounds(seen: &Value) -> u64 {
    seen["done"].as_u64().expect("a number")
}

async fn file(fixture: &Fixture, id: &str, name: &str) -> Answer {
    fixture.get(&format!("{ALL}/{id}/files/{name}")).await
}

/// Where the only training of a server has its files.
fn folder(fixture: &Fixture) -> PathBuf {
    let folder = fixture.settings.data.join("trainings");
    let mut entries = fs::read_dir(folder).expect("a folder");
    let entry = entries.next().expect("a training").expect("readable");
    assert!(entries.next().is_none());
    entry.path()
}

/// What the library makes of [`short`].
fn straight(folder: &std::path::Path) {
    let options = Options {
        seed: 5,
        steps: 3 * 2 * 3 * 128,
        worlds: 2,
        units: 4,
        privileged: false,
    };
    let mut scenario = Spread::scenario().expect("there");
    scenario.randomisation = crawler_sim::world::Profile::Mild;
    let mut run = Run::open(&options, folder, scenario, NonZeroUsize::MIN).expect("options");
    while run.round().expect("a round").is_some() {}
    run.finish().expect("a policy");
}

#[tokio::test(flavor = "multi_thread")]
async fn its_policy_is_that_of_the_console() {
    let fixture = Fixture::start().await;
    let answer = fixture.post(ALL, &short("first").to_string()).await;
    assert_eq!(answer.status, 201, "{}", answer.text());
    let begun = answer.json();
    for (field, wanted) in [
        ("kind", json!("training")),
        ("scenario", json!("spread")),
        ("robots", json!(3)),
        ("seeds", json!(3)),
        ("first_seed", json!(5)),
        ("randomisation", json!("mild")),
        ("state", json!("running")),
        ("summary", json!([])),
    ] {
        assert_eq!(begun[field], wanted, "{field}");
    }
    let asked = &begun["training"];
    assert_eq!(
        (&asked["algorithm"], &asked["units"], &asked["own_critic"]),
        (&json!("ppo"), &json!(4), &json!(true))
    );
    let id = begun["id"].as_str().expect("an id");
    let seen = wait_for(&fixture, id, "completed").await;
    assert_eq!((&seen["done"], &seen["waiting"]), (&json!(3), &Value::Null));
    assert!(seen["ended_at"].as_i64() >= seen["started_at"].as_i64());

    // The files are those of the same run elsewhere, to the byte, and the score is that of the robots' policy.
    let straight_folder = fixture.settings.data.join("straight");
    straight(&straight_folder);
    let mut listed = Vec::new();
    for told in seen["training"]["files"].as_array().expect("files") {
        let name = told["name"].as_str().expect("a name");
        let answer = file(&fixture, id, name).await;
        assert_eq!(answer.status, 200, "{name}");
        assert_eq!(answer.header("content-disposition"), "attachment");
        assert_eq!(told["bytes"], answer.body.len());
        let wanted = fs::read(straight_folder.join(name)).expect("written");
        if name == EVENTS {
            // As long, whatever the times and rates: three rounds of one world end no episode.
            assert_eq!(answer.body.len(), wanted.len());
            continue;
        }
        assert_eq!(answer.body, wanted, "{name}");
        listed.push(name.to_owned());
    }
    assert_eq!(listed, FILES);
    let report = fs::read(straight_folder.join("run.json")).expect("written");
    let report: Value = serde_json::from_slice(&report).expect("JSON");
    let score = &seen["training"]["score"];
    let near = |one: &Value, other: &Value| {
        let (one, other) = (one.as_f64().expect("one"), other.as_f64().expect("other"));
        assert!((one - other).abs() < 1e-6, "{one} and {other}");
    };
    near(&score["success"], &report["int8"]["success"]);
    near(&score["floats"], &report["floats"]["success"]);
    assert_eq!(
        (&score["episodes"], &score["bytes"]),
        (&json!(300), &report["bytes"])
    );
    let summary = &seen["summary"][0];
    assert_eq!(
        (&summary["metric"], &summary["count"]),
        (&json!("success"), &json!(300))
    );
    near(&summary["mean"], &score["success"]);
    assert!(summary["low"].as_f64() <= summary["mean"].as_f64());

    // Round by round, also page by page.
    let path = format!("{ALL}/{id}/curve");
    let curve = fixture.get(&path).await.json();
    let points = curve["points"].as_array().expect("points");
    assert_eq!((points.len(), &curve["next"]), (3, &Value::Null));
    for (number, point) in points.iter().enumerate() {
        assert_eq!(point["round"], number + 1);
        assert_eq!(point["steps"], (number + 1) * 768);
        for field in [
            "entropy",
            "divergence",
            "clipped",
            "critic",
            "loss",
            "vetoes",
        ] {
            assert!(point[field].is_number(), "{field} of {point}");
        }
    }
    assert_eq!(seen["training"]["last"]["round"], 3);
    let page = fixture.get(&format!("{path}?after=1&limit=1")).await.json();
    assert_eq!(
        (&page["points"][0]["round"], &page["next"]),
        (&json!(2), &json!(2))
    );
    for (query, parameter) in [
        ("limit=0", "limit"),
        ("limit=10001", "limit"),
        ("after=-1", ""),
        ("x=1", ""),
    ] {
        let answer = fixture.get(&format!("{path}?{query}")).await;
        answer.is_problem(400, "bad_query");
        assert!(answer.text().contains(parameter));
    }

    for name in [
        "checkpoint",
        "so-far.tcpo",
        "build",
        "policy.new",
        "..",
        "..%2F..%2Frecords.db",
        "%00",
    ] {
        let answer = file(&fixture, id, name).await;
        assert_eq!(answer.status, 404, "{name}: {}", answer.text());
    }
    // What only goes on with it is gone, and the rest goes with the training.
    eventually("it is tidy", async || {
        !folder(&fixture).join("checkpoint").exists()
    })
    .await;
    let trained = folder(&fixture);
    let path = format!("{ALL}/{id}");
    assert_eq!(
        fixture.call(Method::DELETE, &path, &[], "").await.status,
        204
    );
    eventually("its files are gone", async || !trained.exists()).await;
    file(&fixture, id, "policy")
        .await
        .is_problem(404, "unknown_experiment");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn it_stands_goes_on_and_ends_as_it_is_told() {
    let fixture = Fixture::start().await;
    let mut body = endless("long");
    body["start"] = json!(false);
    let long = made(&fixture, &body).await;
    let seen = one(&fixture, &long).await;
    assert_eq!(
        (&seen["state"], &seen["training"]["last"]),
        (&json!("created"), &Value::Null)
    );
    done(&fixture, &long, "start", "running").await;
    let learns = |seen: &Value| {
        let training = &seen["training"];
        rounds(seen) > 0
            && training["steps_per_second"].is_number()
            && training["left_s"].is_number()
    };
    wait(&fixture, &long, "it learns", learns).await;
    let second = made(&fixture, &short("second")).await;
    wait(&fixture, &second, "it waits", |seen| {
        seen["waiting"] == true
    })
    .await;

    // What stands keeps what it has learned, and makes room.
    done(&fixture, &long, "pause", "paused").await;
    let stood = |seen: &Value| seen["training"]["steps_per_second"].is_null();
    let seen = wait(&fixture, &long, "it stands", stood).await;
    let kept = rounds(&seen);
    assert!(kept > 0);
    wait_for(&fixture, &second, "completed").await;
    assert_eq!(rounds(&one(&fixture, &long).await), kept, "nobody is at it");
    let names = |seen: &Value| seen["training"]["files"].clone();
    let seen = one(&fixture, &long).await;
    let wanted: Vec<_> = names(&seen)
        .as_array()
        .expect("files")
        .iter()
        .map(|file| file["name"].clone())
        .collect();
    assert_eq!(
        wanted,
        [json!("so-far.tcpo"), json!("curve.csv"), json!(EVENTS)]
    );
    let policy = file(&fixture, &long, "so-far.tcpo").await;
    assert_eq!(&policy.body[..4], b"TCPO");
    let curve = file(&fixture, &long, "curve.csv").await;
    assert_eq!(curve.header("content-type"), "text/csv; charset=utf-8");
    assert_eq!(curve.text().lines().count() as u64, kept + 1);

    done(&fixture, &long, "resume", "running").await;
    wait(&fixture, &long, "it goes on", |seen| rounds(seen) > kept).await;
    let path = format!("{ALL}/{long}");
    let busy = fixture.call(Method::DELETE, &path, &[], "").await;
    busy.is_problem(409, "wrong_state");
    done(&fixture, &long, "stop", "stopped").await;
    for wrong in ["start", "pause", "resume", "stop"] {
        act(&fixture, &long, wrong)
            .await
            .is_problem(409, "wrong_state");
    }
    let seen = wait(&fixture, &long, "it has ended", stood).await;
    assert_eq!(seen["training"]["score"], Value::Null);
    // Deleted at once: the thread may still be at its last round.
    assert_eq!(
        fixture.call(Method::DELETE, &path, &[], "").await.status,
        204
    );
    let trained = fixture.settings.data.join("trainings");
    eventually("its files are gone", async || {
        fs::read_dir(&trained).expect("a folder").count() == 1
    })
    .await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_that_stood_comes_to_the_same_as_one_that_did_not() {
    let fixture = Fixture::closed_with(Role::Serve, |layer| layer.open = Some(true)).await;
    // 40 rounds of one world.
    let body = json!({
        "kind": "training", "name": "stands", "seed": 5, "steps": 40 * 384, "worlds": 1, "units": 4,
    });
    let id = made(&fixture, &body).await;
    wait(&fixture, &id, "it learns", |seen| rounds(seen) > 2).await;
    done(&fixture, &id, "pause", "paused").await;
    let scratch = fixture.leave().await;
    let fixture = Fixture::closed_at(scratch, Role::Serve, |layer| layer.open = Some(true)).await;
    assert_eq!(one(&fixture, &id).await["state"], "paused");
    done(&fixture, &id, "resume", "running").await;
    // A server that ends in order has it stand as well.
    let scratch = fixture.leave().await;
    let fixture = Fixture::closed_at(scratch, Role::Serve, |layer| layer.open = Some(true)).await;
    wait_for(&fixture, &id, "completed").await;
    let other = made(&fixture, &body).await;
    wait_for(&fixture, &other, "completed").await;
    for name in FILES {
        let (one, other) = (
            file(&fixture, &id, name).await,
            file(&fixture, &other, name).await,
        );
        assert_eq!(
            (one.status.as_u16(), &one.body),
            (200, &other.body),
            "{name}"
        );
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_is_told_field_by_field() {
    let fixture = Fixture::closed_with(Role::Serve, |_| {}).await;
    let operator = fixture.login(OPERATOR).await.token;
    let viewer = fixture.login(VIEWER).await.token;
    let body = short("x").to_string();
    let refused = fixture.call_as(&viewer, Method::POST, ALL, &body).await;
    refused.is_problem(403, "forbidden");
    let post = async |body: Value| {
        fixture
            .call_as(&operator, Method::POST, ALL, &body.to_string())
            .await
    };
    let wrong = json!({
        "kind": "training", "name": "x".repeat(65), "algorithm": "sac", "task": ["spread"], "seed": 0.5,
        "steps": u64::MAX, "worlds": 0, "units": "64", "own_critic": 1, "randomisation": {}, "start": "now",
        "seeds": 3,
    });
    let answer = post(wrong.clone()).await;
    answer.is_problem(422, "invalid_experiment");
    let told = answer.json()["errors"].as_array().expect("errors").clone();
    let pointers: Vec<&str> = told
        .iter()
        .filter_map(|error| error["pointer"].as_str())
        .collect();
    for field in wrong
        .as_object()
        .expect("fields")
        .keys()
        .filter(|field| *field != "kind")
    {
        let pointer = format!("/{field}");
        assert!(
            pointers.contains(&pointer.as_str()),
            "{pointer} is not in {told:?}"
        );
    }
    for kind in [json!("learning"), json!(1), json!(["training"])] {
        let answer = post(json!({ "kind": kind, "name": "x" })).await;
        answer.is_problem(422, "invalid_experiment");
        assert_eq!(answer.json()["errors"][0]["pointer"], "/kind");
    }
    let answer =
        post(json!({ "kind": "training", "name": "x", "worlds": 1, "steps": 10_000_000 })).await;
    answer.is_problem(422, "invalid_experiment");
    assert_eq!(answer.json()["errors"][0]["pointer"], "/steps");
    let all = fixture.get_as(&operator, ALL).await.json();
    assert_eq!(all["experiments"], json!([]));

    // An evaluation has neither curve nor files.
    let body = json!({ "kind": "evaluation", "name": "e", "scenario": "empty", "seeds": 1, "start": false });
    let answer = post(body).await;
    assert_eq!(
        (answer.status.as_u16(), &answer.json()["kind"]),
        (201, &json!("evaluation"))
    );
    let id = answer.json()["id"].as_str().expect("an id").to_owned();
    for part in ["curve", "files/policy"] {
        let answer = fixture.get_as(&viewer, &format!("{ALL}/{id}/{part}")).await;
        answer.is_problem(404, "not_found");
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_damaged_on_the_disk_is_said() {
    let mut fixture = Fixture::closed_with(Role::Serve, |layer| layer.open = Some(true)).await;
    let id = made(&fixture, &endless("damaged")).await;
    wait(&fixture, &id, "a checkpoint", |seen| rounds(seen) > 10).await;
    done(&fixture, &id, "pause", "paused").await;
    let trained = folder(&fixture);
    for (name, damage, state, words) in [
        // What cannot be read just now may be there later.
        ("curve.csv", None, "paused", "curve.csv: "),
        ("curve.csv", Some(&b"\xff\xfe"[..]), "failed", "curve.csv: "),
    ] {
        let scratch = fixture.leave().await;
        let kept = fs::read(trained.join(name)).expect("written");
        match damage {
            None => fs::remove_file(trained.join(name)).expect("removed"),
            Some(bytes) => fs::write(trained.join(name), bytes).expect("written"),
        }
        fixture = Fixture::closed_at(scratch, Role::Serve, |layer| layer.open = Some(true)).await;
        done(&fixture, &id, "resume", "running").await;
        let seen = wait(&fixture, &id, state, |seen| {
            seen["state"] == state && !seen["reason"].is_null()
        })
        .await;
        let reason = seen["reason"].as_str().expect("a reason");
        assert!(reason.starts_with(words), "{reason}");
        let place = fixture.settings.data.to_str().expect("UTF-8");
        assert!(!reason.contains(place), "{reason}");
        fs::write(trained.join(name), kept).expect("written");
    }
    // A damaged checkpoint ends another one, and the server goes on.
    let other = made(&fixture, &endless("other")).await;
    wait(&fixture, &other, "a checkpoint", |seen| rounds(seen) > 10).await;
    done(&fixture, &other, "pause", "paused").await;
    let scratch = fixture.leave().await;
    let entries = fs::read_dir(scratch.0.join("trainings")).expect("a folder");
    for entry in entries {
        let checkpoint = entry.expect("an entry").path().join("checkpoint");
        if let Ok(mut bytes) = fs::read(&checkpoint) {
            bytes.truncate(bytes.len() / 2);
            fs::write(&checkpoint, bytes).expect("written");
        }
    }
    let fixture = Fixture::closed_at(scratch, Role::Serve, |layer| layer.open = Some(true)).await;
    done(&fixture, &other, "resume", "running").await;
    let seen = wait_for(&fixture, &other, "failed").await;
    let reason = seen["reason"].as_str().expect("a reason");
    assert!(
        reason.starts_with("its checkpoint cannot be used: "),
        "{reason}"
    );
    let last = made(&fixture, &short("goes on")).await;
    wait_for(&fixture, &last, "completed").await;
    fixture.stop().await;
}
