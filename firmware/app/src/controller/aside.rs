//! What others who are near mean for how fast the robot goes on.

use crawler_hal::Instant;

use super::{Controller, Inputs};
use crate::behaviour::{BACK_SPEED, Leeway};
use crate::goal::Goal;
use crate::motion::angle::{PoseMm, millimetres};
use crate::state::{Side, State};

/// How little sure of its place a robot may be to go by where others are, in metres of sigma.
const VAGUE: f32 = 0.2;
/// For so many steps a robot on its way to a place waits for who is in the way before it turns aside.
const PATIENCE: u8 = 60;

/// Whether who does this keeps off others by [`Leeway`]: rules that go by others have their own ways.
pub(super) fn keeps_off(state: &State) -> bool {
    matches!(state.goal(), Some(Goal::Wander { .. }))
}

/// Asks how fast others let the robot go on.
pub(super) fn look_aside(controller: &mut Controller, inputs: &Inputs<'_>, now: Instant) {
    controller.leeway = left_by_others(controller, inputs, now);
    let stands = matches!(controller.state, State::Moving(_) | State::Caution(_))
        && controller.leeway.way_round().is_some();
    controller.held = if stands {
        controller.held.saturating_add(1)
    } else {
        0
    };
}

/// How fast others let it go on. In a step in which no rule is asked that is what it was before.
fn left_by_others(controller: &Controller, inputs: &Inputs<'_>, now: Instant) -> Leeway {
    let share = match controller.state {
        State::Moving(Goal::Goto { .. })
        | State::Caution(Goal::Goto { .. })
        | State::Avoiding(Goal::Goto { .. }, _) => {
            return if knows_place(controller) {
                inputs.leeway
            } else {
                Leeway::ALL
            };
        }
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
    if inputs.near.is_empty() || !knows_place(controller) {
        return Leeway::ALL;
    }
    if !controller.rules {
        return controller.leeway;
    }
    let pose = controller.pose();
    let wanted = millimetres(share * controller.tuning.max_speed);
    let here = PoseMm::new(&pose);
    Leeway::of(&here, millimetres(pose.sigma), wanted, inputs.near)
}

/// Whether it knows where it is. Without a fix, or long after the last one, others are anywhere.
fn knows_place(controller: &Controller) -> bool {
    controller.odometry.is_placed() && controller.pose().sigma <= VAGUE
}

/// Where to turn because others do not let the robot go on. One on its way to a place first waits for a while: they go
/// on, or its plan leads round them.
pub(super) fn way_round_others(controller: &Controller, goal: &Goal, now: Instant) -> Option<Side> {
    let patience = match goal {
        Goal::Wander { .. } => 0,
        Goal::Goto { .. } => PATIENCE,
        Goal::Manual { .. } | Goal::Swarm(_) | Goal::Mission { .. } | Goal::Policy { .. } => {
            return None;
        }
    };
    let side = controller.leeway.way_round()?;
    (controller.held > patience).then(|| controller.same_corner(now).unwrap_or(side))
}
