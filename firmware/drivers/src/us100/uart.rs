//! Request and reply over the UART.

use core::pin::pin;

use crawler_hal::{Clock, Instant, with_deadline};
use embedded_io_async::{Error as _, Read, Write};

use super::{LinkError, REPLY_TIMEOUT, SILENCE};

/// A request, and how many bytes answer it.
pub(super) struct Request<const N: usize> {
    pub(super) code: u8,
}

pub(super) const RANGE: Request<2> = Request { code: 0x55 };
pub(super) const TEMPERATURE: Request<1> = Request { code: 0x50 };

const SCRAP: usize = 16;
/// Reads until a line counts as babbling. 32 · 16 bytes are four times the receive FIFO of an
/// ESP32 (128 bytes): more than can have waited there while nobody read.
pub(super) const DRAIN_READS: usize = 32;

/// Sends `request` and returns its reply.
pub(super) async fn request<U: Read + Write, C: Clock, const N: usize>(
    uart: &mut U,
    clock: &C,
    request: Request<N>,
) -> Result<[u8; N], LinkError> {
    let deadline = clock.now() + REPLY_TIMEOUT;
    drain(uart, clock).await?;
    let reply = {
        // Lent, not moved: whoever awaits a future keeps it a second time.
        let exchange = pin!(async {
            send(uart, request.code).await?;
            receive(uart).await
        });
        with_deadline(clock, deadline, exchange)
            .await
            .map_err(|_| LinkError::Timeout)??
    };
    silence(uart, clock).await?;
    Ok(reply)
}

/// Drops what has arrived already, without waiting for more.
async fn drain<U: Read, C: Clock>(uart: &mut U, clock: &C) -> Result<(), LinkError> {
    let mut last = LinkError::Noise;
    let mut scrap = [0; SCRAP];
    for _ in 0..DRAIN_READS {
        // A deadline in the past: a read that has something completes, any other is dropped.
        match with_deadline(clock, Instant::BOOT, uart.read(&mut scrap)).await {
            Err(_) => return Ok(()),
            Ok(Ok(0)) => return Err(LinkError::Closed),
            Ok(Ok(_)) => last = LinkError::Noise,
            // An overrun of old bytes is what a drain is for; an error that does not go away is
            // not.
            Ok(Err(error)) => last = LinkError::Uart(error.kind()),
        }
    }
    Err(last)
}

async fn send<U: Write>(uart: &mut U, code: u8) -> Result<(), LinkError> {
    // Not `write_all`: one byte is written whole or not at all.
    match uart.write(&[code]).await {
        Ok(0) => return Err(LinkError::Closed),
        Ok(_) => {}
        Err(error) => return Err(LinkError::Uart(error.kind())),
    }
    uart.flush()
        .await
        .map_err(|error| LinkError::Uart(error.kind()))
}

async fn receive<U: Read, const N: usize>(uart: &mut U) -> Result<[u8; N], LinkError> {
    let mut reply = [0; N];
    let mut rest = &mut reply[..];
    while !rest.is_empty() {
        match uart.read(rest).await {
            Ok(0) => return Err(LinkError::Closed),
            // A driver that claims more than it was given room for leaves nothing to fill.
            Ok(read) => rest = rest.get_mut(read..).unwrap_or_default(),
            Err(error) => return Err(LinkError::Uart(error.kind())),
        }
    }
    Ok(reply)
}

/// Checks that the reply is over: a byte too many means that it was not the one asked for.
async fn silence<U: Read, C: Clock>(uart: &mut U, clock: &C) -> Result<(), LinkError> {
    let until = clock.now() + SILENCE;
    match with_deadline(clock, until, uart.read(&mut [0; 1])).await {
        Err(_) => Ok(()),
        Ok(Ok(0)) => Err(LinkError::Closed),
        Ok(Ok(_)) => Err(LinkError::Noise),
        Ok(Err(error)) => Err(LinkError::Uart(error.kind())),
    }
}
