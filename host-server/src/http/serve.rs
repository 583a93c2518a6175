//! Serving connections: a bounded number of them, with a limit on how long a request may take to
//! arrive, and an end in good order.

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

use super::peer::Peer;
use crate::tls::{Door, Refusal};

/// Connections at a time; live feeds have a limit of their own. Others wait in the system's queue.
const MAX_CONNECTIONS: u32 = 1_024;
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

/// Serves `router` until `stop`, then lets requests under way finish. With a `door` connections are
/// encrypted.
pub(crate) async fn serve(
    listener: TcpListener,
    router: Router,
    door: Option<Door>,
    stop: CancellationToken,
) {
    let permits = Arc::new(Semaphore::new(MAX_CONNECTIONS as usize));
    let service = TowerToHyperService::new(router);
    let door = door.map(Arc::new);
    loop {
        let accepted = tokio::select! {
            biased;
            () = stop.cancelled() => break,
            accepted = accept(&listener, &permits) => accepted,
        };
        let (stream, address, permit) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                // Out of file descriptors, most likely: trying at once would only burn time.
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(Duration::from_millis(200)).await;
                continue;
            }
        };
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "no TCP_NODELAY");
        }
        let peer = Peer {
            address,
            tls: door.is_some(),
        };
        let (service, door, stop) = (service.clone(), door.clone(), stop.clone());
        tokio::spawn(async move {
            match door {
                None => speak(stream, peer, service, stop).await,
                Some(door) => {
                    let entered = tokio::select! {
                        () = stop.cancelled() => return,
                        entered = door.enter(stream, address.ip()) => entered,
                    };
                    match entered {
                        Ok(stream) => speak(stream, peer, service, stop).await,
                        Err(Refusal::Plain(stream)) => explain(stream).await,
                        Err(refusal) => {
                            tracing::debug!(%address, %refusal, "a client did not get in");
                        }
                    }
                }
            }
            drop(permit);
        });
    }
    drop(listener);
    // Every connection gives its permit back when it ends.
    let all = permits.acquire_many(MAX_CONNECTIONS);
    if tokio::time::timeout(DRAIN, all).await.is_err() {
        tracing::warn!("requests were under way and did not come to their end");
    }
}

/// Serves one connection to its end.
async fn speak<S>(stream: S, peer: Peer, service: Service, stop: CancellationToken)
where
    S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    let service = hyper::service::service_fn(move |mut request| {
        peer.mark(&mut request);
        service.call(request)
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
) -> std::io::Result<(TcpStream, SocketAddr, OwnedSemaphorePermit)> {
    let permit = Arc::clone(permits)
        .acquire_owned()
        .await
        .map_err(std::io::Error::other)?;
    let (stream, address) = listener.accept().await?;
    Ok((stream, address, permit))
}
