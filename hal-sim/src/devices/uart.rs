//! The US-100's serial line: 9600 baud, 8N1.

use core::future::pending;

use crawler_hal::{Clock, Duration, Instant};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};

use super::ports::Wire;
use super::sonar::FIFO_BYTES;

/// One byte: start bit, eight data bits and stop bit at 9600 baud.
pub(crate) const BYTE_TIME: Duration = Duration::from_micros(1_042);

/// Asks for a range.
const RANGE: u8 = 0x55;
/// Asks for the temperature.
const TEMPERATURE: u8 = 0x50;

/// What the sensor takes to read its thermometer.
const THERMOMETER_TIME: Duration = Duration::from_millis(2);

/// The controller's end of the serial line to the US-100.
#[derive(Debug)]
pub struct SimUart {
    wire: Wire,
}

/// The line reports nothing by itself: like the real one it has no framing to check beyond the
/// byte. The variant stands for a controller without power.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UartError;

impl core::fmt::Display for UartError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the body behind this line was reset or lost its power")
    }
}

impl core::error::Error for UartError {}

impl embedded_io_async::Error for UartError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NotConnected
    }
}

impl SimUart {
    pub(crate) const fn new(wire: Wire) -> Self {
        Self { wire }
    }

    fn check(&self) -> Result<(), UartError> {
        if self.wire.is_live() {
            Ok(())
        } else {
            Err(UartError)
        }
    }

    /// When a reader that wants `most` bytes wakes: at once with bytes that are there, else when
    /// it has what it wants or the line pauses, as a receiver's interrupt does. `None` when
    /// nothing is under way.
    fn awaited(&self, most: usize) -> Option<Instant> {
        let sonar = self.wire.ports.sonar.borrow();
        let &(first, _) = sonar.inbox.front()?;
        if first <= self.wire.clock().now() {
            return Some(first);
        }
        let mut last = first;
        for &(arrival, _) in sonar.inbox.iter().take(most).skip(1) {
            if arrival - last > BYTE_TIME {
                break;
            }
            last = arrival;
        }
        Some(last)
    }

    /// A FIFO that nothing leaves.
    async fn fill_hanging(&self, buf: &[u8]) -> Result<usize, UartError> {
        let taken = {
            let mut sonar = self.wire.ports.sonar.borrow_mut();
            let taken = buf.len().min(FIFO_BYTES - sonar.hanging);
            sonar.hanging += taken;
            taken
        };
        if taken == 0 {
            return pending().await;
        }
        Ok(taken)
    }

    /// The sensor receives one byte at `at`.
    fn deliver(&self, byte: u8, at: Instant) {
        let ports = &self.wire.ports;
        let flips = ports.faults.get().bit_flips;
        let mut sonar = ports.sonar.borrow_mut();
        let byte = sonar.over_the_line(byte, flips);
        // Anything else is noise to the sensor.
        if !matches!(byte, RANGE | TEMPERATURE) || !sonar.claim(ports, at) {
            return;
        }
        let mut reply = heapless::Vec::<u8, 2>::new();
        let ready = if byte == RANGE {
            let echo = sonar.listen(ports, at);
            // Two bytes always fit.
            let _ = reply.extend_from_slice(&echo.says_mm.to_be_bytes());
            at + echo.after
        } else {
            let _ = reply.push(sonar.temperature_code(ports));
            at + THERMOMETER_TIME
        };
        let mut arrival = ready;
        for byte in reply {
            arrival += BYTE_TIME;
            let byte = sonar.over_the_line(byte, flips);
            // A receiver that is full loses what comes.
            if sonar.inbox.len() < FIFO_BYTES {
                sonar.inbox.push_back((arrival, byte));
            }
        }
        sonar.occupy(arrival);
    }
}

impl ErrorType for SimUart {
    type Error = UartError;
}

impl Read for SimUart {
    /// Waits for at least one byte. Nothing can arrive unless something was written before, so
    /// with nothing under way this waits for ever.
    ///
    /// # Cancellation Safety
    /// A dropped call takes no byte.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, UartError> {
        self.check()?;
        if buf.is_empty() {
            return Ok(0);
        }
        let stuck = self.wire.ports.faults.get().line_stuck;
        let wake = self.awaited(buf.len()).filter(|_| !stuck);
        let Some(wake) = wake else {
            return pending().await;
        };
        self.wire.clock().sleep_until(wake).await;
        self.check()?;
        let now = self.wire.clock().now();
        let mut sonar = self.wire.ports.sonar.borrow_mut();
        let mut taken = 0;
        while taken < buf.len()
            && let Some(&(arrival, byte)) = sonar.inbox.front()
            && arrival <= now
        {
            sonar.inbox.pop_front();
            buf[taken] = byte;
            taken += 1;
        }
        Ok(taken)
    }
}

impl Write for SimUart {
    /// Puts bytes into the transmit FIFO, waiting while it is full.
    ///
    /// # Cancellation Safety
    /// A dropped call has written nothing.
    async fn write(&mut self, buf: &[u8]) -> Result<usize, UartError> {
        self.check()?;
        if buf.is_empty() {
            return Ok(0);
        }
        let clock = self.wire.clock();
        let full = BYTE_TIME * (FIFO_BYTES as u32);
        if self.wire.ports.faults.get().line_stuck {
            return self.fill_hanging(buf).await;
        }
        let sent_until = self.wire.ports.sonar.borrow().sent_until;
        if sent_until - clock.now() >= full {
            // Until one byte has left.
            let room_at = Instant::from_micros(
                sent_until.as_micros() - full.as_micros() + BYTE_TIME.as_micros(),
            );
            clock.sleep_until(room_at).await;
            self.check()?;
        }
        let mut written = 0;
        for &byte in buf {
            let now = clock.now();
            let starts = self.wire.ports.sonar.borrow().sent_until.max(now);
            if written > 0 && starts - now >= full {
                break;
            }
            let arrives = starts + BYTE_TIME;
            self.wire.ports.sonar.borrow_mut().sent_until = arrives;
            self.deliver(byte, arrives);
            written += 1;
        }
        Ok(written)
    }

    /// Waits until the last byte has left.
    ///
    /// # Cancellation Safety
    /// A dropped call has no effect.
    async fn flush(&mut self) -> Result<(), UartError> {
        self.check()?;
        if self.wire.ports.faults.get().line_stuck {
            return pending().await;
        }
        let sent_until = self.wire.ports.sonar.borrow().sent_until;
        self.wire.clock().sleep_until(sent_until).await;
        self.check()
    }
}
