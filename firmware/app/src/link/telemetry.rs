//! Telemetry: when a sample is taken, how it is written, and how many travel together.
//!
//! A sample is taken `telemetry_hz` times a second. With a `telemetry_batch` of 1 it goes out at once.
//! Otherwise samples are collected, and go out together when there are as many, or no more fit a
//! message, and sooner
//!
//! - when the next sample would find the oldest [`BATCH_AGE`] old;
//! - when the state of the robot is another than in the sample before, or it is the first one of a
//!   connection;
//! - while the robot does not know the time: only by their times can the samples of one message be
//!   told apart;
//! - when samples are to be written in another way.
//!
//! What has been collected when the link is lost is dropped, as all telemetry is that cannot be sent.

use crawler_hal::{Clock, Duration, Instant, LinkMonitor, LinkState};
use crawler_protocol::{MAX_BATCH, MAX_MESSAGE, RobotState, TelemetryEncoding, Topic};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};

use super::loss::Loss;
use super::messages::{self, Look};
use super::outgoing::following;
use super::session::Connection;
use crate::context::Robot;
use crate::hold::{Hold, Room as _};
use crate::parameters::{Parameter, Parameters};

/// Age that no sample reaches before it is sent, unless the link is busy writing.
pub const BATCH_AGE: Duration = Duration::from_secs(2);

/// What the parameters ask for.
struct Wish {
    period: Duration,
    encoding: TelemetryEncoding,
    /// Samples of a message.
    size: usize,
}

impl Wish {
    fn of(parameters: &Parameters) -> Self {
        // The table keeps numbers within their ranges; the bounds here are only for the arithmetic.
        let hz = parameters
            .number(Parameter::TelemetryRate)
            .clamp(0.1, 100.0);
        let size = parameters.number(Parameter::TelemetryBatch) as usize;
        let cbor = parameters.switch(Parameter::TelemetryFormat);
        Self {
            period: Duration::from_micros((1e6 / hz) as u64),
            encoding: match (cbor, size > 1) {
                (false, false) => TelemetryEncoding::Json,
                (false, true) => TelemetryEncoding::JsonSeq,
                (true, false) => TelemetryEncoding::Cbor,
                (true, true) => TelemetryEncoding::CborSeq,
            },
            size: size.clamp(1, MAX_BATCH),
        }
    }
}

/// Samples that wait for others to travel with.
pub(super) struct Batch<H: Hold> {
    page: H::Room<[u8; MAX_MESSAGE]>,
    encoding: TelemetryEncoding,
    len: usize,
    count: usize,
    /// When the oldest sample was taken; `None` without any.
    oldest: Option<Instant>,
    /// State in the newest sample, also when that has been sent.
    state: Option<RobotState>,
    urgent: bool,
}

impl<H: Hold> Batch<H> {
    pub(super) const fn new() -> Self {
        Self {
            page: crate::hold::Room::EMPTY,
            encoding: TelemetryEncoding::Json,
            len: 0,
            count: 0,
            oldest: None,
            state: None,
            urgent: false,
        }
    }

    /// Drops what has been collected, for a new connection.
    pub(super) fn discard(&mut self) {
        self.clear();
        self.state = None;
    }

    fn clear(&mut self) {
        self.page.leave();
        self.len = 0;
        self.count = 0;
        self.oldest = None;
        self.urgent = false;
    }

    /// Takes a sample; `false` when it does not fit.
    fn add<M: RawMutex>(&mut self, robot: &Robot<M>, look: &Look, how: TelemetryEncoding) -> bool {
        self.encoding = how;
        let page = self.page.enter();
        let Ok((len, state)) = messages::telemetry(robot, look, how, page, self.len) else {
            return false;
        };
        self.len = len;
        self.count += 1;
        self.oldest.get_or_insert(look.now);
        self.urgent |= self.state.replace(state) != Some(state);
        true
    }

    /// Whether to send what there is rather than wait for a sample at `next`.
    fn is_due(&self, size: usize, next: Instant) -> bool {
        let grown_old = |oldest| next >= oldest + BATCH_AGE;
        self.urgent || self.count >= size || self.oldest.is_some_and(grown_old)
    }

    /// Copies what there is to the front of `page`; its length.
    fn copy_to(&self, page: &mut [u8]) -> Option<usize> {
        let samples = self.page.get()?.get(..self.len)?;
        page.get_mut(..self.len)?.copy_from_slice(samples);
        (self.len > 0).then_some(self.len)
    }
}

impl<H, M, C, L, S> Connection<'_, '_, H, M, C, L, S>
where
    H: Hold,
    M: RawMutex,
    C: Clock,
    L: LinkMonitor,
    S: Read + Write,
{
    /// Takes a sample when one is due, and sends what is to be sent.
    pub(super) async fn send_telemetry(&mut self) -> Result<(), Loss> {
        let robot = self.robot;
        let now = self.clock.now();
        if now < self.state.next_telemetry {
            return Ok(());
        }
        let wish = robot.with_parameters(Wish::of);
        self.state.next_telemetry = following(self.state.next_telemetry, wish.period, now);
        let look = Look {
            seq: self.counters.telemetry,
            rssi_dbm: match self.monitor.state() {
                LinkState::Up { rssi_dbm, .. } => rssi_dbm,
                LinkState::Down => None,
            },
            now,
        };
        self.counters.telemetry += 1;
        let how = wish.encoding;
        if self.batch.encoding != how {
            self.flush().await?;
        }
        if !how.is_sequence() {
            self.batch.encoding = how;
            let written = self.write(|page| {
                let written = messages::telemetry(robot, &look, how, page, 0);
                written.ok().map(|(len, _)| len)
            });
            return self.send_samples(written).await;
        }
        if !self.batch.add(robot, &look, how) {
            self.flush().await?;
            // Alone it fits, or never will.
            self.batch.add(robot, &look, how);
        }
        let timeless = robot.unix_ms(now).is_none();
        if timeless || self.batch.is_due(wish.size, self.state.next_telemetry) {
            self.flush().await?;
        }
        Ok(())
    }

    /// Sends what has been collected.
    async fn flush(&mut self) -> Result<(), Loss> {
        let written = self.write(|page| self.batch.copy_to(page));
        self.batch.clear();
        self.send_samples(written).await
    }

    /// Publishes what was written to the page of the letter, if anything was.
    async fn send_samples(&mut self, written: Option<usize>) -> Result<(), Loss> {
        let Some(len) = written else {
            return Ok(());
        };
        // Not needed for what has always been sent, and so left out.
        let how = Some(self.batch.encoding).filter(|how| *how != TelemetryEncoding::Json);
        let topic = Topic::Telemetry(self.robot.config().id.clone());
        let content_type = how.map(TelemetryEncoding::content_type);
        self.publish(&topic, len, None, content_type).await
    }
}
