//! TLS over real connections: whom clients trust, what they get when something is wrong, and how
//! certificates are replaced.

#[path = "support/log.rs"]
mod log;
mod support;
#[path = "support/tls.rs"]
mod tls;

use std::path::Path;
use std::time::{Duration, Instant};

use crawler_server::config::{Layer, Role, Settings, TlsMode};
use crawler_server::server::{Robots, Server};
use log::Log;
use support::{FakeRobot, Fixture, Scratch, eventually, settings, within};
use tls::{Made, get, make, pipe, shake, trust, trust_in};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

fn on(layer: &mut Layer) {
    layer.tls = Some(TlsMode::On);
}

fn authority(fixture: &Fixture) -> std::path::PathBuf {
    fixture.settings.data.join("tls/ca.pem")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_pinned_the_authority_gets_through_and_no_other() {
    let fixture = Fixture::start_with(|layer| {
        on(layer);
        layer.tls_names = Some("robots.example".parse().expect("name"));
    })
    .await;
    assert!(fixture.server.https());
    assert_eq!(fixture.server.authority(), Some(&*authority(&fixture)));
    let address = fixture.server.http();
    let pinned = trust(&authority(&fixture));
    for name in ["localhost", "127.0.0.1", "::1", "robots.example"] {
        let (status, _) = get(address, &pinned, name, "/healthz").await.expect(name);
        assert_eq!(status, 200, "{name}");
    }
    // The certificate is for no other name, and the client knows no other authority.
    let other_name = get(address, &pinned, "other.example", "/healthz").await;
    assert!(format!("{:?}", other_name.expect_err("name")).contains("NotValidForName"));
    let stranger = Scratch::new();
    make(&stranger.0, "other", Made::default());
    let other = trust(&stranger.0.join("other.pem"));
    let unknown = get(address, &other, "localhost", "/healthz").await;
    assert!(format!("{:?}", unknown.expect_err("unknown")).contains("UnknownIssuer"));

    // The live feed comes the same way.
    let stream = shake(address, &pinned, "localhost").await.expect("TLS");
    let url = format!("wss://localhost:{}/api/v1/live", address.port());
    let (mut feed, _) = tokio_tungstenite::client_async(url, stream)
        .await
        .expect("a feed");
    let first = futures_util::StreamExt::next(&mut feed).await;
    assert!(matches!(first, Some(Ok(_))), "{first:?}");
    drop(feed);
    fixture.stop().await;
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn keys_are_private_and_everything_survives_a_restart() {
    use std::os::unix::fs::PermissionsExt as _;
    let scratch = Scratch::new();
    let settings = settings(&scratch, on);
    let dir = scratch.0.join("tls");
    let mode = |name: &str| {
        let data = std::fs::metadata(dir.join(name)).expect(name);
        data.permissions().mode() & 0o777
    };
    let read = |name: &str| std::fs::read(dir.join(name)).expect(name);

    Server::start(&settings).await.expect("start").stop().await;
    for key in ["ca.key", "server.key"] {
        assert_eq!(mode(key), 0o600, "{key}");
    }
    assert_eq!(mode(""), 0o700);
    let before = ["ca.pem", "ca.key", "server.pem", "server.key"].map(read);

    // Somebody is careless with a key.
    let careless = std::fs::Permissions::from_mode(0o644);
    std::fs::set_permissions(dir.join("ca.key"), careless).expect("ours");
    Server::start(&settings).await.expect("again").stop().await;
    assert_eq!(mode("ca.key"), 0o600);
    let after = ["ca.pem", "ca.key", "server.pem", "server.key"].map(read);
    assert_eq!(before, after);

    // An authority that clients have pinned is never replaced in silence.
    std::fs::remove_file(dir.join("ca.key")).expect("ours");
    let error = Server::start(&settings).await.err().expect("half of it");
    assert!(error.to_string().contains("ca.key is missing"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_expired_certificate_is_made_anew_at_the_start() {
    let scratch = Scratch::new();
    let settings = settings(&scratch, on);
    Server::start(&settings).await.expect("start").stop().await;
    let dir = scratch.0.join("tls");
    let old = Made {
        from: (2020, 1, 1),
        until: (2021, 1, 1),
        ..Made::default()
    };
    make(&dir, "server", old);
    let server = Server::start(&settings).await.expect("start");
    let pinned = trust(&dir.join("ca.pem"));
    let (status, _) = get(server.http(), &pinned, "localhost", "/healthz")
        .await
        .expect("a new certificate");
    assert_eq!(status, 200);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_without_tls_is_told_or_hung_up_on() {
    let fixture = Fixture::start_with(on).await;
    let mqtt = ("127.0.0.1", fixture.server.mqtt().port);
    let mut plain = TcpStream::connect(fixture.server.http())
        .await
        .expect("connect");
    plain
        .write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n")
        .await
        .expect("sent");
    let mut answer = String::new();
    let read = within("an answer", plain.read_to_string(&mut answer)).await;
    read.expect("text");
    assert!(answer.starts_with("HTTP/1.1 400 "), "{answer}");
    let (head, body) = answer.split_once("\r\n\r\n").expect("head and body");
    assert!(body.contains("https://"), "{body}");
    assert!(head.contains(&format!("content-length: {}\r\n", body.len())));

    // Who says nothing is waited for.
    let mut silent = TcpStream::connect(mqtt).await.expect("connect");
    let mut plain = TcpStream::connect(mqtt).await.expect("connect");
    plain
        .write_all(b"\x10\x0d\0\x04MQTT\x05\x02\0\x05\0\0\0")
        .await
        .expect("sent");
    let mut answer = Vec::new();
    let mut nothing = Vec::new();
    within("hung up on", async {
        tokio::select! {
            biased;
            // Closed or reset: there is no session in either case.
            _ = plain.read_to_end(&mut answer) => {}
            _ = silent.read_to_end(&mut nothing) => panic!("not before who says nothing"),
        }
    })
    .await;
    assert!(answer.is_empty(), "{answer:?}");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_takes_too_long_is_dropped_and_keeps_out_nobody() {
    /// For a whole handshake.
    const GIVEN: Duration = Duration::from_secs(10);
    let fixture = Fixture::start_with(on).await;
    let http = fixture.server.http();
    let mqtt = ([127, 0, 0, 1], fixture.server.mqtt().port).into();
    let pinned = trust(&authority(&fixture));
    // Where the machine is so slow that they are dropped before it comes to somebody who speaks,
    // it shows nothing, and is tried again.
    let mut rounds = 0;
    let (began, slow) = loop {
        rounds += 1;
        assert!(rounds <= 3, "who speaks waits for those who do not");
        let began = Instant::now();
        let mut slow = Vec::new();
        for address in [http, mqtt] {
            for said in [&b""[..], &b"\x16"[..], &b"\x16\x03\x01\x02\0\x01"[..]] {
                let mut tcp = TcpStream::connect(address).await.expect("connect");
                tcp.write_all(said).await.expect("sent");
                slow.push(tcp);
            }
        }
        let answer = get(http, &pinned, "localhost", "/healthz");
        let (status, _) = within("an answer", answer).await.expect("TLS");
        assert_eq!(status, 200);
        if began.elapsed() < GIVEN {
            break (began, slow);
        }
    };
    for mut tcp in slow {
        let mut rest = Vec::new();
        // Closed or reset.
        let _ = within("dropped", tcp.read_to_end(&mut rest)).await;
        assert!(began.elapsed() >= GIVEN, "all are given time");
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_works_over_tls_and_others_over_a_listener_without() {
    let fixture = Fixture::start_with(|layer| {
        on(layer);
        layer.mqtt_plain = Some("127.0.0.1:0".parse().expect("address"));
    })
    .await;
    let mqtt = fixture.server.mqtt();
    assert!(mqtt.tls && mqtt.to_string().starts_with("mqtts://127.0.0.1:"));
    let pinned = trust(&authority(&fixture));
    let port = pipe(mqtt.port, &pinned).await;
    let robot = FakeRobot::connect(port, "rb-1", "rb-1").await;
    robot.introduce().await;
    wait_online(&fixture, &pinned, "rb-1").await;
    robot.vanish().await;
    eventually("its will is published", async || {
        robot_of(&fixture, &pinned, "rb-1")
            .await
            .contains(r#""presence":"offline""#)
    })
    .await;
    fixture.stop().await;
}

async fn robot_of(fixture: &Fixture, pinned: &tls::Trust, id: &str) -> String {
    let path = format!("/api/v1/robots/{id}");
    let answer = get(fixture.server.http(), pinned, "localhost", &path).await;
    answer.expect("an answer").1
}

async fn wait_online(fixture: &Fixture, pinned: &tls::Trust, id: &str) {
    eventually("online", async || {
        robot_of(fixture, pinned, id)
            .await
            .contains(r#""presence":"online""#)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn simulated_robots_and_another_server_use_a_broker_with_tls() {
    let fixture = Fixture::start_with(on).await;
    let pinned = trust(&authority(&fixture));
    let url = format!("mqtts://localhost:{}", fixture.server.mqtt().port);
    let sim = |ca: Option<&Path>| {
        let layer = Layer {
            broker: Some(url.parse().expect("url")),
            broker_ca: ca.map(Path::to_owned),
            scenario: Some("empty".into()),
            robots: Some(3),
            ..Layer::default()
        };
        Settings::from_layers(Role::Sim, &[layer]).expect("settings")
    };
    // Of the authorities of this machine none knows that broker.
    let error = Robots::start(&sim(None)).await.err().expect("not trusted");
    let error = error.to_string();
    assert!(
        error.contains("mqtts://localhost") && error.contains("--broker-ca"),
        "{error}"
    );

    let robots = Robots::start(&sim(Some(&authority(&fixture))))
        .await
        .expect("robots");
    assert_eq!(robots.count(), 3);
    eventually("all are online", async || {
        let answer = get(
            fixture.server.http(),
            &pinned,
            "localhost",
            "/api/v1/robots",
        )
        .await;
        answer
            .expect("an answer")
            .1
            .matches(r#""presence":"online""#)
            .count()
            == 3
    })
    .await;

    let ca = authority(&fixture);
    let second = Fixture::start_with(|layer| {
        layer.mqtt = None;
        layer.broker = Some(url.parse().expect("url"));
        layer.broker_ca = Some(ca);
    })
    .await;
    eventually("the second server knows them, too", async || {
        second
            .get("/api/v1/robots")
            .await
            .text()
            .matches(r#""presence":"online""#)
            .count()
            == 3
    })
    .await;
    second.stop().await;
    robots.stop().await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_of_the_same_process_need_no_tls() {
    let fixture = Fixture::up("empty", |layer| {
        on(layer);
        layer.robots = Some(2);
    })
    .await;
    let pinned = trust(&authority(&fixture));
    eventually("both are online", async || {
        let answer = get(
            fixture.server.http(),
            &pinned,
            "localhost",
            "/api/v1/robots",
        )
        .await;
        answer
            .expect("an answer")
            .1
            .matches(r#""presence":"online""#)
            .count()
            == 2
    })
    .await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn certificates_of_the_user_are_read_again_when_they_change() {
    let log = Log::shared();
    let files = Scratch::new();
    make(&files.0, "server", Made::default());
    let certificate = files.0.join("server.pem");
    let fixture = Fixture::start_with(|layer| {
        on(layer);
        layer.tls_certificate = Some(certificate.clone());
        layer.tls_key = Some(files.0.join("server.key"));
    })
    .await;
    let http = fixture.server.http();
    assert_eq!(fixture.server.authority(), None);
    assert!(!authority(&fixture).exists());
    std::fs::copy(&certificate, files.0.join("first.pem")).expect("ours");
    // A client that was there before resumes its session and asks for no certificate.
    let served = async |name: &str| {
        let fresh = trust(&files.0.join(name));
        get(http, &fresh, "localhost", "/healthz").await.is_ok()
    };
    assert!(served("first.pem").await);

    // Half a change, as long as it lasts, changes nothing.
    make(&files.0, "next", Made::default());
    std::fs::copy(files.0.join("next.pem"), &certificate).expect("ours");
    let name = certificate.display().to_string();
    eventually("it is looked at", async || {
        log.has(&["the old one stays", "not that of the certificate", &name])
    })
    .await;
    assert!(served("first.pem").await && !served("next.pem").await);
    std::fs::copy(files.0.join("next.key"), files.0.join("server.key")).expect("ours");
    eventually("the next is served", async || served("next.pem").await).await;
    assert!(!served("first.pem").await);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_with_certificates_is_said_at_the_start() {
    let files = Scratch::new();
    make(&files.0, "good", Made::default());
    make(&files.0, "other", Made::default());
    let old = Made {
        until: (2021, 3, 4),
        ..Made::default()
    };
    make(&files.0, "old", old);
    std::fs::write(files.0.join("nonsense"), "nonsense").expect("ours");
    for (certificate, key, expected) in [
        ("good.pem", "absent", "absent"),
        ("good.pem", "other.key", "is not that of the certificate"),
        ("good.pem", "good.pem", "holds no private key"),
        ("good.key", "good.key", "holds no certificate"),
        ("nonsense", "good.key", "holds no certificate"),
        ("old.pem", "old.key", "expired on 2021-03-04"),
    ] {
        let scratch = Scratch::new();
        let settings = settings(&scratch, |layer| {
            on(layer);
            layer.tls_certificate = Some(files.0.join(certificate));
            layer.tls_key = Some(files.0.join(key));
        });
        let error = Server::start(&settings)
            .await
            .err()
            .expect(expected)
            .to_string();
        assert!(error.contains(expected), "{certificate}, {key}: {error}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn certificates_of_robots_are_verified_where_they_are_shown() {
    let files = Scratch::new();
    let robot = Made {
        client: true,
        ..Made::default()
    };
    make(&files.0, "robot", robot);
    let stranger = Made {
        client: true,
        ..Made::default()
    };
    make(&files.0, "stranger", stranger);
    let fixture = Fixture::start_with(|layer| {
        on(layer);
        layer.tls_client_ca = Some(files.0.join("robot.pem"));
    })
    .await;
    let mqtt = fixture.server.mqtt().port;
    let pinned = trust(&authority(&fixture));
    let port = pipe(mqtt, &pinned).await;
    FakeRobot::connect(port, "rb-none", "rb-none").await;
    let known = trust_in(&authority(&fixture), Some(&files.0.join("robot")));
    let port = pipe(mqtt, &known).await;
    FakeRobot::connect(port, "rb-known", "rb-known").await;

    let unknown = trust_in(&authority(&fixture), Some(&files.0.join("stranger")));
    let address = ([127, 0, 0, 1], mqtt).into();
    let refused = async {
        // With TLS 1.3 the refusal comes after the client believes that it is through.
        let mut stream = shake(address, &unknown, "localhost").await?;
        stream.read_u8().await
    };
    assert!(within("an answer", refused).await.is_err());
    fixture.stop().await;
}
