//! What others who are near mean for how fast the robot goes on.

use crawler_hal::Instant;

use super::{Controller, Inputs};
use crate::behaviour::{BACK_SPEED, Leeway};
use crate::goal::Goal;
use crate::motion::angle::{PoseMm, millimetres};
use crate::state::{Side, State};

/// How little sure of its place a robot may be to go by where others are, in metres of sigma.
const VAGUE: f32 = 0.2;
/// Where others leave no more than this a robot that wanders turns aside, in millimetres per second.
const HELD_UP: i32 = 60;
/// Where they leave as much as this it goes on in the direction that it has turned to.
const FREE: i32 = 120;

impl Controller {
    /// Whether what it does keeps off others by [`Leeway`]: rules that go by others have their own ways.
    pub(super) fn keeps_off(&self) -> bool {
        matches!(self.state.goal(), Some(Goal::Wander { .. }))
    }

    /// Asks how fast others let the robot go on.
    pub(super) fn look_aside(&mut self, inputs: &Inputs<'_>, now: Instant) {
        if self.leeway == Leeway::ALL && inputs.near.is_empty() {
            return;
        }
        let share = match self.state {
            State::Avoiding(Goal::Wander { .. }, escape) if now < escape.back_until => -BACK_SPEED,
            State::Moving(Goal::Wander { speed })
            | State::Caution(Goal::Wander { speed })
            | State::Avoiding(Goal::Wander { speed }, _) => speed,
            State::Moving(_)
            | State::Caution(_)
            | State::Avoiding(..)
            | State::Initializing
            | State::Idle
            | State::Scanning { .. }
            | State::Error(_)
            | State::Updating => {
                self.leeway = Leeway::ALL;
                return;
            }
        };
        let pose = self.pose();
        // Without a fix, or long after the last one, others are anywhere.
        if inputs.near.is_empty() || !self.odometry.is_placed() || pose.sigma > VAGUE {
            self.leeway = Leeway::ALL;
        } else if self.rules {
            let wanted = millimetres(share * self.tuning.max_speed);
            let here = PoseMm::new(&pose);
            self.leeway = Leeway::of(&here, millimetres(pose.sigma), wanted, inputs.near);
        }
    }

    /// Where to turn because others do not let the robot go on.
    pub(super) fn way_round_others(&self) -> Option<Side> {
        (self.leeway.speed < HELD_UP).then(|| self.leeway.side.other())
    }

    /// Whether a robot that turns aside would not get on where it looks.
    pub(super) fn is_held_up(&self) -> bool {
        self.leeway.speed < FREE
    }

    /// What of a speed others leave.
    pub(super) fn left_by_others(&self, v: f32) -> f32 {
        if self.leeway == Leeway::ALL {
            return v;
        }
        let most = self.leeway.speed as f32 * 0.001;
        v.clamp(-most, most)
    }
}
