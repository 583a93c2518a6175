//! What a robot's report means, where the robot stands: pure, and spelled out for every state.

use super::event::Report;
use super::names::BuildId;
use super::robot::{Reason, UpdateState};

/// What follows from a report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Next {
    /// Nothing: it is known, or came late.
    Stay,
    /// The robot stands there now.
    Enter(UpdateState, Option<Reason>),
    /// The robot is at work without having a place: it gets one, or gives up.
    AtWork(UpdateState),
    /// It must give up what it is at.
    Cancel,
    /// The attempt has failed; whether for good.
    AttemptFailed {
        /// Why.
        reason: Reason,
        /// Whether another attempt would fail too.
        lasting: bool,
    },
}

/// What a report means of a robot in `state` that was offered a release of this `build`.
///
/// A robot is believed as far as it goes: what it says of itself later is worth more than what the server made
/// of its silence. Nothing that comes late or twice undoes a confirmation or a roll-back.
pub(super) fn next(state: UpdateState, report: &Report, build: &BuildId) -> Next {
    use UpdateState::{
        Confirmed, Deferred, Failed, NotApplicable, Offered, Preparing, Receiving, RolledBack,
        Skipped, Staged, Superseded, Trial, Verifying, Waiting,
    };
    let working = match report {
        Report::Preparing => Preparing,
        Report::Receiving(_) => Receiving,
        Report::Verifying => Verifying,
        Report::Staged => Staged,
        Report::Deferred(code) => {
            return match state {
                Offered | Preparing | Receiving => {
                    Next::Enter(Deferred, Some(Reason::Told(code.clone())))
                }
                NotApplicable | Waiting | Deferred | Verifying | Staged | Trial | Confirmed
                | RolledBack | Failed | Skipped | Superseded => Next::Stay,
            };
        }
        Report::Trial(runs) => {
            return match state {
                _ if runs != build => Next::Stay,
                Waiting | Deferred | Offered | Preparing | Receiving | Verifying | Staged
                | Failed => Next::Enter(Trial, None),
                Skipped | Superseded => Next::Cancel,
                NotApplicable | Trial | Confirmed | RolledBack => Next::Stay,
            };
        }
        Report::Confirmed(runs) => {
            let right = runs == build;
            return match state {
                Waiting | Deferred | Offered | Preparing | Receiving | Verifying | Staged
                | Trial | Failed
                    if right =>
                {
                    Next::Enter(Confirmed, None)
                }
                Waiting | Deferred | Offered | Preparing | Receiving | Verifying | Staged
                | Trial => Next::Enter(Failed, Some(Reason::WrongBuild(runs.clone()))),
                NotApplicable | Confirmed | RolledBack | Failed | Skipped | Superseded => {
                    Next::Stay
                }
            };
        }
        Report::RolledBack(code) => {
            return match state {
                Waiting | Deferred | Offered | Preparing | Receiving | Verifying | Staged
                | Trial | Failed => Next::Enter(RolledBack, Some(Reason::Told(code.clone()))),
                NotApplicable | Confirmed | RolledBack | Skipped | Superseded => Next::Stay,
            };
        }
        Report::Refused { code, lasting } => {
            return match state {
                Offered | Preparing | Receiving | Verifying | Staged => Next::AttemptFailed {
                    reason: Reason::Told(code.clone()),
                    lasting: *lasting,
                },
                NotApplicable | Waiting | Deferred | Trial | Confirmed | RolledBack | Failed
                | Skipped | Superseded => Next::Stay,
            };
        }
        Report::Withdrawn => {
            return match state {
                Offered | Preparing | Receiving | Verifying | Staged => {
                    Next::Enter(Deferred, Some(Reason::Withdrawn))
                }
                NotApplicable | Waiting | Deferred | Trial | Confirmed | RolledBack | Failed
                | Skipped | Superseded => Next::Stay,
            };
        }
    };
    match state {
        Offered | Preparing | Receiving | Verifying | Staged => Next::Enter(working, None),
        Waiting | Deferred => Next::AtWork(working),
        RolledBack | Failed | Skipped | Superseded => Next::Cancel,
        NotApplicable | Trial | Confirmed => Next::Stay,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rollout::names::Code;

    fn reports() -> [Report; 12] {
        let build = |name| BuildId::new(name).unwrap();
        let code = Code::new("why").unwrap();
        [
            Report::Deferred(code.clone()),
            Report::Preparing,
            Report::Receiving(1),
            Report::Verifying,
            Report::Staged,
            Report::Trial(build("new")),
            Report::Trial(build("old")),
            Report::Confirmed(build("new")),
            Report::Confirmed(build("old")),
            Report::RolledBack(code.clone()),
            Report::Refused {
                code,
                lasting: false,
            },
            Report::Withdrawn,
        ]
    }

    /// One row for each state, one letter for each report. `.` stays, `x` cancels, `?` asks for a place, `!` fails
    /// the attempt; others are the first letter of the state that is entered, `F` is failed.
    const TABLE: [(UpdateState, &str); 14] = [
        (UpdateState::NotApplicable, "............"),
        (UpdateState::Waiting, ".????t.cFr.."),
        (UpdateState::Offered, "dpRvst.cFr!d"),
        (UpdateState::Deferred, ".????t.cFr.."),
        (UpdateState::Preparing, "dpRvst.cFr!d"),
        (UpdateState::Receiving, "dpRvst.cFr!d"),
        (UpdateState::Verifying, ".pRvst.cFr!d"),
        (UpdateState::Staged, ".pRvst.cFr!d"),
        (UpdateState::Trial, ".......cFr.."),
        (UpdateState::Confirmed, "............"),
        (UpdateState::RolledBack, ".xxxx......."),
        (UpdateState::Failed, ".xxxxt.c.r.."),
        (UpdateState::Skipped, ".xxxxx......"),
        (UpdateState::Superseded, ".xxxxx......"),
    ];

    #[test]
    fn every_report_in_every_state() {
        let build = BuildId::new("new").unwrap();
        for (state, want) in TABLE {
            let letter = |report| match next(state, &report, &build) {
                Next::Stay => '.',
                Next::Cancel => 'x',
                Next::AtWork(_) => '?',
                Next::AttemptFailed { .. } => '!',
                Next::Enter(UpdateState::Failed, _) => 'F',
                Next::Enter(UpdateState::Receiving, _) => 'R',
                Next::Enter(state, _) => state.name().chars().next().unwrap(),
            };
            let found: String = reports().into_iter().map(letter).collect();
            assert_eq!(found, want, "{state}");
        }
        assert_eq!(TABLE.map(|(state, _)| state), UpdateState::ALL);
    }
}
