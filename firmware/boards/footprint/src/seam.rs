//! Ports whose other side is not there. The compiler can assume nothing about what they answer, so
//! it can leave nothing of the program out.

use core::convert::Infallible;
use core::future::poll_fn;
use core::task::Poll;

use crawler_app::Geometry;
use crawler_hal::{
    Adc, Clock, Instant, LinkMonitor, LinkState, Millivolts, NetError, Network, ResetCause, System,
};
use embedded_hal::{digital, pwm};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use embedded_storage_async::nor_flash::{
    self, MultiwriteNorFlash, NorFlash, NorFlashErrorKind, ReadNorFlash,
};

// SAFETY: nothing defines them, and nothing ever calls them: this program is weighed, not run.
unsafe extern "Rust" {
    safe fn footprint_now() -> u64;
    safe fn footprint_number(port: u32) -> u32;
    safe fn footprint_set(port: u32, value: u32) -> bool;
    safe fn footprint_read(port: u32, at: u32, bytes: &mut [u8]) -> Poll<Option<usize>>;
    safe fn footprint_write(port: u32, at: u32, bytes: &[u8]) -> Poll<Option<usize>>;
    safe fn footprint_link() -> LinkState;
    safe fn footprint_cause() -> ResetCause;
    safe fn footprint_geometry() -> Geometry;
    safe fn footprint_joined() -> Poll<Result<(), NetError>>;
    safe fn footprint_connected(host: &str, port: u16) -> Poll<Result<(), NetError>>;
    pub(crate) safe fn footprint_level(port: u32) -> bool;
    pub(crate) safe fn footprint_text(number: u32) -> &'static str;
    pub(crate) safe fn footprint_end() -> !;
}

/// Measures of a robot.
pub(crate) fn geometry() -> Geometry {
    footprint_geometry()
}

/// Any port of a board, by number.
#[derive(Clone, Debug)]
pub(crate) struct Port(pub(crate) u32);

fn outcome<E>(fine: bool, error: E) -> Result<(), E> {
    if fine { Ok(()) } else { Err(error) }
}

impl pwm::ErrorType for Port {
    type Error = pwm::ErrorKind;
}

impl pwm::SetDutyCycle for Port {
    fn max_duty_cycle(&self) -> u16 {
        255
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), pwm::ErrorKind> {
        outcome(footprint_set(self.0, duty.into()), pwm::ErrorKind::Other)
    }
}

impl digital::ErrorType for Port {
    type Error = digital::ErrorKind;
}

impl digital::OutputPin for Port {
    fn set_low(&mut self) -> Result<(), digital::ErrorKind> {
        outcome(footprint_set(self.0, 0), digital::ErrorKind::Other)
    }

    fn set_high(&mut self) -> Result<(), digital::ErrorKind> {
        outcome(footprint_set(self.0, 1), digital::ErrorKind::Other)
    }
}

impl digital::InputPin for Port {
    fn is_high(&mut self) -> Result<bool, digital::ErrorKind> {
        Ok(footprint_level(self.0))
    }

    fn is_low(&mut self) -> Result<bool, digital::ErrorKind> {
        Ok(!footprint_level(self.0))
    }
}

impl Port {
    async fn level(&self, wanted: bool) -> Result<(), digital::ErrorKind> {
        poll_fn(|_| {
            if footprint_level(self.0) == wanted {
                Poll::Ready(Ok(()))
            } else {
                Poll::Pending
            }
        })
        .await
    }
}

impl Wait for Port {
    async fn wait_for_high(&mut self) -> Result<(), digital::ErrorKind> {
        self.level(true).await
    }

    async fn wait_for_low(&mut self) -> Result<(), digital::ErrorKind> {
        self.level(false).await
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), digital::ErrorKind> {
        self.level(true).await
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), digital::ErrorKind> {
        self.level(false).await
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), digital::ErrorKind> {
        self.level(true).await
    }
}

impl ErrorType for Port {
    type Error = ErrorKind;
}

impl Read for Port {
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, ErrorKind> {
        poll_fn(|_| footprint_read(self.0, 0, bytes))
            .await
            .ok_or(ErrorKind::Other)
    }
}

impl Write for Port {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        poll_fn(|_| footprint_write(self.0, 0, bytes))
            .await
            .ok_or(ErrorKind::Other)
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Write::write(self, &[]).await.map(|_| ())
    }
}

impl Adc for Port {
    type Error = ErrorKind;

    async fn read(&mut self) -> Result<Millivolts, ErrorKind> {
        let mut bytes = [0; 2];
        Read::read(self, &mut bytes).await?;
        Ok(Millivolts(u16::from_le_bytes(bytes)))
    }
}

impl Clock for Port {
    fn now(&self) -> Instant {
        Instant::from_micros(footprint_now())
    }

    async fn sleep_until(&self, at: Instant) {
        poll_fn(|_| {
            if self.now() >= at {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
        .await;
    }
}

impl System for Port {
    fn reset_cause(&self) -> ResetCause {
        footprint_cause()
    }

    fn last_panic(&self) -> Option<&str> {
        footprint_level(self.0).then(|| footprint_text(self.0))
    }

    fn feed_watchdog(&mut self) {
        footprint_set(self.0, 0);
    }

    async fn reset(&mut self) -> Infallible {
        footprint_end()
    }
}

impl rand_core::TryRng for Port {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        Ok(footprint_number(self.0))
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        Ok(u64::from(footprint_number(self.0)) << 32 | u64::from(footprint_number(self.0)))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        let _ = footprint_read(self.0, 0, bytes);
        Ok(())
    }
}

impl nor_flash::ErrorType for Port {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Port {
    const READ_SIZE: usize = 4;

    async fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        match poll_fn(|_| footprint_read(self.0, at, bytes)).await {
            Some(_) => Ok(()),
            None => Err(NorFlashErrorKind::Other),
        }
    }

    fn capacity(&self) -> usize {
        0x1_0000
    }
}

impl NorFlash for Port {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        outcome(footprint_set(from, to), NorFlashErrorKind::Other)
    }

    async fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        match poll_fn(|_| footprint_write(self.0, at, bytes)).await {
            Some(_) => Ok(()),
            None => Err(NorFlashErrorKind::Other),
        }
    }
}

impl MultiwriteNorFlash for Port {}

impl LinkMonitor for Port {
    fn state(&self) -> LinkState {
        footprint_link()
    }
}

impl Network for Port {
    type Stream<'a> = Port;
    type Monitor = Port;

    fn monitor(&self) -> Port {
        self.clone()
    }

    async fn join(&mut self) -> Result<(), NetError> {
        poll_fn(|_| footprint_joined()).await
    }

    async fn connect(&mut self, host: &str, port: u16) -> Result<Port, NetError> {
        poll_fn(|_| footprint_connected(host, port)).await?;
        Ok(Port(17))
    }
}
