//! How links behave, and what can be wrong with them.

use rand_core::Rng;
use serde::{Deserialize, Serialize};

use crate::world::{RadioFigures, uniform};

/// How a link behaves. All robots of a simulation share one model; their draws differ.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LinkModel {
    /// Shortest time one way, milliseconds.
    pub latency_ms: f32,
    /// Added to it, uniformly from 0 to this, milliseconds.
    pub jitter_ms: f32,
    /// Probability that a segment is lost and has to be sent again.
    pub loss: f32,
    /// Time until a lost segment is sent again, doubled each time it is lost again, milliseconds.
    pub retransmit_ms: f32,
    /// Signal strength that robots report, dBm.
    pub rssi_dbm: i8,
}

impl Default for LinkModel {
    /// A quiet wireless LAN.
    fn default() -> Self {
        Self {
            latency_ms: 2.0,
            jitter_ms: 3.0,
            loss: 0.0,
            retransmit_ms: 200.0,
            rssi_dbm: -55,
        }
    }
}

impl LinkModel {
    /// The part of a radio's figures that makes up a link beyond the air.
    #[must_use]
    pub fn of_radio(figures: &RadioFigures) -> Self {
        Self {
            latency_ms: figures.latency_ms,
            jitter_ms: figures.jitter_ms,
            loss: figures.loss,
            retransmit_ms: figures.retransmit_ms,
            rssi_dbm: libm::roundf(figures.rssi_dbm) as i8,
        }
    }

    /// Checks that every number is one a link can have.
    ///
    /// # Errors
    /// The name of the field that is out of range, and its range.
    pub fn validate(&self) -> Result<(), &'static str> {
        let within = |value: f32, low: f32, high: f32| (low..=high).contains(&value);
        if !within(self.latency_ms, 0.1, 10_000.0) {
            Err("latency_ms must be 0.1 to 10000")
        } else if !within(self.jitter_ms, 0.0, 10_000.0) {
            Err("jitter_ms must be 0 to 10000")
        } else if !within(self.loss, 0.0, 0.9) {
            Err("loss must be 0 to 0.9")
        } else if !within(self.retransmit_ms, 1.0, 10_000.0) {
            Err("retransmit_ms must be 1 to 10000")
        } else {
            Ok(())
        }
    }
}

/// No attempt comes later than this after the one before, milliseconds.
const LAST_ATTEMPT_MS: f32 = 60_000.0;

impl LinkModel {
    /// Draws how long a segment takes from one end to the other, in microseconds. `loss` is the
    /// share of segments that are lost.
    pub(crate) fn draw(&self, loss: f32, rng: &mut impl Rng) -> u64 {
        let mut ms = self.latency_ms + self.jitter_ms * uniform(rng);
        if loss > 0.0 {
            let mut again = self.retransmit_ms;
            while uniform(rng) < loss && again < LAST_ATTEMPT_MS {
                ms += again;
                again *= 2.0;
            }
        }
        (ms * 1_000.0) as u64
    }
}

/// What is wrong with a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cut {
    /// Nothing.
    #[default]
    None,
    /// Nothing gets through, and nobody is told.
    Silent,
    /// The radio has lost its access point, and the robot can know it.
    Radio,
    /// The access point refuses the robot's password.
    Password,
    /// The access point has the robot, and nobody gives it an address.
    NoAddress,
}

impl Cut {
    /// Whether the robot can know that it is cut off.
    pub(crate) const fn is_known(self) -> bool {
        match self {
            Self::None | Self::Silent => false,
            Self::Radio | Self::Password | Self::NoAddress => true,
        }
    }
}
