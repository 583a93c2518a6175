//! A swarm under the server: who needs to know who is near is told, twice a second, and comes
//! together for it.

use std::time::Duration;

use crate::support::{Fixture, eventually};
use crawler_protocol::{CellDigest, Topic};
use rumqttc::v5::mqttbytes::QoS;
use serde_json::Value;

const EMPTY: &str = "empty";

async fn places(fixture: &Fixture) -> Vec<[f64; 2]> {
    let answer = fixture.get("/api/v1/robots").await.json();
    let robots = answer["robots"].as_array().expect("a list").clone();
    let of = |robot: &Value, axis: &str| robot["pose"][axis].as_f64();
    robots
        .iter()
        .filter_map(|robot| Some([of(robot, "x")?, of(robot, "y")?]))
        .collect()
}

/// Greatest distance to the middle.
fn spread(places: &[[f64; 2]]) -> f64 {
    let count = places.len() as f64;
    let middle = [0, 1].map(|axis| places.iter().map(|place| place[axis]).sum::<f64>() / count);
    places
        .iter()
        .map(|place| (place[0] - middle[0]).hypot(place[1] - middle[1]))
        .fold(0.0, f64::max)
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_that_gather_are_told_who_is_near() {
    let fixture = Fixture::up(EMPTY, |layer| layer.robots = Some(4)).await;
    let mut watcher = fixture.robot("watcher").await;
    watcher
        .client
        .subscribe("swarm/cell/+/+", QoS::AtMostOnce)
        .await
        .expect("subscribe");
    eventually("all of them tell where they are", async || {
        places(&fixture).await.len() == 4
    })
    .await;
    let behave =
        |name: &str| format!(r#"{{"command":"behave","parameters":{{"behaviour":"{name}"}}}}"#);
    // One that does not know the time yet refuses.
    eventually("every robot behaves so", async || {
        let accepted = fixture
            .post("/api/v1/swarm/commands", &behave("disperse"))
            .await;
        assert_eq!(accepted.status, 202, "{}", accepted.text());
        tokio::time::sleep(Duration::from_millis(500)).await;
        let answer = fixture.get("/api/v1/robots").await.json();
        let robots = answer["robots"].as_array().expect("a list").clone();
        let behaves = |robot: &Value| robot["behaviour"] == "disperse";
        robots.iter().filter(|robot| behaves(robot)).count() == 4
    })
    .await;
    let fleet = crawler_protocol::Fleet::default();
    let (told, x, y) = loop {
        let told = watcher.next("").await;
        let topic = std::str::from_utf8(&told.topic).expect("text");
        // The command to the swarm comes here too.
        if let Ok(Topic::Cell { x, y }) = Topic::parse(&fleet, topic) {
            break (told, x, y);
        }
    };
    let digest = CellDigest::from_json(&told.payload).expect("a digest");
    assert_eq!((digest.x, digest.y), (x, y));
    fixture
        .post("/api/v1/swarm/commands", &behave("gather"))
        .await;
    eventually("they have come together", async || {
        spread(&places(&fixture).await) < 0.8
    })
    .await;
    fixture.stop().await;
}
