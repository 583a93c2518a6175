//! Noticing that the robot is caught although the ranger sees nothing near.

use crawler_hal::{Duration, Instant};

use crate::perception::Sight;

/// Driving forward this long changes a range, unless the robot does not move.
const WINDOW: Duration = Duration::from_millis(2_500);
/// A change below this is noise, in millimetres. Slowest forward driving covers several times
/// as much within the window.
const NOISE_MM: u16 = 30;

/// The spread of ranges seen while driving forward.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Progress {
    seen: Option<Seen>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Seen {
    since: Instant,
    nearest: u16,
    farthest: u16,
}

impl Progress {
    /// Takes one view in while the robot drives forward, and tells whether it is caught.
    ///
    /// Without a range there is nothing to compare, so a view of nothing starts over; so does a
    /// range that changes.
    pub fn observe(&mut self, sight: Sight, now: Instant) -> bool {
        let Sight::Range(mm) = sight else {
            self.seen = None;
            return false;
        };
        let fresh = Seen {
            since: now,
            nearest: mm.0,
            farthest: mm.0,
        };
        let seen = self.seen.unwrap_or(fresh);
        let seen = Seen {
            nearest: seen.nearest.min(mm.0),
            farthest: seen.farthest.max(mm.0),
            ..seen
        };
        let moved = seen.farthest - seen.nearest > NOISE_MM;
        self.seen = Some(if moved { fresh } else { seen });
        !moved && now - seen.since >= WINDOW
    }

    /// Forgets: the robot does something else than driving forward.
    pub fn reset(&mut self) {
        self.seen = None;
    }
}
