//! Releases over the API: only genuine ones get in, everybody sees them, and one that was withdrawn stays away.

use crate::support::closed::{ADMIN, OPERATOR, VIEWER};
use crate::support::{Answer, Fixture, Scratch, eventually};
use crawler_release::{Kind, Requires};
use crawler_server::config::{KeyFiles, RequireGate, Role};
use crawler_updates::gate::{
    Bound, Digest, Estimate, Evaluated, Evaluator, GATE_FORMAT, GATE_MAX, GateReport, Threshold,
    sign,
};
use crawler_updates::release::{FILE_MAX, SecretKey, SignOptions, join};
use hyper::Method;
use serde_json::{Value, json};

const RELEASES: &str = "/api/v1/releases";
const FILE: (&str, &str) = ("content-type", "application/octet-stream");

/// A pair of keys, the public one in a file.
struct Signer {
    key: SecretKey,
    folder: Scratch,
}

impl Signer {
    fn new() -> Self {
        let key = SecretKey::generate().expect("random numbers");
        let folder = Scratch::new();
        std::fs::create_dir_all(&folder.0).expect("a folder");
        std::fs::write(folder.0.join("public.pem"), key.public_pem()).expect("written");
        Self { key, folder }
    }

    fn keys(&self) -> Option<KeyFiles> {
        let file = self.folder.0.join("public.pem");
        file.display().to_string().parse().ok()
    }

    /// The file of a release for the board `virt`.
    fn release(
        &self,
        sequence: u32,
        image: &[u8],
        change: impl FnOnce(&mut SignOptions<'_>),
    ) -> Vec<u8> {
        let mut options = SignOptions {
            kind: Kind::Program,
            name: None,
            board: "virt",
            chip: None,
            version: "0.4.0",
            build: Some("abc123"),
            sequence,
            floor: 3,
            expires: Some(4_073_500_800),
            requires: Requires::default(),
        };
        change(&mut options);
        let envelope = options.sign(image, &self.key).expect("signed");
        join(&envelope, image).expect("a release")
    }
}

async fn add(fixture: &Fixture, file: &[u8]) -> Answer {
    fixture.call(Method::POST, RELEASES, &[FILE], file).await
}

/// A report on a release, which passed or did not.
fn report(release: &str, passed: bool) -> GateReport {
    let measured = Estimate {
        mean: if passed { 0.95 } else { 0.5 },
        low: 0.1,
        high: 1.0,
        runs: 20,
    };
    GateReport {
        format: GATE_FORMAT,
        release: release.to_owned(),
        build: "abc123".to_owned(),
        made: 1_798_761_600,
        evaluator: Evaluator {
            version: "0.1.0".to_owned(),
            protocol: 1,
            program: Digest([7; 32]),
        },
        plan: Digest([0xA5; 32]),
        evaluations: vec![Evaluated {
            scenario: "simple-navigation".to_owned(),
            sha256: Digest([1; 32]),
            robots: 3,
            seed: 1,
            seeds: 20,
            successes: 19,
            thresholds: vec![Threshold {
                metric: "success".to_owned(),
                bound: Bound::AtLeast(0.9),
                measured: Some(measured),
            }],
        }],
        replays: Vec::new(),
        passed,
    }
}

async fn list(fixture: &Fixture, query: &str) -> Value {
    let answer = fixture.get(&format!("{RELEASES}{query}")).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    answer.json()
}

fn codes(answer: &Answer) -> Vec<String> {
    let faults = answer.json()["faults"].as_array().expect("reasons").clone();
    let code = |fault: &Value| fault["code"].as_str().expect("a code").to_owned();
    faults.iter().map(code).collect()
}

async fn told(fixture: &Fixture, level: &str, text: &str) {
    eventually(text, async || {
        let events = fixture.get("/api/v1/events").await.json();
        let events = events["events"].as_array().expect("events").clone();
        let is_it = |event: &Value| event["level"] == level && event["text"] == text;
        events.iter().any(is_it)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_genuine_release_is_kept_and_told_of() {
    let signer = Signer::new();
    let fixture = Fixture::start_with(|layer| layer.release_key = signer.keys()).await;
    let empty = json!({ "releases": [], "next": null, "can_add": true });
    assert_eq!(list(&fixture, "").await, empty);
    let image: Vec<u8> = (0..150_000).map(|at| at as u8).collect();
    let added = add(&fixture, &signer.release(12, &image, |_| {})).await;
    assert_eq!(added.status, 201, "{}", added.text());
    let release = added.json();
    for (field, value) in [
        ("kind", json!("program")),
        ("name", Value::Null),
        ("board", json!("virt")),
        ("chip", json!("none")),
        ("version", json!("0.4.0")),
        ("build", json!("abc123")),
        ("sequence", json!(12)),
        ("floor", json!(3)),
        ("expires_at", json!(4_073_500_800_000_u64)),
        ("size", json!(150_000)),
        ("by", json!("anonymous")),
        ("key", json!(signer.key.public().id().to_string())),
        ("block_size", json!(65_536)),
        ("blocks", json!(3)),
        ("delta", Value::Null),
        ("requires", json!({ "sequence": 0, "protocol": 0 })),
        ("gate", Value::Null),
        ("withdrawn", Value::Null),
    ] {
        assert_eq!(release[field], value, "{field}");
    }
    let id = release["id"].as_str().expect("an id").to_owned();
    let one = fixture.get(&format!("{RELEASES}/{id}")).await;
    assert_eq!(one.json(), release);
    let text = format!("release {id} (program 0.4.0 for virt) was added by anonymous");
    told(&fixture, "info", &text).await;
    let again = add(&fixture, &signer.release(12, &image, |_| {})).await;
    again.is_problem(409, "exists");

    // A lower sequence may be kept as well; whoever was added last comes first.
    let model = signer.release(2, b"weights", |options| {
        (options.kind, options.name, options.build) = (Kind::Model, Some("eyes"), None);
        (options.floor, options.expires) = (0, None);
    });
    let model = add(&fixture, &model).await.json();
    assert_eq!(
        (&model["name"], &model["expires_at"]),
        (&json!("eyes"), &Value::Null)
    );
    let page = list(&fixture, "?limit=1").await;
    assert_eq!(page["releases"][0]["id"], model["id"]);
    assert_eq!(page["next"], model["id"]);
    let rest = list(
        &fixture,
        &format!("?before={}", model["id"].as_str().expect("an id")),
    )
    .await;
    assert_eq!(rest["releases"][0]["id"], release["id"]);
    assert_eq!(
        (rest["releases"].as_array().map(Vec::len), &rest["next"]),
        (Some(1), &Value::Null)
    );

    for query in ["?limit=0", "?limit=201", "?before=1", "?after=1"] {
        let answer = fixture.get(&format!("{RELEASES}{query}")).await;
        answer.is_problem(400, "bad_query");
    }
    for id in ["0", "0000000000000000", "ABCDEFABCDEFABCD"] {
        let answer = fixture.get(&format!("{RELEASES}/{id}")).await;
        answer.is_problem(404, "unknown_release");
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_not_genuine_is_refused_with_every_reason() {
    let (signer, stranger) = (Signer::new(), Signer::new());
    let fixture = Fixture::start_with(|layer| layer.release_key = signer.keys()).await;
    let image = vec![7; 70_000];
    let good = signer.release(12, &image, |_| {});
    let head = good.len() - image.len();
    let flipped = |at: usize| {
        let mut file = good.clone();
        file[at] ^= 1;
        file
    };
    let mixed = |other: &[u8]| [&good[..head], other].concat();
    let old = signer.release(12, &image, |options| options.expires = Some(1_000_000_000));
    for (file, reasons) in [
        (Vec::new(), &["no_release"][..]),
        (b"{\"command\":\"stop\"}".to_vec(), &["no_release"]),
        (good[..head - 1].to_vec(), &["no_release"]),
        (good[..head].to_vec(), &["image_too_short"]),
        (good[..good.len() - 1].to_vec(), &["image_too_short"]),
        (mixed(&vec![7; 70_001]), &["image_too_long"]),
        (mixed(&vec![8; 70_000]), &["bad_block"]),
        (flipped(good.len() - 1), &["bad_block"]),
        (flipped(head - 1), &["bad_signature"]),
        (stranger.release(12, &image, |_| {}), &["unknown_key"]),
        (old, &["expired"]),
    ] {
        let answer = add(&fixture, &file).await;
        answer.is_problem(422, "invalid_release");
        let found = codes(&answer);
        assert!(
            reasons
                .iter()
                .all(|code| found.contains(&(*code).to_owned())),
            "{found:?} {reasons:?}"
        );
    }
    let large = add(&fixture, &vec![0; FILE_MAX + 1]).await;
    large.is_problem(413, "too_large");
    let answer = fixture.post(RELEASES, "{}").await;
    answer.is_problem(415, "unsupported_media_type");
    assert_eq!(list(&fixture, "").await["releases"], json!([]));
    // The largest that there can be is taken.
    let largest = signer.release(12, &vec![1; 4_718_592], |_| {});
    let added = add(&fixture, &largest).await;
    assert_eq!(added.status, 201, "{}", added.text());
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_release_is_withdrawn_for_good() {
    let signer = Signer::new();
    let fixture = Fixture::start_with(|layer| layer.release_key = signer.keys()).await;
    let file = signer.release(12, b"image", |_| {});
    let id = add(&fixture, &file).await.json()["id"]
        .as_str()
        .expect("an id")
        .to_owned();
    let path = format!("{RELEASES}/{id}/withdraw");
    for wrong in [r#"{"reason":" "}"#, "{}", r#"{"reason":"x","force":true}"#] {
        fixture
            .post(&path, wrong)
            .await
            .is_problem(422, "invalid_body");
    }
    let long = json!({ "reason": "x".repeat(513) }).to_string();
    fixture
        .post(&path, &long)
        .await
        .is_problem(422, "invalid_body");
    let nobody = format!("{RELEASES}/0000000000000000/withdraw");
    let reason = r#"{"reason":" drives into walls "}"#;
    fixture
        .post(&nobody, reason)
        .await
        .is_problem(404, "unknown_release");
    let done = fixture.post(&path, reason).await;
    assert_eq!(done.status, 200, "{}", done.text());
    let withdrawn = done.json()["withdrawn"].clone();
    assert_eq!(withdrawn["by"], "anonymous");
    assert_eq!(withdrawn["reason"], "drives into walls");
    assert!(withdrawn["at"].as_i64() > Some(1_600_000_000_000));
    fixture
        .post(&path, reason)
        .await
        .is_problem(409, "wrong_state");
    assert_eq!(
        list(&fixture, "").await["releases"][0]["withdrawn"],
        withdrawn
    );
    add(&fixture, &file).await.is_problem(409, "exists");
    let text = format!(
        "release {id} (program 0.4.0 for virt) was withdrawn by anonymous: drives into walls"
    );
    told(&fixture, "warn", &text).await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn administrators_add_and_everybody_reads_and_it_is_written_down() {
    let signer = Signer::new();
    let fixture =
        Fixture::closed_with(Role::Serve, |layer| layer.release_key = signer.keys()).await;
    let admin = fixture.login(ADMIN).await.token;
    let viewer = fixture.login(VIEWER).await.token;
    let operator = fixture.login(OPERATOR).await.token;
    let file = signer.release(12, b"image", |_| {});
    let send = async |token: &str, file: &[u8]| {
        let bearer = format!("Bearer {token}");
        let headers = [FILE, ("authorization", bearer.as_str())];
        fixture.call(Method::POST, RELEASES, &headers, file).await
    };
    for low in [&viewer, &operator] {
        send(low, &file).await.is_problem(403, "forbidden");
    }
    let written = async |action: &str| {
        let entries = fixture.audit(&admin).await;
        let found = entries.iter().find(|entry| entry["action"] == action);
        found.cloned().expect(action)
    };
    send(&admin, b"forged")
        .await
        .is_problem(422, "invalid_release");
    let entry = written("release.add").await;
    assert_eq!(entry["outcome"], "invalid_release");
    assert!(
        entry["detail"]["why"]
            .as_str()
            .is_some_and(|why| why.contains("no_release"))
    );
    let added = send(&admin, &file).await;
    assert_eq!(added.status, 201, "{}", added.text());
    let release = added.json();
    let entry = written("release.add").await;
    assert_eq!(
        (&entry["who"], &entry["target"], &entry["outcome"]),
        (&json!(ADMIN), &release["id"], &json!("ok"))
    );
    assert_eq!(entry["detail"]["sequence"], 12);
    let path = format!("{RELEASES}/{}", release["id"].as_str().expect("an id"));
    for reader in [&viewer, &operator, &admin] {
        assert_eq!(fixture.get_as(reader, &path).await.json(), release);
    }
    let path = format!("{path}/withdraw");
    let reason = r#"{"reason":"too early"}"#;
    let refused = fixture
        .call_as(&operator, Method::POST, &path, reason)
        .await;
    refused.is_problem(403, "forbidden");
    let done = fixture.call_as(&admin, Method::POST, &path, reason).await;
    assert_eq!(done.status, 200, "{}", done.text());
    let entry = written("release.withdraw").await;
    assert_eq!(
        (&entry["who"], &entry["target"]),
        (&json!(ADMIN), &release["id"])
    );
    assert_eq!(entry["detail"]["reason"], "too early");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_without_a_key_believes_nobody() {
    let signer = Signer::new();
    let fixture = Fixture::start().await;
    assert_eq!(list(&fixture, "").await["can_add"], false);
    let answer = add(&fixture, &signer.release(12, b"image", |_| {})).await;
    answer.is_problem(409, "no_release_keys");
    assert!(answer.text().contains("--release-key"), "{}", answer.text());
    fixture.stop().await;
}

/// Attaching and showing a gate, and what rollouts make of it: nothing else is in their way but that there are no
/// robots.
#[tokio::test(flavor = "multi_thread")]
async fn a_gate_is_attached_shown_and_demanded() {
    let signer = Signer::new();
    let fixture = Fixture::start_with(|layer| layer.release_key = signer.keys()).await;
    let added = add(&fixture, &signer.release(12, b"image", |_| {})).await;
    let release = added.json();
    let id = release["id"].as_str().expect("an id");
    let path = format!("{RELEASES}/{id}/gate");
    let attach = async |file: &[u8]| fixture.call(Method::POST, &path, &[FILE], file).await;
    let begin = async |more: &[(&str, Value)]| {
        let phases = json!([{ "select": { "share": 100 } }]);
        let mut plan = json!({ "releases": [{ "release": id }], "phases": phases });
        for (field, value) in more {
            plan[*field] = value.clone();
        }
        fixture.post("/api/v1/rollouts", &plan.to_string()).await
    };
    fixture.get(&path).await.is_problem(404, "no_gate");
    let missing = begin(&[]).await;
    missing.is_problem(422, "gate_missing");
    assert!(missing.text().contains(id), "{}", missing.text());

    let passed = sign(&report(id, true), &signer.key).expect("signed");
    let mut flipped = passed.clone();
    flipped[200] ^= 1;
    let other = sign(&report("0123456789abcdef", true), &signer.key).expect("signed");
    let forged = sign(&report(id, true), &Signer::new().key).expect("signed");
    for (file, code) in [
        (&b"text"[..], "no_report"),
        (&passed[..60], "no_report"),
        (&flipped, "gate_bad_signature"),
        (&forged, "gate_unknown_key"),
        (&other, "gate_other_release"),
    ] {
        let refused = attach(file).await;
        refused.is_problem(422, "invalid_gate");
        assert_eq!(codes(&refused), [code]);
    }
    attach(&vec![0; GATE_MAX + 1])
        .await
        .is_problem(413, "too_large");
    let answer = fixture.post(&path, "{}").await;
    answer.is_problem(415, "unsupported_media_type");
    for nobody in ["0000000000000000", "x"] {
        let path = format!("{RELEASES}/{nobody}/gate");
        let unknown = fixture.call(Method::POST, &path, &[FILE], &passed).await;
        unknown.is_problem(404, "unknown_release");
        fixture.get(&path).await.is_problem(404, "unknown_release");
    }
    fixture.get(&path).await.is_problem(404, "no_gate");

    // One that failed is shown, and does not open the way.
    let failed = sign(&report(id, false), &signer.key).expect("signed");
    let attached = attach(&failed).await;
    assert_eq!(attached.status, 200, "{}", attached.text());
    assert_eq!(attached.json()["gate"], "failed");
    let text = format!(
        "release {id} (program 0.4.0 for virt) did not pass its gate, which was attached by anonymous"
    );
    told(&fixture, "warn", &text).await;
    begin(&[]).await.is_problem(422, "gate_missing");
    let nobody = begin(&[("override_gate", json!("a robot is stuck"))]).await;
    nobody.is_problem(422, "invalid_rollout");
    assert!(
        nobody.text().contains("no phase selects"),
        "{}",
        nobody.text()
    );
    let long = "x".repeat(513);
    for wrong in ["", " ", "a\nb", long.as_str()] {
        let refused = begin(&[("override_gate", json!(wrong))]).await;
        refused.is_problem(422, "invalid_rollout");
        assert!(
            refused.text().contains("override_gate"),
            "{}",
            refused.text()
        );
    }

    assert_eq!(attach(&passed).await.json()["gate"], "passed");
    assert_eq!(list(&fixture, "").await["releases"][0]["gate"], "passed");
    let shown = fixture.get(&path).await.json();
    assert_eq!(shown["key"], signer.key.public().id().to_string());
    let signed = serde_json::to_value(report(id, true)).expect("JSON");
    assert_eq!(shown["report"], signed);
    let nobody = begin(&[]).await;
    nobody.is_problem(422, "invalid_rollout");
    assert!(
        nobody.text().contains("no phase selects"),
        "{}",
        nobody.text()
    );

    let reason = r#"{"reason":"drives into walls"}"#;
    fixture
        .post(&format!("{RELEASES}/{id}/withdraw"), reason)
        .await;
    attach(&passed).await.is_problem(409, "wrong_state");
    let entries = fixture.get("/api/v1/audit?limit=100").await.json();
    let entries = entries["entries"].as_array().expect("entries").clone();
    let outcomes: Vec<_> = entries
        .iter()
        .filter(|entry| entry["action"] == "release.gate" && entry["target"] == id)
        .map(|entry| entry["outcome"].as_str().expect("a word").to_owned())
        .collect();
    let of = |outcome: &str| outcomes.iter().filter(|one| *one == outcome).count();
    assert_eq!(
        (of("ok"), of("invalid_gate"), of("wrong_state")),
        (2, 5, 1),
        "{outcomes:?}"
    );
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gate_is_demanded_of_a_model_too() {
    let signer = Signer::new();
    let fixture = Fixture::start_with(|layer| layer.release_key = signer.keys()).await;
    let model = signer.release(12, b"eyes", |options| {
        (options.kind, options.name) = (Kind::Model, Some("eyes"));
    });
    let added = add(&fixture, &model).await.json();
    let id = added["id"].as_str().expect("an id");
    let begin = async |why: Option<&str>| {
        let phases = json!([{ "select": { "share": 100 } }]);
        let plan =
            json!({ "releases": [{ "release": id }], "phases": phases, "override_gate": why });
        fixture.post("/api/v1/rollouts", &plan.to_string()).await
    };
    begin(None).await.is_problem(422, "gate_missing");
    let nobody = begin(Some("a robot sees nothing")).await;
    nobody.is_problem(422, "invalid_rollout");
    let path = format!("{RELEASES}/{id}/gate");
    for (passed, refused) in [(false, "gate_missing"), (true, "invalid_rollout")] {
        let gate = sign(&report(id, passed), &signer.key).expect("signed");
        let attached = fixture.call(Method::POST, &path, &[FILE], &gate).await;
        assert_eq!(attached.status, 200, "{}", attached.text());
        begin(None).await.is_problem(422, refused);
    }
    let whom = begin(None).await;
    assert!(whom.text().contains("no phase selects"), "{}", whom.text());
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn which_releases_need_a_gate_is_an_option() {
    let signer = Signer::new();
    let bundle = crawler_bundle::Bundle::new("0.4.0", "abc123").image(2_000, 0);
    let bundle = bundle.expect("a bundle");
    let simulated = signer.release(1, &bundle, |options| {
        (options.board, options.floor) = ("sim", 0);
    });
    let board = signer.release(12, b"image", |_| {});
    for (option, demanded) in [
        (None, [false, true]),
        (Some(RequireGate::All), [true, true]),
        (Some(RequireGate::None), [false, false]),
    ] {
        let fixture = Fixture::start_with(|layer| {
            layer.release_key = signer.keys();
            layer.require_gate = option;
        })
        .await;
        for (file, demanded) in [&simulated, &board].into_iter().zip(demanded) {
            let id = add(&fixture, file).await.json()["id"].clone();
            let phases = json!([{ "select": { "share": 100 } }]);
            let plan = json!({ "releases": [{ "release": id }], "phases": phases });
            let refused = fixture.post("/api/v1/rollouts", &plan.to_string()).await;
            refused.is_problem(
                422,
                if demanded {
                    "gate_missing"
                } else {
                    "invalid_rollout"
                },
            );
        }
        fixture.stop().await;
    }
}
