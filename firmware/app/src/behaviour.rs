//! What behaviours want: a twist for every period, and when they are done.

mod detour;
mod goto;
mod leeway;
mod mission;
mod progress;
mod scan;
mod swarm;
#[cfg(test)]
mod tests;

use crawler_hal::Instant;

use crate::motion::Twist;
use crate::state::{Escape, Side};

pub use detour::Detour;
pub(crate) use goto::{HEADING_GAIN, SLOW_WITHIN, SLOWEST};
pub use goto::{goto_twist, place_twist};
pub use leeway::{Course, Leeway};
pub use mission::{MissionNews, Scene as MissionScene, Underway, Wish};
pub use progress::Progress;
pub use scan::{HalfRecognised, HalfScan, SECTORS, Scan, ScanResult, Sector};
pub(crate) use swarm::VAGUE;
pub use swarm::{APART, BESIDE, LATTICE, Scene, THERE, steer, swarm_twist};

/// Rate of turning when turning aside, in radians per second, unless the permitted one is less.
pub const ESCAPE_TURN: f32 = 2.0;
/// Share of the permitted speed when backing off: the robot does not see where it goes.
pub const BACK_SPEED: f32 = 0.3;

/// Wanted motion while getting out of the way.
pub fn escape_twist(escape: &Escape, max_speed: f32, max_turn: f32, now: Instant) -> Twist {
    if now < escape.back_until {
        return Twist {
            v: -BACK_SPEED * max_speed,
            w: 0.0,
        };
    }
    let turn = ESCAPE_TURN.min(max_turn);
    Twist {
        v: 0.0,
        w: match escape.side {
            Side::Left => turn,
            Side::Right => -turn,
        },
    }
}
