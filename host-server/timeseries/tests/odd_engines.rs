//! Engines that are none, or say more than they should.

use std::time::Duration;

use crawler_history::Sample;
use crawler_protocol::{RobotId, RobotState};
use crawler_timeseries::{EngineError, Product, Remote, State, look};
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpSocket};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::PrivateKeyDer;

const PATIENCE: Duration = Duration::from_mins(1);

/// The head and the body of a request.
async fn request(stream: &mut (impl AsyncRead + Unpin)) -> Option<String> {
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        head.push(stream.read_u8().await.ok()?);
    }
    let head = String::from_utf8(head).ok()?.to_lowercase();
    let length = head
        .split_once("content-length: ")
        .and_then(|(_, rest)| rest.split("\r\n").next()?.parse().ok())
        .unwrap_or(0);
    let mut body = vec![0; length];
    stream.read_exact(&mut body).await.ok()?;
    Some(head)
}

async fn serve(stream: &mut (impl AsyncRead + AsyncWrite + Unpin), answer: fn(&str) -> String) {
    while let Some(head) = request(stream).await {
        if stream.write_all(answer(&head).as_bytes()).await.is_err() {
            break;
        }
    }
}

/// Serves what `answer` makes of each request, and returns the address.
async fn engine(answer: fn(&str) -> String) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("an address");
    tokio::spawn(async move {
        while let Ok((mut stream, _)) = listener.accept().await {
            tokio::spawn(async move {
                serve(&mut stream, answer).await;
            });
        }
    });
    format!("influx://{address}/fleet")
}

fn reply(status: &str, headers: &str, body: &str) -> String {
    let length = body.len();
    format!("HTTP/1.1 {status}\r\n{headers}content-length: {length}\r\n\r\n{body}")
}

fn sample() -> Sample {
    Sample {
        robot: RobotId::new("sim-1").expect("a robot id"),
        at: 1,
        x: 0.0,
        y: 0.0,
        theta: 0.0,
        range_mm: None,
        battery_mv: 0,
        battery_percent: 0,
        rssi: None,
        left: 0.0,
        right: 0.0,
        state: RobotState::Idle,
    }
}

fn start(url: &str) -> Remote {
    Remote::start(url.parse().expect("an address"), "swarm", 100).expect("begins")
}

async fn until(what: &str, ready: impl Fn() -> bool) {
    let waiting = async {
        while !ready() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    let done = tokio::time::timeout(PATIENCE, waiting).await;
    assert!(done.is_ok(), "gave up: {what}");
}

#[tokio::test]
async fn an_engine_whose_language_is_not_known_is_written_to() {
    let url = engine(|head| {
        if head.starts_with("get /ping") || head.starts_with("post /write?db=fleet&precision=ms ") {
            reply("204 No Content", "Server: questDB/1.0\r\n", "")
        } else {
            reply("404 Not Found", "", "")
        }
    })
    .await;
    let seen = look(&url.parse().expect("an address"))
        .await
        .expect("there");
    assert_eq!((seen.product, seen.dialect), (Product::QuestDb, None));
    let remote = start(&url);
    remote.push(sample()).expect("room");
    let flushed = tokio::time::timeout(PATIENCE, remote.flush()).await;
    assert_eq!(flushed, Ok(Ok(())));
    assert_eq!(remote.stats().written, 1);
    let asked = remote.query(&sample().robot, 0, 10, 1).await;
    assert_eq!(asked, Err(EngineError::Unreadable));
    remote.close().await;
}

#[tokio::test]
async fn a_token_is_shown_and_what_makes_no_database_is_not_asked_to() {
    let url = engine(|head| {
        let let_in = head.contains("authorization: token s3cret\r\n");
        match head.split(' ').nth(1) {
            Some("/ping") => reply("204 No Content", "X-Influxdb-Version: v2.7.1\r\n", ""),
            Some(_) if !let_in => reply("401 Unauthorized", "", "{\"message\":\"who?\"}"),
            Some(path) if path.contains("create") => reply("400 Bad Request", "", "no"),
            Some(path) if path.starts_with("/query?db=fleet&epoch=ms&q=select") => {
                reply("200 OK", "", "{\"results\":[{\"statement_id\":0}]}")
            }
            _ => reply("404 Not Found", "", ""),
        }
    })
    .await;
    let remote = start(&format!("{url}?token=s3cret"));
    until("let in", || remote.state() == State::Up).await;
    let product = remote.engine().map(|engine| engine.product);
    assert_eq!(product, Some(Product::InfluxDb("2.7.1".into())));
    let denied = look(&url.parse().expect("an address")).await;
    assert_eq!(denied, Err(EngineError::Denied("who?".into())));
    remote.close().await;
}

#[tokio::test]
async fn what_is_no_engine_is_not_believed() {
    let page = |_: &str| reply("200 OK", "", "<html>\r\nwelcome</html>");
    let url = engine(page).await;
    let seen = look(&url.parse().expect("an address")).await;
    assert!(matches!(seen, Err(EngineError::Nonsense(_))), "{seen:?}");
    let quiet = engine(|_| reply("204 No Content", "", "")).await;
    let seen = look(&quiet.parse().expect("an address")).await;
    let seen = seen.map(|engine| (engine.product, engine.dialect));
    assert_eq!(seen, Ok((Product::Unknown, None)));
    // One that is asked must answer.
    let asked = format!("{quiet}?read=influxql");
    let seen = look(&asked.parse().expect("an address")).await;
    assert!(matches!(seen, Err(EngineError::Nonsense(_))), "{seen:?}");

    let lost = engine(|_| reply("301 Moved", "Location: http://elsewhere/\r\n", "")).await;
    let seen = look(&lost.parse().expect("an address")).await;
    assert!(matches!(seen, Err(EngineError::Nonsense(_))), "{seen:?}");

    let noise = engine(|_| "\u{1}\u{2}\u{3}\r\n\r\n".to_owned()).await;
    let seen = look(&noise.parse().expect("an address")).await;
    assert!(matches!(seen, Err(EngineError::Unreachable(_))), "{seen:?}");

    // A port that is taken and not listened at: nobody else is given it.
    let nobody = TcpSocket::new_v4().expect("a socket");
    let any = "127.0.0.1:0".parse().expect("an address");
    nobody.bind(any).expect("a port");
    let address = nobody.local_addr().expect("an address");
    let gone = format!("influx://{address}/fleet");
    let seen = look(&gone.parse().expect("an address")).await;
    assert!(matches!(seen, Err(EngineError::Unreachable(_))), "{seen:?}");
}

#[tokio::test]
async fn an_answer_without_end_is_cut_off() {
    let url = engine(|head| {
        if head.starts_with("get /query") {
            reply("200 OK", "", &" ".repeat(33 * 1024 * 1024))
        } else {
            reply("204 No Content", "X-Influxdb-Version: 3.0\r\n", "")
        }
    })
    .await;
    let seen = look(&url.parse().expect("an address")).await;
    let error = seen.expect_err("too long").to_string();
    assert!(error.contains("longer than"), "{error}");
}

#[tokio::test]
async fn an_engine_that_is_silent_is_given_up() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("an address");
    let address = format!("influx://{address}/fleet")
        .parse()
        .expect("an address");
    let seen = tokio::time::timeout(PATIENCE, look(&address)).await;
    let seen = seen.expect("an end");
    assert!(
        matches!(&seen, Err(EngineError::Unreachable(why)) if why.contains("within 5 s")),
        "{seen:?}"
    );
    drop(listener);
}

#[tokio::test]
async fn an_engine_that_cannot_for_now_is_tried_again() {
    static BUSY: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(3);
    let url = engine(|head| {
        let busy = |n: u32| n.checked_sub(1);
        let order = std::sync::atomic::Ordering::SeqCst;
        if head.starts_with("post /write") && BUSY.fetch_update(order, order, busy).is_ok() {
            reply("503 Service Unavailable", "", "later")
        } else {
            reply("204 No Content", "", "")
        }
    })
    .await;
    let remote = start(&url);
    remote.push(sample()).expect("room");
    let flushed = tokio::time::timeout(PATIENCE, remote.flush()).await;
    assert_eq!(flushed, Ok(Ok(())));
    let stats = remote.stats();
    assert_eq!(
        (stats.failures, stats.written, stats.refused),
        (3, 1, 0),
        "{stats:?}"
    );
    remote.close().await;
}

#[tokio::test]
async fn an_engine_with_tls_is_trusted_by_who_vouches_for_it() {
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).expect("a certificate");
    let key = PrivateKeyDer::try_from(made.signing_key.serialize_der()).expect("a key");
    let config = ServerConfig::builder_with_provider(ring::default_provider().into())
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_no_client_auth()
        .with_single_cert(vec![made.cert.der().clone()], key)
        .expect("a configuration");
    let acceptor = TlsAcceptor::from(std::sync::Arc::new(config));
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let port = listener.local_addr().expect("an address").port();
    tokio::spawn(async move {
        while let Ok((stream, _)) = listener.accept().await {
            let acceptor = acceptor.clone();
            tokio::spawn(async move {
                // Who does not trust us goes away.
                if let Ok(mut stream) = acceptor.accept(stream).await {
                    serve(&mut stream, |_| reply("204 No Content", "", "")).await;
                }
            });
        }
    });
    let ca = std::env::temp_dir().join(format!("crawler-timeseries-{}.pem", std::process::id()));
    std::fs::write(&ca, made.cert.pem()).expect("a file");
    let at = |host: &str| {
        let url = format!("influxs://{host}:{port}/fleet?ca={}", ca.display());
        url.parse().expect("an address")
    };
    let seen = look(&at("localhost")).await;
    let seen = seen.map(|engine| engine.product);
    assert_eq!(seen, Ok(Product::Unknown));
    let seen = look(&at("127.0.0.1")).await;
    assert!(
        matches!(seen, Err(EngineError::Certificates(_))),
        "{seen:?}"
    );
    std::fs::write(&ca, "nothing").expect("a file");
    let seen = look(&at("localhost")).await;
    assert!(
        matches!(seen, Err(EngineError::Certificates(_))),
        "{seen:?}"
    );
    std::fs::remove_file(&ca).expect("removed");
    let seen = look(&at("localhost")).await;
    assert!(
        matches!(seen, Err(EngineError::Certificates(_))),
        "{seen:?}"
    );
}
