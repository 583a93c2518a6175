//! Commands to JSON.

use serde::ser::{SerializeMap, SerializeStruct};
use serde::{Serialize, Serializer};

use super::{Action, BehaviourSpec, Command, Formation, Measure, ParameterValue};

/// The parameters of an action as the flat object they are on the wire.
struct Parameters<'a>(&'a Action);

impl Parameters<'_> {
    fn any(&self) -> bool {
        match self.0 {
            Action::Move { .. }
            | Action::Drive { .. }
            | Action::Behave(_)
            | Action::Goto { .. }
            | Action::Set(_)
            | Action::Shadow { policy: Some(_) } => true,
            Action::Stop
            | Action::Estop
            | Action::Reset
            | Action::Scan
            | Action::Capture
            | Action::ReportMap
            | Action::Identify
            | Action::Reboot
            | Action::Shadow { policy: None } => false,
        }
    }
}

impl Serialize for Parameters<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        match self.0 {
            Action::Move {
                direction,
                speed,
                duration_ms,
            } => {
                map.serialize_entry("direction", direction)?;
                map.serialize_entry("speed", speed)?;
                map.serialize_entry("duration", duration_ms)?;
            }
            Action::Drive { v, w } => {
                map.serialize_entry("v", &ParameterValue::Number(*v))?;
                map.serialize_entry("w", &ParameterValue::Number(*w))?;
            }
            Action::Goto { x, y } => place(&mut map, *x, *y)?,
            Action::Behave(spec) => {
                map.serialize_entry("behaviour", &spec.behaviour())?;
                match spec {
                    BehaviourSpec::Wander { speed } => map.serialize_entry("speed", speed)?,
                    BehaviourSpec::Goto { x, y } => place(&mut map, *x, *y)?,
                    BehaviourSpec::Gather { x, y } => {
                        unless(&mut map, "x", *x, 0.0)?;
                        unless(&mut map, "y", *y, 0.0)?;
                    }
                    BehaviourSpec::Follow { leader, distance } => {
                        map.serialize_entry("leader", leader)?;
                        map.serialize_entry("distance", &ParameterValue::Number(*distance))?;
                    }
                    BehaviourSpec::Patrol { waypoints, laps } => {
                        map.serialize_entry("waypoints", waypoints)?;
                        map.serialize_entry("laps", laps)?;
                    }
                    BehaviourSpec::Consensus { measure, f } => {
                        match measure {
                            Measure::Value(value) => {
                                map.serialize_entry("value", &ParameterValue::Number(*value))?;
                            }
                            Measure::Temperature => {
                                map.serialize_entry("measure", "temperature")?;
                            }
                            Measure::Range => map.serialize_entry("measure", "range")?,
                        }
                        map.serialize_entry("f", f)?;
                    }
                    BehaviourSpec::Allocate { tasks } => map.serialize_entry("tasks", tasks)?,
                    BehaviourSpec::Policy { policy } => map.serialize_entry("policy", policy)?,
                    BehaviourSpec::Shaped(formation) => {
                        let (size, _, usual) = Formation::size_of(formation.shape);
                        map.serialize_entry("shape", &formation.shape)?;
                        unless(&mut map, size, formation.size, usual)?;
                        unless(&mut map, "heading", formation.heading, 0.0)?;
                        if formation.path.as_slice() != [[0.0; 2]] {
                            map.serialize_entry("path", &formation.path)?;
                        }
                    }
                    BehaviourSpec::Cover { area } => map.serialize_entry("area", area)?,
                    BehaviourSpec::Manual
                    | BehaviourSpec::Disperse
                    | BehaviourSpec::Flock
                    | BehaviourSpec::Formation => {}
                }
            }
            Action::Set(values) => {
                for (name, value) in values {
                    map.serialize_entry(name.as_str(), value)?;
                }
            }
            Action::Shadow {
                policy: Some(policy),
            } => map.serialize_entry("policy", policy)?,
            Action::Stop
            | Action::Estop
            | Action::Reset
            | Action::Scan
            | Action::Capture
            | Action::ReportMap
            | Action::Identify
            | Action::Reboot
            | Action::Shadow { policy: None } => {}
        }
        map.end()
    }
}

/// Through [`ParameterValue`], which refuses what is not finite.
fn place<M: SerializeMap>(map: &mut M, x: f32, y: f32) -> Result<(), M::Error> {
    map.serialize_entry("x", &ParameterValue::Number(x))?;
    map.serialize_entry("y", &ParameterValue::Number(y))
}

/// A parameter that may be left out where it is `usual`.
fn unless<M: SerializeMap>(
    map: &mut M,
    name: &'static str,
    value: f32,
    usual: f32,
) -> Result<(), M::Error> {
    if value == usual {
        return Ok(());
    }
    map.serialize_entry(name, &ParameterValue::Number(value))
}

fn fields<S: SerializeStruct>(fields: &mut S, action: &Action) -> Result<(), S::Error> {
    fields.serialize_field("command", &action.command())?;
    let parameters = Parameters(action);
    if parameters.any() {
        fields.serialize_field("parameters", &parameters)
    } else {
        fields.skip_field("parameters")
    }
}

impl Serialize for Action {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut object = serializer.serialize_struct("Action", 2)?;
        fields(&mut object, self)?;
        object.end()
    }
}

impl Serialize for Command {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut object = serializer.serialize_struct("Command", 5)?;
        fields(&mut object, &self.action)?;
        object.serialize_field("timestamp", &self.timestamp)?;
        object.serialize_field("seq", &self.seq)?;
        object.serialize_field("source", &self.source)?;
        object.end()
    }
}
