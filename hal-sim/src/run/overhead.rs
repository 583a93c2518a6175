//! The overhead camera at work: whose turn it is, and what it sees.

use crawler_hal::Duration;

use crate::scenario::Tracker;
use crate::world::{Pose, Purpose, normal, stream};

/// Fixes in a second that one client publishes on a real broker at most. The embedded one slows a
/// client down beyond 500 messages a second; fixes would queue up and all arrive too late.
#[cfg(any(feature = "live", test))]
pub(super) const LIVE_MOST_PER_S: u64 = 400;

/// Looks at the robots in turn. All of its noise comes from the seed of the world.
#[derive(Debug)]
pub(super) struct OverheadCamera {
    model: Tracker,
    seed: u64,
    /// Turns so far.
    turns: u64,
    /// Fixes due, in millionths.
    credit: u64,
    next: usize,
}

impl OverheadCamera {
    pub(super) fn new(model: Tracker, seed: u64) -> Option<Self> {
        model.on.then_some(Self {
            model,
            seed,
            turns: 0,
            credit: 0,
            next: 0,
        })
    }

    /// Lets `span` pass over `robots` robots; returns how many are to be looked at now, which is
    /// at most `most_per_s` in a second.
    pub(super) fn pass(&mut self, span: Duration, robots: usize, most_per_s: u64) -> usize {
        // In millihertz the rate is a whole number, so that no rounding piles up.
        let rate_mhz = (self.model.rate_hz * 1e3) as u64;
        let all_mhz = (rate_mhz * robots as u64).min(most_per_s.saturating_mul(1_000));
        self.credit += span.as_micros() * all_mhz / 1_000;
        let due = self.credit / 1_000_000;
        self.credit %= 1_000_000;
        (due as usize).min(robots)
    }

    /// Whose turn it is.
    pub(super) fn turn(&mut self, robots: usize) -> usize {
        let robot = if self.next < robots { self.next } else { 0 };
        self.next = robot + 1;
        self.turns += 1;
        robot
    }

    /// What the camera takes `truth` for, when it looks at `robot` in its turn. Each turn has noise
    /// of its own, so that turns nobody asks for need not be drawn.
    pub(super) fn see(&self, robot: usize, truth: Pose) -> crawler_protocol::Pose {
        let Tracker {
            sigma_m, sigma_rad, ..
        } = self.model;
        let seed = self.seed ^ self.turns.rotate_left(32);
        let mut rng = stream(seed, robot as u32, Purpose::Tracker);
        let mut off = |sigma: f32| sigma * normal(&mut rng);
        let seen = Pose::new(
            truth.x + off(sigma_m),
            truth.y + off(sigma_m),
            truth.theta + off(sigma_rad),
        );
        crawler_protocol::Pose {
            x: seen.x,
            y: seen.y,
            theta: libm::remainderf(seen.theta, core::f32::consts::TAU),
            sigma: sigma_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_robot_has_its_turn_and_nobody_waits_for_a_burst() {
        let model = Tracker::default();
        let mut camera = OverheadCamera::new(model, 1).unwrap();
        let mut seen = [0; 30];
        for _ in 0..1_000 {
            let due = camera.pass(Duration::from_millis(10), seen.len(), u64::MAX);
            assert!(due <= 1, "30 robots twice a second are 0.6 in 10 ms");
            for _ in 0..due {
                seen[camera.turn(seen.len())] += 1;
            }
        }
        assert_eq!(seen, [20; 30]);
        let all: usize = (0..1_000)
            .map(|_| camera.pass(Duration::from_millis(10), 10_000, LIVE_MOST_PER_S))
            .sum();
        assert_eq!(all, 4_000, "ten seconds of them");
        let off = Tracker { on: false, ..model };
        assert!(OverheadCamera::new(off, 1).is_none());
    }
}
