//! A command in a scenario, and what is wrong with one that robots would refuse.

use std::collections::BTreeMap;
use std::fmt;

use crawler_protocol::{Action, BehaviourName, CommandName, Reason};
use serde_json::{Value, json};

/// Why robots would refuse a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// The key that is to blame, below the table of the command.
    pub(super) key: String,
    /// What is wrong with it, and what may stand there.
    pub(super) rule: String,
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.key, self.rule)
    }
}

/// The command of this name with these parameters.
///
/// # Errors
/// [`Refused`] when it is none.
pub(super) fn action(
    command: &str,
    parameters: &BTreeMap<String, Value>,
) -> Result<Action, Refused> {
    parse(command, parameters).map_err(|reason| {
        let known = match reason {
            Reason::UnknownCommand => names(CommandName::ALL.iter().map(|name| name.name())),
            Reason::UnknownBehaviour => names(BehaviourName::ALL.iter().map(|name| name.name())),
            _ => String::new(),
        };
        Refused {
            key: culprit(command, parameters, reason),
            rule: format!("is refused: {}{known}", reason.name()),
        }
    })
}

fn parse(command: &str, parameters: &BTreeMap<String, Value>) -> Result<Action, Reason> {
    let mut object = json!({ "command": command });
    if !parameters.is_empty() {
        object["parameters"] = json!(parameters);
    }
    Action::parse(object.to_string().as_bytes())
}

fn names<'a>(known: impl Iterator<Item = &'a str>) -> String {
    format!("; there are {}", known.collect::<Vec<_>>().join(", "))
}

/// The key without which the command would do, or would be refused for another reason than this; the command itself
/// where there is none.
fn culprit(command: &str, parameters: &BTreeMap<String, Value>, reason: Reason) -> String {
    if reason == Reason::UnknownBehaviour {
        return "parameters.behaviour".to_owned();
    }
    let without = |key: &String| {
        let mut others = parameters.clone();
        others.remove(key);
        parse(command, &others)
    };
    let to_blame = parameters.keys().find(|key| without(key).is_ok());
    let to_blame = to_blame.or_else(|| {
        let mut keys = parameters.keys();
        keys.find(|key| without(key).err() != Some(reason))
    });
    match to_blame {
        Some(key) => format!("parameters.{key}"),
        None => "command".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(command: &str, parameters: Value) -> String {
        let parameters = serde_json::from_value(parameters).expect("a table");
        action(command, &parameters)
            .expect_err("refused")
            .to_string()
    }

    #[test]
    fn what_is_to_blame_is_named_with_what_may_stand_there() {
        let said = refused("behave", json!({ "behaviour": "dance" }));
        assert!(
            said.starts_with(
                "parameters.behaviour is refused: unknown_behaviour; there are manual, wander, goto"
            ),
            "{said}"
        );
        let said = refused("dance", json!({}));
        assert!(
            said.starts_with("command is refused: unknown_command; there are move, drive"),
            "{said}"
        );
        assert_eq!(
            refused("behave", json!({ "behaviour": "wander", "speed": 101 })),
            "parameters.speed is refused: out_of_range"
        );
        assert_eq!(
            refused("goto", json!({ "x": 1.0, "y": 2.0, "z": 3.0 })),
            "parameters.z is refused: unknown_field"
        );
        assert_eq!(
            refused("goto", json!({ "x": 1.0 })),
            "command is refused: missing_field"
        );
    }
}
