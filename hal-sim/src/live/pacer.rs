//! How virtual time follows real time, and what is given up when it cannot.

use crawler_hal::{Duration, Instant};

use super::MAX_BATCH;

/// How often the pace is measured.
const WINDOW: Duration = Duration::from_secs(1);

/// How a world kept up during one window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pace {
    /// Virtual time passed for each unit of real time.
    pub(super) factor: f64,
    /// Longest that anything ran after it was due.
    pub(super) lateness: Duration,
    /// Virtual time given up since the start.
    pub(super) lost: Duration,
}

/// Decides how far a world runs. Both kinds of time count from its start; it reads no clock.
#[derive(Debug)]
pub(super) struct Pacer {
    /// Virtual time given up.
    lost: Duration,
    /// Beginning of the window in real time, and in virtual time.
    window: Instant,
    window_virtual: Instant,
    lateness: Duration,
}

impl Pacer {
    /// At the start of a world.
    pub(super) const fn new() -> Self {
        Self {
            lost: Duration::from_micros(0),
            window: Instant::BOOT,
            window_virtual: Instant::BOOT,
            lateness: Duration::from_micros(0),
        }
    }

    /// How far a world runs at the moment `real`, that stands at `reached` and has something to
    /// do at `due`: to the present, but by no more than [`MAX_BATCH`]. The rest is given up.
    pub(super) fn target(&mut self, real: Instant, reached: Instant, due: Instant) -> Instant {
        let present = Instant::BOOT + (real.saturating_since(Instant::BOOT + self.lost));
        self.lateness = self.lateness.max(present.saturating_since(due));
        let target = present.min(reached + MAX_BATCH).max(reached);
        self.lost = self.lost + present.saturating_since(target);
        target
    }

    /// The moment in real time at which the world gets to `due`.
    pub(super) fn real(&self, due: Instant) -> Instant {
        due + self.lost
    }

    /// What the window at hand was like, once it is over; the next one then begins.
    pub(super) fn measure(&mut self, real: Instant, reached: Instant) -> Option<Pace> {
        let span = real.saturating_since(self.window);
        if span < WINDOW {
            return None;
        }
        let passed = reached.saturating_since(self.window_virtual);
        let pace = Pace {
            factor: passed.as_micros() as f64 / span.as_micros() as f64,
            lateness: self.lateness,
            lost: self.lost,
        };
        self.window = real;
        self.window_virtual = reached;
        self.lateness = Duration::from_micros(0);
        Some(pace)
    }
}

#[cfg(test)]
mod tests;
