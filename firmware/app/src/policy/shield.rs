//! What is left of an action when nothing is to be driven into that is known.
//!
//! Turning on the spot is free: the body is round. What leads ahead or back is slowed down until the robot can stand
//! before what is known to be in its way, and is stopped where that takes too slow a motion to be one. The critical
//! distance of the ranger holds besides, in the controller's last gate before the wheels.

use super::action::Action;

/// What is known to be in the way, in millimetres from the rim of the robot; [`u16::MAX`] is nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Around {
    /// In a corridor ahead.
    pub ahead: u16,
    /// In a corridor behind.
    pub behind: u16,
}

impl Around {
    /// Nothing is known to be in the way.
    pub const CLEAR: Self = Self {
        ahead: u16::MAX,
        behind: u16::MAX,
    };
}

/// Way that is left over in any case, in millimetres: what is remembered is where it was seen, not where it is.
const MARGIN_MM: i32 = 40;
/// Time from a change of the way to standing, in milliseconds: what is known is up to a decision old, the order takes
/// a control step, and wheels roll out.
const REACTION_MS: i32 = 250;
/// Slower than this is no driving: wheels do not turn so slowly.
const SLOWEST_MMPS: i32 = 60;

/// The twist of `action` as far as what is `around` permits it, in mm/s ahead and mrad/s; and whether anything of it was
/// taken away.
pub fn shield(action: Action, around: Around) -> ([i32; 2], bool) {
    let [v, w] = action.twist();
    let free = if v < 0 { around.behind } else { around.ahead };
    let fastest = (i32::from(free) - MARGIN_MM).max(0) * 1_000 / REACTION_MS;
    if v.abs() <= fastest {
        return ([v, w], false);
    }
    let v = if fastest < SLOWEST_MMPS {
        0
    } else {
        fastest * v.signum()
    };
    ([v, w], true)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Everything there is to ask.
    #[test]
    fn no_action_reaches_what_is_known_before_it_can_stand() {
        for action in Action::ALL {
            let [wanted, turn] = action.twist();
            for free in 0..=u16::MAX {
                for (ahead, behind) in [(free, u16::MAX), (u16::MAX, free), (free, free)] {
                    let ([v, w], less) = shield(action, Around { ahead, behind });
                    assert_eq!(w, turn, "turning is free");
                    assert_eq!(less, v != wanted);
                    assert!(v.abs() <= wanted.abs() && v * wanted >= 0);
                    let way = i32::from(if v < 0 { behind } else { ahead });
                    assert!(v == 0 || v.abs() * REACTION_MS / 1_000 + MARGIN_MM <= way);
                }
            }
        }
    }

    #[test]
    fn what_is_far_away_takes_nothing() {
        for action in Action::ALL {
            assert_eq!(shield(action, Around::CLEAR), (action.twist(), false));
            let near = Around {
                ahead: 115,
                behind: 78,
            };
            assert_eq!(shield(action, near), (action.twist(), false));
        }
        let near = Around {
            ahead: 65,
            behind: 50,
        };
        assert_eq!(shield(Action::Ahead, near), ([100, 0], true));
        assert_eq!(shield(Action::CurveLeft, near), ([100, 800], true));
        assert_eq!(shield(Action::Back, near), ([0, 0], true));
    }
}
