//! What robots tell is kept, and can be asked for.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::support::closed::VIEWER;
use crate::support::{FakeRobot, Fixture, eventually, mqtt_options, telemetry};
use crawler_protocol::{Telemetry, TelemetryEncoding};
use crawler_server::config::Role;
use hyper::Method;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Packet, PublishProperties};
use rumqttc::v5::{AsyncClient, Event};

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
        ("left", 0.5),
        ("right", 0.5),
    ] {
        let told = point[key].as_f64().expect("a number");
        assert!((told - value).abs() < 0.01, "{key}: {told}");
    }
    assert_eq!(point["state"], "MOVING");
    // One that was near for a moment is not lost in the mean.
    let near = telemetry("a", 21).replace("812", "112");
    robot.publish("swarm/telemetry/a", near).await;
    eventually("kept", async || count(&ask().await) == 21).await;
    let answer = ask().await;
    let points = answer["points"].as_array().expect("points");
    let of = |which: &str, key: &str| {
        let values = points.iter().map(|point| point[which][key].as_f64());
        let values: Vec<f64> = values.map(|value| value.expect("a number")).collect();
        if which == "least" {
            values.into_iter().fold(f64::MAX, f64::min)
        } else {
            values.into_iter().fold(f64::MIN, f64::max)
        }
    };
    assert_eq!(of("least", "range_mm"), 112.0);
    assert_eq!(of("most", "range_mm"), 812.0);
    assert_eq!(of("least", "battery_mv"), 7_610.0);
    assert_eq!(of("most", "rssi_dbm"), -61.0);

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
    assert_eq!(count(&ask().await), 21);
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

/// The numbers of a history, added up.
fn count(answer: &serde_json::Value) -> u64 {
    let points = answer["points"].as_array().expect("points");
    let counts = points.iter().map(|point| point["count"].as_u64());
    counts.map(|count| count.expect("a count")).sum()
}

/// Samples of robot `a`, 200 ms apart, in one message.
fn batch(how: TelemetryEncoding, numbers: std::ops::Range<u64>) -> Vec<u8> {
    let mut bytes = [0; 1024];
    let length = numbers.fold(0, |at, seq| {
        let mut sample = Telemetry::from_json(telemetry("a", seq).as_bytes()).expect("telemetry");
        sample.timestamp = 1_000_000 + 200 * seq;
        sample.battery.mv = 7_000 + seq as u16;
        how.append(&sample, &mut bytes, at).expect("it fits")
    });
    bytes[..length].to_vec()
}

async fn tell(robot: &FakeRobot, content_type: Option<&str>, payload: Vec<u8>) {
    let properties = PublishProperties {
        content_type: content_type.map(str::to_owned),
        ..PublishProperties::default()
    };
    robot
        .client
        .publish_with_properties(
            "swarm/telemetry/a",
            QoS::AtLeastOnce,
            false,
            payload,
            properties,
        )
        .await
        .expect("publish");
}

#[tokio::test(flavor = "multi_thread")]
async fn samples_that_come_together_are_kept_apart() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("a").await;
    let begin = now() - 1_500;
    let mut told = 0;
    for (how, numbers) in [
        (TelemetryEncoding::CborSeq, 0..5),
        (TelemetryEncoding::JsonSeq, 5..7),
        (TelemetryEncoding::Cbor, 7..8),
        (TelemetryEncoding::Json, 8..9),
    ] {
        told += numbers.clone().count() as u64;
        let newest = numbers.end - 1;
        tell(&robot, Some(how.content_type()), batch(how, numbers)).await;
        let path = format!("/api/v1/robots/a/telemetry?from={begin}&step=60000");
        eventually("kept", async || {
            count(&fixture.get(&path).await.json()) == told
        })
        .await;
        let live = fixture.get("/api/v1/robots/a").await.json();
        assert_eq!(live["battery"]["mv"], 7_000 + newest, "{live}");
        if how == TelemetryEncoding::CborSeq {
            // Each at its own time. All came within moments of the first, so two seconds hold them.
            let path = format!(
                "/api/v1/robots/a/telemetry?from={begin}&step=100&to={}",
                now() + 1
            );
            let answer = fixture.get(&path).await.json();
            let points = answer["points"].as_array().expect("points");
            let at: Vec<_> = points.iter().map(|point| point["at"].as_i64()).collect();
            let at: Vec<_> = at.into_iter().map(|at| at.expect("a time")).collect();
            assert_eq!(at.len(), 5, "{answer}");
            assert!(at.windows(2).all(|pair| pair[1] - pair[0] == 200), "{at:?}");
            let mv: Vec<_> = points
                .iter()
                .map(|point| point["battery_mv"].as_f64())
                .collect();
            let expected = (0..5).map(|seq| Some(7_000.0 + f64::from(seq)));
            assert!(mv.into_iter().eq(expected), "{answer}");
        }
    }

    // What is not known, broken, or of another robot is worth nothing at all.
    let good = batch(TelemetryEncoding::CborSeq, 20..23);
    let mut broken = good.clone();
    broken.truncate(good.len() - 1);
    let mut repeated = good.clone();
    repeated.extend(&good);
    let mut foreign = good.clone();
    let last = foreign
        .iter()
        .rposition(|byte| *byte == b'a')
        .expect("its name");
    foreign[last] = b'b';
    for (content_type, payload) in [
        (Some("application/cbor-seq"), broken),
        (Some("application/cbor-seq"), repeated),
        (Some("application/cbor-seq"), foreign),
        (Some("application/cbor"), good.clone()),
        (Some("application/json"), good.clone()),
        (None, good.clone()),
        (Some("text/plain"), telemetry("a", 30).into_bytes()),
        (Some("application/protobuf"), good),
    ] {
        tell(&robot, content_type, payload).await;
    }
    let rejected = async |kind: &str| {
        let metrics = fixture.get("/metrics").await;
        let line = format!("terracrawler_mqtt_messages_rejected_total{{kind=\"{kind}\"}} ");
        let found = metrics
            .text()
            .lines()
            .find_map(|text| text.strip_prefix(&line));
        found.map_or(0, |value| value.parse().expect("a number"))
    };
    eventually("rejected", async || {
        let counts = [
            rejected("malformed").await,
            rejected("mismatch").await,
            rejected("content_type").await,
        ];
        counts == [5, 1, 2]
    })
    .await;
    let path = format!("/api/v1/robots/a/telemetry?from={begin}&step=60000");
    assert_eq!(count(&fixture.get(&path).await.json()), told);
    fixture.stop().await;
}

/// What a robot says, by anybody's client: how often in which way, and the numbers of the samples.
#[derive(Default)]
struct Heard {
    ways: BTreeMap<&'static str, u64>,
    seqs: Vec<u64>,
}

async fn listen(port: u16, robot: &str, heard: Arc<Mutex<Heard>>) {
    let options = mqtt_options("listener", port);
    let (client, mut events) = AsyncClient::new(options, 16);
    let topic = format!("swarm/telemetry/{robot}");
    client
        .subscribe(topic, QoS::AtMostOnce)
        .await
        .expect("room");
    loop {
        let event = events.poll().await.expect("a broker");
        let Event::Incoming(Packet::Publish(publish)) = event else {
            continue;
        };
        let properties = publish.properties.as_ref();
        let kind = properties.and_then(|properties| properties.content_type.as_deref());
        let how = TelemetryEncoding::of(kind).expect("a way to write telemetry");
        let mut heard = heard.lock().expect("whole");
        *heard.ways.entry(how.content_type()).or_default() += 1;
        for sample in how.samples(&publish.payload) {
            heard.seqs.push(sample.expect("a sample").seq);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn simulated_robots_send_several_samples_at_a_time_and_none_is_lost() {
    let begin = now();
    let fixture = Fixture::world(false).await;
    fixture.wait_told("sim-0001").await;
    let heard = Arc::new(Mutex::new(Heard::default()));
    let port = fixture.server.mqtt().port;
    let listener = tokio::spawn(listen(port, "sim-0001", Arc::clone(&heard)));
    let ways = |way: &str| heard.lock().expect("whole").ways.get(way).copied();
    eventually("told as always", async || {
        ways("application/json") > Some(2)
    })
    .await;

    let path = "/api/v1/robots/sim-0001/parameters";
    let json = [("content-type", "application/json")];
    let put = async |body: &str| {
        let answer = fixture.call(Method::PUT, path, &json, body).await;
        assert_eq!(answer.status, 202, "{}", answer.text());
    };
    put(r#"{"telemetry_format": 1, "telemetry_batch": 5}"#).await;
    eventually("several in CBOR", async || {
        ways("application/cbor-seq") > Some(3)
    })
    .await;
    let live = fixture.get("/api/v1/robots/sim-0001").await.json();
    assert_eq!(live["presence"], "online");
    assert!(live["pose"]["x"].is_number(), "{live}");
    put(r#"{"telemetry_format": 0}"#).await;
    eventually("several in JSON", async || {
        ways("application/json-seq") > Some(3)
    })
    .await;

    // From here on nothing more comes.
    let pause = r#"{"command":"pause"}"#;
    fixture.post("/api/v1/simulator/commands", pause).await;
    let history = format!("/api/v1/robots/sim-0001/telemetry?from={begin}&step=60000");
    eventually("everything that was heard is kept", async || {
        let last = heard.lock().expect("whole").seqs.last().copied();
        let kept = count(&fixture.get(&history).await.json());
        last.map(|last| last + 1) == Some(kept)
    })
    .await;
    listener.abort();
    let seqs = heard.lock().expect("whole").seqs.clone();
    assert!(
        seqs.windows(2).all(|pair| pair[1] == pair[0] + 1),
        "{seqs:?}"
    );
    fixture.stop().await;
}
