//! Rollouts for people.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use crawler_system::text::line;
use serde_json::Value;

use super::view::{Line, Phase, Robot, Rollout};
use crate::calendar::moment;

/// Characters of a name or a reason that are shown.
const SHOWN: usize = 60;
/// Lines of the log that are shown.
const LOG: usize = 10;

fn short(text: &str) -> String {
    line(text, SHOWN)
}

/// A word, or an object with one field: `{"told": "panic"}` is `told panic`.
fn words(value: &Value) -> String {
    let text = match value {
        Value::Null => String::new(),
        Value::String(word) => word.clone(),
        Value::Object(fields) => {
            let fields = fields.iter().map(|(name, value)| match value {
                Value::Object(_) => name.clone(),
                value => format!("{name} {}", words(value)),
            });
            fields.collect::<Vec<_>>().join(", ")
        }
        other => other.to_string(),
    };
    short(&text)
}

/// How many robots are in which state, most first.
pub(super) fn states(robots: &BTreeMap<String, u64>) -> String {
    let mut counted: Vec<_> = robots
        .iter()
        .filter(|(state, _)| *state != "not_applicable")
        .collect();
    counted.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
    let texts = counted
        .into_iter()
        .map(|(state, count)| format!("{count} {}", short(state)));
    let texts: Vec<_> = texts.collect();
    if texts.is_empty() {
        return "none".to_owned();
    }
    texts.join(", ")
}

fn selected(phase: &Phase) -> String {
    let select = &phase.select;
    if let Some(share) = select["share"].as_u64() {
        return format!("{share} % of the robots");
    }
    if let Some(group) = select["group"].as_array() {
        return match group.as_slice() {
            [one] => format!("robot {}", words(one)),
            group => format!("{} robots by name", group.len()),
        };
    }
    words(select)
}

/// The state of a rollout, and why.
pub(super) fn state(rollout: &Rollout) -> String {
    let why = match rollout.reason.as_deref() {
        None => String::new(),
        Some("person") => " by a person".to_owned(),
        Some("failures") => " by itself: too many robots have failed (failures)".to_owned(),
        Some("threshold") => " by itself: too few robots are confirmed (threshold)".to_owned(),
        Some(other) => format!(": {}", short(other)),
    };
    format!("{}{why}", short(&rollout.state))
}

/// A line of the log.
pub(super) fn happening(line: &Line) -> String {
    let mut text = format!(
        "{}  {}",
        moment(line.at),
        short(&line.what).replace('_', " ")
    );
    if let Some(phase) = line.phase {
        let _ = write!(text, " {phase}");
    }
    if let Some(reason) = &line.reason {
        let _ = write!(text, ": {}", short(reason));
    }
    text
}

/// One rollout, the robots at which it has failed, and whether there are more of those.
pub(super) fn rollout(rollout: &Rollout, failures: &[Robot], more: bool) -> String {
    let mut out = String::new();
    let mut row = |name: &str, value: &str| {
        let _ = writeln!(out, "{name:<12}{value}");
    };
    row("rollout", &short(&rollout.id));
    row("state", &state(rollout));
    row(
        "begun",
        &format!("{} by {}", moment(rollout.made), short(&rollout.by)),
    );
    row("server", &short(&rollout.server));
    for release in &rollout.plan.releases {
        let (version, board) = (short(&release.version), short(&release.board));
        row(
            "release",
            &format!("{} ({version} for {board})", short(&release.id)),
        );
    }
    if let Some(counts) = &rollout.counts {
        row("robots", &states(&counts.robots));
        let left = counts.robots.get("not_applicable").copied().unwrap_or(0);
        if left > 0 {
            row("", &format!("it is not for {left} others"));
        }
        out.push('\n');
        let _ = writeln!(out, "phase  {:<9}  {:<24}  failed  robots", "state", "for");
        for (at, (phase, planned)) in counts.phases.iter().zip(&rollout.plan.phases).enumerate() {
            let mark = if at + 1 == rollout.phase { '>' } else { ' ' };
            let state = match &phase.state {
                Value::Object(fields) => fields.keys().next().map_or("", String::as_str),
                state => state.as_str().unwrap_or_default(),
            };
            let failed = format!("{}/{}", phase.failures, phase.most_failures);
            let _ = writeln!(
                out,
                "{mark} {:<4} {:<9}  {:<24}  {failed:<6}  {}",
                at + 1,
                short(state),
                selected(planned),
                states(&phase.robots)
            );
        }
    }
    if !failures.is_empty() {
        out.push('\n');
        out.push_str(&robots(failures));
        if more {
            let id = short(&rollout.id);
            let _ = writeln!(
                out,
                "There are more: rollout robots {id} --state failed, or rolled_back."
            );
        }
    }
    if !rollout.log.is_empty() {
        out.push('\n');
        for line in rollout
            .log
            .iter()
            .skip(rollout.log.len().saturating_sub(LOG))
        {
            let _ = writeln!(out, "{}", happening(line));
        }
    }
    out
}

/// Robots, a line each.
pub(super) fn robots(robots: &[Robot]) -> String {
    if robots.is_empty() {
        return "No robots.\n".to_owned();
    }
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{:<32}  {:<14}  phase  image  {:<20}  why",
        "robot", "state", "since"
    );
    for robot in robots {
        let phase = robot
            .phase
            .map_or_else(|| "-".to_owned(), |phase| phase.to_string());
        let image = match robot.bytes {
            Some(bytes) if bytes > 0 => {
                let percent = u128::from(robot.received) * 100 / u128::from(bytes);
                format!("{percent} %")
            }
            _ => "-".to_owned(),
        };
        let text = format!(
            "{:<32}  {:<14}  {phase:<5}  {image:<5}  {:<20}  {}",
            short(&robot.id),
            short(&robot.state),
            moment(robot.since),
            words(&robot.reason)
        );
        let _ = writeln!(out, "{}", text.trim_end());
    }
    out
}

/// Rollouts, a line each.
pub(super) fn list(rollouts: &[Rollout]) -> String {
    if rollouts.is_empty() {
        return "No rollouts yet.\n".to_owned();
    }
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{:<6}  {:<20}  {:<32}  {:<16}  state",
        "id", "begun", "by", "release"
    );
    for rollout in rollouts {
        let release = rollout.plan.releases.first();
        let _ = writeln!(
            out,
            "{:<6}  {:<20}  {:<32}  {:<16}  {}",
            short(&rollout.id),
            moment(rollout.made),
            short(&rollout.by),
            release.map_or_else(String::new, |release| short(&release.id)),
            state(rollout)
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn told() -> Value {
        json!({
            "id": "3", "by": "ada", "made": 0, "ended": null, "server": "one", "state": "paused",
            "reason": "failures", "phase": 1,
            "plan": {
                "releases": [{"release": "9f2c1ab034d5e6f7", "board": "sim", "version": "0.4.0", "build": "b"}],
                "phases": [{"select": {"group": ["a", "b"]}, "soak_s": 5}, {"select": {"share": 100}}],
            },
            "counts": {
                "state": {"paused": "failures"}, "phase": 0, "bytes": 7, "elapsed_s": 9,
                "robots": {"rolled_back": 2, "waiting": 18, "not_applicable": 1},
                "phases": [
                    {"state": {"active": {"since_ms": 1}}, "robots": {"rolled_back": 2}, "failures": 2,
                     "most_failures": 2, "ended_per_hour": 5, "left_s": null},
                    {"state": "pending", "robots": {"waiting": 18}, "failures": 0, "most_failures": 2,
                     "ended_per_hour": 0, "left_s": null},
                ],
            },
            "log": [
                {"at": 0, "what": "phase_began", "phase": 1},
                {"at": 1_000, "what": "paused", "reason": "failures"},
            ],
        })
    }

    #[test]
    fn a_rollout_is_a_table() {
        let view = Rollout::read(told()).expect("a rollout");
        let robots = json!([{"robot": "a", "state": "rolled_back", "reason": {"told": "panic"}, "phase": 1,
            "received": 500, "bytes": 1_000, "since": 0, "attempts": 1, "offers": 1, "release": "x"}]);
        let robots = Robot::read(robots).expect("robots");
        let expected = "\
rollout     3
state       paused by itself: too many robots have failed (failures)
begun       1970-01-01 00:00:00Z by ada
server      one
release     9f2c1ab034d5e6f7 (0.4.0 for sim)
robots      18 waiting, 2 rolled_back
            it is not for 1 others

phase  state      for                       failed  robots
> 1    active     2 robots by name          2/2     2 rolled_back
  2    pending    100 % of the robots       0/2     18 waiting

robot                             state           phase  image  since                 why
a                                 rolled_back     1      50 %   1970-01-01 00:00:00Z  told panic
There are more: rollout robots 3 --state failed, or rolled_back.

1970-01-01 00:00:00Z  phase began 1
1970-01-01 00:00:01Z  paused: failures
";
        assert_eq!(rollout(&view, &robots, true), expected);
        assert_eq!(
            list(&[view]).lines().last(),
            Some(
                "3       1970-01-01 00:00:00Z  ada                               9f2c1ab034d5e6f7  paused by itself: \
                  too many robots have failed (failures)"
            )
        );
    }

    #[test]
    fn what_a_server_says_steers_no_terminal() {
        let table = |word: &str| {
            let mut told = told();
            for field in ["by", "server", "state", "reason", "id"] {
                told[field] = json!(word);
            }
            told["plan"]["releases"][0]["board"] = json!(word);
            told["plan"]["phases"][0]["select"] = json!({ word: { "x": word } });
            told["counts"]["robots"] = json!({ word: 1 });
            told["counts"]["phases"][0]["state"] = json!(word);
            told["log"][0]["what"] = json!(word);
            let view = Rollout::read(told).expect("a rollout");
            let robots = json!([{"robot": word, "state": word, "reason": {word: [word]}, "phase": null,
                "received": u64::MAX, "bytes": 1, "since": i64::MIN}]);
            let robots = Robot::read(robots).expect("robots");
            rollout(&view, &robots, true) + &list(&[view])
        };
        let text = table("\u{1b}[2J\r\n");
        assert!(!text.contains(['\u{1b}', '\r']), "{text}");
        assert_eq!(
            text.lines().count(),
            table("word").lines().count(),
            "{text}"
        );
    }
}
