//! What is stored of a step, and what people are told of it.

use std::collections::BTreeMap;

use crawler_protocol::RobotId;
use crawler_records::{Entry, EventLevel, RolloutRobot, RolloutStep, StepNote};
use crawler_updates::rollout::{Happening, Note, PauseReason, Reason, RobotRow, Step, UpdateState};
use serde_json::json;

/// Robots that one line of the audit log names.
const NAMED: usize = 100;
/// When more robots than this come to stand elsewhere at once, one event tells of all of them.
const ONE_BY_ONE: usize = 5;

/// Takes `later` into `step`, as if both were one.
pub(crate) fn merge(step: &mut Step, later: Step) {
    if later.document.is_some() {
        step.document = later.document;
    }
    step.rows.extend(later.rows);
    step.notes.extend(later.notes);
    step.effects.extend(later.effects);
}

/// Whether there is nothing to store.
pub(crate) fn is_empty(step: &Step) -> bool {
    step.document.is_none() && step.rows.is_empty() && step.notes.is_empty()
}

/// A value of the engine as it is stored.
///
/// # Errors
/// Those of JSON; values of the engine have none.
fn text(value: &impl serde::Serialize) -> Result<String, serde_json::Error> {
    serde_json::to_string(value)
}

/// What of a step of the rollout `id` goes into the records.
///
/// # Errors
/// Those of JSON; values of the engine have none.
pub(crate) fn to_records(id: i64, step: &Step, at: i64) -> Result<RolloutStep, serde_json::Error> {
    // Of several steps the last row of a robot counts.
    let rows: BTreeMap<&RobotId, &RobotRow> =
        step.rows.iter().map(|row| (&row.robot, row)).collect();
    let robots = rows.into_values().map(|row| {
        Ok(RolloutRobot {
            robot: row.robot.clone(),
            state: row.state.name().to_owned(),
            entry: text(row)?,
        })
    });
    let notes = step.notes.iter().map(|note| {
        Ok(StepNote {
            robot: about(&note.what).cloned(),
            revision: note.revision,
            what: text(&note.what)?,
        })
    });
    Ok(RolloutStep {
        at,
        document: step.document.as_ref().map(text).transpose()?,
        over: step
            .document
            .as_ref()
            .is_some_and(|document| document.state.is_over()),
        robots: robots.collect::<Result<_, serde_json::Error>>()?,
        notes: notes.collect::<Result<_, serde_json::Error>>()?,
        audit: audit(id, &step.notes, at),
    })
}

const fn about(what: &Happening) -> Option<&RobotId> {
    match what {
        Happening::Robot { robot, .. } => Some(robot),
        _ => None,
    }
}

/// What the audit log says of notes: a line for each that is about the rollout, and one for all robots in a row that
/// have come to the same.
fn audit(id: i64, notes: &[Note], at: i64) -> Vec<Entry> {
    let entry = |action: &str, detail| Entry {
        at,
        who: "server".to_owned(),
        from: String::new(),
        action: format!("rollout.{action}"),
        target: id.to_string(),
        detail,
        outcome: "ok".to_owned(),
    };
    let mut lines = Vec::new();
    let mut robots: BTreeMap<(UpdateState, String), Vec<&RobotId>> = BTreeMap::new();
    for note in notes {
        match &note.what {
            Happening::Robot {
                robot,
                state,
                reason,
            } => {
                let why = json!(reason).to_string();
                robots.entry((*state, why)).or_default().push(robot);
            }
            what => lines.push(entry(action(what), detail(what))),
        }
    }
    for ((state, why), robots) in robots {
        // It is JSON that was written here.
        let why: serde_json::Value = serde_json::from_str(&why).unwrap_or_default();
        for robots in robots.chunks(NAMED) {
            let detail = json!({ "state": state, "reason": why, "robots": robots });
            lines.push(entry("robots", detail));
        }
    }
    lines
}

/// The word for it in the audit log, and in the log of a rollout.
pub(crate) const fn action(what: &Happening) -> &'static str {
    match what {
        Happening::Started => "started",
        Happening::TakenOver(_) => "taken_over",
        Happening::PhaseBegan(_) => "phase_began",
        Happening::PhaseSoaks(_) => "phase_soaks",
        Happening::PhasePassed(_) => "phase_passed",
        Happening::Paused(_) => "paused",
        Happening::Resumed => "resumed",
        Happening::Aborted => "aborted",
        Happening::Done => "done",
        Happening::Robot { .. } => "robot",
    }
}

fn detail(what: &Happening) -> serde_json::Value {
    match what {
        Happening::TakenOver(server) => json!({ "server": server }),
        Happening::PhaseBegan(phase)
        | Happening::PhaseSoaks(phase)
        | Happening::PhasePassed(phase) => json!({ "phase": u32::from(*phase) + 1 }),
        Happening::Paused(reason) => json!({ "reason": reason }),
        _ => json!({}),
    }
}

/// What those are told who watch the fleet: all that is about the rollout, and how it ends for robots.
pub(crate) fn events(id: i64, notes: &[Note]) -> Vec<(EventLevel, Option<RobotId>, String)> {
    let mut events = Vec::new();
    let mut ends: BTreeMap<UpdateState, Vec<(&RobotId, &Option<Reason>)>> = BTreeMap::new();
    for note in notes {
        match &note.what {
            Happening::Robot {
                robot,
                state:
                    state @ (UpdateState::Confirmed | UpdateState::RolledBack | UpdateState::Failed),
                reason,
            } => ends.entry(*state).or_default().push((robot, reason)),
            Happening::Robot { .. } => {}
            what => {
                let (level, text) = told(what);
                events.push((level, None, format!("rollout {id} {text}")));
            }
        }
    }
    for (state, robots) in ends {
        let level = if state.is_failure() {
            EventLevel::Warn
        } else {
            EventLevel::Info
        };
        if robots.len() > ONE_BY_ONE {
            let text = format!("rollout {id}: {} robots are {state}", robots.len());
            events.push((level, None, text));
            continue;
        }
        for (robot, reason) in robots {
            let why = reason.as_ref().map_or_else(String::new, |reason| {
                format!(
                    ": {}",
                    json!(reason).to_string().replace(['"', '{', '}'], "")
                )
            });
            let text = format!("rollout {id}: {state}{why}");
            events.push((level, Some(robot.clone()), text));
        }
    }
    events
}

fn told(what: &Happening) -> (EventLevel, String) {
    let phase = |phase: &u8| u32::from(*phase) + 1;
    let text = match what {
        Happening::Started => "has begun".to_owned(),
        Happening::TakenOver(server) => format!("is carried out by server {server} now"),
        Happening::PhaseBegan(number) => format!("begins phase {}", phase(number)),
        Happening::PhaseSoaks(number) => format!("watches phase {}", phase(number)),
        Happening::PhasePassed(number) => format!("has passed phase {}", phase(number)),
        Happening::Paused(PauseReason::Person) => "was paused".to_owned(),
        Happening::Paused(PauseReason::Failures) => {
            return (
                EventLevel::Error,
                "has stopped by itself: too many robots failed".to_owned(),
            );
        }
        Happening::Paused(PauseReason::Threshold) => {
            return (
                EventLevel::Error,
                "has stopped by itself: too few robots are confirmed".to_owned(),
            );
        }
        Happening::Resumed => "goes on".to_owned(),
        Happening::Aborted => return (EventLevel::Warn, "was aborted".to_owned()),
        Happening::Done => "is done".to_owned(),
        Happening::Robot { robot, state, .. } => format!("has {robot} {state}"),
    };
    (EventLevel::Info, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(n: usize, state: UpdateState) -> Note {
        Note {
            revision: 1,
            what: Happening::Robot {
                robot: format!("r{n}").parse().expect("a robot"),
                state,
                reason: (state == UpdateState::Failed)
                    .then_some(Reason::TimedOut(UpdateState::Offered)),
            },
        }
    }

    #[test]
    fn a_line_names_all_robots_that_have_come_to_the_same() {
        let mut notes: Vec<_> = (0..250).map(|n| robot(n, UpdateState::Offered)).collect();
        notes.push(Note {
            revision: 3,
            what: Happening::PhaseBegan(0),
        });
        notes.push(robot(250, UpdateState::Failed));
        let lines = audit(7, &notes, 5);
        let actions: Vec<_> = lines.iter().map(|line| line.action.as_str()).collect();
        assert_eq!(
            actions,
            [
                "rollout.phase_began",
                "rollout.robots",
                "rollout.robots",
                "rollout.robots",
                "rollout.robots"
            ]
        );
        let named = |line: &Entry| line.detail["robots"].as_array().map_or(0, Vec::len);
        assert_eq!(lines.iter().map(named).sum::<usize>(), 251);
        assert_eq!(lines[4].detail["reason"], json!({"timed_out": "offered"}));
        assert!(lines.iter().all(|line| line.target == "7" && line.at == 5));
        let longest = lines.iter().map(|line| line.detail.to_string().len()).max();
        assert!(
            longest.is_some_and(|longest| longest < 8_192),
            "{longest:?}"
        );
    }

    #[test]
    fn people_hear_of_ends_and_of_crowds_once() {
        let few = [robot(1, UpdateState::Failed), robot(2, UpdateState::Trial)];
        let events = super::events(7, &few);
        assert_eq!(events.len(), 1, "{events:?}");
        assert_eq!(events[0].0, EventLevel::Warn);
        assert_eq!(events[0].2, "rollout 7: failed: timed_out:offered");
        let many: Vec<_> = (0..6).map(|n| robot(n, UpdateState::Confirmed)).collect();
        let events = super::events(7, &many);
        assert_eq!(events.len(), 1, "{events:?}");
        assert_eq!(events[0].2, "rollout 7: 6 robots are confirmed");
    }

    #[test]
    fn the_last_row_of_a_robot_is_stored() {
        let row = |state: &str, revision| {
            let row = json!({"robot": "a", "revision": revision, "state": state, "reason": null,
                "release": 0, "phase": 0, "attempts": 0, "offers": 0, "received": 0, "boot": 0,
                "forgiven": false, "recalled": false, "since_ms": 0, "due_ms": null,
                "resend_ms": null, "attempt_ends_ms": null});
            serde_json::from_value::<RobotRow>(row).expect("a row")
        };
        let mut step = Step {
            rows: vec![row("offered", 1)],
            ..Step::default()
        };
        assert!(!is_empty(&step));
        merge(
            &mut step,
            Step {
                rows: vec![row("receiving", 2)],
                ..Step::default()
            },
        );
        let stored = to_records(1, &step, 9).expect("JSON");
        assert_eq!(stored.robots.len(), 1);
        assert_eq!(stored.robots[0].state, "receiving");
        assert!(is_empty(&Step::default()));
    }
}
