//! One connection of a robot, from its first byte to its last.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use embassy_futures::select::{Either, select};
use tokio::net::TcpStream;
use tokio::sync::OwnedSemaphorePermit;

use super::air::Shared;
use super::hello::{self, Hello};
use super::pump::{End, Way};
use crate::net::lockstep::Cut;
use crate::net::radio::Direction;

/// For a robot to say who it is.
const HELLO: Duration = Duration::from_secs(10);
/// For the broker to answer the telephone.
const CONNECT: Duration = Duration::from_secs(10);
/// A connection of which one side has ended lives on so long.
const HALF_OPEN: Duration = Duration::from_mins(1);
/// A connection over a link that is cut is given up by TCP after about so long.
const LONGEST_CUT: Duration = Duration::from_mins(15);

/// Counts a connection for as long as it lives.
struct Counted(Arc<Shared>);

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Serves one connection.
pub(super) async fn serve(
    shared: Arc<Shared>,
    client: TcpStream,
    peer: SocketAddr,
    place: OwnedSemaphorePermit,
) {
    shared.accept();
    let counted = Counted(shared);
    let shared = &counted.0;
    // Only costs latency when it fails.
    let _ = client.set_nodelay(true);
    let mut said = Vec::new();
    let Ok(Ok(name)) = tokio::time::timeout(HELLO, introduce(&client, &mut said)).await else {
        return;
    };
    let name = name.unwrap_or_else(|| peer.ip().to_string());
    let station = shared.station(&name);
    if shake_hands(shared, station, &client).await.is_none() {
        return;
    }
    match call(shared).await {
        Ok(broker) => carry(shared, station, client, broker, &said).await,
        // The robot hears of it as it would of a broker that is not there.
        Err(_) => reset(&client),
    }
    drop(place);
}

/// Reads until it is clear who speaks. What was read stays in `said`.
async fn introduce(client: &TcpStream, said: &mut Vec<u8>) -> io::Result<Option<String>> {
    let mut buffer = [0; hello::MOST];
    loop {
        client.readable().await?;
        let room = hello::MOST - said.len();
        match client.try_read(&mut buffer[..room]) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(len) => said.extend_from_slice(&buffer[..len]),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
            Err(error) => return Err(error),
        }
        match hello::read(said) {
            Hello::More => {}
            Hello::Name(name) => return Ok(Some(name)),
            Hello::Nobody => return Ok(None),
        }
    }
}

/// Takes the time of a TCP handshake over the air. `None` when the robot does not wait for it.
async fn shake_hands(shared: &Shared, station: usize, client: &TcpStream) -> Option<()> {
    let mut news = shared.news(station);
    for direction in [Direction::Up, Direction::Down] {
        let through = async {
            loop {
                let now = shared.now_us();
                if let Some(arrival) = shared.transit(station, direction, 0, now) {
                    tokio::time::sleep_until(shared.at(arrival)).await;
                    return Some(());
                }
                news.wait_for(|signal| signal.cut == Cut::None).await.ok()?;
            }
        };
        let gone = async {
            let mut byte = [0];
            // More bytes than the greeting mean that it is there.
            while !matches!(client.peek(&mut byte).await, Ok(0) | Err(_)) {
                tokio::time::sleep(Duration::from_secs(1)).await;
            }
        };
        let both = tokio::time::timeout(LONGEST_CUT, select(through, gone));
        match both.await {
            Ok(Either::First(Some(()))) => {}
            _ => return None,
        }
    }
    Some(())
}

async fn call(shared: &Shared) -> io::Result<TcpStream> {
    let mut last = io::Error::from(io::ErrorKind::AddrNotAvailable);
    for &address in &shared.broker {
        match tokio::time::timeout(CONNECT, TcpStream::connect(address)).await {
            Ok(Ok(stream)) => {
                let _ = stream.set_nodelay(true);
                return Ok(stream);
            }
            Ok(Err(error)) => last = error,
            Err(_) => last = io::ErrorKind::TimedOut.into(),
        }
    }
    Err(last)
}

/// Carries bytes both ways until both sides have ended, or one is gone.
async fn carry(shared: &Shared, station: usize, client: TcpStream, broker: TcpStream, said: &[u8]) {
    let (from_client, to_client) = client.into_split();
    let (from_broker, to_broker) = broker.into_split();
    let up = Way {
        shared,
        station,
        direction: Direction::Up,
        from: &from_client,
        to: to_broker,
    };
    let down = Way {
        shared,
        station,
        direction: Direction::Down,
        from: &from_broker,
        to: to_client,
    };
    let ways = async {
        let (mut up, mut down) = (
            std::pin::pin!(up.carry(said)),
            std::pin::pin!(down.carry(&[])),
        );
        match select(&mut up, &mut down).await {
            Either::First(End::Said) => {
                tokio::time::timeout(HALF_OPEN, down).await == Ok(End::Said)
            }
            Either::Second(End::Said) => tokio::time::timeout(HALF_OPEN, up).await == Ok(End::Said),
            _ => false,
        }
    };
    // Both carry on through a cut, but not for ever.
    let mut news = shared.news(station);
    let forgotten = async {
        loop {
            if news.wait_for(|s| s.cut != Cut::None).await.is_err() {
                return;
            }
            let healed = news.wait_for(|s| s.cut == Cut::None);
            match tokio::time::timeout(LONGEST_CUT, healed).await {
                Ok(Ok(_)) => {}
                _ => return,
            }
        }
    };
    let ended_well = matches!(select(ways, forgotten).await, Either::First(true));
    if !ended_well {
        reset(from_client.as_ref());
        reset(from_broker.as_ref());
    }
}

/// Lets a connection end with a reset when it is dropped, as its other side did.
fn reset(stream: &TcpStream) {
    let _ = stream.set_zero_linger();
}
