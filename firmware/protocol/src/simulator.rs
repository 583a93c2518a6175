//! Control of a simulated world, and faults put into robots on purpose.
//!
//! `simulator/command` carries a [`SimulatorCommand`]. Whoever runs a world obeys all of them; a
//! robot on a bench, built and booted to take faults, obeys `inject` and `heal` that name it.
//! There is no heap, so a command is read in two steps: the fields that are there, each with its
//! type, then what the command makes of them.

mod fault;
#[cfg(feature = "schema")]
pub(crate) mod schema;

use serde::de::{Deserialize, Deserializer, Error, Unexpected};
use serde::ser::{Serialize, SerializeMap, Serializer};

pub use fault::{
    FaultName, FaultRange, FaultSpec, LinkCut, MAX_CLOCK_STEP_MS, MAX_NOISE_MM, MAX_PACKETS_PER_S,
    MAX_SAG_OHM, Wheel,
};

use crate::message::wire;
use crate::words::words;
use crate::{MAX_COORDINATE, RobotId, SnapshotName};

/// Most physics steps of one `step`.
pub const MAX_STEPS: u32 = 1_000_000;
/// Slowest and fastest a world can be told to run, as multiples of real time.
pub const SPEED_RANGE: (f32, f32) = (0.01, 1_000.0);
/// Longest time for which a fault can be ordered: a day, in milliseconds.
pub const MAX_LASTING_MS: u32 = 86_400_000;

words! {
    /// The name of a command to a simulated world.
    SimulatorCommandName {
        /// See [`SimulatorCommand::Pause`].
        Pause = "pause",
        /// See [`SimulatorCommand::Resume`].
        Resume = "resume",
        /// See [`SimulatorCommand::Step`].
        Step = "step",
        /// See [`SimulatorCommand::Speed`].
        Speed = "speed",
        /// See [`SimulatorCommand::Reset`].
        Reset = "reset",
        /// See [`SimulatorCommand::Add`].
        Add = "add",
        /// See [`SimulatorCommand::Remove`].
        Remove = "remove",
        /// See [`SimulatorCommand::Snapshot`].
        Snapshot = "snapshot",
        /// See [`SimulatorCommand::Restore`].
        Restore = "restore",
        /// See [`SimulatorCommand::Inject`].
        Inject = "inject",
        /// See [`SimulatorCommand::Heal`].
        Heal = "heal",
    }
}

/// Where a robot is put.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// Metres along the x axis, within ±[`MAX_COORDINATE`].
    pub x: f32,
    /// Metres along the y axis, within ±[`MAX_COORDINATE`].
    pub y: f32,
    /// Heading in radians, counter-clockwise from the x axis, within ±[`Place::MAX_THETA`].
    pub theta: f32,
}

impl Place {
    /// Largest heading either way, in radians.
    pub const MAX_THETA: f32 = 7.0;

    fn is_sound(&self) -> bool {
        self.x.abs() <= MAX_COORDINATE
            && self.y.abs() <= MAX_COORDINATE
            && self.theta.abs() <= Self::MAX_THETA
    }
}

/// What a simulated world is told to do.
///
/// On the wire the fields stand beside `command`:
/// `{"command":"inject","robot":"sim-0001","fault":{"fault":"ranger-dead"},"lasting_ms":5000}`.
#[derive(Debug, Clone, PartialEq)]
pub enum SimulatorCommand {
    /// Stand still until `resume`.
    Pause,
    /// Go on.
    Resume,
    /// Make this many physics steps, and stand still again.
    Step {
        /// 1 to [`MAX_STEPS`].
        steps: u32,
    },
    /// Run this many times as fast as real time.
    Speed {
        /// Within [`SPEED_RANGE`].
        factor: f32,
    },
    /// Begin again.
    Reset {
        /// With this seed; with the same as before where there is none.
        seed: Option<u64>,
    },
    /// Put in another robot.
    Add {
        /// There; where the scenario puts robots when there is none.
        pose: Option<Place>,
    },
    /// Take a robot out.
    Remove {
        /// This one.
        robot: RobotId,
    },
    /// Keep the world as it is now.
    Snapshot {
        /// Under this name.
        name: SnapshotName,
    },
    /// Go back to a world that was kept.
    Restore {
        /// Under this name.
        name: SnapshotName,
    },
    /// Put a fault into a robot.
    Inject {
        /// This one.
        robot: RobotId,
        /// What breaks.
        fault: FaultSpec,
        /// For how long, in milliseconds of the world: 1 to [`MAX_LASTING_MS`]; until `heal` where
        /// there is none.
        lasting_ms: Option<u32>,
    },
    /// Mend every fault of a robot.
    Heal {
        /// This one.
        robot: RobotId,
    },
}
wire!(SimulatorCommand);

impl SimulatorCommand {
    /// Which command this is.
    #[must_use]
    pub const fn name(&self) -> SimulatorCommandName {
        match self {
            Self::Pause => SimulatorCommandName::Pause,
            Self::Resume => SimulatorCommandName::Resume,
            Self::Step { .. } => SimulatorCommandName::Step,
            Self::Speed { .. } => SimulatorCommandName::Speed,
            Self::Reset { .. } => SimulatorCommandName::Reset,
            Self::Add { .. } => SimulatorCommandName::Add,
            Self::Remove { .. } => SimulatorCommandName::Remove,
            Self::Snapshot { .. } => SimulatorCommandName::Snapshot,
            Self::Restore { .. } => SimulatorCommandName::Restore,
            Self::Inject { .. } => SimulatorCommandName::Inject,
            Self::Heal { .. } => SimulatorCommandName::Heal,
        }
    }
}

impl SimulatorCommandName {
    /// The fields of this command beside `command`.
    const fn fields(self) -> &'static [&'static str] {
        match self {
            Self::Pause | Self::Resume => &[],
            Self::Step => &["steps"],
            Self::Speed => &["factor"],
            Self::Reset => &["seed"],
            Self::Add => &["pose"],
            Self::Remove | Self::Heal => &["robot"],
            Self::Snapshot | Self::Restore => &["name"],
            Self::Inject => &["robot", "fault", "lasting_ms"],
        }
    }
}

/// A field that is there has a value: `null` is another type.
fn given<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

/// The value of a field that must be there.
fn must<T, E: Error>(value: Option<T>, name: &'static str) -> Result<T, E> {
    value.ok_or_else(|| E::missing_field(name))
}

/// Refuses a field that is there and does not belong.
fn only<const N: usize, E: Error>(
    there: [(&'static str, bool); N],
    allowed: &'static [&'static str],
) -> Result<(), E> {
    match there
        .iter()
        .find(|(name, there)| *there && !allowed.contains(name))
    {
        None => Ok(()),
        Some((name, _)) => Err(E::unknown_field(name, allowed)),
    }
}

/// Every field that a command can have.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    command: SimulatorCommandName,
    #[serde(default, deserialize_with = "given")]
    steps: Option<u32>,
    #[serde(default, deserialize_with = "given")]
    factor: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    seed: Option<u64>,
    #[serde(default, deserialize_with = "given")]
    pose: Option<Place>,
    #[serde(default, deserialize_with = "given")]
    robot: Option<RobotId>,
    #[serde(default, deserialize_with = "given")]
    name: Option<SnapshotName>,
    #[serde(default, deserialize_with = "given")]
    fault: Option<FaultSpec>,
    #[serde(default, deserialize_with = "given")]
    lasting_ms: Option<u32>,
}

impl Fields {
    fn meaning<E: Error>(self) -> Result<SimulatorCommand, E> {
        let there = [
            ("steps", self.steps.is_some()),
            ("factor", self.factor.is_some()),
            ("seed", self.seed.is_some()),
            ("pose", self.pose.is_some()),
            ("robot", self.robot.is_some()),
            ("name", self.name.is_some()),
            ("fault", self.fault.is_some()),
            ("lasting_ms", self.lasting_ms.is_some()),
        ];
        only(there, self.command.fields())?;
        Ok(match self.command {
            SimulatorCommandName::Pause => SimulatorCommand::Pause,
            SimulatorCommandName::Resume => SimulatorCommand::Resume,
            SimulatorCommandName::Step => SimulatorCommand::Step {
                steps: whole(must(self.steps, "steps")?, MAX_STEPS, &"1 to 1000000 steps")?,
            },
            SimulatorCommandName::Speed => {
                let factor = must(self.factor, "factor")?;
                if !(SPEED_RANGE.0..=SPEED_RANGE.1).contains(&factor) {
                    let number = Unexpected::Float(factor.into());
                    return Err(E::invalid_value(number, &"0.01 to 1000"));
                }
                SimulatorCommand::Speed { factor }
            }
            SimulatorCommandName::Reset => SimulatorCommand::Reset { seed: self.seed },
            SimulatorCommandName::Add => {
                if self.pose.is_some_and(|pose| !pose.is_sound()) {
                    let pose = Unexpected::Other("a pose out of range");
                    return Err(E::invalid_value(pose, &"a pose within 10 km and 7 rad"));
                }
                SimulatorCommand::Add { pose: self.pose }
            }
            SimulatorCommandName::Remove => SimulatorCommand::Remove {
                robot: must(self.robot, "robot")?,
            },
            SimulatorCommandName::Heal => SimulatorCommand::Heal {
                robot: must(self.robot, "robot")?,
            },
            SimulatorCommandName::Snapshot => SimulatorCommand::Snapshot {
                name: must(self.name, "name")?,
            },
            SimulatorCommandName::Restore => SimulatorCommand::Restore {
                name: must(self.name, "name")?,
            },
            SimulatorCommandName::Inject => SimulatorCommand::Inject {
                robot: must(self.robot, "robot")?,
                fault: must(self.fault, "fault")?,
                lasting_ms: match self.lasting_ms {
                    None => None,
                    Some(ms) => Some(whole(ms, MAX_LASTING_MS, &"1 ms to a day")?),
                },
            },
        })
    }
}

/// A number from 1 to `most`.
fn whole<E: Error>(value: u32, most: u32, expected: &'static &'static str) -> Result<u32, E> {
    if (1..=most).contains(&value) {
        Ok(value)
    } else {
        let number = Unexpected::Unsigned(value.into());
        Err(E::invalid_value(number, expected))
    }
}

impl<'de> Deserialize<'de> for SimulatorCommand {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Fields::deserialize(deserializer)?.meaning()
    }
}

impl Serialize for SimulatorCommand {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("command", self.name().name())?;
        match self {
            Self::Pause | Self::Resume | Self::Reset { seed: None } | Self::Add { pose: None } => {}
            Self::Step { steps } => map.serialize_entry("steps", steps)?,
            Self::Speed { factor } => map.serialize_entry("factor", factor)?,
            Self::Reset { seed: Some(seed) } => map.serialize_entry("seed", seed)?,
            Self::Add { pose: Some(pose) } => map.serialize_entry("pose", pose)?,
            Self::Remove { robot } | Self::Heal { robot } => map.serialize_entry("robot", robot)?,
            Self::Snapshot { name } | Self::Restore { name } => {
                map.serialize_entry("name", name)?;
            }
            Self::Inject {
                robot,
                fault,
                lasting_ms,
            } => {
                map.serialize_entry("robot", robot)?;
                map.serialize_entry("fault", fault)?;
                if let Some(ms) = lasting_ms {
                    map.serialize_entry("lasting_ms", ms)?;
                }
            }
        }
        map.end()
    }
}
