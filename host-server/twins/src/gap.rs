//! How far bodies and robots of a fleet are apart.

use std::sync::Arc;

use crawler_protocol::RobotId;
use crawler_twin::certificate::Certificate;
use crawler_twin::gap::{Measures, Samples};

/// What measures are of.
#[derive(Debug, Clone)]
pub(crate) struct Evidence {
    pub(crate) robot: RobotId,
    pub(crate) body: Option<Arc<Certificate>>,
    pub(crate) since_ms: Option<u64>,
}

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
    pub(crate) fn of(mut robots: Vec<(Evidence, Samples)>, time_ms: u64) -> Self {
        robots.sort_by(|(a, _), (b, _)| a.robot.cmp(&b.robot));
        let (robots, samples): (Vec<RobotGap>, Vec<Samples>) = robots
            .into_iter()
            .map(|(evidence, samples)| {
                let gap = RobotGap {
                    robot: evidence.robot,
                    body: evidence.body,
                    since_ms: evidence.since_ms,
                    measures: samples.measure(),
                };
                (gap, samples)
            })
            .unzip();
        Self {
            time_ms,
            fleet: Samples::pool(&samples).measure(),
            robots,
        }
    }
}
