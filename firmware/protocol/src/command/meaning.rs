//! The second step: a frame to a command.

use heapless::String;

use super::frame::{Frame, Scalar};
use super::value::is_text;
use super::{
    Action, BehaviourSpec, Command, CommandName, DEFAULT_FOLLOW_DISTANCE, DEFAULT_LIARS,
    DEFAULT_WANDER_SPEED, Direction, FOLLOW_DISTANCE, Formation, MAX_COORDINATE, MAX_DRIVE_V,
    MAX_DRIVE_W, MAX_LAPS, MAX_LIARS, MAX_MOVE_MS, MAX_VALUE, Measure, ParameterValue,
    ParameterValues, Places, Shape,
};
use crate::{BehaviourName, PolicyName, Reason, RobotId};

/// Makes a command of a frame. Takes `source` out of it only where nothing is wrong.
pub(super) fn command(frame: &mut Frame) -> Result<Command, Reason> {
    if let Some(fault) = frame.fault {
        return Err(fault);
    }
    let (Some(timestamp), Some(seq), true) = (frame.timestamp, frame.seq, frame.source.is_some())
    else {
        return Err(Reason::MissingField);
    };
    let action = action(frame)?;
    let source = frame.source.take().ok_or(Reason::MissingField)?;
    Ok(Command {
        action,
        timestamp,
        seq,
        source,
    })
}

/// Makes an action of a frame.
pub(super) fn action(frame: &Frame) -> Result<Action, Reason> {
    if let Some(fault) = frame.fault {
        return Err(fault);
    }
    let command = frame.command.ok_or(Reason::MissingField)?;
    if frame.long_name {
        return Err(match command {
            CommandName::Set => Reason::UnknownParameter,
            _ => Reason::UnknownField,
        });
    }
    let given = Given(&frame.parameters);
    match command {
        CommandName::Move => {
            given.only(&["direction", "speed", "duration"])?;
            Ok(Action::Move {
                direction: Direction::from_name(given.text("direction")?)
                    .ok_or(Reason::OutOfRange)?,
                speed: percent(given.number("speed")?)?,
                duration_ms: whole(given.number("duration")?, MAX_MOVE_MS)?,
            })
        }
        CommandName::Drive => {
            given.only(&["v", "w"])?;
            Ok(Action::Drive {
                v: within(given.number("v")?, MAX_DRIVE_V)?,
                w: within(given.number("w")?, MAX_DRIVE_W)?,
            })
        }
        CommandName::Goto => {
            given.only(&["x", "y"])?;
            Ok(Action::Goto {
                x: within(given.number("x")?, MAX_COORDINATE)?,
                y: within(given.number("y")?, MAX_COORDINATE)?,
            })
        }
        CommandName::Behave => behave(given).map(Action::Behave),
        CommandName::Set => set(given).map(Action::Set),
        CommandName::Stop => given.only(&[]).map(|()| Action::Stop),
        CommandName::Estop => given.only(&[]).map(|()| Action::Estop),
        CommandName::Reset => given.only(&[]).map(|()| Action::Reset),
        CommandName::Scan => given.only(&[]).map(|()| Action::Scan),
        CommandName::Capture => given.only(&[]).map(|()| Action::Capture),
        CommandName::ReportMap => given.only(&[]).map(|()| Action::ReportMap),
        CommandName::Identify => given.only(&[]).map(|()| Action::Identify),
        CommandName::Reboot => given.only(&[]).map(|()| Action::Reboot),
        CommandName::Shadow => {
            given.only(&["policy"])?;
            Ok(Action::Shadow {
                policy: match given.get("policy") {
                    Some(_) => Some(given.policy()?),
                    None => None,
                },
            })
        }
    }
}

fn behave(given: Given<'_>) -> Result<BehaviourSpec, Reason> {
    let name = given.text("behaviour")?;
    let behaviour = BehaviourName::from_name(name).ok_or(Reason::UnknownBehaviour)?;
    let alone = |spec| given.only(&["behaviour"]).map(|()| spec);
    match behaviour {
        BehaviourName::Wander => {
            given.only(&["behaviour", "speed"])?;
            Ok(BehaviourSpec::Wander {
                speed: match given.get("speed") {
                    Some(_) => percent(given.number("speed")?)?,
                    None => DEFAULT_WANDER_SPEED,
                },
            })
        }
        BehaviourName::Goto => {
            given.only(&["behaviour", "x", "y"])?;
            Ok(BehaviourSpec::Goto {
                x: within(given.number("x")?, MAX_COORDINATE)?,
                y: within(given.number("y")?, MAX_COORDINATE)?,
            })
        }
        BehaviourName::Follow => {
            given.only(&["behaviour", "leader", "distance"])?;
            let [least, most] = FOLLOW_DISTANCE;
            let distance = match given.get("distance") {
                Some(_) => within(given.number("distance")?, most)?,
                None => DEFAULT_FOLLOW_DISTANCE,
            };
            if distance < least {
                return Err(Reason::OutOfRange);
            }
            Ok(BehaviourSpec::Follow {
                leader: RobotId::new(given.text("leader")?).map_err(|_| Reason::OutOfRange)?,
                distance,
            })
        }
        BehaviourName::Patrol => {
            given.only(&["behaviour", "waypoints", "laps"])?;
            Ok(BehaviourSpec::Patrol {
                waypoints: given.places("waypoints", 2)?,
                laps: match given.get("laps") {
                    Some(_) => whole(given.number("laps")?, MAX_LAPS.into())? as u16,
                    None => 0,
                },
            })
        }
        BehaviourName::Consensus => {
            given.only(&["behaviour", "value", "measure", "f"])?;
            let measure = match (given.get("value"), given.get("measure")) {
                (Some(_), None) => Measure::Value(within(given.number("value")?, MAX_VALUE)?),
                (None, Some(_)) => match given.text("measure")? {
                    "temperature" => Measure::Temperature,
                    "range" => Measure::Range,
                    _ => return Err(Reason::OutOfRange),
                },
                (None, None) => return Err(Reason::MissingField),
                // One or the other.
                (Some(_), Some(_)) => return Err(Reason::UnknownField),
            };
            let f = match given.get("f") {
                Some(_) => whole(given.number("f")?, MAX_LIARS.into())? as u8,
                None => DEFAULT_LIARS,
            };
            Ok(BehaviourSpec::Consensus { measure, f })
        }
        BehaviourName::Allocate => {
            given.only(&["behaviour", "tasks"])?;
            Ok(BehaviourSpec::Allocate {
                tasks: given.places("tasks", 1)?,
            })
        }
        BehaviourName::Cover => {
            given.only(&["behaviour", "area"])?;
            Ok(BehaviourSpec::Cover {
                area: given.places("area", 3)?,
            })
        }
        BehaviourName::Manual => alone(BehaviourSpec::Manual),
        BehaviourName::Disperse => alone(BehaviourSpec::Disperse),
        BehaviourName::Gather => {
            given.only(&["behaviour", "x", "y"])?;
            Ok(BehaviourSpec::Gather {
                x: given.within_or("x", MAX_COORDINATE, 0.0)?,
                y: given.within_or("y", MAX_COORDINATE, 0.0)?,
            })
        }
        BehaviourName::Flock => alone(BehaviourSpec::Flock),
        BehaviourName::Formation if given.get("shape").is_none() => alone(BehaviourSpec::Formation),
        BehaviourName::Formation => shaped(given).map(BehaviourSpec::Shaped),
        BehaviourName::Policy => {
            given.only(&["behaviour", "policy"])?;
            Ok(BehaviourSpec::Policy {
                policy: given.policy()?,
            })
        }
    }
}

/// A formation with a shape.
fn shaped(given: Given<'_>) -> Result<Formation, Reason> {
    let shape = Shape::from_name(given.text("shape")?).ok_or(Reason::OutOfRange)?;
    let (name, [least, most], usual) = Formation::size_of(shape);
    given.only(&["behaviour", "shape", name, "heading", "path"])?;
    let size = given.within_or(name, most, usual)?;
    if size < least {
        return Err(Reason::OutOfRange);
    }
    let path = match given.get("path") {
        Some(_) => given.places("path", 1)?,
        None => Places::new(&[[0.0; 2]]).unwrap_or_default(),
    };
    Ok(Formation {
        shape,
        size,
        heading: given.within_or("heading", Formation::MOST_HEADING, 0.0)?,
        path,
    })
}

/// Which parameters there are is the robot's business; here they only must look like some.
fn set(given: Given<'_>) -> Result<ParameterValues, Reason> {
    let mut values = ParameterValues::new();
    for (name, scalar) in given.0 {
        if !is_parameter_name(name) {
            return Err(Reason::UnknownParameter);
        }
        let value = match scalar {
            Scalar::Bool(value) => ParameterValue::Bool(*value),
            Scalar::Number(value) => ParameterValue::Number(within(*value, f32::MAX)?),
            Scalar::Text(value) if is_text(value) => ParameterValue::Text(value.clone()),
            Scalar::Text(_) => return Err(Reason::OutOfRange),
            Scalar::Places(_) => return Err(Reason::WrongType),
        };
        values
            .push((name.clone(), value))
            .map_err(|_| Reason::TooLarge)?;
    }
    if values.is_empty() {
        return Err(Reason::MissingField);
    }
    Ok(values)
}

/// `a-z`, `0-9` and `_`, at least one.
fn is_parameter_name(name: &str) -> bool {
    !name.is_empty()
        && name
            .bytes()
            .all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_'))
}

/// The parameters that came.
#[derive(Clone, Copy)]
struct Given<'a>(&'a [(String<32>, Scalar)]);

impl<'a> Given<'a> {
    /// An unknown name is reported before a missing one: it usually is the missing one, misspelt.
    fn only(self, names: &[&str]) -> Result<(), Reason> {
        if self
            .0
            .iter()
            .all(|(name, _)| names.contains(&name.as_str()))
        {
            Ok(())
        } else {
            Err(Reason::UnknownField)
        }
    }

    fn get(self, name: &str) -> Option<&'a Scalar> {
        self.0
            .iter()
            .find(|(given, _)| given == name)
            .map(|(_, value)| value)
    }

    fn number(self, name: &str) -> Result<f64, Reason> {
        match self.get(name).ok_or(Reason::MissingField)? {
            Scalar::Number(value) => Ok(*value),
            Scalar::Bool(_) | Scalar::Text(_) | Scalar::Places(_) => Err(Reason::WrongType),
        }
    }

    /// A number from `-most` to `most`, or `usual` where none is given.
    fn within_or(self, name: &str, most: f32, usual: f32) -> Result<f32, Reason> {
        match self.get(name) {
            Some(_) => within(self.number(name)?, most),
            None => Ok(usual),
        }
    }

    fn text(self, name: &str) -> Result<&'a str, Reason> {
        match self.get(name).ok_or(Reason::MissingField)? {
            Scalar::Text(value) => Ok(value),
            Scalar::Bool(_) | Scalar::Number(_) | Scalar::Places(_) => Err(Reason::WrongType),
        }
    }

    fn policy(self) -> Result<PolicyName, Reason> {
        PolicyName::new(self.text("policy")?).map_err(|_| Reason::OutOfRange)
    }

    /// Places, `least` of them or more.
    fn places(self, name: &str, least: u8) -> Result<Places, Reason> {
        match self.get(name).ok_or(Reason::MissingField)? {
            Scalar::Places(places) if places.count() >= least => Ok(*places),
            Scalar::Places(_) => Err(Reason::OutOfRange),
            Scalar::Bool(_) | Scalar::Number(_) | Scalar::Text(_) => Err(Reason::WrongType),
        }
    }
}

/// A number from `-most` to `most`.
fn within(value: f64, most: f32) -> Result<f32, Reason> {
    if value.abs() <= f64::from(most) {
        Ok(value as f32)
    } else {
        Err(Reason::OutOfRange)
    }
}

/// A whole number from 0 to `most`. `80.0` is one: some languages write it so.
fn whole(value: f64, most: u32) -> Result<u32, Reason> {
    if !(0.0..=f64::from(most)).contains(&value) {
        return Err(Reason::OutOfRange);
    }
    let number = value as u32;
    if f64::from(number) == value {
        Ok(number)
    } else {
        Err(Reason::WrongType)
    }
}

fn percent(value: f64) -> Result<u8, Reason> {
    whole(value, 100).and_then(|value| u8::try_from(value).map_err(|_| Reason::OutOfRange))
}
