//! Simulated robots of a whole server take a release as it is, and the next one as a delta to it.

use crate::support::{Answer, Fixture, Scratch, eventually};
use crawler_bundle::{Bundle, SIZE_DEFAULT};
use crawler_release::{Kind, Requires};
use crawler_updates::release::{SecretKey, SignOptions, join};
use hyper::Method;
use serde_json::{Value, json};

const ROBOTS: u32 = 3;
const FILE: (&str, &str) = ("content-type", "application/octet-stream");

/// Keeps a release of a bundle that is as large as a program; its id.
async fn add(fixture: &Fixture, key: &SecretKey, build: &str, sequence: u32) -> String {
    let bundle = Bundle::new("9.0.0", build);
    let image = bundle.image(SIZE_DEFAULT, 0).expect("a bundle");
    let options = SignOptions {
        kind: Kind::Program,
        name: None,
        board: "sim",
        chip: None,
        version: "9.0.0",
        build: Some(build),
        sequence,
        floor: 0,
        expires: None,
        requires: Requires::default(),
    };
    let envelope = options.sign(&image, key).expect("signed");
    let file = join(&envelope, &image).expect("a release");
    let added: Answer = fixture
        .call(Method::POST, "/api/v1/releases", &[FILE], file)
        .await;
    assert_eq!(added.status, 201, "{}", added.text());
    added.json()["id"].as_str().expect("an id").to_owned()
}

/// Rolls a release out to all robots at once, and sees to the end of it.
async fn roll_out(fixture: &Fixture, release: &str) {
    let plan = json!({"releases": [{"release": release}],
        "phases": [{"select": {"share": 100}, "soak_s": 0}],
        "retries": {"pause_s": 1, "deferred_s": 1}});
    let begun = fixture.post("/api/v1/rollouts", &plan.to_string()).await;
    assert_eq!(begun.status, 201, "{}", begun.text());
    let path = format!(
        "/api/v1/rollouts/{}",
        begun.json()["id"].as_str().expect("an id")
    );
    let robots = async |states: &[&str]| {
        let counts: Value = fixture.get(&path).await.json()["counts"]["robots"].clone();
        let of = |state: &&str| counts[*state].as_u64().unwrap_or(0);
        states.iter().map(of).sum::<u64>()
    };
    eventually("a trial", async || {
        robots(&["trial", "confirmed"]).await == u64::from(ROBOTS)
    })
    .await;
    eventually("the end", async || {
        robots(&["confirmed"]).await == u64::from(ROBOTS)
    })
    .await;
    eventually("done", async || {
        fixture.get(&path).await.json()["state"] == "done"
    })
    .await;
}

async fn metric(fixture: &Fixture, name: &str) -> f64 {
    let answer = fixture.get("/metrics").await;
    let name = format!("terracrawler_updates_{name}_total ");
    let mut lines = answer.text().lines();
    let value = lines.find_map(|line| line.strip_prefix(&name));
    let value = value.unwrap_or_else(|| panic!("no {name}"));
    value.trim().parse().expect("a number")
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_that_run_a_release_get_the_next_one_as_a_delta() {
    let key = SecretKey::generate().expect("random numbers");
    let folder = Scratch::new();
    std::fs::create_dir_all(&folder.0).expect("a folder");
    let file = folder.0.join("public.pem");
    std::fs::write(&file, key.public_pem()).expect("written");
    let fixture = Fixture::up("empty", |layer| {
        layer.robots = Some(ROBOTS);
        layer.release_key = file.display().to_string().parse().ok();
    })
    .await;
    for robot in 1..=ROBOTS {
        fixture.wait_told(&format!("sim-{robot:04}")).await;
    }

    // Nobody knows the program of the factory: the image comes as it is.
    let first = add(&fixture, &key, "one", 1).await;
    roll_out(&fixture, &first).await;
    let whole = metric(&fixture, "chunk_bytes").await;
    assert!(whole >= f64::from(ROBOTS * SIZE_DEFAULT), "{whole}");
    assert_eq!(metric(&fixture, "delta_offers").await, 0.0);
    assert_eq!(metric(&fixture, "delta_bytes").await, 0.0);

    let second = add(&fixture, &key, "two", 2).await;
    roll_out(&fixture, &second).await;
    for robot in 1..=ROBOTS {
        let robot = fixture.get(&format!("/api/v1/robots/sim-{robot:04}")).await;
        assert_eq!(robot.json()["build"], "two", "{}", robot.text());
    }
    let by_delta = metric(&fixture, "chunk_bytes").await - whole;
    println!("{ROBOTS} robots: {whole} bytes of chunks as images, {by_delta} as deltas");
    assert!(by_delta < whole / 20.0, "{by_delta} of {whole}");
    assert!(metric(&fixture, "delta_bytes").await > 0.0);
    assert!(metric(&fixture, "delta_offers").await >= f64::from(ROBOTS));
    assert_eq!(metric(&fixture, "deltas_given_up").await, 0.0);
    fixture.stop().await;
}
