//! Calibrations of simulated robots with hidden bodies, from the API.

use std::time::{Duration, Instant};

use crawler_server::server::Server;
use hyper::Method;
use serde_json::{Value, json};

use crate::support::closed::{ADMIN, OPERATOR, VIEWER};
use crate::support::{Fixture, eventually, eventually_within};

/// Two robots whose bodies nobody knows, far from each other, under a camera that sees each of them twenty times a second.
const WORLD: &str = "
name = \"bench\"
about = \"Two robots to calibrate.\"
robots = 2
randomisation = \"wild\"
[arena]
width = 8.0
height = 4.0
[spawn]
poses = [{ x = -2.0, y = 0.0, theta = 0.4 }, { x = 2.0, y = 0.0, theta = -2.0 }]
[tracker]
rate_hz = 20.0
";
const ONE: &str = "/api/v1/robots/sim-0001/twin";
const TWO: &str = "/api/v1/robots/sim-0002/twin";
/// Longer than a few drives by far, on whatever machine.
const LONGEST: Duration = Duration::from_mins(15);
/// By these a calibration rightly ends whose machine has stood still for a second or two, or whose drive, another one
/// each time, says too little of how its robot differs.
const IN_VAIN: [&str; 5] = [
    "left_area",
    "link_lost",
    "not_better_than_nominal",
    "too_little",
    "tracker_lost",
];

async fn up() -> Fixture {
    Fixture::up("empty", |layer| {
        let folder = layer.data.as_ref().expect("a folder");
        std::fs::create_dir_all(folder).expect("made");
        let file = folder.join("bench.toml");
        std::fs::write(&file, WORLD).expect("written");
        layer.scenario = Some(file.to_str().expect("a path").to_owned());
    })
    .await
}

/// Waits until a robot may be calibrated.
async fn ready(fixture: &Fixture, twin: &str) {
    eventually("it may begin", async || {
        let permit = fixture.get(&format!("{twin}/permit")).await;
        permit.status == 200 && permit.json()["refused"] == Value::Null
    })
    .await;
}

async fn begin(fixture: &Fixture, twin: &str) -> String {
    let body = json!({"confirmed": true, "floor": "lino"}).to_string();
    let begun = fixture.post(&format!("{twin}/calibrations"), &body).await;
    assert_eq!(begun.status, 202, "{}", begun.text());
    begun.header("location").to_owned()
}

/// Begins a calibration, and begins anew while it is in vain, until one holds what is wanted.
async fn carried(
    fixture: &Fixture,
    twin: &str,
    wanted: impl Fn(&Value) -> bool,
) -> (String, Value) {
    let end = Instant::now() + LONGEST;
    loop {
        ready(fixture, twin).await;
        let place = begin(fixture, twin).await;
        loop {
            let now = fixture.get(&place).await.json();
            if wanted(&now) {
                return (place, now);
            }
            assert!(Instant::now() < end, "{now}");
            if now["ended"] != Value::Null {
                let code = now["reason"]["code"].as_str();
                assert!(code.is_some_and(|code| IN_VAIN.contains(&code)), "{now}");
                break;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }
}

async fn over(fixture: &Fixture, place: &str) -> Value {
    eventually("it is over", async || {
        fixture.get(place).await.json()["ended"] != Value::Null
    })
    .await;
    fixture.get(place).await.json()
}

fn drives(now: &Value) -> bool {
    now["begun_legs"].as_u64() > Some(3)
}

#[tokio::test(flavor = "multi_thread")]
async fn two_robots_get_certificates_that_their_twins_go_on_with() {
    let fixture = up().await;
    let certified = |now: &Value| now["state"] == "certified" && now["ended"] != Value::Null;
    let (one, two) = tokio::join!(
        carried(&fixture, ONE, certified),
        carried(&fixture, TWO, certified)
    );
    let ids = [&one, &two].map(|(_, over)| over["certificate"].clone());
    for (twin, (_, over)) in [(ONE, one), (TWO, two)] {
        let ten = &over["errors"][1];
        let of = |who: &str| ten[who]["median"].as_f64().expect("a number");
        assert!(of("own") < 0.08 && of("own") < of("nominal"), "{ten}");
        assert!(over["ended"].as_u64().expect("ms") - over["begun"].as_u64().expect("ms") > 60_000);
        // The twin goes on with the new body, and the robot tells of itself as often as before.
        eventually("the twin has it", async || {
            fixture.get(twin).await.json()["certificate"] == over["certificate"]
        })
        .await;
        let known = fixture.get(&format!("{twin}/certificates")).await.json();
        let known = &known["certificates"][0];
        assert_eq!(known["refused"], Value::Null, "{known}");
        assert_eq!(known["certificate"]["floor"], "lino");
        let robot = twin.trim_end_matches("/twin");
        eventually("its rate is set back", async || {
            let told = fixture.get(&format!("{robot}/parameters")).await.json();
            let all = told["parameters"].as_array().expect("parameters");
            let rate = all.iter().find(|one| one["name"] == "telemetry_hz");
            rate.is_some_and(|rate| rate["value"] == 5.0)
        })
        .await;
        let list = fixture.get(&format!("{twin}/calibrations")).await.json();
        assert_eq!(list["calibrations"][0], over);
    }
    the_gap_is_of_the_new_body(&fixture, &ids).await;
    fixture.stop().await;
}

/// What a twin with a new body has not seen yet it does not say; and after a drive the gap is known, of as many predictions as it
/// says.
async fn the_gap_is_of_the_new_body(fixture: &Fixture, certificates: &[Value; 2]) {
    let path = "/api/v1/fleet/gap";
    let begun = fixture.get(path).await.json();
    let robots = begun["robots"].as_array().expect("robots");
    for (gap, id) in robots.iter().zip(certificates) {
        assert_eq!(&gap["certificate"], id, "{gap}");
        assert_eq!(gap["measures"]["errors"][1]["own"], Value::Null, "{gap}");
    }
    let command = json!({"command": "behave", "parameters": {"behaviour": "wander"}}).to_string();
    let mut told = Value::Null;
    eventually_within(LONGEST, "enough was driven", async || {
        told = fixture.get(path).await.json();
        for robot in ["sim-0001", "sim-0002"] {
            let path = format!("/api/v1/robots/{robot}");
            if fixture.get(&path).await.json()["behaviour"] != "wander" {
                let sent = fixture.post(&format!("{path}/commands"), &command).await;
                assert_eq!(sent.status, 202, "{}", sent.text());
            }
        }
        tokio::time::sleep(Duration::from_millis(500)).await;
        let all = told["robots"].as_array().expect("robots");
        let whole = |gap: &Value| gap["measures"]["whole"] == true;
        all.len() == 2 && all.iter().all(whole)
    })
    .await;
    for gap in told["robots"].as_array().expect("robots") {
        let ten = &gap["measures"]["errors"][1];
        let median = |who: &str| ten[who]["median"].as_f64().expect("a number");
        // That it is less, tests in virtual time prove; here a few predictions are of whatever was in the way.
        assert!(median("own") < 1.5 * median("nominal"), "{gap}");
        assert!(
            median("floor") > 0.0 && ten["count"].as_u64() >= Some(10),
            "{gap}"
        );
        assert!(gap["since"].as_u64() <= told["time"].as_u64(), "{told}");
    }
    let count = |gap: &Value| gap["errors"][1]["count"].as_u64().expect("a count");
    let sum: u64 = [0, 1]
        .map(|n: usize| count(&told["robots"][n]["measures"]))
        .iter()
        .sum();
    assert_eq!(count(&told["fleet"]), sum);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_calibration_ends_when_somebody_wants_it_to() {
    let fixture = up().await;
    // A person stops it.
    let (place, _) = carried(&fixture, ONE, drives).await;
    let again = json!({"confirmed": true}).to_string();
    let again = fixture.post(&format!("{ONE}/calibrations"), &again).await;
    again.is_problem(409, "not_permitted");
    assert!(again.text().contains("busy: "), "{}", again.text());
    let stopped = fixture.call(Method::DELETE, &place, &[], "").await;
    assert_eq!(stopped.status, 204, "{}", stopped.text());
    let told = over(&fixture, &place).await;
    assert_eq!(
        (&told["state"], &told["reason"]["code"]),
        (&"broken_off".into(), &"stopped".into())
    );
    let late = fixture.call(Method::DELETE, &place, &[], "").await;
    late.is_problem(409, "wrong_state");
    // So does whoever tells the robot something else, one robot or all.
    for (path, body) in [
        ("/api/v1/swarm/commands", r#"{"command":"stop"}"#),
        (
            "/api/v1/robots/sim-0001/commands",
            r#"{"command":"drive","parameters":{"v":0.1,"w":0}}"#,
        ),
    ] {
        let (place, _) = carried(&fixture, ONE, drives).await;
        let sent = fixture.post(path, body).await;
        assert_eq!(sent.status, 202, "{}", sent.text());
        let told = over(&fixture, &place).await;
        assert_eq!(told["reason"]["code"], "other_command", "{told}");
    }
    let none = fixture.get(&format!("{ONE}/certificates")).await.json();
    assert_eq!(none["certificates"], json!([]), "nothing came of it");
    // A server that ends says so when it is back.
    let (place, _) = carried(&fixture, ONE, drives).await;
    let settings = fixture.settings.clone();
    let scratch = fixture.leave().await;
    let server = Server::start(&settings).await.expect("it starts again");
    let fixture = Fixture::of(server, settings);
    fixture.wait_told("sim-0001").await;
    let told = fixture.get(&place).await.json();
    assert_eq!(told["state"], "broken_off", "{told}");
    assert_eq!(told["reason"]["code"], "server_ended", "{told}");
    fixture.stop().await;
    drop(scratch);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_is_named() {
    let fixture = up().await;
    ready(&fixture, ONE).await;
    let post = async |body: Value| {
        let path = format!("{ONE}/calibrations");
        fixture.post(&path, &body.to_string()).await
    };
    for (body, code, pointer) in [
        (json!({}), "invalid_body", "/confirmed"),
        (
            json!({"confirmed": false}),
            "invalid_calibration",
            "/confirmed",
        ),
        (
            json!({"confirmed": true, "flor": "x"}),
            "invalid_body",
            "/flor",
        ),
        (
            json!({"confirmed": true, "floor": "x".repeat(65)}),
            "invalid_calibration",
            "/floor",
        ),
        (
            json!({"confirmed": true, "around": 0.0}),
            "invalid_calibration",
            "/around",
        ),
        (
            json!({"confirmed": true, "area": [[0, 0], [1, 1]]}),
            "invalid_calibration",
            "/area",
        ),
        (
            json!({"confirmed": true, "area": [[0, 0], [1]]}),
            "invalid_calibration",
            "/area/1",
        ),
        (
            json!({"confirmed": true, "area": [[0, 0], [1, 0], [0, 1]], "around": 2}),
            "invalid_calibration",
            "/around",
        ),
    ] {
        let refused = post(body.clone()).await;
        refused.is_problem(422, code);
        assert_eq!(refused.json()["errors"][0]["pointer"], pointer, "{body}");
    }
    // Where it would leave what is free, is named.
    let small = post(json!({"confirmed": true, "around": 0.5})).await;
    small.is_problem(409, "not_permitted");
    assert!(small.text().contains("leaves: "), "{}", small.text());
    let permit = fixture
        .get(&format!("{ONE}/permit?around=0.5"))
        .await
        .json();
    assert_eq!(permit["refused"]["code"], "leaves", "{permit}");
    assert_eq!(permit["refused"]["at"].as_array().map(Vec::len), Some(2));
    let odd = fixture.get(&format!("{ONE}/permit?around=-1")).await;
    odd.is_problem(400, "bad_query");
    let permit = fixture.get(&format!("{ONE}/permit")).await.json();
    assert_eq!(permit["refused"], Value::Null, "{permit}");
    assert!(permit["seconds"].as_f64() < Some(90.0), "{permit}");
    assert!(
        permit["area"].as_array().map(Vec::len) > Some(8),
        "{permit}"
    );
    // A fence around it is too small for the drive.
    let fence = json!({
        "name": "cage", "kind": "keep_in", "action": "warn",
        "corners": [[-2.6, -0.6], [-1.4, -0.6], [-1.4, 0.6], [-2.6, 0.6]],
    });
    let made = fixture.post("/api/v1/fences", &fence.to_string()).await;
    assert_eq!(made.status, 201, "{}", made.text());
    let caged = post(json!({"confirmed": true})).await;
    caged.is_problem(409, "not_permitted");
    assert!(caged.text().contains("the fence cage"), "{}", caged.text());
    // Who does something else is not calibrated, nor is who stands until somebody sees to it.
    for (command, code) in [
        (
            json!({"command": "behave", "parameters": {"behaviour": "wander"}}),
            "not_idle",
        ),
        (json!({"command": "estop"}), "halted"),
    ] {
        let path = "/api/v1/robots/sim-0001/commands";
        let sent = fixture.post(path, &command.to_string()).await;
        assert_eq!(sent.status, 202, "{}", sent.text());
        eventually(code, async || {
            let permit = fixture.get(&format!("{ONE}/permit")).await.json();
            permit["refused"]["code"] == code
        })
        .await;
    }
    for path in ["7", "0", "x"] {
        let none = fixture.get(&format!("{ONE}/calibrations/{path}")).await;
        none.is_problem(404, "unknown_calibration");
        let place = format!("{ONE}/calibrations/{path}");
        let none = fixture.call(Method::DELETE, &place, &[], "").await;
        none.is_problem(404, "unknown_calibration");
    }
    for path in ["permit", "calibrations", "calibrations/1"] {
        let nobody = fixture
            .get(&format!("/api/v1/robots/eve/twin/{path}"))
            .await;
        nobody.is_problem(404, "unknown_robot");
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn operators_calibrate_and_viewers_look() {
    let fixture = Fixture::closed().await;
    let robot = "/api/v1/robots/ada-1/twin/calibrations";
    let viewer = fixture.login(VIEWER).await.token;
    let body = json!({"confirmed": true}).to_string();
    for (method, path) in [
        (Method::POST, robot.to_owned()),
        (Method::DELETE, format!("{robot}/1")),
    ] {
        let refused = fixture.call_as(&viewer, method, &path, &body).await;
        refused.is_problem(403, "forbidden");
    }
    fixture
        .get_as(&viewer, robot)
        .await
        .is_problem(404, "unknown_robot");
    for who in [OPERATOR, ADMIN] {
        let token = fixture.login(who).await.token;
        let unknown = fixture.call_as(&token, Method::POST, robot, &body).await;
        unknown.is_problem(404, "unknown_robot");
    }
    fixture.stop().await;
}
