//! How far bodies and robots of a fleet are apart.

use std::sync::Arc;

use crawler_protocol::RobotId;
use crawler_twin::certificate::Certificate;
use crawler_twin::gap::{Measures, Samples};

/// How far a robot is from the body of its twin.
#[derive(Debug, Clone)]
pub struct RobotGap {
    /// The robot.
    pub robot: RobotId,
    /// Whose body its twin has; `None` for the nominal one.
    pub body: Option<Arc<Certificate>>,
    /// Unix milliseconds of the oldest prediction that this rests on; `None` without any.
    pub since_ms: Option<u64>,
    /// How far.
    pub measures: Measures,
}

/// How far bodies and robots of a fleet are apart.
#[derive(Debug, Clone)]
pub struct FleetGap {
    /// Unix milliseconds at which it was measured.
    pub time_ms: u64,
    /// Of all robots together, as many predictions of each at most.
    pub fleet: Measures,
    /// Of each that has a twin, by their names.
    pub robots: Vec<RobotGap>,
}

impl FleetGap {
    /// Of robots, each with what was measured.
    pub(crate) fn of(mut all: Vec<(RobotGap, Samples)>, time_ms: u64) -> Self {
        all.sort_by(|(a, _), (b, _)| a.robot.cmp(&b.robot));
        let (robots, samples): (Vec<RobotGap>, Vec<Samples>) = all.into_iter().unzip();
        Self {
            time_ms,
            fleet: Samples::pool(&samples).measure(),
            robots,
        }
    }
}
