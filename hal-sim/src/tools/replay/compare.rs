//! What a program does, as a list for each kind of action, and where two such lists part.

use std::collections::BTreeMap;
use std::fmt;

use crawler_protocol::{BehaviourName, RobotState};

use crate::run::event_log::{Event, Output, What};
use crate::run::journal::Payload;

/// Something a program did that can be seen from outside.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ProgramAction {
    /// It set the duty of the left and right wheel, −255 to 255.
    Duty(i16, i16),
    /// It switched the lamp.
    Lamp(bool),
    /// It came to this state and behaviour.
    State(RobotState, BehaviourName),
    /// It published a message.
    Published {
        /// Topic.
        topic: String,
        /// Message.
        payload: Payload,
    },
    /// It asked the ranger something over the line.
    Asked(Payload),
    /// It moved the trigger pin of the ranger.
    Trigger(bool),
    /// It asked for a reset.
    Reset,
}

impl fmt::Display for ProgramAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Duty(left, right) => write!(f, "duty {left} {right}"),
            Self::Lamp(on) => write!(f, "lamp {}", if *on { "on" } else { "off" }),
            Self::State(state, behaviour) => {
                write!(f, "state {} behaviour {}", state.name(), behaviour.name())
            }
            Self::Published { topic, payload } => write!(f, "published {topic} {payload}"),
            Self::Asked(bytes) => write!(f, "asked the ranger {bytes}"),
            Self::Trigger(level) => write!(f, "trigger pin {}", u8::from(*level)),
            Self::Reset => f.write_str("asked for a reset"),
        }
    }
}

/// Where a program of now parts from the recorded one: microseconds since the beginning of the
/// world, and what each of them did then. `None`: nothing of the kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The moment.
    pub at_us: u64,
    /// Which output: `duty`, `lamp`, `state`, `message`, `ranger` or `reset`.
    pub output: &'static str,
    /// What was done, and when.
    pub recorded: Option<(u64, ProgramAction)>,
    /// What is done now, and when.
    pub now: Option<(u64, ProgramAction)>,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = |us: u64| us as f64 * 1e-6;
        let part = |f: &mut fmt::Formatter<'_>,
                    name: &str,
                    action: &Option<(u64, ProgramAction)>| match action {
            Some((at, action)) => write!(f, "\n  {name:<8} {:.6} s  {action}", seconds(*at)),
            None => write!(f, "\n  {name:<8} nothing more of the kind"),
        };
        write!(f, "at {:.6} s: {}", seconds(self.at_us), self.output)?;
        part(f, "recorded", &self.recorded)?;
        part(f, "now", &self.now)
    }
}

/// What is left out of a comparison.
#[derive(Debug, Clone, Default)]
pub(super) struct Except {
    /// Parts of topics whose messages differ on purpose.
    pub(super) topics: Vec<&'static str>,
    /// Fields of JSON messages that differ on purpose.
    pub(super) fields: Vec<&'static str>,
}

/// The actions among `events`, by kind. Several changes of the pins at one moment are one action.
fn actions(events: &[Event], except: &Except) -> BTreeMap<&'static str, Vec<(u64, ProgramAction)>> {
    let mut kinds: BTreeMap<&'static str, Vec<(u64, ProgramAction)>> = BTreeMap::new();
    let mut pins: BTreeMap<Output, u8> = BTreeMap::new();
    let mut drive = (0, 0);
    let mut changed: Option<u64> = None;
    let mut settle =
        |pins: &BTreeMap<Output, u8>, at: u64, list: &mut Vec<(u64, ProgramAction)>| {
            use Output::{LeftDuty, LeftIn1, LeftIn2, RightDuty, RightIn1, RightIn2};
            let level = |output| pins.get(&output).copied().unwrap_or(0);
            let duty = |enable, in1, in2| match (level(in1) > 0, level(in2) > 0) {
                (true, false) => i16::from(level(enable)),
                (false, true) => -i16::from(level(enable)),
                (true, true) | (false, false) => 0,
            };
            let next = (
                duty(LeftDuty, LeftIn1, LeftIn2),
                duty(RightDuty, RightIn1, RightIn2),
            );
            if next != drive {
                drive = next;
                list.push((at, ProgramAction::Duty(next.0, next.1)));
            }
        };
    for Event(at, what) in events {
        let at = *at;
        if let Some(moment) = changed.filter(|&moment| moment < at) {
            settle(&pins, moment, kinds.entry("duty").or_default());
            changed = None;
        }
        let (kind, action) = match what {
            What::Set(Output::Lamp, level) => ("lamp", ProgramAction::Lamp(*level > 0)),
            What::Set(output, value) => {
                pins.insert(*output, *value);
                changed = Some(at);
                continue;
            }
            What::State(state, behaviour) => ("state", ProgramAction::State(*state, *behaviour)),
            What::Published { topic, payload, .. } => {
                if except.topics.iter().any(|part| topic.contains(part)) {
                    continue;
                }
                let (topic, payload) = (topic.clone(), except.clean(payload));
                ("message", ProgramAction::Published { topic, payload })
            }
            What::Asked { bytes, .. } => ("ranger", ProgramAction::Asked(bytes.clone())),
            What::Trigger(level) => ("ranger", ProgramAction::Trigger(*level)),
            What::Reset => ("reset", ProgramAction::Reset),
            _ => continue,
        };
        kinds.entry(kind).or_default().push((at, action));
    }
    if let Some(moment) = changed {
        settle(&pins, moment, kinds.entry("duty").or_default());
    }
    kinds
}

impl Except {
    fn clean(&self, payload: &Payload) -> Payload {
        if self.fields.is_empty() {
            return payload.clone();
        }
        match serde_json::from_slice::<serde_json::Value>(payload.bytes()) {
            Ok(serde_json::Value::Object(mut object)) => {
                for field in &self.fields {
                    object.remove(*field);
                }
                Payload::new(serde_json::Value::Object(object).to_string().as_bytes())
            }
            _ => payload.clone(),
        }
    }
}

/// Where what is done `now` parts from what was `recorded` first; `end` is when the recorded
/// program was stopped. The second value counts the actions that agree.
pub(super) fn compare(
    recorded: &[Event],
    now: &[Event],
    end: u64,
    except: &Except,
) -> (Option<Difference>, u64) {
    let sorted = |events: &[Event]| {
        let mut events = events.to_vec();
        events.sort_by_key(|event| event.0);
        actions(&events, except)
    };
    let (before, after) = (sorted(recorded), sorted(now));
    let mut first: Option<Difference> = None;
    let mut agreed = 0;
    let mut kinds: Vec<&'static str> = before.keys().chain(after.keys()).copied().collect();
    kinds.sort_unstable();
    kinds.dedup();
    for output in kinds {
        let (old, new) = (before.get(output), after.get(output));
        let old = old.map_or(&[][..], Vec::as_slice);
        let new = new.map_or(&[][..], Vec::as_slice);
        let same = old.iter().zip(new).take_while(|(a, b)| a == b).count();
        agreed += same as u64;
        let (old, new) = (old.get(same), new.get(same));
        // The recorded program was stopped within this moment, and may have had more to do in it.
        if old.is_none() && new.is_none_or(|&(at, _)| at >= end) {
            continue;
        }
        let at = |action: Option<&(u64, ProgramAction)>| action.map_or(u64::MAX, |action| action.0);
        let at_us = at(old).min(at(new));
        if first.as_ref().is_none_or(|first| at_us < first.at_us) {
            first = Some(Difference {
                at_us,
                output,
                recorded: old.cloned(),
                now: new.cloned(),
            });
        }
    }
    (first, agreed)
}
