//! The air between robots and access points: range, rate, shared airtime, partitions.
//!
//! One model for virtual and for real time. A `Medium` holds a station for each robot. Ten
//! times a second it looks where they are, picks an access point for each, and works out what a
//! segment costs there; between two looks a segment costs a multiplication. Airtime is shared
//! through counters of the last window only, so that stations can be spread over threads: each
//! part closes its window, the counters are added up, and all open the next one with the sum.

mod airtime;
mod config;
mod figures;
mod medium;
mod station;
mod survey;
#[cfg(test)]
mod tests;

pub use airtime::Airtime;
pub use config::{AccessPoint, MAX_ACCESS_POINTS, MAX_PARTITIONS, Partition, Radio, Region};
#[cfg(feature = "live")]
pub(crate) use figures::SEGMENT;
pub(crate) use medium::{LOOK_PERIOD_US, Medium, WINDOW_US};
pub(crate) use station::{Direction, Reach};

use crate::net::lockstep::LinkModel;
use crate::world::RadioFigures;

/// All there is to know of a radio before it is switched on.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Latency, jitter and loss of everything behind the air.
    pub link: LinkModel,
    /// Access points and partitions; without them the air costs nothing and reaches everywhere.
    pub radio: Option<Radio>,
    /// How radio waves fare.
    pub figures: RadioFigures,
    /// Where everything is drawn from.
    pub seed: u64,
}
