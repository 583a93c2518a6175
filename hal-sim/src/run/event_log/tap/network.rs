//! Taps on the network of a robot, its monitor and its connections.

use std::rc::Rc;

use crawler_hal::{LinkMonitor, LinkState, NetError, Network};
use embedded_io_async::{ErrorType, Read, Write};

use super::{Attempt, Tap};
use crate::run::event_log::{EventLog, Net, What, Writer};
use crate::run::journal::Payload;

impl<N: Network> Network for Tap<N> {
    type Stream<'a>
        = Tapped<N::Stream<'a>>
    where
        Self: 'a;
    type Monitor = Watched<N::Monitor>;

    fn monitor(&self) -> Self::Monitor {
        Watched {
            inner: self.inner.monitor(),
            event_log: self.event_log.clone(),
        }
    }

    async fn join(&mut self) -> Result<(), NetError> {
        let result = self.inner.join().await;
        self.note(|| What::Joined(result.err().map(Net::from)));
        result
    }

    async fn connect(&mut self, host: &str, port: u16) -> Result<Self::Stream<'_>, NetError> {
        let result = self.inner.connect(host, port).await;
        if let Some(event_log) = &self.event_log {
            let error = result.as_ref().err().copied().map(Net::from);
            event_log.note(What::Connected(error));
            event_log.connected();
        }
        Ok(Tapped {
            inner: result?,
            event_log: self.event_log.clone(),
        })
    }
}

/// A monitor whose changes are told.
#[derive(Debug, Clone)]
pub(crate) struct Watched<M> {
    inner: M,
    event_log: Option<Rc<EventLog>>,
}

impl<M: LinkMonitor> LinkMonitor for Watched<M> {
    fn state(&self) -> LinkState {
        let state = self.inner.state();
        if let Some(event_log) = &self.event_log {
            event_log.link(state);
        }
        state
    }
}

/// A connection whose bytes are told.
#[derive(Debug)]
pub(crate) struct Tapped<S> {
    inner: S,
    event_log: Option<Rc<EventLog>>,
}

impl<S: ErrorType> ErrorType for Tapped<S> {
    type Error = S::Error;
}

impl<S: Read> Read for Tapped<S> {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, S::Error> {
        let result = self.inner.read(buf).await;
        if let Some(event_log) = &self.event_log {
            let bytes = result.as_ref().ok().map(|&taken| &buf[..taken]);
            event_log.note(What::Received(bytes.map(Payload::new)));
            if let Some(bytes) = bytes {
                event_log.received(event_log.now(), bytes);
            }
        }
        result
    }
}

impl<S: Write> Write for Tapped<S> {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, S::Error> {
        let attempt = Attempt::new(self.event_log.as_ref(), Writer::Send);
        let result = self.inner.write(buf).await;
        if let Some((event_log, begun)) = attempt.map(Attempt::over) {
            let taken = result.as_ref().copied().unwrap_or(0);
            event_log.note_at(
                begun,
                What::Sent {
                    bytes: taken as u32,
                    done_us: event_log.done(begun),
                    broken: result.is_err(),
                },
            );
            event_log.sent(begun, &buf[..taken]);
        }
        result
    }

    async fn flush(&mut self) -> Result<(), S::Error> {
        self.inner.flush().await
    }
}
