//! The commands to a simulated world.
//!
//! On the wire the fields of a command stand beside its name, so that it is read in two steps: the
//! fields that are there, each with its type, then what the command makes of them.

use crawler_protocol::{DecodeError, EncodeError, FaultCommand, RobotId, json, words};
use serde::ser::{Serialize, SerializeMap, Serializer};

use crate::{Dropped, Place, ScenarioName, SnapshotName};

/// Most physics steps of one `step`.
pub const MAX_STEPS: u32 = 1_000_000;
/// Slowest and fastest a world can be told to run, as multiples of real time.
pub const SPEED_RANGE: (f32, f32) = (0.01, 1_000.0);
/// Most robots that a scenario is loaded with.
pub const MAX_LOADED: u32 = 65_535;

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
        /// See [`FaultCommand::Inject`].
        Inject = "inject",
        /// See [`FaultCommand::Heal`].
        Heal = "heal",
        /// See [`SimulatorCommand::Load`].
        Load = "load",
        /// See [`SimulatorCommand::Drop`].
        Drop = "drop",
        /// See [`SimulatorCommand::Take`].
        Take = "take",
        /// See [`SimulatorCommand::Forget`].
        Forget = "forget",
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
        /// Under this name; what was kept under it before is gone.
        name: SnapshotName,
    },
    /// Go back to a world that was kept. Programs begin anew there, as after a power cut.
    Restore {
        /// Under this name.
        name: SnapshotName,
    },
    /// Put a fault into a robot, or mend what is broken about it.
    Fault(FaultCommand),
    /// Begin another scenario, one that comes with the simulator.
    Load {
        /// This one.
        scenario: ScenarioName,
        /// With so many robots, 1 to [`MAX_LOADED`]; as many as it says where there is none.
        robots: Option<u32>,
        /// With this seed; with the same as before where there is none.
        seed: Option<u64>,
    },
    /// Put something solid into the running world.
    Drop {
        /// This.
        what: Dropped,
    },
    /// Take away what was dropped.
    Take {
        /// Its number, as the answer to `drop` told it.
        item: u32,
    },
    /// Keep a world no longer.
    Forget {
        /// The one of this name.
        name: SnapshotName,
    },
}

impl From<FaultCommand> for SimulatorCommand {
    fn from(fault: FaultCommand) -> Self {
        Self::Fault(fault)
    }
}

impl SimulatorCommand {
    /// Writes the message as JSON to the front of `buf` and returns its length.
    ///
    /// # Errors
    /// [`EncodeError::TooLarge`] when it does not fit `buf` or
    /// [`MAX_MESSAGE`](crawler_protocol::MAX_MESSAGE); [`EncodeError::NotFinite`] when a number that must
    /// be there is not one.
    pub fn to_json(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        json::to_slice(self, buf)
    }

    /// Reads the message from the whole of `payload`.
    ///
    /// # Errors
    /// [`DecodeError`] names what is wrong with `payload`.
    pub fn from_json(payload: &[u8]) -> Result<Self, DecodeError> {
        json::from_slice(payload)
    }

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
            Self::Fault(FaultCommand::Inject { .. }) => SimulatorCommandName::Inject,
            Self::Fault(FaultCommand::Heal { .. }) => SimulatorCommandName::Heal,
            Self::Load { .. } => SimulatorCommandName::Load,
            Self::Drop { .. } => SimulatorCommandName::Drop,
            Self::Take { .. } => SimulatorCommandName::Take,
            Self::Forget { .. } => SimulatorCommandName::Forget,
        }
    }
}

impl SimulatorCommandName {
    /// The fields of this command beside `command`.
    pub(crate) const fn fields(self) -> &'static [&'static str] {
        match self {
            Self::Pause | Self::Resume => &[],
            Self::Step => &["steps"],
            Self::Speed => &["factor"],
            Self::Reset => &["seed"],
            Self::Add => &["pose"],
            Self::Remove | Self::Heal => &["robot"],
            Self::Snapshot | Self::Restore | Self::Forget => &["name"],
            Self::Inject => &["robot", "fault", "lasting_ms"],
            Self::Load => &["scenario", "robots", "seed"],
            Self::Drop => &["obstacle", "object"],
            Self::Take => &["item"],
        }
    }
}

impl Serialize for SimulatorCommand {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if let Self::Fault(fault) = self {
            return fault.serialize(serializer);
        }
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("command", self.name().name())?;
        match self {
            Self::Fault(_)
            | Self::Pause
            | Self::Resume
            | Self::Reset { seed: None }
            | Self::Add { pose: None } => {}
            Self::Step { steps } => map.serialize_entry("steps", steps)?,
            Self::Speed { factor } => map.serialize_entry("factor", factor)?,
            Self::Reset { seed: Some(seed) } => map.serialize_entry("seed", seed)?,
            Self::Add { pose: Some(pose) } => map.serialize_entry("pose", pose)?,
            Self::Remove { robot } => map.serialize_entry("robot", robot)?,
            Self::Snapshot { name } | Self::Restore { name } | Self::Forget { name } => {
                map.serialize_entry("name", name)?;
            }
            Self::Load {
                scenario,
                robots,
                seed,
            } => {
                map.serialize_entry("scenario", scenario)?;
                if let Some(robots) = robots {
                    map.serialize_entry("robots", robots)?;
                }
                if let Some(seed) = seed {
                    map.serialize_entry("seed", seed)?;
                }
            }
            Self::Drop { what } => match what {
                Dropped::Obstacle(obstacle) => map.serialize_entry("obstacle", obstacle)?,
                Dropped::Object(object) => map.serialize_entry("object", object)?,
            },
            Self::Take { item } => map.serialize_entry("item", item)?,
        }
        map.end()
    }
}
