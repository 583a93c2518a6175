//! What others who are near mean for how fast the robot goes on.

use crawler_hal::Instant;

use super::{Controller, Inputs};
use crate::behaviour::{BACK_SPEED, Leeway};
use crate::goal::Goal;
use crate::motion::angle::{PoseMm, millimetres};
use crate::state::State;

/// How little sure of its place a robot may be to go by where others are, in metres of sigma.
const VAGUE: f32 = 0.2;

/// Whether who does this keeps off others by [`Leeway`]: rules that go by others have their own ways.
pub(super) fn keeps_off(state: &State) -> bool {
    matches!(state.goal(), Some(Goal::Wander { .. }))
}

/// How fast others let the robot go on. In a step in which no rule is asked that is what it was before.
pub(super) fn leeway(controller: &Controller, inputs: &Inputs<'_>, now: Instant) -> Leeway {
    let before = controller.leeway;
    if before == Leeway::ALL && inputs.near.is_empty() {
        return before;
    }
    let share = match controller.state {
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
        | State::Updating => return Leeway::ALL,
    };
    let pose = controller.pose();
    // Without a fix, or long after the last one, others are anywhere.
    if inputs.near.is_empty() || !controller.odometry.is_placed() || pose.sigma > VAGUE {
        return Leeway::ALL;
    }
    if !controller.rules {
        return before;
    }
    let wanted = millimetres(share * controller.tuning.max_speed);
    let here = PoseMm::new(&pose);
    Leeway::of(&here, millimetres(pose.sigma), wanted, inputs.near)
}
