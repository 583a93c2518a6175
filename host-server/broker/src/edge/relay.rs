//! Bytes both ways between a client and the broker.

use std::pin::pin;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::aliases::Aliases;
use super::packets::{Packets, TopicAlias};

/// What is carried at once. Most messages are smaller.
const CHUNK: usize = 4 * 1024;
/// What one side may still say after the other has ended.
const LAST_WORDS: Duration = Duration::from_secs(5);
/// A client that takes nothing for so long is gone. The broker ends the session of one sooner, by its
/// send time-out.
const STALLED: Duration = Duration::from_secs(10);
/// For a client to read why it is cut off.
const FAREWELL: Duration = Duration::from_secs(1);
/// DISCONNECT with *topic alias invalid* (MQTT 5, section 3.14.2.1).
const ALIAS_INVALID: &[u8] = &[0xe0, 2, 0x94, 0];

/// Why a connection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    /// One of the two has ended it, or is gone.
    Closed,
    /// The client has used a topic alias that nobody announced.
    Alias,
}

/// Carries bytes until both sides have ended, or one is gone. With `properties` the client's publishes are
/// looked into: it speaks MQTT 5. With `aliases` it takes numbers for topics.
pub(super) async fn carry<C, B>(
    client: C,
    broker: B,
    properties: bool,
    aliases: Option<Aliases>,
) -> End
where
    C: AsyncRead + AsyncWrite,
    B: AsyncRead + AsyncWrite,
{
    let (mut from_client, to_client) = tokio::io::split(client);
    let end = both(&mut from_client, to_client, broker, (properties, aliases)).await;
    if end == End::Alias {
        // A connection that is closed with bytes unread loses what was sent last.
        let mut rest = [0; 256];
        let reading =
            async { while from_client.read(&mut rest).await.is_ok_and(|read| read > 0) {} };
        let _ = timeout(FAREWELL, reading).await;
    }
    end
}

async fn both<B>(
    from_client: impl AsyncRead + Unpin,
    to_client: impl AsyncWrite + Unpin,
    broker: B,
    (properties, aliases): (bool, Option<Aliases>),
) -> End
where
    B: AsyncRead + AsyncWrite,
{
    let (from_broker, to_broker) = tokio::io::split(broker);
    let cut = CancellationToken::new();
    let packets = if properties {
        Packets::looked_into()
    } else {
        Packets::told_apart()
    };
    let mut there = pin!(there(from_client, to_broker, packets));
    let mut back = pin!(back(from_broker, to_client, aliases, &cut));
    // A way that breaks ends both connections at once.
    tokio::select! {
        ended = &mut there => match ended {
            Ok(()) => {
                let _ = timeout(LAST_WORDS, back).await;
            }
            Err(Broken::Alias) => {
                cut.cancel();
                let _ = timeout(LAST_WORDS, back).await;
                return End::Alias;
            }
            Err(Broken::Gone) => {}
        },
        ended = &mut back => if ended.is_ok() {
            let _ = timeout(LAST_WORDS, there).await;
        },
    }
    End::Closed
}

/// Why a way does not go on.
#[derive(Debug)]
enum Broken {
    Gone,
    Alias,
}

impl From<std::io::Error> for Broken {
    fn from(_: std::io::Error) -> Self {
        Self::Gone
    }
}

impl From<TopicAlias> for Broken {
    fn from(_: TopicAlias) -> Self {
        Self::Alias
    }
}

/// From the client to the broker, until the client has closed its side or said that nothing more comes.
async fn there(
    mut client: impl AsyncRead + Unpin,
    mut broker: impl AsyncWrite + Unpin,
    mut packets: Packets,
) -> Result<(), Broken> {
    let mut chunk = vec![0; CHUNK];
    loop {
        let length = client.read(&mut chunk).await?;
        let bytes = chunk.get_mut(..length).unwrap_or_default();
        let is_closed = bytes.is_empty();
        let count = packets.pass(bytes)?;
        broker
            .write_all(bytes.get(..count).unwrap_or_default())
            .await?;
        if is_closed || packets.are_over() {
            return Ok(broker.shutdown().await?);
        }
    }
}

/// From the broker to the client. When it is `cut` off, the packet that has begun comes to its end first.
async fn back(
    mut broker: impl AsyncRead + Unpin,
    mut client: impl AsyncWrite + Unpin,
    mut aliases: Option<Aliases>,
    cut: &CancellationToken,
) -> Result<(), Broken> {
    let mut chunk = vec![0; CHUNK];
    let mut shortened = Vec::new();
    let mut packets = Packets::told_apart();
    loop {
        if cut.is_cancelled() && packets.is_between() {
            send(&mut client, ALIAS_INVALID).await?;
            return Ok(in_time(client.shutdown()).await?);
        }
        let length = tokio::select! {
            biased;
            () = cut.cancelled(), if packets.is_between() => continue,
            read = broker.read(&mut chunk) => read?,
        };
        let mut bytes = chunk.get_mut(..length).unwrap_or_default();
        if bytes.is_empty() {
            return Ok(in_time(client.shutdown()).await?);
        }
        if cut.is_cancelled() {
            let end = packets.finish(bytes);
            bytes = bytes.get_mut(..end).unwrap_or_default();
        } else {
            packets.pass(bytes)?;
        }
        if let Some(aliases) = &mut aliases {
            shortened.clear();
            aliases.pass(bytes, &mut shortened);
            send(&mut client, &shortened).await?;
        } else {
            send(&mut client, bytes).await?;
        }
    }
}

/// Sends something to a client.
///
/// # Errors
/// What the system says; a client that takes nothing for a while is gone.
pub(super) async fn send(
    client: &mut (impl AsyncWrite + Unpin),
    bytes: &[u8],
) -> std::io::Result<()> {
    in_time(async {
        client.write_all(bytes).await?;
        client.flush().await
    })
    .await
}

async fn in_time(writing: impl Future<Output = std::io::Result<()>>) -> std::io::Result<()> {
    timeout(STALLED, writing)
        .await
        .unwrap_or_else(|_| Err(std::io::ErrorKind::TimedOut.into()))
}

#[cfg(test)]
#[path = "relay_tests.rs"]
mod tests;
