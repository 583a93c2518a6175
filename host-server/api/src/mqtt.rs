//! MQTT over WebSocket (MQTT 5, section 6), for browsers and for clients that a firewall lets out to
//! this port alone.
//!
//! The frames of a client are carried to the embedded broker as a stream of bytes, and back. So names,
//! passwords, topics and budgets are looked after where they are for everybody else, and under the
//! client's own address. Packets may span frames, and a frame may hold several packets.
//!
//! Nothing piles up here: what the broker does not take is not read from the client, and what the client
//! does not take is not read from the broker, which ends the session of a reader that has stalled.

use std::time::Duration;

use axum::body::Bytes;
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::response::Response;
use axum::routing::get;
use futures_util::{Sink, SinkExt as _, Stream, StreamExt as _};
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _, DuplexStream};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::access::Caller;
use super::problem::{Code, Problem};
use super::state::{ApiState, Broker};
use crawler_broker::LARGEST_PACKET;

/// The name of MQTT among the protocols that a WebSocket may carry.
const PROTOCOL: &str = "mqtt";
/// Largest message of a client: the largest packet that the broker takes.
const LARGEST: usize = LARGEST_PACKET as usize;
/// Bytes of the broker that go into one message.
const CHUNK: usize = 16 * 1024;
/// For the first bytes of a client.
const FIRST_WORD: Duration = Duration::from_secs(10);
/// For the whole CONNECT, up to the answer of the broker.
const FIRST_ANSWER: Duration = Duration::from_secs(20);
/// A client that takes nothing for so long is gone.
const STALLED: Duration = Duration::from_secs(5);
/// For the end of a connection to be told and taken.
const FAREWELL: Duration = Duration::from_secs(1);
/// For the broker to take what a client said before it left.
const LAST_WORDS: Duration = Duration::from_secs(5);

pub(super) fn routes() -> axum::Router<ApiState> {
    axum::Router::new().route("/mqtt", get(connect))
}

/// Takes a client in.
async fn connect(
    State(Broker(broker)): State<Broker>,
    State(tasks): State<TaskTracker>,
    State(stop): State<CancellationToken>,
    caller: Caller,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let Some(broker) = broker else {
        return Err(Problem::new(
            Code::OutsideBroker,
            "the broker of this fleet is not part of this server: connect to that broker",
        ));
    };
    let upgrade = upgrade.map_err(|error| Problem::new(Code::NotAWebsocket, error.body_text()))?;
    let upgrade = upgrade.protocols([PROTOCOL]);
    if upgrade.selected_protocol().is_none() {
        return Err(Problem::new(
            Code::NotMqtt,
            "the WebSocket must offer the subprotocol `mqtt`",
        ));
    }
    let place = broker.place(caller.peer.ip()).ok_or_else(|| {
        Problem::later(
            Code::TooManyClients,
            "too many MQTT clients use WebSockets, from your address or in all",
            Duration::from_secs(5),
        )
    })?;
    let stream = broker.enter(caller.peer.address);
    let task = tasks.token();
    Ok(upgrade
        .read_buffer_size(CHUNK)
        .write_buffer_size(0)
        .max_write_buffer_size(4 * CHUNK)
        .max_message_size(LARGEST)
        .max_frame_size(LARGEST)
        .on_upgrade(async move |socket| {
            let end = tunnel(socket, stream, stop).await;
            tracing::debug!(from = %caller.peer.address, ?end, "an MQTT client over WebSocket ended");
            drop((place, task));
        }))
}

/// Why a connection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// The client went away.
    Left,
    /// The broker ended it.
    Broker,
    /// The client sent text.
    Text,
    /// The client sent a message that is larger than any packet.
    TooLarge,
    /// The client did not speak as `WebSockets` do.
    Broken,
    /// The client did not say who it is.
    Silent,
    /// The client took nothing.
    Stalled,
    /// The server stops.
    Stopped,
}

impl End {
    /// What to tell the client, where it can still be told.
    const fn farewell(self) -> Option<(u16, &'static str)> {
        match self {
            Self::Left | Self::Stalled => None,
            Self::Broker => Some((close_code::NORMAL, "the broker ended the connection")),
            Self::Text => Some((close_code::UNSUPPORTED, "MQTT is binary")),
            Self::TooLarge => Some((close_code::SIZE, "larger than any packet may be")),
            Self::Broken => Some((close_code::PROTOCOL, "not a frame of a WebSocket")),
            Self::Silent => Some((close_code::POLICY, "no CONNECT in time")),
            Self::Stopped => Some((close_code::AWAY, "the server stops")),
        }
    }
}

/// Carries bytes both ways until there is a reason not to.
async fn tunnel(socket: WebSocket, broker: DuplexStream, stop: CancellationToken) -> End {
    let (mut sink, mut stream) = socket.split();
    let (mut from_broker, mut to_broker) = tokio::io::split(broker);
    let end = tokio::select! {
        biased;
        () = stop.cancelled() => End::Stopped,
        end = there(&mut stream, &mut to_broker) => end,
        end = back(&mut from_broker, &mut sink) => end,
    };
    let leaving = async {
        if let Some((code, reason)) = end.farewell() {
            let close = Message::Close(Some(CloseFrame {
                code,
                reason: reason.into(),
            }));
            // A connection that is closed with bytes unread loses what was sent last.
            let told = async {
                if sink.send(close).await.is_ok() {
                    while let Some(Ok(_)) = stream.next().await {}
                }
            };
            let _ = tokio::time::timeout(FAREWELL, told).await;
        }
    };
    // The same holds for the broker: a DISCONNECT must arrive, or the will is published.
    let ending = async {
        let _ = to_broker.shutdown().await;
        let mut rest = [0; 1_024];
        while from_broker
            .read(&mut rest)
            .await
            .is_ok_and(|length| length > 0)
        {}
    };
    tokio::join!(leaving, async {
        let _ = tokio::time::timeout(LAST_WORDS, ending).await;
    });
    end
}

/// From the client to the broker.
async fn there<R, E, W>(client: &mut R, broker: &mut W) -> End
where
    R: Stream<Item = Result<Message, E>> + Unpin,
    E: std::fmt::Display,
    W: AsyncWrite + Unpin,
{
    let first = tokio::time::timeout(FIRST_WORD, next(client)).await;
    let mut message = first.unwrap_or(Err(End::Silent));
    loop {
        let bytes = match message {
            Ok(bytes) => bytes,
            Err(end) => return end,
        };
        if broker.write_all(&bytes).await.is_err() {
            return End::Broker;
        }
        message = next(client).await;
    }
}

/// The next bytes of a client.
async fn next<R, E>(client: &mut R) -> Result<Bytes, End>
where
    R: Stream<Item = Result<Message, E>> + Unpin,
    E: std::fmt::Display,
{
    loop {
        match client.next().await {
            Some(Ok(Message::Binary(bytes))) if bytes.is_empty() => {}
            Some(Ok(Message::Binary(bytes))) => return Ok(bytes),
            Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
            Some(Ok(Message::Text(_))) => return Err(End::Text),
            Some(Ok(Message::Close(_))) | None => return Err(End::Left),
            // The library's error is opaque; a test holds it to these words.
            Some(Err(error)) if error.to_string().starts_with("Space limit exceeded") => {
                return Err(End::TooLarge);
            }
            Some(Err(_)) => return Err(End::Broken),
        }
    }
}

/// From the broker to the client.
async fn back<R, S>(broker: &mut R, client: &mut S) -> End
where
    R: AsyncRead + Unpin,
    S: Sink<Message> + Unpin,
{
    let mut chunk = vec![0; CHUNK];
    let Ok(mut read) = tokio::time::timeout(FIRST_ANSWER, broker.read(&mut chunk)).await else {
        return End::Silent;
    };
    loop {
        let length = match read {
            Ok(0) | Err(_) => return End::Broker,
            Ok(length) => length,
        };
        let bytes = Bytes::copy_from_slice(chunk.get(..length).unwrap_or_default());
        match tokio::time::timeout(STALLED, client.send(Message::Binary(bytes))).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) => return End::Left,
            Err(_) => return End::Stalled,
        }
        read = broker.read(&mut chunk).await;
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::pin::Pin;
    use std::task::{Context, Poll};

    use futures_util::stream;
    use tokio::io::duplex;

    use super::*;

    /// Takes messages, as long as there is room.
    struct Client {
        room: usize,
        taken: Vec<u8>,
    }

    impl Sink<Message> for Client {
        type Error = Infallible;

        fn poll_ready(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            if self.room > 0 {
                Poll::Ready(Ok(()))
            } else {
                Poll::Pending
            }
        }

        fn start_send(mut self: Pin<&mut Self>, message: Message) -> Result<(), Infallible> {
            self.room -= 1;
            self.taken.extend(message.into_data());
            Ok(())
        }

        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            Poll::Ready(Ok(()))
        }

        fn poll_close(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            Poll::Ready(Ok(()))
        }
    }

    fn binary(bytes: &'static [u8]) -> Message {
        Message::Binary(Bytes::from_static(bytes))
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_that_takes_nothing_is_dropped() {
        let (mut ours, mut theirs) = duplex(64 * 1024);
        let said = vec![7; 64 * 1024];
        theirs.write_all(&said).await.expect("room");
        let mut client = Client {
            room: 2,
            taken: Vec::new(),
        };
        let begun = tokio::time::Instant::now();
        assert_eq!(back(&mut ours, &mut client).await, End::Stalled);
        assert!(begun.elapsed() >= STALLED);
        assert!(
            client.taken.len() <= 2 * CHUNK,
            "no more was taken than asked for"
        );
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_that_says_nothing_is_sent_away() {
        let (mut ours, _theirs) = duplex(64);
        let mut silent = stream::pending::<Result<Message, Infallible>>();
        assert_eq!(there(&mut silent, &mut ours).await, End::Silent);
        // Signs of life that are no CONNECT do not count.
        let pings = stream::repeat_with(|| Ok::<_, Infallible>(Message::Ping(Bytes::new())));
        let mut pings = Box::pin(pings.then(|ping| async move {
            tokio::time::sleep(Duration::from_millis(100)).await;
            ping
        }));
        assert_eq!(there(&mut pings, &mut ours).await, End::Silent);
    }

    #[tokio::test(start_paused = true)]
    async fn half_a_connect_is_not_waited_for() {
        let (mut ours, _theirs) = duplex(64);
        let mut client = Client {
            room: 1,
            taken: Vec::new(),
        };
        assert_eq!(back(&mut ours, &mut client).await, End::Silent);
    }

    #[tokio::test(start_paused = true)]
    async fn what_the_broker_does_not_take_is_not_read() {
        let (mut ours, mut theirs) = duplex(8);
        let read = std::cell::Cell::new(0);
        let mut client = stream::iter((0..100).map(|_| {
            read.set(read.get() + 1);
            Ok::<_, Infallible>(binary(b"1234"))
        }));
        let carried = there(&mut client, &mut ours);
        let broker = async {
            tokio::time::sleep(Duration::from_mins(10)).await;
            assert!(read.get() <= 3, "{} messages", read.get());
            let mut all = vec![0; 400];
            theirs.read_exact(&mut all).await.expect("everything");
            all
        };
        let (end, all) = tokio::join!(carried, broker);
        assert_eq!(end, End::Left);
        assert_eq!(all, b"1234".repeat(100));
    }

    #[tokio::test]
    async fn what_is_no_stream_of_bytes_ends_it() {
        let (mut ours, _theirs) = duplex(64);
        for (message, end) in [
            (Message::Text("hello".into()), End::Text),
            (Message::Close(None), End::Left),
        ] {
            let mut client =
                stream::iter([binary(b"1"), binary(b""), message].map(Ok::<_, Infallible>));
            assert_eq!(there(&mut client, &mut ours).await, end);
        }
        for (error, end) in [
            (
                "Space limit exceeded: Message too long: 9 > 8",
                End::TooLarge,
            ),
            ("Connection reset without closing handshake", End::Broken),
        ] {
            let mut client =
                stream::iter([Ok(Message::Binary(Bytes::from_static(b"1"))), Err(error)]);
            assert_eq!(there(&mut client, &mut ours).await, end);
        }
        for end in [
            End::Broker,
            End::Text,
            End::TooLarge,
            End::Broken,
            End::Silent,
            End::Stopped,
        ] {
            let (code, reason) = end.farewell().expect("words");
            assert!((1_000..1_014).contains(&code) && reason.len() <= 123);
        }
    }
}
