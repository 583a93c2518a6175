//! Taps on both ways to the ranger.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType as PinErrorType, InputPin, OutputPin};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{ErrorType, Read, Write};

use super::{Attempt, Tap};
use crate::devices::{SimEcho, SimTrigger, SimUart, UartError};
use crate::run::event_log::{What, Writer};
use crate::run::journal::Payload;

impl ErrorType for Tap<SimUart> {
    type Error = UartError;
}

impl Read for Tap<SimUart> {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, UartError> {
        let result = self.inner.read(buf).await;
        self.note(|| What::Heard(result.ok().map(|taken| Payload::new(&buf[..taken]))));
        result
    }
}

impl Write for Tap<SimUart> {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, UartError> {
        let attempt = Attempt::new(self.event_log.as_ref(), Writer::Ask);
        let result = self.inner.write(buf).await;
        if let Some((event_log, begun)) = attempt.map(Attempt::over) {
            let taken = result.unwrap_or(0);
            event_log.note_at(
                begun,
                What::Asked {
                    bytes: Payload::new(&buf[..taken]),
                    done_us: event_log.done(begun),
                    broken: result.is_err(),
                },
            );
        }
        result
    }

    async fn flush(&mut self) -> Result<(), UartError> {
        let attempt = Attempt::new(self.event_log.as_ref(), Writer::Flush);
        let result = self.inner.flush().await;
        if let Some((event_log, begun)) = attempt.map(Attempt::over) {
            event_log.note_at(begun, What::Flushed(event_log.now()));
        }
        result
    }
}

impl PinErrorType for Tap<SimTrigger> {
    type Error = Infallible;
}

impl OutputPin for Tap<SimTrigger> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.note(|| What::Trigger(false));
        self.inner.set_low()
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.note(|| What::Trigger(true));
        self.inner.set_high()
    }
}

impl PinErrorType for Tap<SimEcho> {
    type Error = Infallible;
}

impl InputPin for Tap<SimEcho> {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        let level = self.inner.is_high()?;
        self.note(|| What::EchoLevel(level));
        Ok(level)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.is_high()?)
    }
}

impl Wait for Tap<SimEcho> {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        self.inner.wait_for_high().await?;
        self.note(|| What::Echo);
        Ok(())
    }

    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        self.inner.wait_for_low().await?;
        self.note(|| What::Echo);
        Ok(())
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        self.inner.wait_for_rising_edge().await?;
        self.note(|| What::Echo);
        Ok(())
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        self.inner.wait_for_falling_edge().await?;
        self.note(|| What::Echo);
        Ok(())
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        self.inner.wait_for_any_edge().await?;
        self.note(|| What::Echo);
        Ok(())
    }
}
