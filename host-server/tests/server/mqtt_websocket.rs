//! MQTT over WebSocket, with real MQTT clients behind a bridge of this test's own.

use std::net::SocketAddr;
use std::time::Duration;

use crate::support::mqtt::{Client, Closed, PASSWORD, refused};
use crate::support::tls;
use crate::support::{Answer, Fixture, eventually, mqtt_options, telemetry, within};
use crawler_access::Role;
use crawler_server::config::TlsMode;
use futures_util::{SinkExt as _, StreamExt as _};
use hyper::Method;
use rumqttc::v5::MqttOptions;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{ConnectReturnCode, PubAckReason, SubscribeReasonCode};
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::handshake::client::Request;
use tokio_tungstenite::tungstenite::{Bytes, Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

fn request(scheme: &str, address: SocketAddr, protocol: Option<&str>) -> Request {
    let url = format!("{scheme}://localhost:{}/mqtt", address.port());
    let mut request = url.into_client_request().expect("request");
    if let Some(protocol) = protocol {
        let value = protocol.parse().expect("a value");
        request
            .headers_mut()
            .insert("sec-websocket-protocol", value);
    }
    request
}

async fn open(fixture: &Fixture) -> WebSocketStream<TcpStream> {
    let address = fixture.server.http();
    let stream = TcpStream::connect(address).await.expect("connect");
    let (socket, answer) = client_async(request("ws", address, Some("mqtt")), stream)
        .await
        .expect("a WebSocket");
    assert_eq!(answer.headers()["sec-websocket-protocol"], "mqtt");
    socket
}

/// What a request for a WebSocket is answered, with headers besides those that ask for it.
async fn answer(fixture: &Fixture, more: &[(&str, &str)]) -> Answer {
    let mut headers = vec![
        ("connection", "upgrade"),
        ("upgrade", "websocket"),
        ("sec-websocket-version", "13"),
        ("sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ=="),
    ];
    headers.extend(more);
    fixture.call(Method::GET, "/mqtt", &headers, "").await
}

/// A CONNECT packet of a client that nobody else is.
fn connect(number: u8) -> Message {
    let mut packet = b"\x10\x11\x00\x04MQTT\x05\x02\x00\x3c\x00\x00\x04w000".to_vec();
    for (place, digit) in format!("{number:03}").bytes().enumerate() {
        packet[16 + place] = digit;
    }
    Message::Binary(packet.into())
}

/// How the bytes of a client are cut into messages.
#[derive(Clone, Copy)]
enum Cut {
    /// As they come.
    AsTheyCome,
    /// Byte by byte.
    Bytes,
    /// What comes within a moment goes together, several packets in one.
    Together,
}

/// Carries bytes between a client that knows no `WebSockets` and the server.
async fn carry<S>(client: TcpStream, socket: WebSocketStream<S>, cut: Cut)
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let (mut sink, mut stream) = socket.split();
    let (mut from, mut to) = client.into_split();
    let there = async {
        let mut chunk = vec![0; 64 * 1024];
        loop {
            if matches!(cut, Cut::Together) {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            let Ok(length @ 1..) = from.read(&mut chunk).await else {
                let _ = sink.close().await;
                return;
            };
            let size = if matches!(cut, Cut::Bytes) { 1 } else { length };
            for piece in chunk[..length].chunks(size) {
                let message = Message::Binary(Bytes::copy_from_slice(piece));
                if sink.send(message).await.is_err() {
                    return;
                }
            }
        }
    };
    let back = async {
        while let Some(Ok(message)) = stream.next().await {
            if let Message::Binary(bytes) = message
                && to.write_all(&bytes).await.is_err()
            {
                return;
            }
        }
    };
    tokio::select! {
        () = there => {}
        () = back => {}
    }
}

/// A port that leads to the server's WebSocket.
async fn bridge(server: SocketAddr, cut: Cut, trust: Option<tls::Trust>) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let port = listener.local_addr().expect("an address").port();
    tokio::spawn(async move {
        while let Ok((client, _)) = listener.accept().await {
            client.set_nodelay(true).expect("an option");
            match &trust {
                None => {
                    let stream = TcpStream::connect(server).await.expect("connect");
                    let opened = client_async(request("ws", server, Some("mqtt")), stream).await;
                    tokio::spawn(carry(client, opened.expect("a WebSocket").0, cut));
                }
                Some(trust) => {
                    let stream = tls::shake(server, trust, "localhost").await.expect("TLS");
                    let opened = client_async(request("wss", server, Some("mqtt")), stream).await;
                    tokio::spawn(carry(client, opened.expect("a WebSocket").0, cut));
                }
            }
        }
    });
    port
}

fn options(port: u16, client_id: &str, user: &str, secret: &str) -> MqttOptions {
    let mut options = mqtt_options(client_id, port);
    options.set_clean_start(true).set_credentials(user, secret);
    options
}

/// What a robot may and may not, whichever way it came.
async fn is_a_robot(closed: &Closed, port: u16, id: &str) {
    let secret = closed.enroll(id).await;
    let mut robot = Client::connect(options(port, id, id, &secret))
        .await
        .expect("let in");
    let own = format!("swarm/telemetry/{id}");
    let told = telemetry(id, 1);
    assert_eq!(robot.publish(&own, &told).await, PubAckReason::Success);
    let foreign = robot.publish("swarm/telemetry/other", &told).await;
    assert_eq!(foreign, PubAckReason::NotAuthorized);
    let granted = robot.subscribe(&format!("swarm/command/robot/{id}")).await;
    assert!(matches!(granted, SubscribeReasonCode::Success(_)));
    let refused = robot.subscribe("swarm/command/robot/other").await;
    assert!(
        !matches!(refused, SubscribeReasonCode::Success(_)),
        "{refused:?}"
    );
    // Longer than what goes into one message of the way back.
    let long = "x".repeat(1_000);
    for _ in 0..10 {
        let topic = format!("swarm/logs/{id}");
        let sent = robot
            .sender
            .publish(topic, QoS::AtLeastOnce, false, long.clone());
        sent.await.expect("room");
    }
    assert_eq!(robot.publish(&own, &told).await, PubAckReason::Success);
    assert!(robot.is_connected());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_is_the_same_however_its_packets_are_cut() {
    let closed = Closed::start().await;
    let server = closed.fixture.server.http();
    for (cut, id) in [
        (Cut::AsTheyCome, "rover-1"),
        (Cut::Bytes, "rover-2"),
        (Cut::Together, "rover-3"),
    ] {
        let port = bridge(server, cut, None).await;
        is_a_robot(&closed, port, id).await;
    }
    // What one of them said was understood.
    closed.person("vera", Role::Viewer).await;
    let mut listener = closed.connect("desk", "vera", PASSWORD).await;
    listener.subscribe("swarm/telemetry/#").await;
    let secret = closed.enroll("rover-4").await;
    let port = bridge(server, Cut::Bytes, None).await;
    let mut robot = Client::connect(options(port, "rover-4", "rover-4", &secret))
        .await
        .expect("let in");
    let told = telemetry("rover-4", 7);
    robot.publish("swarm/telemetry/rover-4", &told).await;
    let heard = listener.message("swarm/telemetry/rover-4").await;
    assert_eq!(heard.payload, told.as_bytes());
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn https_carries_it_too() {
    let fixture = Fixture::start_with(|layer| {
        layer.open = Some(false);
        layer.tls = Some(TlsMode::On);
    })
    .await;
    let trust = tls::trust(&fixture.settings.data.join("tls/ca.pem"));
    let closed = Closed::around(fixture).await;
    let port = bridge(closed.fixture.server.http(), Cut::AsTheyCome, Some(trust)).await;
    is_a_robot(&closed, port, "rover-1").await;
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_is_not_known_is_not_let_in() {
    let closed = Closed::start().await;
    let server = closed.fixture.server.http();
    let port = bridge(server, Cut::AsTheyCome, None).await;
    let secret = closed.enroll("rover-1").await;
    closed.enroll("rover-2").await;
    let bad = ConnectReturnCode::BadUserNamePassword;
    assert_eq!(
        refused(options(port, "rover-1", "rover-1", "guess")).await,
        bad
    );
    assert_eq!(
        refused(options(port, "rover-2", "rover-2", &secret)).await,
        bad
    );
    refused(mqtt_options("x", port)).await;
    // One's own id is needed, as over TCP.
    refused(options(port, "rover-2", "rover-1", &secret)).await;
    is_a_robot(&closed, port, "rover-3").await;
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_is_slowed_down_and_cut_off() {
    let closed = Closed::start().await;
    let port = bridge(closed.fixture.server.http(), Cut::AsTheyCome, None).await;
    let secret = closed.enroll("eve").await;
    let mut eve = Client::connect(options(port, "eve", "eve", &secret))
        .await
        .expect("let in");
    let sender = eve.sender.clone();
    let flood = tokio::spawn(async move {
        loop {
            let sent = sender.publish("swarm/heartbeat/eve", QoS::AtMostOnce, false, "x");
            if sent.await.is_err() {
                return;
            }
        }
    });
    eve.ended().await;
    flood.abort();
    assert!(closed.metric("cut_off_total").await >= 1.0);
    // And stays away, whichever way it comes.
    let over_tcp = closed.refusal("eve", "eve", &secret).await;
    assert_eq!(over_tcp, ConnectReturnCode::NotAuthorized);
    is_a_robot(&closed, port, "rover-1").await;
    closed.stop().await;
}

/// The code with which the server closes.
async fn closed_with(socket: &mut WebSocketStream<TcpStream>) -> u16 {
    let end = async {
        loop {
            match socket.next().await {
                Some(Ok(Message::Close(Some(frame)))) => return frame.code.into(),
                Some(Ok(_)) => {}
                other => panic!("no farewell: {other:?}"),
            }
        }
    };
    within("the server closes", end).await
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_not_mqtt_is_closed_with_a_code() {
    let fixture = Fixture::start().await;
    let mut text = open(&fixture).await;
    text.send(Message::Text("CONNECT".into()))
        .await
        .expect("sent");
    assert_eq!(closed_with(&mut text).await, 1003);

    // The head of a frame says how long it is: one more than the largest packet.
    let mut large = open(&fixture).await;
    let mut head = vec![0x82, 0xFF];
    head.extend((256 * 1024 + 1_u64).to_be_bytes());
    head.extend([0; 4]);
    large.get_mut().write_all(&head).await.expect("sent");
    assert_eq!(closed_with(&mut large).await, 1009);

    // The broker hangs up on what is no CONNECT.
    let mut noise = open(&fixture).await;
    let http = Bytes::from_static(b"GET / HTTP/1.1\r\n\r\n");
    noise.send(Message::Binary(http)).await.expect("sent");
    assert_eq!(closed_with(&mut noise).await, 1000);

    // Whoever says nothing, or only half of it, is sent away.
    let mut silent = open(&fixture).await;
    let mut half = open(&fixture).await;
    let begin = Bytes::from_static(b"\x10\x20\x00\x04MQTT");
    half.send(Message::Binary(begin)).await.expect("sent");
    let codes = tokio::join!(closed_with(&mut silent), closed_with(&mut half));
    assert_eq!(codes, (1008, 1008));
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_server_says_goodbye() {
    let fixture = Fixture::start().await;
    let mut socket = open(&fixture).await;
    socket.send(connect(0)).await.expect("sent");
    let next = within("an answer to CONNECT", socket.next()).await;
    let answer = next.expect("open").expect("a message").into_data();
    assert_eq!((answer[0], answer[3]), (0x20, 0), "CONNACK, success");
    let (code, ()) = tokio::join!(closed_with(&mut socket), fixture.stop());
    assert_eq!(code, 1001);
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_that_cannot_be_met_are_told_why() {
    let fixture = Fixture::start().await;
    answer(&fixture, &[]).await.is_problem(400, "not_mqtt");
    let other = [("sec-websocket-protocol", "wamp")];
    answer(&fixture, &other).await.is_problem(400, "not_mqtt");
    let plain = fixture.get("/mqtt").await;
    plain.is_problem(400, "not_a_websocket");

    // Pages: those of others, and our own.
    let offer = ("sec-websocket-protocol", "wamp, mqtt");
    for origin in ["https://evil.example", "null"] {
        let page = answer(&fixture, &[offer, ("origin", origin)]).await;
        page.is_problem(403, "foreign_origin");
    }
    let own = format!("http://{}", fixture.server.http());
    let page = answer(&fixture, &[offer, ("origin", &own)]).await;
    assert_eq!(page.status, 101, "{}", page.text());
    assert_eq!(page.header("sec-websocket-protocol"), "mqtt");

    let outside = Fixture::start_with(|layer| {
        layer.mqtt = None;
        let url = format!("mqtt://127.0.0.1:{}", fixture.server.mqtt().port);
        layer.broker = Some(url.parse().expect("a broker"));
    })
    .await;
    let elsewhere = answer(&outside, &[offer]).await;
    elsewhere.is_problem(501, "outside_broker");
    outside.get("/mqtt").await.is_problem(501, "outside_broker");
    outside.stop().await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_address_has_a_bounded_number_of_connections() {
    let fixture = Fixture::start().await;
    let address = fixture.server.http();
    let from = |ip: &'static str| async move {
        let socket = TcpSocket::new_v4().expect("a socket");
        let ip: SocketAddr = format!("{ip}:0").parse().expect("an address");
        socket.bind(ip).expect("an address of this machine");
        socket.connect(address).await.expect("connect")
    };
    let mut all = Vec::new();
    for number in 0..128 {
        let opened = client_async(
            request("ws", address, Some("mqtt")),
            from("127.0.0.2").await,
        );
        let mut socket = opened.await.expect("a WebSocket").0;
        // Or it would be sent away after a while.
        socket.send(connect(number)).await.expect("sent");
        all.push(socket);
    }
    let refused = client_async(
        request("ws", address, Some("mqtt")),
        from("127.0.0.2").await,
    );
    match refused.await {
        Err(Error::Http(response)) => assert_eq!(response.status(), 503),
        other => panic!("{other:?}"),
    }
    // The broker sees them all at one address; here they are told apart.
    let other = client_async(
        request("ws", address, Some("mqtt")),
        from("127.0.0.3").await,
    );
    other.await.expect("room for others");
    drop(all);
    eventually("room again", async || {
        let again = client_async(
            request("ws", address, Some("mqtt")),
            from("127.0.0.2").await,
        );
        again.await.is_ok()
    })
    .await;
    fixture.stop().await;
}
