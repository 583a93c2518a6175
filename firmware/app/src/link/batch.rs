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

use crawler_hal::{Duration, Instant};
use crawler_protocol::{MAX_BATCH, MAX_MESSAGE, RobotState, TelemetryEncoding};
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::messages::{self, Look};
use crate::context::Robot;
use crate::hold::{Hold, Room as _};
use crate::parameters::{Parameter, Parameters};

/// Age that no sample reaches before it is sent, unless the link is busy writing.
pub const BATCH_AGE: Duration = Duration::from_secs(2);

/// What the parameters ask for.
pub(super) struct Wish {
    pub(super) period: Duration,
    pub(super) encoding: TelemetryEncoding,
    /// Samples of a message.
    pub(super) size: usize,
}

impl Wish {
    pub(super) fn of(parameters: &Parameters) -> Self {
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
    pub(super) encoding: TelemetryEncoding,
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

    pub(super) fn clear(&mut self) {
        self.page.leave();
        self.len = 0;
        self.count = 0;
        self.oldest = None;
        self.urgent = false;
    }

    /// Takes a sample; `false` when it does not fit.
    pub(super) fn add<M: RawMutex>(
        &mut self,
        robot: &Robot<M>,
        look: &Look,
        how: TelemetryEncoding,
    ) -> bool {
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
    pub(super) fn is_due(&self, size: usize, next: Instant) -> bool {
        let grown_old = |oldest| next >= oldest + BATCH_AGE;
        self.urgent || self.count >= size || self.oldest.is_some_and(grown_old)
    }

    /// Copies what there is to the front of `page`; its length.
    pub(super) fn copy_to(&self, page: &mut [u8]) -> Option<usize> {
        let samples = self.page.get()?.get(..self.len)?;
        page.get_mut(..self.len)?.copy_from_slice(samples);
        (self.len > 0).then_some(self.len)
    }
}
