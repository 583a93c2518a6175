//! The live feed over a real WebSocket.

use crate::support;
use crate::support::{Fixture, LIMIT, Scratch, eventually, telemetry, within};
use crawler_records::{NewExperiment, Records};
use crawler_server::config::{Layer, Role};
use futures_util::{SinkExt as _, StreamExt as _};
use serde_json::Value;
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

type Socket = WebSocketStream<TcpStream>;

async fn connect(fixture: &Fixture, origin: Option<&str>) -> Result<Socket, Error> {
    let address = fixture.server.http();
    let mut request = format!("ws://{address}/api/v1/live")
        .into_client_request()
        .expect("request");
    if let Some(origin) = origin {
        let headers = request.headers_mut();
        headers.insert("origin", origin.parse().expect("origin"));
    }
    let stream = TcpStream::connect(address).await.expect("connect");
    client_async(request, stream)
        .await
        .map(|(socket, _)| socket)
}

/// The next frame of a kind.
async fn next(socket: &mut Socket, kind: u8) -> Vec<u8> {
    until(socket, kind, |_| true).await
}

/// The next frame of a kind that is the one.
async fn until(socket: &mut Socket, kind: u8, wanted: impl Fn(&[u8]) -> bool) -> Vec<u8> {
    let mut last = None;
    let next = async {
        loop {
            let message = socket.next().await.expect("open").expect("a message");
            if let Message::Binary(frame) = message
                && frame.first() == Some(&kind)
            {
                if wanted(&frame) {
                    return frame.to_vec();
                }
                last = Some(String::from_utf8_lossy(&frame).into_owned());
            }
        }
    };
    tokio::time::timeout(LIMIT, next).await.unwrap_or_else(|_| {
        panic!("no such frame of kind {kind} within {LIMIT:?}; the last was {last:?}")
    })
}

fn json(frame: &[u8]) -> Value {
    serde_json::from_slice(&frame[1..]).expect("JSON")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_comes_first_and_then_what_changes() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_presence("a", "online").await;
    eventually("its pose", async || {
        let told = fixture.get("/api/v1/robots/a").await.json();
        !told["pose"].is_null()
    })
    .await;

    let own = format!("http://{}", fixture.server.http());
    let mut socket = connect(&fixture, Some(&own)).await.expect("our own page");
    let hello = json(&next(&mut socket, 0).await);
    assert_eq!(
        (&hello["protocol"], &hello["fleet"]),
        (&2.into(), &"swarm".into())
    );
    assert_eq!(hello["arena"], Value::Null);
    let roster = json(&next(&mut socket, 1).await);
    assert_eq!(roster["robots"][0]["id"], "a");
    assert_eq!(roster["robots"][0]["kind"], "emulated");
    let poses = next(&mut socket, 2).await;
    assert_eq!(poses[1], 1, "full");
    assert_eq!(poses.len(), 20 + 2 + 8);

    let moved = telemetry("a", 2).replace("1.5", "2.5");
    robot.publish("swarm/telemetry/a", moved).await;
    // On a slow machine the robot may have become stale in between, which is a change too.
    let moved = |poses: &[u8]| {
        let x0 = f32::from_le_bytes(poses[8..12].try_into().expect("four bytes"));
        poses[1] == 0 && (x0 - 2.5).abs() < 0.001
    };
    until(&mut socket, 2, moved).await;
    robot.introduce().await;
    until(&mut socket, 4, |metrics| {
        json(metrics)["robots"]["online"] == 1
    })
    .await;

    robot.vanish().await;
    let event = json(&until(&mut socket, 3, |event| json(event)["text"] == "offline").await);
    assert_eq!(
        (&event["robot"], &event["level"]),
        (&"a".into(), &"warn".into())
    );
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_others_get_nothing() {
    let fixture = Fixture::start().await;
    match connect(&fixture, Some("https://evil.example")).await {
        Err(Error::Http(response)) => assert_eq!(response.status(), 403),
        other => panic!("{other:?}"),
    }
    fixture.stop().await;
}

/// The code and reason with which the server closes.
async fn closed(socket: &mut Socket) -> (u16, String) {
    let end = async {
        loop {
            match socket.next().await {
                Some(Ok(Message::Close(Some(close)))) => {
                    return (close.code.into(), close.reason.to_string());
                }
                Some(Ok(_)) => {}
                other => panic!("{other:?}"),
            }
        }
    };
    within("the server closes", end).await
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_speaks_is_told_off() {
    let fixture = Fixture::start().await;
    let mut socket = connect(&fixture, None).await.expect("connected");
    socket.send(Message::text("stop")).await.expect("sent");
    let (code, reason) = closed(&mut socket).await;
    assert_eq!(code, 1003);
    assert!(reason.contains("takes no messages"), "{reason}");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn readers_are_told_when_the_server_stops() {
    let fixture = Fixture::start().await;
    let mut socket = connect(&fixture, None).await.expect("connected");
    next(&mut socket, 0).await;
    let ((), (code, reason)) = tokio::join!(fixture.stop(), closed(&mut socket));
    assert_eq!((code, reason.as_str()), (1001, "the server stops"));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_number_of_readers_is_bounded() {
    let fixture = Fixture::start().await;
    let mut sockets = Vec::new();
    for _ in 0..64 {
        sockets.push(connect(&fixture, None).await.expect("room"));
    }
    match connect(&fixture, None).await {
        Err(Error::Http(response)) => assert_eq!(response.status(), 503),
        other => panic!("{other:?}"),
    }
    drop(sockets);
    support::eventually("room again", async || connect(&fixture, None).await.is_ok()).await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn experiments_are_told_of() {
    const ALL: &str = "/api/v1/experiments";
    let scratch = Scratch::new();
    let records = Records::open(&scratch.0).await.expect("records");
    let new = NewExperiment {
        kind: crawler_records::ExperimentKind::Evaluation,
        owner: "x".into(),
        name: "of another version".into(),
        build: "0.0.1 (other)".into(),
        recipe:
            r#"{"scenario":"empty","in_each":1,"seeds":3,"first_seed":1,"set":[],"thresholds":[]}"#
                .into(),
        metrics: r#"[{"name":"luck","unit":"share","better":"more"}]"#.into(),
        seeds: 3,
        by: "ada".into(),
        created: 1,
        start: true,
    };
    let old = records.experiments().add(new).await.expect("made").id;
    records.close().await;
    let open = |layer: &mut Layer| layer.open = Some(true);
    let fixture = Fixture::closed_at(scratch, Role::Serve, open).await;
    let state = async |id: &str| fixture.get(&format!("{ALL}/{id}")).await.json();
    let old = old.to_string();
    eventually("it has failed", async || {
        state(&old).await["state"] == "failed"
    })
    .await;
    let reason = state(&old).await["reason"].to_string();
    assert!(reason.contains("0.0.1 (other)"), "{reason}");

    let body = r#"{"name":"new","scenario":"empty","robots":1,"seeds":2,"set":["duration_s=1"]}"#;
    let made = fixture.post(ALL, body).await.json();
    let new = made["id"].as_str().expect("an id");
    eventually("it is complete", async || {
        state(new).await["state"] == "completed"
    })
    .await;
    // Who comes now is told what was.
    let mut socket = connect(&fixture, None).await.expect("connected");
    for (level, begin) in [
        ("error", "experiment “of another version” has failed: "),
        ("info", "experiment “new” begins: 2 trials"),
        ("info", "experiment “new” is completed: "),
    ] {
        let told = |event: &[u8]| {
            json(event)["text"]
                .as_str()
                .is_some_and(|text| text.starts_with(begin))
        };
        let event = json(&until(&mut socket, 3, told).await);
        assert_eq!(
            (&event["level"], &event["robot"]),
            (&level.into(), &Value::Null)
        );
    }
    fixture.stop().await;
}
