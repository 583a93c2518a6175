//! Serving connections: a bounded number of them, with a limit on how long a request may take to
//! arrive, and an end in good order.
//!
//! A connection without a request under way is closed when there is no room for a new one, and so is one
//! whose client does not take its answer: see [`Waiting`]. So a crowd of connections, however slowly it
//! speaks, keeps out nobody who wants to stop a robot.

use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper::service::Service as _;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::connection::{arriving, awaited};
use super::peer::Peer;
use crawler_server_tls::{Refusal, TlsHandshake};
use crawler_system::descriptors;
use crawler_system::waiting::{Slot, Waiting};

/// Connections of one address that wait for their client. Browsers keep six, proxies a few hundred.
const MOST_OF_ONE: usize = 256;
/// How soon somebody who waits for room is looked after again, where every connection is at work.
const LOOK: Duration = Duration::from_millis(100);
/// For the head of a request, counted from the end of the one before on a kept connection.
const HEAD_TIME_OUT: Duration = Duration::from_secs(30);
/// For requests under way when the server stops.
const DRAIN: Duration = Duration::from_secs(2);

/// Told to whoever speaks HTTP where TLS is spoken. A redirect would teach clients to go on doing it,
/// and send what must not be read by others first.
const PLAIN: &str = "HTTP/1.1 400 Bad Request\r\ncontent-type: text/plain; charset=utf-8\r\n\
    content-length: 60\r\nconnection: close\r\n\r\n\
    This port speaks HTTPS: the address begins with https://...\n";
/// For that to be read.
const PLAIN_TIME_OUT: Duration = Duration::from_secs(2);

type Service = TowerToHyperService<Router>;

/// Serves `router` until `stop`, then lets requests under way finish. With `tls` connections are
/// encrypted. There are at most so many `connections` at a time; live feeds and MQTT over a WebSocket have
/// limits of their own.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    tls: Option<TlsHandshake>,
    connections: usize,
    stop: CancellationToken,
) {
    let permits = Arc::new(Semaphore::new(connections));
    let waiting = Waiting::new(connections, MOST_OF_ONE.min(connections / 2));
    let serving = TaskTracker::new();
    // Cancelled also when nobody waits for the end.
    let cut = CancellationToken::new();
    let guard = cut.clone().drop_guard();
    let service = TowerToHyperService::new(router);
    let tls = tls.map(Arc::new);
    loop {
        let accepted = tokio::select! {
            biased;
            () = stop.cancelled() => break,
            accepted = accept(&listener, &permits, &waiting) => accepted,
        };
        let (stream, address, permit) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                if descriptors::are_used_up(&error) {
                    // Who says nothing has one to spare.
                    waiting.close_oldest();
                }
                // Trying at once would only burn time.
                tokio::time::sleep(Duration::from_millis(200)).await;
                continue;
            }
        };
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "no TCP_NODELAY");
        }
        let peer = Peer {
            address,
            tls: tls.is_some(),
        };
        let slot = Arc::new(waiting.enter(peer.ip()));
        let (service, tls, stop) = (service.clone(), tls.clone(), stop.clone());
        let cut = cut.clone();
        serving.spawn(async move {
            let serving = one(stream, peer, Arc::clone(&slot), service, tls, stop);
            tokio::select! {
                () = serving => {}
                () = cut.cancelled() => {}
                () = slot.crowded_out() => {
                    tracing::debug!(%address, "a connection made room for others");
                }
            }
            drop(permit);
        });
    }
    drop(listener);
    serving.close();
    if tokio::time::timeout(DRAIN, serving.wait()).await.is_err() {
        tracing::warn!("requests were under way and did not come to their end");
        drop(guard);
        serving.wait().await;
    }
}

/// Serves one connection, with TLS or without.
async fn one(
    stream: TcpStream,
    peer: Peer,
    slot: Arc<Slot>,
    service: Service,
    tls: Option<Arc<TlsHandshake>>,
    stop: CancellationToken,
) {
    let Some(tls) = tls else {
        return speak(stream, peer, slot, service, stop).await;
    };
    let entered = tokio::select! {
        () = stop.cancelled() => return,
        entered = tls.enter(stream) => entered,
    };
    match entered {
        Ok(stream) => speak(stream, peer, slot, service, stop).await,
        Err(Refusal::Plain(stream)) => explain(stream).await,
        Err(refusal) => {
            tracing::debug!(address = %peer.address, %refusal, "a client did not get in");
        }
    }
}

/// Serves one connection to its end.
async fn speak<S>(stream: S, peer: Peer, slot: Arc<Slot>, service: Service, stop: CancellationToken)
where
    S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    let service = hyper::service::service_fn(move |mut request| {
        peer.mark(&mut request);
        let answering = service.call(arriving(request, Arc::clone(&slot)));
        let slot = Arc::clone(&slot);
        async move { answering.await.map(|response| awaited(response, slot)) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIME_OUT)
        .max_buf_size(64 * 1024)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    let mut connection = pin!(connection);
    let result = tokio::select! {
        result = connection.as_mut() => result,
        () = stop.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = result {
        tracing::debug!(%error, "a connection ended early");
    }
}

/// Says what to do instead, and lets it be read: a connection that is closed with bytes unread loses
/// the answer as well.
async fn explain(mut stream: TcpStream) {
    let explaining = async {
        stream.write_all(PLAIN.as_bytes()).await?;
        stream.shutdown().await?;
        let mut rest = [0; 1_024];
        while stream.read(&mut rest).await? > 0 {}
        std::io::Result::Ok(())
    };
    let _ = tokio::time::timeout(PLAIN_TIME_OUT, explaining).await;
}

async fn accept(
    listener: &TcpListener,
    permits: &Arc<Semaphore>,
    waiting: &Waiting,
) -> std::io::Result<(TcpStream, SocketAddr, OwnedSemaphorePermit)> {
    let (stream, address) = listener.accept().await?;
    let mut room = pin!(Arc::clone(permits).acquire_owned());
    if permits.available_permits() == 0 {
        waiting.close_oldest();
    }
    loop {
        tokio::select! {
            biased;
            permit = room.as_mut() => {
                return Ok((stream, address, permit.map_err(std::io::Error::other)?));
            }
            () = tokio::time::sleep(LOOK) => {
                waiting.close_oldest();
            }
        }
    }
}

#[cfg(test)]
#[path = "serve_tests.rs"]
mod tests;
