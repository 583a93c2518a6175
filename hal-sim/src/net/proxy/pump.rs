//! One direction of a connection, from a socket through the air into another.

use std::future::pending;
use std::io;
use std::time::Duration;

use embassy_futures::select::{Either3, select3};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::watch;

use super::air::{Shared, Signal};
use crate::net::lockstep::{Cut, HELD, Pipe};
use crate::net::radio::{Direction, SEGMENT};

/// Bytes under way in one direction of a connection before its sender has to wait.
pub(super) const MOST_UNDER_WAY: usize = 64 * 1024;
/// Read at once: small beside what is under way, so that the air is shared finely.
const PIECE: usize = 4 * SEGMENT;
/// A receiver that takes nothing for so long is gone. A sender's TCP gives up after as long.
const STUCK: Duration = Duration::from_mins(2);

/// How a direction ended.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum End {
    /// The sender has said all it had to say, and all of it has arrived.
    Said,
    /// The sender or the receiver is gone.
    Broken,
}

/// One direction of one connection.
pub(super) struct Way<'a> {
    pub(super) shared: &'a Shared,
    pub(super) station: usize,
    pub(super) direction: Direction,
    pub(super) from: &'a OwnedReadHalf,
    /// Dropped at the end, which tells the receiver that nothing more will come.
    pub(super) to: OwnedWriteHalf,
}

impl Way<'_> {
    /// Carries bytes until the sender ends; `first` is what it has said already.
    pub(super) async fn carry(self, first: &[u8]) -> End {
        let end = self.run(first).await;
        if end == End::Broken {
            // An end in order would hide the reset that is to follow.
            self.to.forget();
        }
        end
    }

    async fn run(&self, first: &[u8]) -> End {
        let mut news = self.shared.news(self.station);
        let mut pipe = Pipe::default();
        let mut up = news.borrow_and_update().cut == Cut::None;
        // How the sender ended, and when that arrives.
        let mut ended: Option<(End, u64)> = None;
        let mut buffer = vec![0; PIECE];
        self.enter(&mut pipe, first);
        loop {
            let now = self.shared.now_us();
            if up {
                let arrived = pipe.read(now, &mut buffer);
                if arrived > 0 {
                    if self.deliver(&buffer[..arrived]).await.is_err() {
                        return End::Broken;
                    }
                    continue;
                }
                match &mut ended {
                    Some((End::Broken, at)) if *at <= now => return End::Broken,
                    Some((End::Said, at)) if *at <= now && pipe.len() == 0 => return End::Said,
                    _ => {}
                }
            }
            let next = match (&ended, pipe.next_arrival()) {
                (Some((End::Broken, at)), _) | (Some((End::Said, at)), None) => Some(*at),
                (_, next) => next,
            };
            let full = pipe.len() >= MOST_UNDER_WAY;
            let heard = async {
                if full || ended.is_some() {
                    return pending().await;
                }
                self.hear(&mut buffer).await
            };
            let due = async {
                match next {
                    Some(at) if up && at != HELD => {
                        tokio::time::sleep_until(self.shared.at(at)).await;
                    }
                    _ => pending().await,
                }
            };
            match select3(heard, due, told(&mut news, up)).await {
                Either3::First(Ok(0)) => ended = Some((End::Said, self.arrival(0))),
                Either3::First(Ok(len)) => self.enter(&mut pipe, &buffer[..len]),
                Either3::First(Err(_)) => ended = Some((End::Broken, self.arrival(0))),
                Either3::Second(()) => {}
                Either3::Third(Some(now_up)) => {
                    up = now_up;
                    if up {
                        // It has to be sent again, and takes its time in the air again.
                        let arrival = self.arrival(pipe.len());
                        pipe.release(arrival);
                        if let Some((_, at)) = &mut ended {
                            *at = arrival;
                        }
                    } else {
                        pipe.hold(0);
                    }
                }
                Either3::Third(None) => return End::Broken,
            }
        }
    }

    fn arrival(&self, len: usize) -> u64 {
        let now = self.shared.now_us();
        let transit = self.shared.transit(self.station, self.direction, len, now);
        transit.unwrap_or(HELD)
    }

    fn enter(&self, pipe: &mut Pipe, bytes: &[u8]) {
        if !bytes.is_empty() {
            pipe.write(bytes, self.arrival(bytes.len()));
        }
    }

    /// # Cancellation Safety
    /// A dropped call takes no byte.
    async fn hear(&self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            self.from.readable().await?;
            match self.from.try_read(buffer) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                other => return other,
            }
        }
    }

    async fn deliver(&self, mut bytes: &[u8]) -> io::Result<()> {
        self.shared.count(self.direction, bytes.len());
        while !bytes.is_empty() {
            let writable = tokio::time::timeout(STUCK, self.to.writable());
            writable.await.map_err(|_| io::ErrorKind::TimedOut)??;
            match self.to.try_write(bytes) {
                Ok(written) => bytes = &bytes[written..],
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// Waits until a link is cut or healed; `None` when the proxy ends.
async fn told(news: &mut watch::Receiver<Signal>, was_up: bool) -> Option<bool> {
    let told = news.wait_for(|signal| (signal.cut == Cut::None) != was_up);
    told.await.ok().map(|_| !was_up)
}
