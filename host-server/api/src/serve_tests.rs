use axum::body::Body;
use axum::routing::{get, post};

use super::*;

/// How long a test waits for something that is to happen, however slow the machine is.
const LIMIT: Duration = Duration::from_mins(1);
const CONNECTIONS: usize = 8;

struct Served {
    address: SocketAddr,
    stop: CancellationToken,
    task: tokio::task::JoinHandle<()>,
}

impl Served {
    async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let large = || async { Body::from(vec![b'x'; 32 * 1024 * 1024]) };
        let router = Router::new()
            .route("/halt", get(|| async { "halted" }))
            .route("/take", post(async |body: axum::body::Bytes| body))
            .route("/large", get(large));
        let stop = CancellationToken::new();
        let task = tokio::spawn(serve(listener, router, None, CONNECTIONS, stop.clone()));
        Self {
            address,
            stop,
            task,
        }
    }

    async fn say(&self, bytes: &[u8]) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).await.expect("connect");
        stream.write_all(bytes).await.expect("sent");
        stream
    }

    /// Halts over a connection of its own.
    async fn halt(&self) {
        let halting = async {
            let mut stream = self
                .say(b"GET /halt HTTP/1.1\r\nhost: a\r\nconnection: close\r\n\r\n")
                .await;
            let mut answer = String::new();
            let read = stream.read_to_string(&mut answer).await;
            assert!(answer.ends_with("halted"), "{read:?}: {answer}");
        };
        let halted = tokio::time::timeout(LIMIT, halting).await;
        halted.expect("a crowd keeps nobody out");
    }

    async fn end(self) {
        self.stop.cancel();
        let ended = tokio::time::timeout(LIMIT, self.task).await;
        ended.expect("in time").expect("no panic");
    }
}

/// Waits until the other side has closed the connection.
async fn closed(mut stream: TcpStream) {
    let mut rest = Vec::new();
    // Closed or reset.
    let closed = tokio::time::timeout(LIMIT, stream.read_to_end(&mut rest)).await;
    assert!(closed.is_ok(), "still open");
}

#[tokio::test]
async fn connections_that_say_little_or_nothing_make_room() {
    let served = Served::start().await;
    for said in [
        &b""[..],
        b"G",
        b"GET /halt HTTP/1.1\r\nhost: a\r\nx-slow: ",
        b"POST /take HTTP/1.1\r\nhost: a\r\ncontent-length: 9\r\n\r\nhalf",
        // An answer that was taken, and then nothing.
        b"GET /halt HTTP/1.1\r\nhost: a\r\n\r\n",
    ] {
        let mut crowd = Vec::new();
        for _ in 0..3 * CONNECTIONS {
            crowd.push(served.say(said).await);
        }
        served.halt().await;
        // The oldest went first.
        closed(crowd.remove(0)).await;
    }
    served.end().await;
}

#[tokio::test]
async fn a_request_that_comes_in_pieces_is_answered() {
    let served = Served::start().await;
    let mut crowd = Vec::new();
    let mut whole = served
        .say(b"POST /take HTTP/1.1\r\nhost: a\r\nconnection: close\r\ncontent-length: 4\r\n\r\n1")
        .await;
    // It goes on while it is not the oldest, and comes to its end.
    for _ in 0..CONNECTIONS / 4 {
        crowd.push(served.say(b"").await);
    }
    whole.write_all(b"234").await.expect("sent");
    let mut answer = String::new();
    let read = tokio::time::timeout(LIMIT, whole.read_to_string(&mut answer)).await;
    read.expect("in time").expect("no reset");
    assert!(answer.ends_with("1234"), "{answer}");
    served.end().await;
}

#[tokio::test]
async fn clients_that_do_not_take_their_answer_make_room() {
    let served = Served::start().await;
    let mut crowd = Vec::new();
    for _ in 0..3 * CONNECTIONS {
        let asked = b"GET /large HTTP/1.1\r\nhost: a\r\n\r\n";
        crowd.push(served.say(asked).await);
    }
    served.halt().await;
    drop(crowd);
    served.end().await;
}

#[tokio::test]
async fn an_answer_that_is_taken_comes_to_its_end() {
    let served = Served::start().await;
    let mut large = served
        .say(b"GET /large HTTP/1.1\r\nhost: a\r\nconnection: close\r\n\r\n")
        .await;
    let mut length = 0;
    let mut chunk = vec![0; 64 * 1024];
    loop {
        let read = tokio::time::timeout(LIMIT, large.read(&mut chunk)).await;
        match read.expect("in time").expect("no reset") {
            0 => break,
            read => length += read,
        }
    }
    assert!(length > 32 * 1024 * 1024, "{length}");
    served.end().await;
}
