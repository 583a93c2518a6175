//! Images, from robots made of an MQTT client and from simulated ones.

use crate::support::{FakeRobot, Fixture, Scratch, eventually, settings};
use hyper::Method;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::PublishProperties;

use crawler_server::config::{Layer, Role, Settings};
use crawler_server::server::Server;

fn jpeg(len: usize, filling: u8) -> Vec<u8> {
    let mut bytes = vec![filling; len];
    bytes[..4].copy_from_slice(&[0xFF, 0xD8, 0xFF, 0xE0]);
    bytes[len - 2..].copy_from_slice(&[0xFF, 0xD9]);
    bytes
}

async fn send(robot: &FakeRobot, payload: Vec<u8>, frame: &str, timestamp: &str) {
    let properties = PublishProperties {
        user_properties: vec![
            ("frame".to_owned(), frame.to_owned()),
            ("timestamp".to_owned(), timestamp.to_owned()),
        ],
        content_type: Some("image/jpeg".to_owned()),
        ..PublishProperties::default()
    };
    let topic = format!("swarm/image/{}", robot.id);
    robot
        .client
        .publish_with_properties(topic, QoS::AtLeastOnce, false, payload, properties)
        .await
        .expect("publish");
}

async fn rejected(fixture: &Fixture, kind: &str) -> f64 {
    let metrics = fixture.get("/metrics").await;
    let name = format!("terracrawler_mqtt_messages_rejected_total{{kind=\"{kind}\"}}");
    let line = metrics.text().lines().find_map(|l| l.strip_prefix(&name));
    line.map_or(0.0, |value| value.trim().parse().expect("a number"))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_newest_image_is_served_as_it_came() {
    let fixture = Fixture::start().await;
    let path = "/api/v1/robots/ada-1/image";
    fixture.get(path).await.is_problem(404, "unknown_robot");
    let no = fixture.get("/api/v1/robots/NO/image").await;
    no.is_problem(404, "unknown_robot");
    let robot = fixture.robot("ada-1").await;
    robot.introduce().await;
    fixture.wait_presence("ada-1", "online").await;
    fixture.get(path).await.is_problem(404, "no_image");
    let told = fixture.get("/api/v1/robots/ada-1").await.json();
    assert!(told["image"].is_null(), "{told}");

    send(&robot, jpeg(9_000, 1), "1", "1800000000000").await;
    eventually("the first", async || {
        fixture.get(path).await.header("x-image-frame") == "1"
    })
    .await;
    let first = fixture.get(path).await;
    assert_eq!(first.status, 200);
    let told = fixture.get("/api/v1/robots/ada-1").await.json();
    assert!(told["image"].as_u64() > Some(1_767_225_600_000), "{told}");
    assert_eq!(first.body, jpeg(9_000, 1));
    assert_eq!(first.header("content-type"), "image/jpeg");
    assert_eq!(first.header("cache-control"), "no-cache");
    assert_eq!(first.header("x-image-timestamp"), "1800000000000");
    let tag = [("if-none-match", first.header("etag"))];
    let same = fixture.call(Method::GET, path, &tag, "").await;
    assert_eq!((same.status.as_u16(), same.body.len()), (304, 0));

    // The largest there may be.
    send(&robot, jpeg(60 * 1024, 2), "2", "0").await;
    eventually("the second", async || {
        fixture.call(Method::GET, path, &tag, "").await.status == 200
    })
    .await;
    let second = fixture.get(path).await;
    assert_eq!(second.body, jpeg(60 * 1024, 2));
    assert_eq!(second.header("x-image-frame"), "2");
    let posted = fixture.post(path, "{}").await;
    posted.is_problem(405, "method_not_allowed");

    // A robot that is taken off the books takes its image along.
    robot
        .send("swarm/status/ada-1", QoS::AtLeastOnce, true, Vec::new())
        .await;
    eventually("gone", async || fixture.get(path).await.status == 404).await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_image_changes_nothing() {
    let fixture = Fixture::start().await;
    let path = "/api/v1/robots/ada-1/image";
    let robot = fixture.robot("ada-1").await;
    robot.introduce().await;
    send(&robot, jpeg(100, 1), "1", "5").await;
    eventually("the image", async || fixture.get(path).await.status == 200).await;
    let good = fixture.get(path).await.body;

    send(&robot, jpeg(60 * 1024 + 1, 2), "2", "5").await;
    send(&robot, b"GIF89a".to_vec(), "2", "5").await;
    send(&robot, Vec::new(), "2", "5").await;
    send(&robot, jpeg(100, 2)[..99].to_vec(), "2", "5").await;
    send(&robot, jpeg(100, 2), "two", "5").await;
    send(&robot, jpeg(100, 2), "2", "").await;
    robot.publish("swarm/image/ada-1", jpeg(100, 2)).await;
    eventually("counted", async || {
        (
            rejected(&fixture, "malformed").await,
            rejected(&fixture, "too_large").await,
        ) == (6.0, 1.0)
    })
    .await;
    assert_eq!(fixture.get(path).await.body, good);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_robot_takes_a_picture_on_request() {
    let scratch = Scratch::new();
    std::fs::create_dir_all(&scratch.0).expect("directory");
    let scenario = scratch.0.join("cameras.toml");
    std::fs::write(
        &scenario,
        "name = \"cameras\"\nrobots = 2\n[spawn]\ncamera_share = 0.5\n",
    )
    .expect("file");
    let base = settings(&scratch, |_| {});
    let layer = Layer {
        http: Some(base.http),
        mqtt: Some("127.0.0.1:0".parse().expect("address")),
        data: Some(scratch.0.join("data")),
        open: Some(true),
        scenario: Some(scenario.to_str().expect("UTF-8").to_owned()),
        ..Layer::default()
    };
    let up = Settings::from_layers(Role::Up, &[layer]).expect("settings");
    let server = Server::start(&up).await.expect("the server starts");
    let fixture = Fixture::of(server, up);
    let mut pictures = 0;
    for id in ["sim-0001", "sim-0002"] {
        let robot = fixture.wait_told(id).await;
        let capabilities = robot["capabilities"].as_array().expect("a list");
        let has_camera = capabilities.iter().any(|c| c == "camera");
        let commands = format!("/api/v1/robots/{id}/commands");
        let sent = fixture.post(&commands, r#"{"command":"capture"}"#).await;
        assert_eq!(sent.status, 202, "{}", sent.text());
        let address = sent.header("location").to_owned();
        eventually("an outcome", async || {
            let status = fixture.get(&address).await.json()["status"].clone();
            status != "pending" && status != "accepted"
        })
        .await;
        let outcome = fixture.get(&address).await.json();
        let image = fixture.get(&format!("/api/v1/robots/{id}/image")).await;
        if has_camera {
            assert_eq!(outcome["status"], "completed", "{outcome}");
            assert_eq!(image.status, 200);
            assert!(image.body.len() > 2_000, "{} bytes", image.body.len());
            assert_eq!(image.header("x-image-frame"), "1");
            let taken: u64 = image.header("x-image-timestamp").parse().expect("a time");
            assert!(taken > 1_767_225_600_000, "a clock that is set");
            pictures += 1;
        } else {
            assert_eq!(outcome["reason"], "unsupported", "{outcome}");
            image.is_problem(404, "no_image");
        }
    }
    assert_eq!(pictures, 1);
    fixture.stop().await;
}
