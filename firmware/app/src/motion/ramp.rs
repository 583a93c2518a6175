//! Bounded change of duty, and the pause between forward and backward.

use crawler_hal::{Duration, Instant};

/// How long a wheel stands at zero before it turns the other way: the same as in the motor
/// driver, which holds to it whatever it is told.
pub const DEAD_TIME: Duration = Duration::from_millis(40);

/// Duty of one wheel over time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Ramp {
    duty: f32,
    /// Duty before the last standstill, for its sign.
    before: f32,
    standing_since: Instant,
}

impl Ramp {
    /// The duty in force, −1 to 1.
    pub const fn duty(&self) -> f32 {
        self.duty
    }

    /// Goes towards `target` by at most `step`, and returns the new duty. A reversal stops at
    /// zero for [`DEAD_TIME`]. A target that is not a number is a zero.
    pub fn towards(&mut self, target: f32, step: f32, now: Instant) -> f32 {
        let target = if target.is_nan() {
            0.0
        } else {
            target.clamp(-1.0, 1.0)
        };
        let reversing = are_opposite(self.duty, target);
        let goal = if reversing { 0.0 } else { target };
        let change = goal - self.duty;
        // Not `clamp`: it would prove each time that `step` is none below zero.
        let change = if change > step {
            step
        } else if change < -step {
            -step
        } else {
            change
        };
        self.set(self.duty + change, now)
    }

    /// Zero, at once.
    pub fn cut(&mut self, now: Instant) {
        self.set(0.0, now);
    }

    fn set(&mut self, next: f32, now: Instant) -> f32 {
        let held = self.duty == 0.0
            && are_opposite(next, self.before)
            && now - self.standing_since < DEAD_TIME;
        let next = if held { 0.0 } else { next };
        if next == 0.0 && self.duty != 0.0 {
            self.before = self.duty;
            self.standing_since = now;
        }
        self.duty = next;
        next
    }
}

/// Whether one is above zero and the other below. By the bits: boards multiply floats in 50 instructions.
fn are_opposite(one: f32, other: f32) -> bool {
    let [one, other] = [one.to_bits(), other.to_bits()];
    (one ^ other) >> 31 == 1 && one << 1 != 0 && other << 1 != 0
}
