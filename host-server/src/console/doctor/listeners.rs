//! Ports, the server behind them, and the broker.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::time::Duration;

use crawler_cluster::Cluster;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};

use super::Finding;
use crate::config::{Broker, BrokerUrl, EngineUrl, Redis, Settings};
use crawler_fleet::bus::{self, Target};
use crawler_server_tls::Tunnel;
use crawler_system::cli_error::{CliError, OrSay as _};

const PATIENCE: Duration = Duration::from_secs(3);
/// The head of an answer fits several times over.
const LONGEST: u64 = 16 * 1024;

/// A CONNECT of MQTT 5 without a name: clean start, keep-alive 5 s, no properties, and a client id
/// that the broker assigns. Any answer shows that a broker is there.
const CONNECT: [u8; 15] = [
    0x10, 13, 0, 4, b'M', b'Q', b'T', b'T', 5, 0x02, 0, 5, 0, 0, 0,
];

pub(super) async fn look(settings: &Settings, running: bool) -> Vec<Finding> {
    let mut findings = vec![exposure(settings)];
    findings.push(if running {
        api(dialled(settings.http), settings.tls.covers(settings.http)).await
    } else {
        free("HTTP port", settings.http, "--http").await
    });
    findings.push(match &settings.broker {
        Broker::Embedded(listen) if running => {
            embedded(dialled(*listen), settings.tls.covers(*listen)).await
        }
        Broker::Embedded(listen) => free("MQTT port", *listen, "--mqtt").await,
        Broker::Outside(url) => match outside(settings, url).await {
            Ok(()) => Finding::ok("broker", format!("{url} takes the server")),
            Err(reason) => Finding::fail(
                "broker",
                format!("{url}: {reason}"),
                "is it running, reachable from here, and does it know this user and password?",
            ),
        },
    });
    if let Some(url) = &settings.cache {
        findings.push(cache(url).await);
    }
    findings
}

/// Asks Redis, as the server does.
async fn cache(url: &EngineUrl<Redis>) -> Finding {
    const WHAT: &str = "cache";
    // A name that nobody has: nothing is changed.
    let asked = async {
        let cluster = Cluster::open(url.reveal(), "doctor", Cluster::new_name()?)?;
        cluster.mine().await
    };
    match asked.await {
        Ok(_) => Finding::ok(WHAT, format!("{url} answers")),
        Err(error) => Finding::fail(
            WHAT,
            format!("{url}: {error}"),
            "is Redis running, reachable from here, and does it know this user and password?",
        ),
    }
}

/// Connects to an outside broker as the server does.
async fn outside(settings: &Settings, url: &BrokerUrl) -> Result<(), CliError> {
    // It lives as long as the connection needs it.
    let tunnel = if url.tls {
        let opened = Tunnel::open(url, settings.tls.broker_ca.as_deref()).await;
        Some(opened.or_say(|reason| format!("the broker at {url} cannot be used: {reason}"))?)
    } else {
        None
    };
    let inside = tunnel.as_ref().map_or(url, Tunnel::inside);
    let target =
        Target::outside(inside).map_err(|_| CliError::new("internal error: no randomness"))?;
    Ok(bus::connect(&target, &settings.fleet).await.map(drop)?)
}

/// Who can reach the server, and what they need.
fn exposure(settings: &Settings) -> Finding {
    const WHAT: &str = "access";
    let exposed = settings.exposed();
    match (settings.open, exposed.is_empty()) {
        (true, false) => Finding::fail(
            WHAT,
            "other machines reach the server, and it is open: everybody can steer",
            "remove --open, and make accounts: docs/operate.md",
        ),
        (true, true) => Finding::warn(
            WHAT,
            "open: everybody on this machine can steer",
            "fine for trying; otherwise remove --open",
        ),
        (false, true) => Finding::ok(WHAT, "accounts and credentials, this machine only"),
        (false, false) => Finding::ok(WHAT, "accounts and credentials, other machines can connect"),
    }
}

/// Where to find a listener from here.
fn dialled(listen: SocketAddr) -> SocketAddr {
    let ip = match listen.ip() {
        ip if !ip.is_unspecified() => ip,
        IpAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
    };
    SocketAddr::new(ip, listen.port())
}

/// Whether a port can be had.
async fn free(what: &'static str, address: SocketAddr, option: &str) -> Finding {
    match TcpListener::bind(address).await {
        Ok(_) => Finding::ok(what, format!("{address} is free")),
        Err(error) => judge_bind(what, address, option, error.kind(), &error.to_string()),
    }
}

fn judge_bind(
    what: &'static str,
    address: SocketAddr,
    option: &str,
    kind: io::ErrorKind,
    text: &str,
) -> Finding {
    let advice = match kind {
        io::ErrorKind::AddrInUse => format!(
            "another program has it (`ss -ltnp 'sport = :{}'` names it): stop that, or use {option}",
            address.port()
        ),
        io::ErrorKind::PermissionDenied => format!(
            "ports below 1024 take CAP_NET_BIND_SERVICE (docs/operate.md), or another port with {option}"
        ),
        io::ErrorKind::AddrNotAvailable => {
            format!("this machine has no such address: correct {option}")
        }
        _ => format!("correct {option}"),
    };
    Finding::fail(what, format!("{address}: {text}"), advice)
}

/// Asks the running server whether it is ready.
async fn api(address: SocketAddr, tls: bool) -> Finding {
    const WHAT: &str = "API";
    const ADVICE: &str = "its log says why; are --http and the file the same as the server's?";
    if address.port() == 0 {
        return Finding::ok(WHAT, "at a port of its choice: not looked at");
    }
    match tokio::time::timeout(PATIENCE, ready(address)).await {
        Err(_) => Finding::fail(
            WHAT,
            format!("{address} gives no answer within 3 s"),
            ADVICE,
        ),
        Ok(Err(error)) => Finding::fail(WHAT, format!("{address}: {error}"), ADVICE),
        // What a listener with TLS says to those who do without.
        Ok(Ok(400)) if tls => Finding::ok(WHAT, format!("{address} answers, over TLS alone")),
        Ok(Ok(200)) => Finding::ok(WHAT, format!("{address} is ready")),
        Ok(Ok(503)) => Finding::fail(
            WHAT,
            format!("{address} answers, but is not ready"),
            "GET /readyz says what is missing; most likely the broker",
        ),
        Ok(Ok(status)) => Finding::warn(
            WHAT,
            format!("{address} answers with status {status}"),
            "is that this server, or a proxy?",
        ),
    }
}

async fn ready(address: SocketAddr) -> io::Result<u16> {
    let mut stream = TcpStream::connect(address).await?;
    stream
        .write_all(b"GET /readyz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        .await?;
    let mut answer = Vec::new();
    stream.take(LONGEST).read_to_end(&mut answer).await?;
    status(&answer).ok_or_else(|| io::Error::other("what answers is no HTTP server"))
}

/// The status of an answer.
fn status(answer: &[u8]) -> Option<u16> {
    let line = answer.split(|byte| *byte == b'\r').next()?;
    let line = std::str::from_utf8(line).ok()?;
    line.strip_prefix("HTTP/1.")?
        .split(' ')
        .nth(1)?
        .parse()
        .ok()
}

/// Asks the embedded broker of the running server for any answer.
async fn embedded(address: SocketAddr, tls: bool) -> Finding {
    const WHAT: &str = "broker";
    const ADVICE: &str = "its log says why; are --mqtt and the file the same as the server's?";
    if address.port() == 0 {
        return Finding::ok(WHAT, "at a port of its choice: not looked at");
    }
    let asked = async {
        let mut stream = TcpStream::connect(address).await?;
        if tls {
            // It would hang up on those who do without.
            return Ok(0x20);
        }
        stream.write_all(&CONNECT).await?;
        let mut first = [0];
        stream.read_exact(&mut first).await?;
        Ok::<_, io::Error>(first[0])
    };
    match tokio::time::timeout(PATIENCE, asked).await {
        // CONNACK, whatever it says: strangers are refused.
        Ok(Ok(0x20)) => Finding::ok(WHAT, format!("{address} answers")),
        Ok(Ok(_)) => Finding::fail(WHAT, format!("{address} does not speak MQTT"), ADVICE),
        Ok(Err(error)) => Finding::fail(WHAT, format!("{address}: {error}"), ADVICE),
        Err(_) => Finding::fail(
            WHAT,
            format!("{address} gives no answer within 3 s"),
            ADVICE,
        ),
    }
}

#[cfg(test)]
mod tests {
    use tokio::net::TcpSocket;

    use super::super::Grade;
    use super::*;

    #[test]
    fn answers_are_read() {
        for (answer, expected) in [
            (&b"HTTP/1.1 200 OK\r\n\r\n"[..], Some(200)),
            (
                b"HTTP/1.1 503 Service Unavailable\r\nx: y\r\n\r\n",
                Some(503),
            ),
            (b"SSH-2.0-OpenSSH\r\n", None),
            (b"", None),
            (b"HTTP/1.1\r\n", None),
            (b"HTTP/1.1 \xff\r\n", None),
        ] {
            assert_eq!(status(answer), expected);
        }
    }

    #[tokio::test]
    async fn a_port_in_use_is_found() {
        // Held, so that nobody else is given it, and listened at by nobody: free for a server.
        let socket = TcpSocket::new_v4().expect("a socket");
        socket.set_reuseaddr(true).expect("an option");
        let any = "127.0.0.1:0".parse().expect("an address");
        socket.bind(any).expect("a port");
        let address = socket.local_addr().expect("address");
        assert_eq!(free("HTTP port", address, "--http").await.grade, Grade::Ok);
        let _taken = socket.listen(1).expect("listens");
        let finding = free("HTTP port", address, "--http").await;
        assert_eq!(finding.grade, Grade::Fail);
        assert!(
            finding
                .advice
                .is_some_and(|advice| advice.contains("--http"))
        );
    }

    #[tokio::test]
    async fn what_answers_must_speak_the_language() {
        let stranger = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = stranger.local_addr().expect("address");
        tokio::spawn(async move {
            while let Ok((mut stream, _)) = stranger.accept().await {
                let _ = stream.write_all(b"SSH-2.0-OpenSSH\r\n").await;
            }
        });
        assert_eq!(embedded(address, false).await.grade, Grade::Fail);
        assert_eq!(api(address, false).await.grade, Grade::Fail);
    }
}
