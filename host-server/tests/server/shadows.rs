//! Policies that are compared with the one that drives, on simulated robots that take releases from this server.

use crate::support::closed::{OPERATOR, VIEWER};
use crate::support::{Fixture, Scratch, eventually};
use crawler_release::{Kind, Requires};
use crawler_server::config::Role;
use crawler_updates::release::{SecretKey, SignOptions, join};
use hyper::Method;
use serde_json::{Value, json};

/// The policy that is shipped.
const SPREAD: &[u8] = include_bytes!(concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../firmware/app/policies/spread.tcpo"
));
const POLICY: &str = "/api/v1/policies/candidate";
const ROBOTS: [&str; 2] = ["sim-0001", "sim-0002"];

async fn robot(fixture: &Fixture, id: &str) -> Value {
    fixture.get(&format!("/api/v1/robots/{id}")).await.json()
}

/// Sends a command to each, and waits until it is completed.
async fn tell(fixture: &Fixture, command: &Value) {
    for id in ROBOTS {
        let path = format!("/api/v1/robots/{id}/commands");
        let sent = fixture.post(&path, &command.to_string()).await;
        assert_eq!(sent.status, 202, "{}", sent.text());
        let id = sent.json()["id"].as_str().expect("an id").to_owned();
        is_completed(fixture, &id).await;
    }
}

async fn is_completed(fixture: &Fixture, id: &str) {
    eventually("completed", async || {
        let path = format!("/api/v1/commands/{id}");
        fixture.get(&path).await.json()["status"] == "completed"
    })
    .await;
}

async fn shadow(fixture: &Fixture, body: &Value) -> Vec<Value> {
    let path = format!("{POLICY}/shadow");
    let sent = fixture.post(&path, &body.to_string()).await;
    assert_eq!(sent.status, 202, "{}", sent.text());
    let sent = sent.json()["sent"].as_array().expect("commands").clone();
    for one in &sent {
        is_completed(fixture, one["command"].as_str().expect("an id")).await;
    }
    sent
}

fn decisions(comparison: &Value) -> u64 {
    comparison["decisions"].as_u64().unwrap_or(0)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_candidate_is_compared_on_simulated_robots_before_it_drives() {
    let key = SecretKey::generate().expect("random numbers");
    let folder = Scratch::new();
    std::fs::create_dir_all(&folder.0).expect("a folder");
    let public = folder.0.join("public.pem");
    std::fs::write(&public, key.public_pem()).expect("written");
    let fixture = Fixture::up("empty", |layer| {
        layer.robots = Some(2);
        layer.release_key = public.display().to_string().parse().ok();
    })
    .await;
    for id in ROBOTS {
        fixture.wait_told(id).await;
    }
    tell(&fixture, &json!({"command": "stop"})).await;

    // The network of the one that is shipped, under another name: it is to agree with itself.
    let options = SignOptions {
        kind: Kind::Policy,
        name: Some("candidate"),
        board: "sim",
        chip: None,
        version: "1",
        build: None,
        sequence: 1,
        floor: 0,
        expires: None,
        requires: Requires::default(),
    };
    let envelope = options.sign(SPREAD, &key).expect("signed");
    let file = join(&envelope, SPREAD).expect("a release");
    let binary = ("content-type", "application/octet-stream");
    let added = fixture
        .call(Method::POST, "/api/v1/releases", &[binary], &file[..])
        .await;
    assert_eq!(added.status, 201, "{}", added.text());
    let ask = async |body: &Value| {
        fixture
            .post(&format!("{POLICY}/shadow"), &body.to_string())
            .await
    };
    let early = ask(&json!({"robots": ["sim-0001", "sim-0001", "nobody", "NO NAME"]})).await;
    early.is_problem(422, "invalid_shadow");
    let errors = early.json()["errors"].as_array().expect("errors").clone();
    let told: Vec<_> = errors
        .iter()
        .map(|error| (error["pointer"].clone(), error["detail"].clone()))
        .collect();
    let nobody = json!("is known to nobody");
    assert_eq!(
        told,
        [
            (json!("/robots/0"), json!("does not have the policy")),
            (json!("/robots/1"), json!("is named twice")),
            (json!("/robots/2"), nobody.clone()),
            (json!("/robots/3"), nobody),
        ]
    );
    // As a deployment, but that robots which are busy are asked again soon.
    let release = added.json()["id"].clone();
    let plan = json!({
        "releases": [{"release": release}], "override_gate": "robots of a test",
        "phases": [{"select": {"group": ROBOTS}, "soak_s": 0}],
        "retries": {"pause_s": 1, "deferred_s": 1},
    });
    let begun = fixture.post("/api/v1/rollouts", &plan.to_string()).await;
    assert_eq!(begun.status, 201, "{}", begun.text());
    let rollout = begun.json()["id"].as_str().expect("an id").to_owned();
    eventually("done", async || {
        let path = format!("/api/v1/rollouts/{rollout}");
        fixture.get(&path).await.json()["state"] == "done"
    })
    .await;
    eventually("both tell that they have it", async || {
        let one = fixture.get(POLICY).await.json();
        one["robots"].as_array().map_or(0, Vec::len) == 2
    })
    .await;

    let sent = shadow(&fixture, &json!({ "robots": ROBOTS })).await;
    let to: Vec<_> = sent.iter().map(|one| one["robot"].clone()).collect();
    assert_eq!(to, ROBOTS);
    for id in ROBOTS {
        eventually("what stands has decided nothing", async || {
            let told = robot(&fixture, id).await["shadow"].clone();
            told["policy"] == "candidate" && decisions(&told) == 0 && told["agreement"].is_null()
        })
        .await;
        assert_ne!(
            robot(&fixture, id).await["state"],
            "MOVING",
            "nothing moves by it"
        );
    }
    let drive = |policy: &str| json!({"command": "behave", "parameters": {"behaviour": "policy", "policy": policy}});
    tell(&fixture, &drive("spread")).await;
    eventually("a hundred decisions of both", async || {
        let one = fixture.get(POLICY).await.json();
        decisions(&one["shadows"][0]) >= 100
    })
    .await;
    let one = fixture.get(POLICY).await.json();
    let sums = one["shadows"].as_array().expect("sums").clone();
    assert_eq!(sums.len(), 1, "{one}");
    let sum = &sums[0];
    assert_eq!(sum["build"], one["builds"][0]["build"], "{one}");
    assert_eq!(
        (&sum["robots"], &sum["agreed"]),
        (&json!(2), &sum["decisions"])
    );
    assert_eq!(sum["vetoes"], sum["driving_vetoes"], "{sum}");
    let agreement = &sum["agreement"];
    assert_eq!(
        (&agreement["share"], &agreement["high"]),
        (&json!(1.0), &json!(1.0))
    );
    let low = agreement["low"].as_f64().expect("a number");
    assert!(low > 0.96 && low < 1.0, "{agreement}");
    for id in ROBOTS {
        let told = robot(&fixture, id).await["shadow"].clone();
        assert!(
            decisions(&told) > 0 && told["agreed"] == told["decisions"],
            "{told}"
        );
    }

    // The candidate drives, and the shipped one is the candidate: that begins at 0.
    let other = json!({"robots": ["sim-0001"]}).to_string();
    let sent = fixture.post("/api/v1/policies/spread/shadow", &other).await;
    assert_eq!(sent.status, 202, "{}", sent.text());
    tell(&fixture, &drive("candidate")).await;
    eventually("the shipped one is compared", async || {
        let told = robot(&fixture, "sim-0001").await["shadow"].clone();
        told["policy"] == "spread" && decisions(&told) > 10 && told["agreed"] == told["decisions"]
    })
    .await;
    // On the other robot the candidate drives, beside which there is nobody.
    let before = robot(&fixture, "sim-0002").await["shadow"].clone();
    let spread = fixture.get("/api/v1/policies/spread").await.json();
    assert_eq!(
        (
            &spread["shadows"][0]["build"],
            &spread["shadows"][0]["robots"]
        ),
        (&Value::Null, &json!(1))
    );
    shadow(&fixture, &json!({"robots": ROBOTS, "end": true})).await;
    for id in ROBOTS {
        eventually("it has ended", async || {
            robot(&fixture, id).await["shadow"].is_null()
        })
        .await;
    }
    assert_eq!(before["policy"], "candidate", "{before}");
    let audit = fixture.get("/api/v1/audit?limit=1000").await.json();
    let entries = audit["entries"].as_array().expect("entries").clone();
    let written = entries
        .iter()
        .filter(|one| one["action"] == "policy.shadow");
    assert_eq!(written.count(), 3);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_asks_for_a_comparison_is_told_what_is_wrong() {
    let fixture = Fixture::closed_with(Role::Serve, |_| {}).await;
    let viewer = fixture.login(VIEWER).await.token;
    let operator = fixture.login(OPERATOR).await.token;
    let ask = async |token: &str, name: &str, body: Value| {
        let path = format!("/api/v1/policies/{name}/shadow");
        let body = body.to_string();
        fixture.call_as(token, Method::POST, &path, &body).await
    };
    let nobody = json!({"robots": ["nobody"]});
    let refused = ask(&viewer, "spread", nobody.clone()).await;
    refused.is_problem(403, "forbidden");
    for name in ["candidate", "NO%20NAME", "..%2F.."] {
        let refused = ask(&operator, name, nobody.clone()).await;
        refused.is_problem(404, "unknown_policy");
    }
    for (body, code) in [
        (json!({}), "invalid_body"),
        (json!({"robots": "nobody"}), "invalid_body"),
        (json!({"robots": ["nobody"], "end": 1}), "invalid_body"),
        (json!({"robots": ["nobody"], "drive": true}), "invalid_body"),
        (json!({"robots": []}), "invalid_shadow"),
        (json!({"robots": vec!["a"; 1_001]}), "invalid_shadow"),
        (nobody, "invalid_shadow"),
    ] {
        let refused = ask(&operator, "spread", body).await;
        refused.is_problem(422, code);
    }
    fixture.stop().await;
}
