//! The live feed's connections.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::extract::{FromRef, State};
use axum::response::Response;
use futures_util::{Sink, SinkExt as _, Stream, StreamExt as _};
use tokio::sync::broadcast;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::access::Caller;
use super::problem::{Code, Problem};
use super::state::{ApiState, Readers};
use crawler_accounts::{Accounts, Ending};
use crawler_fleet::SharedFleet;
use crawler_fleet::feed::Feed;
use crawler_metrics::Metrics;

/// A reader that takes nothing for so long is gone.
const STALLED: Duration = Duration::from_secs(5);
/// For the snapshot of a large fleet over a slow link.
const SNAPSHOT: Duration = Duration::from_secs(30);
const FAREWELL: Duration = Duration::from_secs(1);

/// What a reader of the live feed gets, and until when.
#[derive(Clone)]
pub(super) struct LiveFeed {
    feed: Arc<Feed>,
    fleet: Arc<SharedFleet>,
    accounts: Arc<Accounts>,
    metrics: Arc<Metrics>,
    readers: Readers,
    tasks: TaskTracker,
    stop: CancellationToken,
}

impl FromRef<ApiState> for LiveFeed {
    fn from_ref(state: &ApiState) -> Self {
        Self {
            feed: FromRef::from_ref(state),
            fleet: FromRef::from_ref(state),
            accounts: FromRef::from_ref(state),
            metrics: FromRef::from_ref(state),
            readers: FromRef::from_ref(state),
            tasks: FromRef::from_ref(state),
            stop: FromRef::from_ref(state),
        }
    }
}

/// Everything as it happens (WebSocket)
///
/// Binary frames, little-endian; the first byte is the kind: 0 hello, 1 roster, 2 poses, 3 event,
/// 4 metrics. A snapshot first, then what changes. Readers that are too slow, and those whose session
/// has ended, are closed with code 1008 and a reason. Messages to the server are not taken. Takes a
/// ticket of `POST session/ticket`, or a token; an open server takes neither.
#[utoipa::path(get, path = "/live", tag = "feed",
    params(("ticket" = Option<String>, Query, description = "Good once")),
    responses(
        (status = 101, description = "The feed follows"),
        (status = 401, description = "The ticket is not good"),
        (status = 400, description = "Not a WebSocket request"),
        (status = 503, description = "Too many readers")))]
pub(super) async fn connect(
    State(live): State<LiveFeed>,
    caller: Caller,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let upgrade = upgrade.map_err(|error| Problem::new(Code::NotAWebsocket, error.body_text()))?;
    let identity = caller.identity;
    let permit = Arc::clone(&live.readers.0)
        .try_acquire_owned()
        .map_err(|_| {
            Problem::new(
                Code::TooManyReaders,
                "the feed has as many readers as it may have",
            )
        })?;
    let task = live.tasks.token();
    Ok(upgrade
        .max_message_size(1_024)
        .max_frame_size(1_024)
        .on_upgrade(async move |socket| {
            live.metrics.live_clients(1);
            let (frames, receiver) = live.feed.connect(&live.fleet);
            let why = || {
                identity
                    .as_ref()
                    .map(|who| live.accounts.ending(who.session))
            };
            let ended = identity.as_ref().map(|who| who.ended.clone());
            let until = Until {
                stop: live.stop.clone(),
                // On an open server nobody has a session that could end.
                ended: ended.unwrap_or_default(),
            };
            let end = read(socket, frames, receiver, until, why).await;
            live.metrics.live_clients(-1);
            if end.is_slow() {
                live.metrics.live_dropped();
                tracing::warn!(?end, "dropped a reader of the live feed");
            }
            drop((permit, task));
        }))
}

/// Why a reader's connection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// The reader went away.
    Left,
    /// The reader sent something.
    Spoke,
    /// The reader fell too far behind.
    Behind,
    /// The reader took nothing at all.
    Stalled,
    /// The session of the reader was ended.
    Revoked,
    /// The session of the reader ran out.
    Expired,
    /// The server stops.
    Stopped,
}

/// Until when a reader is served.
struct Until {
    /// The server stops.
    stop: CancellationToken,
    /// The reader's session ends.
    ended: CancellationToken,
}

impl Until {
    async fn over(&self) -> End {
        tokio::select! {
            biased;
            () = self.ended.cancelled() => End::Revoked,
            () = self.stop.cancelled() => End::Stopped,
        }
    }
}

impl End {
    const fn is_slow(self) -> bool {
        matches!(self, Self::Behind | Self::Stalled)
    }

    /// What to tell the reader, where it can still be told.
    const fn farewell(self) -> Option<(u16, &'static str)> {
        match self {
            Self::Left | Self::Stalled => None,
            Self::Spoke => Some((close_code::UNSUPPORTED, "this feed takes no messages")),
            Self::Behind => Some((close_code::POLICY, "too slow: frames were lost")),
            Self::Revoked => Some((close_code::POLICY, "the session was ended")),
            Self::Expired => Some((close_code::POLICY, "the session has expired")),
            Self::Stopped => Some((close_code::AWAY, "the server stops")),
        }
    }
}

async fn read(
    socket: WebSocket,
    frames: Vec<Bytes>,
    receiver: broadcast::Receiver<Bytes>,
    until: Until,
    why: impl Fn() -> Option<Ending>,
) -> End {
    let (mut sink, stream) = socket.split();
    let mut end = pump(&mut sink, stream, frames, receiver, until).await;
    if end == End::Revoked && why() == Some(Ending::Expired) {
        end = End::Expired;
    }
    if let Some((code, reason)) = end.farewell() {
        let close = Message::Close(Some(CloseFrame {
            code,
            reason: reason.into(),
        }));
        let _ = tokio::time::timeout(FAREWELL, sink.send(close)).await;
    }
    end
}

/// Hands frames on until there is a reason not to.
async fn pump<S, R, E>(
    sink: &mut S,
    mut stream: R,
    frames: Vec<Bytes>,
    mut receiver: broadcast::Receiver<Bytes>,
    until: Until,
) -> End
where
    S: Sink<Message> + Unpin,
    R: Stream<Item = Result<Message, E>> + Unpin,
{
    let snapshot = async {
        for frame in frames {
            if sink.send(Message::Binary(frame)).await.is_err() {
                return Some(End::Left);
            }
        }
        None
    };
    let sent = tokio::select! {
        biased;
        end = until.over() => Some(end),
        sent = tokio::time::timeout(SNAPSHOT, snapshot) => sent.unwrap_or(Some(End::Stalled)),
    };
    if let Some(end) = sent {
        return end;
    }
    loop {
        tokio::select! {
            biased;
            end = until.over() => return end,
            word = stream.next() => match word {
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                Some(Ok(Message::Text(_) | Message::Binary(_))) => return End::Spoke,
                Some(Ok(Message::Close(_)) | Err(_)) | None => return End::Left,
            },
            frame = receiver.recv() => match frame {
                Ok(frame) => {
                    let sent = sink.send(Message::Binary(frame));
                    tokio::select! {
                        biased;
                        // A reader that is slow to take a frame keeps its place no longer for it.
                        end = until.over() => return end,
                        sent = tokio::time::timeout(STALLED, sent) => match sent {
                            Ok(Ok(())) => {}
                            Ok(Err(_)) => return End::Left,
                            Err(_) => return End::Stalled,
                        },
                    }
                }
                Err(broadcast::error::RecvError::Lagged(_)) => return End::Behind,
                Err(broadcast::error::RecvError::Closed) => return End::Stopped,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::pin::Pin;
    use std::task::{Context, Poll};

    use futures_util::stream;

    use super::*;

    /// Takes frames at a pace; `None` never takes any.
    struct Reader {
        pace: Option<Duration>,
        busy: Option<Pin<Box<tokio::time::Sleep>>>,
        taken: usize,
    }

    impl Reader {
        fn new(pace: Option<Duration>) -> Self {
            Self {
                pace,
                busy: None,
                taken: 0,
            }
        }
    }

    impl Sink<Message> for Reader {
        type Error = Infallible;

        fn poll_ready(
            mut self: Pin<&mut Self>,
            cx: &mut Context<'_>,
        ) -> Poll<Result<(), Infallible>> {
            if self.pace.is_none() {
                return Poll::Pending;
            }
            match &mut self.busy {
                Some(busy) => busy.as_mut().poll(cx).map(Ok),
                None => Poll::Ready(Ok(())),
            }
        }

        fn start_send(mut self: Pin<&mut Self>, _: Message) -> Result<(), Infallible> {
            self.taken += 1;
            self.busy = self.pace.map(|pace| Box::pin(tokio::time::sleep(pace)));
            Ok(())
        }

        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            Poll::Ready(Ok(()))
        }

        fn poll_close(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            Poll::Ready(Ok(()))
        }
    }

    /// Sends a frame every 10 ms to `reader` and says how it ended.
    async fn run(reader: &mut Reader, frames: usize) -> End {
        let sender = broadcast::Sender::new(16);
        let receiver = sender.subscribe();
        let stop = CancellationToken::new();
        let until_stop = stop.clone();
        let feed = {
            let stop = stop.clone();
            async move {
                for _ in 0..frames {
                    tokio::time::sleep(Duration::from_millis(10)).await;
                    if sender.send(Bytes::from_static(b"{}")).is_err() {
                        break;
                    }
                }
                // Time for whoever is still waiting on the last frame.
                tokio::time::sleep(Duration::from_secs(10)).await;
                stop.cancel();
            }
        };
        let silent = stream::pending::<Result<Message, Infallible>>();
        let until = Until {
            stop: until_stop,
            ended: CancellationToken::new(),
        };
        let (end, ()) = tokio::join!(pump(reader, silent, Vec::new(), receiver, until), feed);
        end
    }

    #[tokio::test(start_paused = true)]
    async fn a_quick_reader_gets_everything() {
        let mut reader = Reader::new(Some(Duration::from_millis(1)));
        assert_eq!(run(&mut reader, 500).await, End::Stopped);
        assert_eq!(reader.taken, 500);
    }

    #[tokio::test(start_paused = true)]
    async fn a_slow_reader_is_dropped() {
        let mut reader = Reader::new(Some(Duration::from_millis(100)));
        assert_eq!(run(&mut reader, 500).await, End::Behind);
    }

    #[tokio::test(start_paused = true)]
    async fn a_reader_that_takes_nothing_is_dropped() {
        assert_eq!(run(&mut Reader::new(None), 500).await, End::Stalled);
    }

    #[tokio::test(start_paused = true)]
    async fn a_reader_that_speaks_is_told_off() {
        let sender = broadcast::Sender::new(16);
        let word = stream::iter([Ok::<_, Infallible>(Message::Text("stop".into()))]);
        let end = pump(
            &mut Reader::new(Some(Duration::ZERO)),
            word,
            Vec::new(),
            sender.subscribe(),
            Until {
                stop: CancellationToken::new(),
                ended: CancellationToken::new(),
            },
        )
        .await;
        assert_eq!(end, End::Spoke);
        assert!(end.farewell().is_some());
    }
}
