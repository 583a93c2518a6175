//! What robots say they see.

use crate::support::{Fixture, eventually};

const PATH: &str = "/api/v1/robots/ada-1";

fn detections(robot: &str, frame: u32, objects: &str) -> String {
    format!(r#"{{"robot":"{robot}","seq":1,"timestamp":7,"frame":{frame},"objects":[{objects}]}}"#)
}

fn object(x: f32, bearing: f32) -> String {
    format!(r#"{{"class":"object","x":{x},"y":0.5,"bearing":{bearing},"margin":40}}"#)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_newest_sight_is_told_and_nonsense_is_not() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("ada-1").await;
    robot.introduce().await;
    fixture.wait_presence("ada-1", "online").await;
    assert!(fixture.get(PATH).await.json()["sees"].is_null());

    let topic = "swarm/vision/ada-1";
    robot
        .publish(topic, detections("ada-1", 3, &object(0.25, 0.5)))
        .await;
    eventually("seen", async || {
        fixture.get(PATH).await.json()["sees"]["frame"] == 3
    })
    .await;
    let sees = fixture.get(PATH).await.json()["sees"].clone();
    assert_eq!(sees["timestamp"], 7);
    assert_eq!(
        sees["objects"],
        serde_json::json!([{"class": "object", "x": 0.25, "y": 0.5, "bearing": 0.5, "margin": 40}])
    );

    let many = vec![object(0.5, 0.0); 9].join(",");
    for payload in [
        detections("ada-2", 4, ""),
        detections("ada-1", 4, &object(1.5, 0.0)),
        detections("ada-1", 4, &object(0.5, 7.0)),
        detections("ada-1", 4, &many),
        detections("ada-1", 4, "{}"),
        "[]".to_owned(),
        String::new(),
    ] {
        robot.publish(topic, payload).await;
    }
    robot.publish(topic, detections("ada-1", 5, "")).await;
    eventually("nothing seen", async || {
        fixture.get(PATH).await.json()["sees"]["frame"] == 5
    })
    .await;
    let metrics = fixture.get("/metrics").await;
    for (kind, count) in [("mismatch", 1), ("absurd", 2), ("malformed", 4)] {
        let line = format!("terracrawler_mqtt_messages_rejected_total{{kind=\"{kind}\"}} {count}");
        assert!(metrics.text().contains(&line), "{line}: {}", metrics.text());
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_robot_tells_of_the_cylinder_before_it() {
    let fixture = Fixture::up("search", |_| {}).await;
    let told = fixture.wait_told("sim-0001").await;
    let path = "/api/v1/robots/sim-0001";
    let capabilities = told["capabilities"].as_array().expect("a list");
    assert!(capabilities.iter().any(|word| word == "vision"), "{told}");
    assert!(told["sees"].is_null(), "nobody asked it to look: {told}");
    let always = r#"{"command":"set","parameters":{"vision_always":true}}"#;
    fixture.post(&format!("{path}/commands"), always).await;
    eventually("the cylinder", async || {
        let sees = fixture.get(path).await.json()["sees"].clone();
        let objects = sees["objects"].as_array().cloned().unwrap_or_default();
        // It stands 0.97 m ahead and 0.2 m to the right of the middle.
        objects.iter().any(|object| {
            let bearing = object["bearing"].as_f64().unwrap_or(9.0);
            object["class"] == "object" && (bearing + 0.2).abs() < 0.12
        })
    })
    .await;
    fixture.stop().await;
}
