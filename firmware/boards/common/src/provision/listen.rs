//! The page over embassy-net: connections one after the other, some at a time.

use core::convert::Infallible;

use crawler_hal::{Clock, with_deadline};
use embassy_futures::select::select_array;
use embassy_net::Stack;
use embassy_net::tcp::TcpSocket;
use embedded_storage_async::nor_flash::NorFlash;

use super::scan::Scanner;
use super::serve::{BUFFER, CLOSED_WITHIN, Outcome, Server};
use crate::settings::Settings;

/// Memory of one connection.
#[derive(Debug)]
pub struct Connection {
    receive: [u8; 1_024],
    transmit: [u8; 1_536],
    buffer: [u8; BUFFER],
}

impl Connection {
    /// Memory of one connection.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            receive: [0; 1_024],
            transmit: [0; 1_536],
            buffer: [0; BUFFER],
        }
    }
}

impl Default for Connection {
    fn default() -> Self {
        Self::new()
    }
}

/// Serves the page on `port` until settings are saved, which it returns: the caller then
/// restarts. Needs one socket of `stack` for each of `connections`.
///
/// # Cancellation Safety
/// Dropping it resets the connections that are open.
pub async fn serve<F: NorFlash, N: Scanner, C: Clock, const COUNT: usize>(
    stack: Stack<'_>,
    port: u16,
    server: &Server<F, N, C>,
    connections: &mut [Connection; COUNT],
) -> Settings {
    let work = connections
        .each_mut()
        .map(|connection| attend(stack, port, server, connection));
    match embassy_futures::select::select(server.saved.wait(), select_array(work)).await {
        embassy_futures::select::Either::First(settings) => settings,
        embassy_futures::select::Either::Second((never, _)) => match never {},
    }
}

/// Serves one connection after the other.
async fn attend<F: NorFlash, N: Scanner, C: Clock>(
    stack: Stack<'_>,
    port: u16,
    server: &Server<F, N, C>,
    connection: &mut Connection,
) -> Infallible {
    let Connection {
        receive,
        transmit,
        buffer,
    } = connection;
    let mut socket = TcpSocket::new(stack, receive, transmit);
    // A peer that vanished: noticed well after every deadline here.
    socket.set_timeout(Some(embassy_time::Duration::from_secs(20)));
    loop {
        if socket.accept(port).await.is_err() {
            // The socket was not closed: cannot be, and must not spin if it is.
            server.clock.sleep(CLOSED_WITHIN).await;
            socket.abort();
            continue;
        }
        let outcome = server.converse(&mut socket, buffer).await;
        socket.close();
        let until = server.clock.now() + CLOSED_WITHIN;
        let rest = async { while matches!(socket.read(buffer).await, Ok(1..)) {} };
        // Either way it is over.
        let _ = with_deadline(&server.clock, until, rest).await;
        socket.abort();
        // Lets the reset out, when there was anything left to reset.
        let until = server.clock.now() + CLOSED_WITHIN;
        let _ = with_deadline(&server.clock, until, socket.flush()).await;
        if let Outcome::Saved(settings) = outcome {
            server.saved.signal(settings);
        }
    }
}
