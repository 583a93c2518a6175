//! What people are told of twins: that something is wrong with a robot, and that it is over.

use std::collections::BTreeMap;

use crawler_protocol::RobotId;
use crawler_twin::detect::{Fault, FaultName};

/// When more robots than this have the same at once, one notice tells of all of them.
const ONE_BY_ONE: usize = 5;

/// Something to tell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Notice {
    /// Of whom; of several robots where there is none.
    pub robot: Option<RobotId>,
    /// Whether somebody should look.
    pub is_bad: bool,
    /// For people.
    pub text: String,
}

/// What became of a fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Turn {
    /// It was named.
    Begins(Fault),
    /// What named it says that it is over.
    IsOver(FaultName),
    /// Its twin is no more.
    IsLost(FaultName),
}

impl Turn {
    const fn fault(self) -> FaultName {
        match self {
            Self::Begins(fault) => fault.fault,
            Self::IsOver(fault) | Self::IsLost(fault) => fault,
        }
    }

    const fn order(self) -> u8 {
        match self {
            Self::Begins(_) => 0,
            Self::IsOver(_) => 1,
            Self::IsLost(_) => 2,
        }
    }

    /// Of one robot, or of the fault alone.
    fn text(self, is_one: bool) -> String {
        match self {
            Self::Begins(fault) if is_one => format!("twin: {fault}: {}", fault.fault.meaning()),
            Self::Begins(fault) => {
                format!("twin: {}: {}", fault.fault.name(), fault.fault.meaning())
            }
            Self::IsOver(fault) => format!("twin: {} is over", fault.name()),
            Self::IsLost(fault) => format!("twin: {} is no longer looked for", fault.name()),
        }
    }
}

/// Puts in words what became of faults at the same time.
pub(crate) fn notices(turns: Vec<(RobotId, Turn)>) -> Vec<Notice> {
    let mut same: BTreeMap<(u8, FaultName), Vec<(RobotId, Turn)>> = BTreeMap::new();
    for (robot, turn) in turns {
        let key = (turn.order(), turn.fault());
        same.entry(key).or_default().push((robot, turn));
    }
    let mut notices = Vec::new();
    for ((order, _), turns) in same {
        let is_bad = order == 0;
        match turns.first() {
            Some((_, turn)) if turns.len() > ONE_BY_ONE => notices.push(Notice {
                robot: None,
                is_bad,
                text: format!("{} robots: {}", turns.len(), turn.text(false)),
            }),
            _ => notices.extend(turns.into_iter().map(|(robot, turn)| Notice {
                robot: Some(robot),
                is_bad,
                text: turn.text(true),
            })),
        }
    }
    notices
}
