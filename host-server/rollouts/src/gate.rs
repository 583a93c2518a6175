//! Which releases go to robots without a report that they passed, and who says so.

use crawler_records::{Entry, KeptRelease, RolloutStep};
use crawler_updates::rollout::{GateOverride, Plan, ReleaseId};
use serde_json::json;

use crate::control::RolloutError;

/// The board of simulated robots.
const SIMULATED: &str = "sim";
/// Longest reason for an override, in bytes.
const WHY_MAX: usize = 512;

/// Of which releases a rollout demands a gate that has passed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[allow(clippy::exhaustive_enums)] // an option of the server has a word for each
pub enum GateDemand {
    /// Of all but those for simulated robots, with which releases are rehearsed.
    #[default]
    Boards,
    /// Of all.
    All,
    /// Of none.
    None,
}

impl GateDemand {
    /// Whether a release must not go out without an override.
    pub(crate) fn refuses(self, release: &KeptRelease) -> bool {
        let demanded = match self {
            Self::Boards => release.board != SIMULATED,
            Self::All => true,
            Self::None => false,
        };
        demanded && release.passed != Some(true)
    }
}

/// What is written into a plan that has `ungated` releases and perhaps a reason for an override.
///
/// # Errors
/// [`RolloutError::NoGate`] without a reason, [`RolloutError::Override`] for what is none.
pub(crate) fn overridden(
    why: Option<&str>,
    ungated: Vec<ReleaseId>,
) -> Result<Option<GateOverride>, RolloutError> {
    let why = why.map(str::trim);
    let is_reason =
        |why: &str| (1..=WHY_MAX).contains(&why.len()) && !why.chars().any(char::is_control);
    if why.is_some_and(|why| !is_reason(why)) {
        return Err(RolloutError::Override);
    }
    match (why, ungated.is_empty()) {
        // Nothing is overridden.
        (_, true) => Ok(None),
        (None, false) => Err(RolloutError::NoGate(ungated)),
        (Some(why), false) => Ok(Some(GateOverride {
            why: why.to_owned(),
            releases: ungated,
        })),
    }
}

/// The step with which a rollout is kept, with a line for the audit log where `by` has overridden gates: both are
/// stored, or neither.
pub(crate) fn noted(step: RolloutStep, id: i64, by: &str, plan: &Plan) -> RolloutStep {
    let Some(override_gate) = &plan.override_gate else {
        return step;
    };
    let entry = Entry {
        at: step.at,
        who: by.to_owned(),
        from: String::new(),
        action: "rollout.override_gate".to_owned(),
        target: id.to_string(),
        detail: json!(override_gate),
        outcome: "ok".to_owned(),
    };
    let audit = std::iter::once(entry).chain(step.audit).collect();
    RolloutStep { audit, ..step }
}

/// What people are told of an override.
pub(crate) fn told(id: i64, by: &str, plan: &Plan) -> Option<String> {
    let GateOverride { why, releases } = plan.override_gate.as_ref()?;
    let releases: Vec<_> = releases.iter().map(ReleaseId::as_str).collect();
    let releases = releases.join(", ");
    Some(format!(
        "rollout {id} brings {releases} to robots without a gate that has passed; {by} says: {why}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(text: &str) -> ReleaseId {
        ReleaseId::new(text).expect("an id")
    }

    fn release(board: &str, passed: Option<bool>) -> KeptRelease {
        KeptRelease {
            id: "9f2c1ab034d5e6f7".to_owned(),
            kind: "program".to_owned(),
            name: None,
            board: board.to_owned(),
            version: "1".to_owned(),
            build: "b".to_owned(),
            sequence: 1,
            floor: 0,
            expires: None,
            size: 1,
            envelope: Vec::new(),
            passed,
            by: "ada".to_owned(),
            added: 0,
            withdrawn: None,
        }
    }

    #[test]
    fn gates_are_demanded_of_what_boards_get() {
        use GateDemand::{All, Boards, None as Nothing};
        for (demand, board, passed, refused) in [
            (Boards, "virt", None, true),
            (Boards, "virt", Some(false), true),
            (Boards, "virt", Some(true), false),
            (Boards, "sim", None, false),
            (Boards, "sim", Some(false), false),
            (All, "sim", None, true),
            (All, "sim", Some(false), true),
            (All, "xiao-c3", Some(true), false),
            (Nothing, "virt", None, false),
            (Nothing, "virt", Some(false), false),
        ] {
            let release = release(board, passed);
            assert_eq!(
                demand.refuses(&release),
                refused,
                "{demand:?} {board} {passed:?}"
            );
        }
        assert_eq!(GateDemand::default(), Boards);
    }

    #[test]
    fn an_override_has_a_reason_and_something_to_override() {
        let ungated = || vec![id("a"), id("b")];
        assert!(matches!(overridden(None, vec![]), Ok(None)));
        assert!(matches!(overridden(Some("hurry"), vec![]), Ok(None)));
        assert!(
            matches!(overridden(None, ungated()), Err(RolloutError::NoGate(all)) if all == ungated())
        );
        for wrong in ["", "  ", "a\nb", &"x".repeat(513)] {
            for releases in [ungated(), vec![]] {
                let refused = overridden(Some(wrong), releases);
                assert!(matches!(refused, Err(RolloutError::Override)), "{wrong:?}");
            }
        }
        let done = overridden(Some(" a robot is stuck "), ungated()).expect("a reason");
        let done = done.expect("an override");
        assert_eq!(
            (done.why.as_str(), done.releases),
            ("a robot is stuck", ungated())
        );
    }
}
