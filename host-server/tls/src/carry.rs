//! Bytes both ways between two connections.

use std::pin::pin;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt as _};

/// What one side may still say after the other has ended.
const LAST_WORDS: Duration = Duration::from_secs(5);

/// Carries bytes until both sides have ended, or one is gone.
pub(crate) async fn carry<A, B>(one: A, other: B)
where
    A: AsyncRead + AsyncWrite,
    B: AsyncRead + AsyncWrite,
{
    let (from_one, to_one) = tokio::io::split(one);
    let (from_other, to_other) = tokio::io::split(other);
    let mut there = pin!(way(from_one, to_other));
    let mut back = pin!(way(from_other, to_one));
    // A way that breaks ends both connections at once.
    tokio::select! {
        ended = &mut there => if ended.is_ok() {
            let _ = tokio::time::timeout(LAST_WORDS, back).await;
        },
        ended = &mut back => if ended.is_ok() {
            let _ = tokio::time::timeout(LAST_WORDS, there).await;
        },
    }
}

async fn way(
    mut from: impl AsyncRead + Unpin,
    mut to: impl AsyncWrite + Unpin,
) -> std::io::Result<()> {
    tokio::io::copy(&mut from, &mut to).await?;
    to.shutdown().await
}
