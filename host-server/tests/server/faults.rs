//! Breaking robots on purpose, over HTTP.

use crate::support;
use crate::support::{Fixture, status};
use hyper::Method;
use rumqttc::v5::mqttbytes::QoS;
use serde_json::json;

const DEAD: &str = r#"{"fault":{"fault":"ranger-dead"},"lasting_ms":5000}"#;

#[tokio::test(flavor = "multi_thread")]
async fn faults_go_to_robots_that_take_them_and_to_no_others() {
    let fixture = Fixture::start().await;
    let path = "/api/v1/robots/ada-1/faults";
    fixture
        .post(path, DEAD)
        .await
        .is_problem(404, "unknown_robot");
    let mut robot = fixture.robot("ada-1").await;
    robot
        .client
        .subscribe("swarm/simulator/command", QoS::AtLeastOnce)
        .await
        .expect("subscribe");
    robot.introduce().await;
    fixture.wait_presence("ada-1", "online").await;
    fixture
        .post(path, DEAD)
        .await
        .is_problem(409, "takes_no_faults");

    let bench = status("ada-1", true).replace(r#""range""#, r#""range","faults""#);
    robot
        .send("swarm/status/ada-1", QoS::AtLeastOnce, true, bench.into())
        .await;
    support::eventually("the bench is known", async || {
        fixture.post(path, DEAD).await.status == 202
    })
    .await;
    let told = robot.next("simulator/command").await;
    let told: serde_json::Value = serde_json::from_slice(&told.payload).expect("JSON");
    let expected = json!({
        "command": "inject",
        "robot": "ada-1",
        "fault": {"fault": "ranger-dead"},
        "lasting_ms": 5000,
    });
    assert_eq!(told, expected);
    for (body, status, code) in [
        ("", 400, "malformed"),
        ("{}", 422, "missing_field"),
        (r#"{"fault":{"fault":"rust"}}"#, 422, "out_of_range"),
        (
            r#"{"fault":{"fault":"ranger-dead"},"lasting_ms":0}"#,
            422,
            "out_of_range",
        ),
        (
            r#"{"fault":{"fault":"ranger-dead"},"robot":"eve"}"#,
            422,
            "duplicate_field",
        ),
    ] {
        fixture.post(path, body).await.is_problem(status, code);
    }
    let healed = fixture.call(Method::DELETE, path, &[], "").await;
    assert_eq!(healed.status, 202, "{}", healed.text());
    let told = robot.next("simulator/command").await;
    let told: serde_json::Value = serde_json::from_slice(&told.payload).expect("JSON");
    assert_eq!(told, json!({"command": "heal", "robot": "ada-1"}));
    robot.vanish().await;
    fixture.wait_presence("ada-1", "offline").await;
    fixture
        .post(path, DEAD)
        .await
        .is_problem(409, "robot_offline");
    fixture.stop().await;
}
