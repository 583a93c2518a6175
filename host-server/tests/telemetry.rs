//! What robots tell is kept, and can be asked for.

mod support;

use std::time::{SystemTime, UNIX_EPOCH};

use crawler_server::config::Role;
use support::closed::VIEWER;
use support::{Fixture, eventually, telemetry};

fn now() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.expect("after 1970").as_millis() as u64
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_robot_tells_is_kept() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("a").await;
    let begin = now();
    for seq in 1..=20 {
        robot
            .publish("swarm/telemetry/a", telemetry("a", seq))
            .await;
    }
    let path = format!("/api/v1/robots/a/telemetry?from={begin}&step=60000");
    let ask = async || fixture.get(&path).await.json();
    let count = |answer: &serde_json::Value| -> u64 {
        let points = answer["points"].as_array().expect("points");
        let counts = points.iter().map(|point| point["count"].as_u64());
        counts.map(|count| count.expect("a count")).sum()
    };
    eventually("kept", async || count(&ask().await) == 20).await;
    let answer = ask().await;
    assert_eq!(answer["robot"], "a");
    assert_eq!(answer["step"], 60_000);
    let point = &answer["points"][0];
    for (key, value) in [
        ("x", 1.5),
        ("y", -0.25),
        ("theta", 0.5),
        ("range_mm", 812.0),
        ("battery_mv", 7610.0),
        ("battery_percent", 71.0),
        ("rssi_dbm", -61.0),
    ] {
        let told = point[key].as_f64().expect("a number");
        assert!((told - value).abs() < 0.01, "{key}: {told}");
    }
    assert_eq!(point["state"], "MOVING");

    // Nonsense is neither known nor kept.
    robot.publish("swarm/telemetry/a", "{}").await;
    robot.publish("swarm/telemetry/a", telemetry("b", 1)).await;
    let other = fixture.get("/api/v1/robots/b/telemetry").await.json();
    assert_eq!(other["points"], serde_json::json!([]));
    for query in [
        "from=5&to=4",
        "from=-1",
        "step=0",
        "step=1",
        "from=0&to=9223372036854775807&step=1",
        "from=x",
        "since=1",
    ] {
        fixture
            .get(&format!("/api/v1/robots/a/telemetry?{query}"))
            .await
            .is_problem(400, "bad_query");
    }
    fixture
        .get("/api/v1/robots/NO/telemetry")
        .await
        .is_problem(404, "unknown_robot");
    assert_eq!(count(&ask().await), 20);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn history_outlives_the_server() {
    let fixture = Fixture::closed_with(Role::Serve, |layer| layer.open = Some(true)).await;
    let robot = fixture.robot("a").await;
    robot.publish("swarm/telemetry/a", telemetry("a", 1)).await;
    let kept = async |fixture: &Fixture, token: &str| {
        let path = "/api/v1/robots/a/telemetry";
        let answer = fixture.get_as(token, path).await;
        assert_eq!(answer.status, 200, "{}", answer.text());
        answer.json()["points"].as_array().map(Vec::len) == Some(1)
    };
    eventually("kept", async || kept(&fixture, "").await).await;
    let scratch = fixture.leave().await;
    let again = Fixture::closed_at(scratch, Role::Serve, |_| {}).await;
    let viewer = again.login(VIEWER).await.token;
    assert!(kept(&again, &viewer).await);
    again.stop().await;
}
