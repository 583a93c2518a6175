//! Clients at the tls of a real broker.

use crawler_protocol::Fleet;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore, crypto};

use super::super::{EmbeddedBroker, Open};
use super::*;
use crawler_server_tls::{CertificateOptions, Certificates};

/// How long a test waits for something that is to happen, however slow the machine is.
const LIMIT: Duration = Duration::from_mins(1);
/// So long that nothing ends by it in a test.
const LONG: Times = Times {
    first_byte: Duration::from_mins(10),
    connect: Duration::from_mins(10),
    answer: Duration::from_mins(10),
};
const SHORT: Times = Times {
    first_byte: Duration::from_millis(200),
    connect: Duration::from_millis(400),
    answer: Duration::from_mins(10),
};
const LET_IN: u8 = 0;

async fn within<T>(what: &str, happening: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, happening)
        .await
        .unwrap_or_else(|_| panic!("not within {LIMIT:?}: {what}"))
}

/// A CONNECT of MQTT 5 with a clean start.
fn connect(id: &str) -> Vec<u8> {
    let mut body = b"\0\x04MQTT\x05\x02\0\x3c\0".to_vec();
    body.extend_from_slice(&(id.len() as u16).to_be_bytes());
    body.extend_from_slice(id.as_bytes());
    [&[0x10, body.len() as u8][..], &body].concat()
}

/// The same, of a client whose session is to be kept for an hour.
fn staying(id: &str) -> Vec<u8> {
    let mut packet = connect(id);
    packet[1] += 5;
    packet.splice(12..13, [5, 0x11, 0, 0, 0x0e, 0x10]);
    packet
}

fn limits(waiting: usize, waiting_of_one: usize, clients: usize, times: Times) -> Limits {
    Limits {
        waiting,
        waiting_of_one,
        clients,
        sessions: 1_000,
        times,
    }
}

struct Bench {
    broker: EmbeddedBroker,
    address: SocketAddr,
}

impl Bench {
    async fn start(limits: Limits) -> Self {
        let fleet = Fleet::new("swarm").expect("a fleet");
        let broker = EmbeddedBroker::start(&fleet, Arc::new(Open), limits).await;
        let broker = broker.expect("a broker");
        let any = "127.0.0.1:0".parse().expect("an address");
        let address = broker.listen(any, None).await.expect("a port");
        Self { broker, address }
    }

    async fn say(&self, bytes: &[u8]) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).await.expect("connect");
        stream.write_all(bytes).await.expect("sent");
        stream
    }

    /// The reason in the CONNACK for a client over a new connection.
    async fn reason(&self, connect: &[u8]) -> (u8, TcpStream) {
        let mut stream = self.say(connect).await;
        let reason = reason(&mut stream).await;
        (reason, stream)
    }

    fn refused(&self, reason: Refusal) -> u64 {
        let handle = self.broker.handle();
        let mut refusals = handle.counters.refusals();
        let found = refusals.find(|(name, _)| *name == reason.name());
        found.expect("every reason").1
    }

    /// Waits until so many are refused for this reason.
    async fn counts(&self, reason: Refusal, count: u64) {
        let counted = async {
            while self.refused(reason) < count {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        within("every refusal is counted", counted).await;
    }
}

/// Reads a CONNACK to its end.
async fn reason(stream: &mut (impl AsyncRead + Unpin)) -> u8 {
    let reading = async {
        let mut head = [0; 2];
        stream.read_exact(&mut head).await.expect("a CONNACK");
        assert_eq!(head[0], CONNACK);
        let mut body = vec![0; usize::from(head[1])];
        stream.read_exact(&mut body).await.expect("a whole CONNACK");
        body[1]
    };
    within("a CONNACK", reading).await
}

/// Waits for the end of a connection, and returns what came until then.
async fn end(stream: &mut (impl AsyncRead + Unpin)) -> Vec<u8> {
    let mut rest = Vec::new();
    // Closed or reset.
    let _ = within("the connection ends", stream.read_to_end(&mut rest)).await;
    rest
}

#[tokio::test(flavor = "multi_thread")]
async fn who_does_not_say_in_time_who_it_is_is_closed() {
    let bench = Bench::start(limits(100, 100, 100, SHORT)).await;
    let whole = connect("wheely");
    let half = &whole[..whole.len() - 1];
    for (count, said) in [&b""[..], &b"\x10"[..], half].into_iter().enumerate() {
        let mut stream = bench.say(said).await;
        assert_eq!(end(&mut stream).await, b"", "{said:?}");
        assert_eq!(bench.refused(Refusal::Silent), count as u64 + 1);
    }
    // A byte now and then does not help.
    let mut slow = bench.say(b"\x10").await;
    let (mut read, mut write) = slow.split();
    let dripping = async {
        for byte in whole[1..].iter().cycle() {
            if write.write_all(&[*byte]).await.is_err() {
                break;
            }
            tokio::time::sleep(SHORT.connect / 4).await;
        }
    };
    tokio::select! {
        rest = end(&mut read) => assert_eq!(rest, b""),
        () = dripping => {}
    }
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_is_silent_before_or_after_tls_is_closed() {
    let scratch = std::env::temp_dir().join(format!("crawler-edge-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&scratch);
    let options = CertificateOptions {
        names: vec!["localhost".to_owned()],
        dir: scratch.clone(),
        ..CertificateOptions::default()
    };
    let now = (crawler_system::clock::unix_ms() / 1_000) as i64;
    let certificates = Certificates::open(&options, now).expect("certificates");
    let acceptor = certificates.acceptor(tls::MQTT, None).expect("TLS");
    let tls = TlsHandshake::new(acceptor).within(Duration::from_millis(400));
    let bench = Bench::start(limits(100, 100, 100, SHORT)).await;
    let any = "127.0.0.1:0".parse().expect("an address");
    let address = bench.broker.listen(any, Some(tls)).await.expect("a port");

    for said in [&b""[..], b"\x16\x03\x01\x02\0\x01"] {
        let mut stream = TcpStream::connect(address).await.expect("connect");
        stream.write_all(said).await.expect("sent");
        end(&mut stream).await;
    }
    bench.counts(Refusal::Tls, 2).await;

    let mut roots = RootCertStore::empty();
    let authority = certificates.authority().expect("an authority of its own");
    for certificate in CertificateDer::pem_file_iter(authority).expect("a file") {
        roots.add(certificate.expect("PEM")).expect("an authority");
    }
    let config = ClientConfig::builder_with_provider(Arc::new(crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_root_certificates(roots)
        .with_no_client_auth();
    let connector = TlsConnector::from(Arc::new(config));
    let mut silent = 0;
    // On a slow machine the handshake may take longer than it may here; then it shows nothing.
    while silent == 0 {
        let stream = TcpStream::connect(address).await.expect("connect");
        let name = ServerName::try_from("localhost").expect("a name");
        let Ok(mut stream) = within("TLS", connector.connect(name, stream)).await else {
            continue;
        };
        assert_eq!(end(&mut stream).await, b"");
        silent = bench.refused(Refusal::Silent);
    }
    let _ = std::fs::remove_dir_all(&scratch);
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_crowd_at_the_same_address_keeps_nobody_out() {
    let bench = Bench::start(limits(16, 8, 100, LONG)).await;
    let mut crowd = Vec::new();
    for number in 0..600 {
        let said: &[u8] = if number % 2 == 0 { b"" } else { b"\x10\x10" };
        crowd.push(bench.say(said).await);
    }
    let (reason, _wheely) = bench.reason(&connect("wheely")).await;
    assert_eq!(reason, LET_IN);
    // Those that came first went first, and one for the robot.
    for stream in &mut crowd[..593] {
        assert_eq!(end(stream).await, b"");
    }
    assert_eq!(bench.refused(Refusal::Crowded), 593);
    // Whoever is let in is no part of the crowd any more.
    for _ in 0..100 {
        crowd.push(bench.say(b"").await);
    }
    let (reason, _) = bench.reason(&connect("speedy")).await;
    assert_eq!(reason, LET_IN);
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn there_is_an_end_to_clients_and_they_are_told() {
    let bench = Bench::start(limits(100, 100, 2, LONG)).await;
    let (first, one) = bench.reason(&connect("one")).await;
    let (second, _two) = bench.reason(&connect("two")).await;
    assert_eq!([first, second], [LET_IN; 2]);
    let (third, mut stream) = bench.reason(&connect("three")).await;
    assert_eq!(third, 0x89);
    end(&mut stream).await;
    let old = b"\x10\x0d\0\x04MQTT\x04\x02\0\x3c\0\x01o";
    assert_eq!(bench.reason(old).await.0, 3);
    assert_eq!(bench.refused(Refusal::Full), 2);
    drop(one);
    let again = async { while bench.reason(&connect("three")).await.0 != LET_IN {} };
    within("room again", again).await;
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn there_is_an_end_to_sessions_whose_clients_are_away() {
    let few = Limits {
        sessions: 3,
        ..limits(100, 100, 100, LONG)
    };
    let bench = Bench::start(few).await;
    for number in 0..4 {
        let mut packet = staying("wheely-0");
        let last = packet.len() - 1;
        packet[last] += number;
        let (reason, mut stream) = bench.reason(&packet).await;
        assert_eq!(reason == LET_IN, number < 3, "{number}: {reason:#x}");
        let _ = stream.write_all(b"\xe0\0").await;
    }
    // Whoever has one gets it back.
    assert_eq!(bench.reason(&connect("wheely-0")).await.0, LET_IN);
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_waits_for_a_client_is_counted_as_long_as_it_waits() {
    let bench = Bench::start(limits(100, 100, 100, LONG)).await;
    let handle = bench.broker.handle();
    let (reason, mut away) = bench.reason(&staying("wheely")).await;
    assert_eq!(reason, LET_IN);
    let subscribe = b"\x82\x07\0\x01\0\0\x01t\x01";
    away.write_all(subscribe).await.expect("sent");
    assert_eq!(away.read_u8().await.expect("a SUBACK"), 0x90);
    drop(away);

    let (_, mut sender) = bench.reason(&connect("speedy")).await;
    let publish = b"\x32\x06\0\x01t\0\x07\0";
    // As many as it takes: those that are sent before the broker has seen it go are under way.
    while handle.load().await.queued == 0 {
        sender.write_all(publish).await.expect("sent");
        assert_eq!(sender.read_u8().await.expect("a PUBACK"), 0x40);
        let length = sender.read_u8().await.expect("a PUBACK");
        let mut rest = vec![0; usize::from(length)];
        sender.read_exact(&mut rest).await.expect("a PUBACK");
    }
    // It begins anew, and nothing waits for it any more.
    let (reason, _back) = bench.reason(&connect("wheely")).await;
    assert_eq!(reason, LET_IN);
    let at_rest = async {
        loop {
            let load = handle.load().await;
            if (load.connections, load.queued, load.unacknowledged) == (2, 0, 0) {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    within("two connections, for which nothing waits", at_rest).await;
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_version_that_is_not_spoken_is_told_so() {
    let bench = Bench::start(limits(100, 100, 100, LONG)).await;
    for (level, told) in [(6, 0x84), (9, 0x84), (0, 1), (2, 1)] {
        let mut packet = connect("wheely");
        packet[8] = level;
        let (reason, mut stream) = bench.reason(&packet).await;
        assert_eq!(reason, told, "level {level}");
        assert_eq!(end(&mut stream).await, b"");
    }
    assert_eq!(bench.refused(Refusal::Version), 4);
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_that_expires_at_once_ends_no_session() {
    let bench = Bench::start(limits(100, 100, 100, LONG)).await;
    let (_, mut stream) = bench.reason(&connect("wheely")).await;
    // QoS 1 on `t`, with an expiry of zero, and then a ping.
    let publish = b"\x32\x0b\0\x01t\0\x07\x05\x02\0\0\0\0";
    stream.write_all(publish).await.expect("sent");
    stream.write_all(b"\xc0\0").await.expect("sent");
    let mut answer = Vec::new();
    let answered = async {
        while !answer.ends_with(b"\xd0\0") {
            let read = stream.read_buf(&mut answer).await.expect("no reset");
            assert!(read > 0, "the session ended: {answer:?}");
        }
    };
    within("an answer to a ping", answered).await;
    assert_eq!(answer[0], 0x40, "acknowledged: {answer:?}");
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_says_that_it_goes_is_closed() {
    let bench = Bench::start(limits(100, 100, 100, LONG)).await;
    let old = b"\x10\x12\0\x04MQTT\x04\x02\0\0\0\x06speedy".to_vec();
    for said in [connect("wheely"), old] {
        let (reason, mut stream) = bench.reason(&said).await;
        assert_eq!(reason, LET_IN);
        stream.write_all(b"\xe0\0").await.expect("sent");
        assert_eq!(end(&mut stream).await, [0_u8; 0]);
    }
    bench.broker.stop().await;
}

/// A broker that answers `reasons` to one connection after the other, and the way in to it.
async fn answering(reasons: Vec<u8>) -> (Arc<Edge>, tokio::task::JoinHandle<usize>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("its address");
    let broker = tokio::spawn(async move {
        let (mut asked, mut open) = (0, Vec::new());
        for reason in reasons {
            let (mut stream, _) = listener.accept().await.expect("a connection");
            let mut said = vec![0; connect("wheely").len()];
            stream.read_exact(&mut said).await.expect("a CONNECT");
            assert_eq!(said, connect("wheely"));
            let answer = [0x20, 3, 0, reason, 0];
            stream.write_all(&answer).await.expect("sent");
            open.push(stream);
            asked += 1;
        }
        asked
    });
    let counters = Arc::new(GuardCounters::default());
    let edge = Edge::new(address, limits(9, 9, 9, LONG), Arc::default(), counters);
    (edge, broker)
}

#[tokio::test]
async fn a_client_that_comes_at_a_bad_moment_is_introduced_again() {
    const UNAVAILABLE: u8 = 0x88;
    const NOT_AUTHORIZED: u8 = 0x87;
    let origin = "192.0.2.1:4242".parse().expect("an address");
    for (reasons, told) in [
        (vec![UNAVAILABLE, UNAVAILABLE, LET_IN], LET_IN),
        (vec![UNAVAILABLE; INTRODUCTIONS], UNAVAILABLE),
        // Whoever may not come in is not asked about twice.
        (vec![UNAVAILABLE, NOT_AUTHORIZED], NOT_AUTHORIZED),
    ] {
        let times = reasons.len();
        let (edge, broker) = answering(reasons).await;
        let mut client = edge.enter(origin, &Handle::current());
        client.write_all(&connect("wheely")).await.expect("sent");
        assert_eq!(reason(&mut client).await, told);
        let asked = within("the broker is asked so often", broker).await;
        assert_eq!(asked.expect("no panic"), times);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_topic_alias_that_nobody_announced_ends_the_session() {
    let bench = Bench::start(limits(100, 100, 100, LONG)).await;
    let (_, mut stream) = bench.reason(&connect("wheely")).await;
    let publish = b"\x32\x0a\0\x01t\0\x07\x03\x23\0\x01x";
    stream.write_all(publish).await.expect("sent");
    assert_eq!(end(&mut stream).await, b"\xe0\x02\x94\0");
    drop(stream);
    bench.counts(Refusal::TopicAlias, 1).await;
    bench.broker.stop().await;
}
