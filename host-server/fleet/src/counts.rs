//! The robots of the fleet, counted for the metrics.

use crawler_protocol::RobotState;
use crawler_protocol::open::Open;

use super::{FleetState, Presence};
use crawler_metrics::Exposition;

/// The state of robots that have not told theirs, or one that is not known.
const UNTOLD: &str = "unknown";

/// The robots of the fleet, counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RobotCounts {
    online: usize,
    stale: usize,
    offline: usize,
    /// Those not offline, by the order of [`RobotState::ALL`]; the last place is for those that have
    /// told no state, or one that is not known.
    states: [usize; RobotState::ALL.len() + 1],
    /// Ids that two robots seem to share.
    doubles: usize,
}

impl RobotCounts {
    /// Counts `fleet`.
    pub fn of(fleet: &FleetState) -> Self {
        let mut count = Self::default();
        for robot in fleet.robots() {
            match robot.presence {
                Presence::Online => count.online += 1,
                Presence::Stale => count.stale += 1,
                Presence::Offline => count.offline += 1,
            }
            count.doubles += usize::from(robot.has_double());
            // What an absent robot did last says nothing about now.
            if robot.presence != Presence::Offline {
                let place = robot
                    .state()
                    .and_then(Open::known)
                    .and_then(|state| RobotState::ALL.iter().position(|known| *known == state));
                if let Some(slot) = count.states.get_mut(place.unwrap_or(RobotState::ALL.len())) {
                    *slot += 1;
                }
            }
        }
        count
    }

    /// Writes all of it.
    pub fn write_metrics(&self, out: &mut Exposition) {
        out.gauges(
            "terracrawler_robots",
            "Robots known, by presence",
            "status",
            [
                ("online", self.online),
                ("stale", self.stale),
                ("offline", self.offline),
            ],
        );
        let names = RobotState::ALL
            .iter()
            .map(|state| state.name())
            .chain([UNTOLD]);
        out.gauges(
            "terracrawler_robots_by_state",
            "Robots that are not offline, by the state they told last",
            "state",
            names.zip(self.states),
        );
        out.gauge(
            "terracrawler_robots_sharing_an_id",
            "Ids under which two robots seem to speak",
            self.doubles as f64,
        );
    }
}
