//! Maps, from robots made of an MQTT client and from simulated ones.

use crawler_protocol::{Action, Reason, ResponseStatus};
use rumqttc::v5::mqttbytes::QoS;
use serde_json::{Value, json};

use crate::support::{FakeRobot, Fixture, eventually, status, within};

const PATH: &str = "/api/v1/robots/ada-1/map";

/// A robot whose status says that it tells its map.
async fn robot(fixture: &Fixture, id: &str) -> FakeRobot {
    let robot = fixture.robot(id).await;
    robot.introduce().await;
    let mut told: Value = serde_json::from_str(&status(id, true)).expect("a status");
    let capabilities = told["capabilities"].as_array_mut().expect("a list");
    capabilities.push("map".into());
    let topic = format!("swarm/status/{id}");
    let text = told.to_string().into_bytes();
    robot.send(&topic, QoS::AtLeastOnce, true, text).await;
    let path = format!("/api/v1/robots/{id}");
    eventually("the capability", async || {
        let told = fixture.get(&path).await.json();
        let capabilities = told["capabilities"].as_array();
        capabilities.is_some_and(|words| words.contains(&"map".into()))
    })
    .await;
    robot
}

/// Two of four rows of 24 cells, the first of which is blocked.
fn part(robot: &str, seq: u64, row: u8) -> Value {
    json!({
        "robot": robot, "seq": seq, "timestamp": 5, "cell_mm": 100, "origin": [-12, 3],
        "columns": 24, "rows": 4, "row": row, "cells": "AQAAAAAAAQAAAAAA",
        "goal": if row == 0 { json!([1.5, 0.25]) } else { Value::Null },
        "next": null,
        "way": if row == 0 { json!([[12, 1], [16, 2]]) } else { json!([]) },
    })
}

async fn asked(robot: &mut FakeRobot) -> u64 {
    let command = robot.next_command().await;
    assert_eq!(command.action, Action::ReportMap);
    assert_eq!(command.source.as_str(), "map");
    command.seq
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_is_asked_once_for_all_who_look() {
    let fixture = Fixture::start().await;
    fixture.get(PATH).await.is_problem(404, "unknown_robot");
    let old = fixture.robot("old-1").await;
    old.introduce().await;
    fixture.wait_presence("old-1", "online").await;
    let no = fixture.get("/api/v1/robots/old-1/map").await;
    no.is_problem(409, "tells_no_map");

    let mut robot = robot(&fixture, "ada-1").await;
    let tells = async {
        let seq = asked(&mut robot).await;
        let topic = "swarm/map/ada-1";
        // What nobody asked for, what is no map, and what does not follow.
        let mut wrong = part("ada-1", seq, 0);
        wrong["cells"] = "AQAA".into();
        for payload in [
            part("ada-1", seq + 1, 0),
            part("eve-1", seq, 0),
            part("ada-1", seq, 2),
            wrong,
            json!({}),
            part("ada-1", seq, 0),
            part("ada-1", seq, 2),
        ] {
            robot.publish(topic, payload.to_string()).await;
        }
    };
    let looks = async { tokio::join!(fixture.get(PATH), fixture.get(PATH), fixture.get(PATH)) };
    let ((one, two, three), ()) = within("the map", async { tokio::join!(looks, tells) }).await;
    for told in [one, two, three] {
        assert_eq!(told.status, 200, "{}", told.text());
        assert_eq!(
            told.json(),
            json!({
                "timestamp": 5, "resolution": 0.1, "origin": [-1.2, 0.3], "columns": 24,
                "rows": vec!["#......................."; 4],
                "goal": [1.5, 0.25], "next": null, "way": [[0.05, 0.45], [0.45, 0.55]],
            })
        );
    }
    // Nobody but the robot was told: it is no command of anybody's.
    let commands = fixture.get("/api/v1/commands").await.json();
    assert_eq!(commands["commands"], json!([]));
    let metrics = fixture.get("/metrics").await;
    for (kind, count) in [("mismatch", 1), ("absurd", 1), ("malformed", 1)] {
        let line = format!("terracrawler_mqtt_messages_rejected_total{{kind=\"{kind}\"}} {count}");
        assert!(metrics.text().contains(&line), "{line}: {}", metrics.text());
    }
    drop((robot, old));
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_says_why_it_tells_none() {
    let fixture = Fixture::start().await;
    // What one said is good for a second, so each is another one.
    for (id, status, reason, expected) in [
        (
            "eve-1",
            ResponseStatus::Failed,
            Some(Reason::NoMap),
            (404, "no_map"),
        ),
        (
            "eve-2",
            ResponseStatus::Rejected,
            Some(Reason::Busy),
            (409, "refused"),
        ),
        ("eve-3", ResponseStatus::Stale, None, (409, "refused")),
    ] {
        let mut robot = robot(&fixture, id).await;
        let answers = async {
            let seq = asked(&mut robot).await;
            robot.answer(seq, status, reason).await;
        };
        let path = format!("/api/v1/robots/{id}/map");
        let both = async { tokio::join!(fixture.get(&path), answers) };
        let (told, ()) = within("the answer", both).await;
        told.is_problem(expected.0, expected.1);
    }
    let robot = robot(&fixture, "ada-1").await;
    // One that says nothing is waited for.
    let told = within("the end of patience", fixture.get(PATH)).await;
    told.is_problem(504, "no_answer");
    robot.vanish().await;
    fixture.wait_presence("ada-1", "offline").await;
    fixture.get(PATH).await.is_problem(409, "robot_offline");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_robot_tells_its_map_on_its_way() {
    let fixture = Fixture::up("empty", |_| {}).await;
    let told = fixture.wait_told("sim-0001").await;
    let [x, y] = ["x", "y"].map(|axis| told["pose"][axis].as_f64().expect(axis));
    // Two metres away, and within the walls.
    let goal = json!({"x": if x > 0.0 { x - 2.0 } else { x + 2.0 }, "y": y});
    let path = "/api/v1/robots/sim-0001";
    let map = format!("{path}/map");
    // On a busy machine it may answer late, and is asked again.
    eventually("it has no map", async || {
        let told = fixture.get(&map).await;
        if told.status != 504 {
            told.is_problem(404, "no_map");
        }
        told.status == 404
    })
    .await;
    let body = json!({"command": "goto", "parameters": goal}).to_string();
    let mut seen = Value::Null;
    eventually("a map with a way", async || {
        let told = fixture.get(&map).await;
        if told.status == 200 {
            seen = told.json();
        } else {
            // Refused before the robot has the time.
            let sent = fixture.post(&format!("{path}/commands"), &body).await;
            assert_eq!(sent.status, 202, "{}", sent.text());
        }
        seen["next"].is_array() && !seen["way"].as_array().expect("a way").is_empty()
    })
    .await;
    assert_eq!(seen["columns"], 96);
    let rows = seen["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 80);
    for row in rows {
        let row = row.as_str().expect("a row");
        assert!(row.len() == 96 && row.bytes().all(|cell| b".o#".contains(&cell)));
    }
    let to = |at: usize| seen["goal"][at].as_f64().expect("a goal");
    assert!(
        (to(0) - goal["x"].as_f64().expect("x")).abs() < 0.01,
        "{seen}"
    );
    fixture.stop().await;
}
