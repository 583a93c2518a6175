//! Twins, from a robot made of an MQTT client and from simulated ones.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crawler_twin::body::Parameters;
use crawler_twin::certificate::{About, Certificate, FORMAT};
use crawler_twin::evidence::Counts;
use rumqttc::v5::mqttbytes::QoS;
use serde_json::{Value, json};

use crate::support::{FakeRobot, Fixture, eventually, status, telemetry, within};

const PATH: &str = "/api/v1/robots/ada-1/twin";

fn unix_ms() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.expect("after 1970").as_millis() as u64
}

fn fix(robot: &str, x: f64) -> Value {
    json!({
        "robot": robot, "timestamp": unix_ms(),
        "pose": {"x": x, "y": 2.0, "theta": 0.5, "sigma": 0.01},
    })
}

/// What a robot that stands and its tracker say at a moment.
async fn say(robot: &FakeRobot, x: f64) {
    let id = &robot.id;
    let mut sample: Value = serde_json::from_str(&telemetry(id, 2)).expect("telemetry");
    sample["timestamp"] = unix_ms().into();
    sample["wheels"] = json!({"left": 0.0, "right": 0.0});
    // Where it believes to be is no evidence.
    sample["pose"]["x"] = 77.into();
    for (topic, payload) in [("telemetry", sample), ("pose", fix(id, x))] {
        let (topic, text) = (format!("swarm/{topic}/{id}"), payload.to_string());
        robot
            .send(&topic, QoS::AtMostOnce, false, text.into())
            .await;
    }
}

/// Says something ten times a second until `holds`.
async fn until(
    what: &str,
    robot: &FakeRobot,
    mut x: impl FnMut(u32) -> f64,
    mut holds: impl AsyncFnMut() -> bool,
) {
    let saying = async {
        let mut tick = 0;
        while !holds().await {
            say(robot, x(tick)).await;
            tick += 1;
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    within(what, saying).await;
}

/// A certificate that says that a body is the nominal one.
fn certificate(robot: &str, build: &str) -> String {
    let certificate = Certificate {
        format: FORMAT,
        about: About {
            robot: robot.to_owned(),
            build: build.to_owned(),
            ..About::default()
        },
        evidence: "0123456789abcdef0123456789abcdef".to_owned(),
        expires_ms: 0,
        parameters: Parameters::NOMINAL,
        values: Vec::new(),
        covariance: Vec::new(),
        validation: Vec::new(),
        residual: 1.0,
        wander: 0.02,
        behind_s: None,
        counts: Counts::default(),
        jumps: 0,
    };
    certificate.write()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_a_tracker_sees_has_a_twin() {
    let fixture = Fixture::start_with(|layer| {
        let folder = layer.data.as_ref().expect("a folder").join("twins");
        std::fs::create_dir_all(&folder).expect("made");
        for (name, text) in [
            ("ada-1", certificate("ada-1", "0.1.0")),
            ("eve-1", certificate("eve-1", "9.9.9")),
            ("old-1", "{\"format\": 7}".to_owned()),
        ] {
            std::fs::write(folder.join(format!("{name}.json")), text).expect("written");
        }
    })
    .await;
    for path in ["", "/forecast", "/certificates"] {
        let nobody = fixture.get(&format!("{PATH}{path}")).await;
        nobody.is_problem(404, "unknown_robot");
        let none = fixture
            .get(&format!("/api/v1/robots/A%20B/twin{path}"))
            .await;
        none.is_problem(404, "unknown_robot");
    }
    let robot = fixture.robot("ada-1").await;
    // A tracker makes nobody known.
    let topic = "swarm/pose/ada-1";
    robot.publish(topic, fix("ada-1", 1.0).to_string()).await;
    robot.introduce().await;
    for id in ["eve-1", "old-1"] {
        let topic = format!("swarm/status/{id}");
        let text = status(id, true).into_bytes();
        robot.send(&topic, QoS::AtLeastOnce, true, text).await;
        fixture.wait_presence(id, "online").await;
    }
    fixture.wait_told("ada-1").await;
    let none = fixture.get(PATH).await;
    none.is_problem(404, "no_twin");
    assert!(none.text().contains("no tracker"), "{}", none.text());

    until(
        "a twin",
        &robot,
        |_| 1.0,
        async || fixture.get(PATH).await.status == 200,
    )
    .await;
    let told = fixture.get(PATH).await.json();
    let near = |value: &Value, place: f64| (value.as_f64().expect("a number") - place).abs() < 0.1;
    assert!(
        near(&told["pose"]["x"], 1.0) && near(&told["pose"]["y"], 2.0),
        "{told}"
    );
    assert_eq!(told["certificate"], "0123456789abcdef");
    assert_eq!(told["faults"], json!([]));
    assert_eq!(told["drift"]["stale_since"], Value::Null, "{told}");
    assert!(
        told["drift"]["deviations"]["left"].as_f64() < Some(3.0),
        "{told}"
    );
    assert!(
        told["time"].as_u64().expect("a time").abs_diff(unix_ms()) < 60_000,
        "{told}"
    );
    let ahead = fixture.get(&format!("{PATH}/forecast")).await.json();
    let forecasts = ahead["forecasts"].as_array().expect("forecasts");
    let horizons: Vec<_> = forecasts
        .iter()
        .map(|one| one["ahead_s"].as_f64())
        .collect();
    assert_eq!(horizons, [Some(1.0), Some(10.0)]);
    assert!(
        forecasts.iter().all(|one| near(&one["pose"]["x"], 1.0)),
        "{ahead}"
    );
    assert_eq!(ahead["errors"].as_array().map(Vec::len), Some(2));
    for (id, refused) in [
        ("ada-1", Value::Null),
        ("eve-1", "other_build".into()),
        ("old-1", "no_certificate".into()),
    ] {
        let path = format!("/api/v1/robots/{id}/twin/certificates");
        let told = fixture.get(&path).await.json();
        assert_eq!(told["certificates"][0]["file"], format!("{id}.json"));
        assert_eq!(
            told["certificates"][0]["refused"]["code"], refused,
            "{told}"
        );
    }

    // What is no fix is counted, and nothing else.
    for payload in [
        json!({}),
        fix("eve-1", 1.0),
        fix("ada-1", 1e9),
        json!({"robot": "ada-1", "timestamp": -1, "pose": 5}),
    ] {
        robot.publish(topic, payload.to_string()).await;
    }
    eventually("what was rejected", async || {
        let metrics = fixture.get("/metrics").await;
        let counts = [("malformed", 2), ("mismatch", 1), ("absurd", 1)];
        counts.iter().all(|(kind, count)| {
            let name = "terracrawler_mqtt_messages_rejected_total";
            let line = format!("{name}{{kind=\"{kind}\"}} {count}\n");
            metrics.text().contains(&line)
        })
    })
    .await;

    // A tracker that takes another robot for it now and then becomes an event.
    let elsewhere = |tick: u32| if tick % 4 < 2 { 1.0 } else { 5.0 };
    until("an event", &robot, elsewhere, async || {
        let told = fixture.get("/api/v1/events?robot=ada-1").await.json();
        told["events"]
            .as_array()
            .expect("events")
            .iter()
            .any(|event| {
                let text = event["text"].as_str().unwrap_or_default();
                event["level"] == "warn" && text.starts_with("twin: tracker_wrong: ")
            })
    })
    .await;
    let told = fixture.get(PATH).await.json();
    assert_eq!(told["faults"][0]["fault"], "tracker_wrong", "{told}");
    // Of who stands, and is now here, now there, nothing is known of the gap.
    let gap = fixture.get("/api/v1/fleet/gap").await.json();
    let own = &gap["robots"][0];
    assert_eq!(
        (&own["robot"], &own["certificate"], &own["since"]),
        (&"ada-1".into(), &"0123456789abcdef".into(), &Value::Null),
        "{gap}"
    );
    for measures in [&own["measures"], &gap["fleet"]] {
        assert_eq!(measures["whole"], false, "{gap}");
        let errors = measures["errors"].as_array().expect("errors");
        let of_each = errors.iter().zip([1.0, 10.0]);
        for (errors, ahead_s) in of_each {
            assert_eq!(errors["ahead_s"], ahead_s, "{gap}");
            assert_eq!(
                (&errors["count"], &errors["own"]),
                (&0.into(), &Value::Null)
            );
        }
        assert_eq!(measures["displacements"]["own"], Value::Null, "{gap}");
    }
    let metrics = fixture.get("/metrics").await;
    for line in [
        "terracrawler_twins{body=\"certificate\"} 1\n",
        "terracrawler_twin_faults{fault=\"tracker_wrong\"} 1\n",
        "terracrawler_drops_total{reason=\"twins_full\"} 0\n",
    ] {
        assert!(metrics.text().contains(line), "{line}: {}", metrics.text());
    }
    drop(robot);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_robot_is_followed_by_what_its_camera_sees() {
    let fixture = Fixture::up("empty", |_| {}).await;
    fixture.wait_told("sim-0001").await;
    let path = "/api/v1/robots/sim-0001";
    let command = json!({"command": "behave", "parameters": {"behaviour": "wander"}}).to_string();
    // It drives, as soon as it knows the time, and the twin is where it is.
    let mut seen = (Value::Null, Value::Null);
    eventually("a twin beside its robot", async || {
        seen = (
            fixture.get(&format!("{path}/twin")).await.json(),
            fixture.get(path).await.json(),
        );
        if seen.1["behaviour"] != "wander" {
            let sent = fixture.post(&format!("{path}/commands"), &command).await;
            assert_eq!(sent.status, 202, "{}", sent.text());
            tokio::time::sleep(Duration::from_millis(500)).await;
            return false;
        }
        let of = |value: &Value, axis: &str| value["pose"][axis].as_f64().unwrap_or(f64::NAN);
        let [x, y] = ["x", "y"].map(|axis| of(&seen.0, axis) - of(&seen.1, axis));
        x.hypot(y) < 0.3 && seen.0["fixes"].as_u64() > Some(6) && seen.0["v"].as_f64() > Some(0.05)
    })
    .await;
    assert_eq!(seen.0["certificate"], Value::Null);
    assert_eq!(seen.0["drift"], Value::Null);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_may_keep_none() {
    let fixture = Fixture::start_with(|layer| layer.twins = Some(0)).await;
    let robot = fixture.robot("ada-1").await;
    robot.introduce().await;
    fixture.wait_presence("ada-1", "online").await;
    say(&robot, 1.0).await;
    let none = fixture.get(PATH).await;
    none.is_problem(404, "no_twin");
    assert!(none.text().contains("keeps no twins"), "{}", none.text());
    let gap = fixture.get("/api/v1/fleet/gap").await;
    gap.is_problem(404, "no_twin");
    let metrics = fixture.get("/metrics").await;
    assert!(
        !metrics.text().contains("terracrawler_twin"),
        "{}",
        metrics.text()
    );
    drop(robot);
    fixture.stop().await;
}
