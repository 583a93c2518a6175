//! What stands between clients and the broker.
//!
//! The broker's library accepts whoever connects, waits for ever for the first bytes of a CONNECT, and has
//! no limit but that of all connections. So it listens on loopback, and connections come in here: over
//! TCP, with TLS or without, and over a WebSocket. Each has to say in time who it is; until the broker has
//! let it in, it may be closed to make room for others ([`Waiting`]). Then its bytes are carried, and what
//! the library gets wrong of them is put right ([`packets`]); clients that take numbers for topics get them
//! ([`aliases`]).
//!
//! The library's own TLS is not used for another reason: it reads its certificate once, and needs a second
//! provider of cryptography that is built from C.

mod aliases;
mod connect;
mod packets;
mod peers;
mod relay;
#[cfg(test)]
mod tests;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rustix::net::sockopt;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _, DuplexStream};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio::time::timeout;

use super::GuardCounters;
use super::accounts::Refusal;
use aliases::{Aliases, Announced};
use connect::{Connect, LEVEL_5, NoConnect};
use crawler_server_tls::{self as tls, TlsHandshake};
use crawler_system::descriptors::{self, Descriptors};
use crawler_system::waiting::{Slot, Waiting};
use peers::Note;
pub(crate) use peers::Peers;

/// Connections of one address that the broker has not let in yet. A simulator opens 64 at a time.
const MOST_OF_ONE: usize = 256;
/// Bytes under way between a WebSocket and here, each way.
const PIPE: usize = 16 * 1024;
/// How often a client is introduced to the broker. The library answers *server unavailable* to one that comes
/// back while another connection of it is coming or going, which is over a moment later.
const INTRODUCTIONS: usize = 3;
const INTRODUCE_EVERY: Duration = Duration::from_millis(20);
/// For a refused client to read why.
const FAREWELL: Duration = Duration::from_secs(1);
/// After a failure to accept: trying at once would only burn time.
const BACK_OFF: Duration = Duration::from_millis(200);
/// The first byte of a CONNACK (MQTT 5, section 3.2); the second behind its head is the reason code, zero when
/// the client is let in.
const CONNACK: u8 = 0x20;
/// What the system sends to a client that is silent, so that one whose network is gone is noticed.
const PROBE_AFTER: Duration = Duration::from_mins(1);
const PROBE_EVERY: Duration = Duration::from_secs(15);
const PROBES: u32 = 4;

/// How long a client may take to say who it is.
#[derive(Debug, Clone, Copy)]
pub struct Times {
    /// For the first byte, once TCP and TLS are through.
    pub first_byte: Duration,
    /// For the whole CONNECT, counted from the same moment.
    pub connect: Duration,
    /// For the broker to answer: somebody else's password may be checked first.
    pub answer: Duration,
}

impl Default for Times {
    fn default() -> Self {
        Self {
            first_byte: Duration::from_secs(10),
            connect: Duration::from_secs(20),
            answer: Duration::from_secs(30),
        }
    }
}

/// How many clients there may be, and how long they may take.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Clients that the broker has not let in yet.
    pub waiting: usize,
    /// Of those, at one address.
    pub waiting_of_one: usize,
    /// Clients in all.
    pub clients: usize,
    /// Sessions, also of this process and of clients that are away.
    pub sessions: usize,
    /// How long each may take.
    pub times: Times,
}

impl From<Descriptors> for Limits {
    fn from(descriptors: Descriptors) -> Self {
        Self {
            waiting: descriptors.waiting,
            // Half for others, however few there are.
            waiting_of_one: MOST_OF_ONE.min(descriptors.waiting / 2),
            clients: descriptors.clients,
            sessions: descriptors.sessions,
            times: Times::default(),
        }
    }
}

/// The way in for everybody but this process.
pub(crate) struct Edge {
    /// Where the broker listens.
    broker: SocketAddr,
    waiting: Arc<Waiting>,
    clients: Arc<Semaphore>,
    times: Times,
    peers: Arc<Peers>,
    counters: Arc<GuardCounters>,
}

impl Edge {
    pub(crate) fn new(
        broker: SocketAddr,
        limits: Limits,
        peers: Arc<Peers>,
        counters: Arc<GuardCounters>,
    ) -> Arc<Self> {
        Arc::new(Self {
            broker,
            waiting: Waiting::new(limits.waiting, limits.waiting_of_one),
            clients: Arc::new(Semaphore::new(limits.clients)),
            times: limits.times,
            peers,
            counters,
        })
    }

    /// Listens at `listen` in the runtime of the broker, and ends with that. With `tls` connections are
    /// encrypted. Returns the address it listens at, with the port chosen by the system when none was
    /// asked for.
    ///
    /// # Errors
    /// What the operating system says when the address cannot be bound.
    pub(crate) async fn listen(
        self: &Arc<Self>,
        listen: SocketAddr,
        tls: Option<TlsHandshake>,
        runtime: &Handle,
    ) -> std::io::Result<SocketAddr> {
        // A socket belongs to the runtime that it is made in.
        let bind = runtime.spawn(TcpListener::bind(listen));
        let listener = bind.await.map_err(std::io::Error::other)??;
        let address = listener.local_addr()?;
        runtime.spawn(Arc::clone(self).accept(listener, tls.map(Arc::new)));
        Ok(address)
    }

    /// A connection to the broker for a client at `origin` over something else than TCP. Who carries it
    /// closes it when the client is silent.
    pub(crate) fn enter(self: &Arc<Self>, origin: SocketAddr, runtime: &Handle) -> DuplexStream {
        let (ours, theirs) = tokio::io::duplex(PIPE);
        let edge = Arc::clone(self);
        runtime.spawn(async move {
            let slot = edge.waiting.enter(origin.ip());
            // Who carries it knows sooner, and tells the client.
            let times = Times {
                first_byte: edge.times.first_byte * 2,
                connect: edge.times.connect * 2,
                answer: edge.times.answer * 2,
            };
            edge.serve(theirs, origin, slot, times).await;
        });
        ours
    }

    async fn accept(self: Arc<Self>, listener: TcpListener, tls: Option<Arc<TlsHandshake>>) {
        loop {
            let (client, origin) = match listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!(%error, "cannot accept a connection to the broker");
                    if descriptors::are_used_up(&error) {
                        // Who says nothing has one to spare.
                        self.waiting.close_oldest();
                    }
                    tokio::time::sleep(BACK_OFF).await;
                    continue;
                }
            };
            let slot = self.waiting.enter(origin.ip());
            let (edge, tls) = (Arc::clone(&self), tls.clone());
            tokio::spawn(async move {
                tune(&client);
                let Some(tls) = tls else {
                    return edge.serve(client, origin, slot, edge.times).await;
                };
                let entered = tokio::select! {
                    entered = tls.enter(client) => entered,
                    () = slot.crowded_out() => {
                        return edge.refuse(Refusal::Crowded, origin);
                    }
                };
                match entered {
                    Ok(client) => edge.serve(client, origin, slot, edge.times).await,
                    Err(tls::Refusal::Gone) => {}
                    Err(refusal) => {
                        tracing::debug!(%origin, %refusal, "no TLS with a client");
                        edge.refuse(Refusal::Tls, origin);
                    }
                }
            });
        }
    }

    /// Serves one client to its end.
    async fn serve<C>(&self, mut client: C, origin: SocketAddr, slot: Slot, times: Times)
    where
        C: AsyncRead + AsyncWrite + Unpin,
    {
        let read = tokio::select! {
            read = connect::read(&mut client, times) => read,
            () = slot.crowded_out() => return self.refuse(Refusal::Crowded, origin),
        };
        let connect = match read {
            Ok(connect) => connect,
            Err(NoConnect::Gone) => return,
            Err(NoConnect::Refused { reason, answer }) => {
                self.refuse(reason, origin);
                return farewell(client, answer).await;
            }
        };
        // Who has said who it is does not count among the silent.
        slot.wait();
        let Ok(_permit) = self.clients.try_acquire() else {
            self.refuse(Refusal::Full, origin);
            return farewell(client, connect::busy(connect.level)).await;
        };
        let introduced = tokio::select! {
            introduced = timeout(times.answer, self.introduce(&connect, origin)) => introduced,
            () = slot.crowded_out() => return self.refuse(Refusal::Crowded, origin),
        };
        let introduced = match introduced {
            Ok(Ok(introduced)) => introduced,
            Ok(Err(NoAnswer::NoConnection(error))) => {
                tracing::warn!(%error, "the broker takes no connection");
                return farewell(client, connect::busy(connect.level)).await;
            }
            Ok(Err(NoAnswer::Closed)) | Err(_) => return,
        };
        if !introduced.is_let_in() {
            return farewell(client, &introduced.answer).await;
        }
        if relay::send(&mut client, &introduced.answer).await.is_err() {
            return;
        }
        let Introduced {
            broker,
            note: _note,
            ..
        } = introduced;
        let is_5 = connect.level == LEVEL_5;
        let aliases = Aliases::new(Announced::of(&connect.bytes)).filter(|_| is_5);
        drop((slot, connect.bytes));
        let end = relay::carry(client, broker, is_5, aliases).await;
        if end == relay::End::Alias {
            self.refuse(Refusal::TopicAlias, origin);
        }
    }

    /// Hands a CONNECT to the broker, again if it cannot let the client in at this very moment.
    async fn introduce(
        &self,
        connect: &Connect,
        origin: SocketAddr,
    ) -> Result<Introduced, NoAnswer> {
        let mut tries = 1;
        loop {
            let broker = TcpStream::connect(self.broker)
                .await
                .map_err(NoAnswer::NoConnection)?;
            // Only costs latency when it fails.
            let _ = broker.set_nodelay(true);
            let seen = broker.local_addr()?;
            // Before the first byte: the broker asks with the first packet.
            let note = self.peers.note(seen, origin);
            let introduced = introduce(broker, note, &connect.bytes).await?;
            if tries == INTRODUCTIONS || !introduced.is_unavailable(connect.level) {
                return Ok(introduced);
            }
            tries += 1;
            tokio::time::sleep(INTRODUCE_EVERY).await;
        }
    }

    fn refuse(&self, reason: Refusal, origin: SocketAddr) {
        if self.counters.refuse_connection(reason, Instant::now()) {
            let reason = reason.name();
            tracing::warn!(reason, from = %origin, "refused a client of the broker");
        }
    }
}

/// What the broker says to a client.
struct Introduced {
    broker: TcpStream,
    /// As long as the connection is there.
    note: Note,
    /// A CONNACK.
    answer: Vec<u8>,
    /// Its reason code; `None` when it is something else.
    reason: Option<u8>,
}

impl Introduced {
    fn is_let_in(&self) -> bool {
        self.reason == Some(0)
    }

    /// *Server unavailable*, as the library says it to clients of this level (MQTT 5, section 3.2.2.2; MQTT
    /// 3.1.1, section 3.2.2.3).
    fn is_unavailable(&self, level: u8) -> bool {
        self.reason == Some(if level == LEVEL_5 { 0x88 } else { 3 })
    }
}

/// Why the broker has not answered a CONNECT.
#[derive(Debug)]
enum NoAnswer {
    NoConnection(std::io::Error),
    Closed,
}

impl From<std::io::Error> for NoAnswer {
    fn from(_: std::io::Error) -> Self {
        Self::Closed
    }
}

/// Hands a CONNECT to the broker over a connection.
async fn introduce(
    mut broker: TcpStream,
    note: Note,
    connect: &[u8],
) -> std::io::Result<Introduced> {
    broker.write_all(connect).await?;
    let mut answer = vec![broker.read_u8().await?];
    let mut length = 0;
    for place in 0..4 {
        let byte = broker.read_u8().await?;
        answer.push(byte);
        length |= usize::from(byte & 0x7f) << (7 * place);
        if byte < 0x80 {
            break;
        }
    }
    let head = answer.len();
    answer.resize(head + length, 0);
    broker
        .read_exact(answer.get_mut(head..).unwrap_or_default())
        .await?;
    let is_connack = answer.first() == Some(&CONNACK);
    let reason = is_connack.then(|| answer.get(head + 1).copied()).flatten();
    Ok(Introduced {
        broker,
        note,
        answer,
        reason,
    })
}

/// Sends a last packet and lets it be read: a connection that is closed with bytes unread loses the
/// answer as well.
async fn farewell(mut client: impl AsyncRead + AsyncWrite + Unpin, answer: &[u8]) {
    let telling = async {
        client.write_all(answer).await?;
        client.shutdown().await?;
        let mut rest = [0; 256];
        while client.read(&mut rest).await? > 0 {}
        std::io::Result::Ok(())
    };
    if !answer.is_empty() {
        let _ = timeout(FAREWELL, telling).await;
    }
}

/// What a connection does without only costs latency, or notices a lost client later.
fn tune(client: &TcpStream) {
    let _ = client.set_nodelay(true);
    let _ = sockopt::set_socket_keepalive(client, true);
    let _ = sockopt::set_tcp_keepidle(client, PROBE_AFTER);
    let _ = sockopt::set_tcp_keepintvl(client, PROBE_EVERY);
    let _ = sockopt::set_tcp_keepcnt(client, PROBES);
}
