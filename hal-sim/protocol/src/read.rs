//! Reading commands in two steps: the fields that are there, then what they mean.

use serde::de::{Deserialize, Deserializer, Error, Unexpected};

use crate::command::{MAX_LOADED, MAX_STEPS, SPEED_RANGE, SimulatorCommand, SimulatorCommandName};
use crate::place::Place;
use crate::thing::{Dropped, Solid};
use crate::{ScenarioName, SnapshotName};
use crawler_protocol::fields::{given, must, only, whole};
use crawler_protocol::{FaultCommand, FaultSpec, MAX_LASTING_MS, RobotId};

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
    #[serde(default, deserialize_with = "given")]
    scenario: Option<ScenarioName>,
    #[serde(default, deserialize_with = "given")]
    robots: Option<u32>,
    #[serde(default, deserialize_with = "given")]
    obstacle: Option<Solid>,
    #[serde(default, deserialize_with = "given")]
    object: Option<Solid>,
    #[serde(default, deserialize_with = "given")]
    item: Option<u32>,
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
            ("scenario", self.scenario.is_some()),
            ("robots", self.robots.is_some()),
            ("obstacle", self.obstacle.is_some()),
            ("object", self.object.is_some()),
            ("item", self.item.is_some()),
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
            SimulatorCommandName::Heal => FaultCommand::Heal {
                robot: must(self.robot, "robot")?,
            }
            .into(),
            SimulatorCommandName::Snapshot => SimulatorCommand::Snapshot {
                name: must(self.name, "name")?,
            },
            SimulatorCommandName::Restore => SimulatorCommand::Restore {
                name: must(self.name, "name")?,
            },
            SimulatorCommandName::Inject => FaultCommand::Inject {
                robot: must(self.robot, "robot")?,
                fault: must(self.fault, "fault")?,
                lasting_ms: match self.lasting_ms {
                    None => None,
                    Some(ms) => Some(whole(ms, MAX_LASTING_MS, &"1 ms to a day")?),
                },
            }
            .into(),
            SimulatorCommandName::Load => SimulatorCommand::Load {
                scenario: must(self.scenario, "scenario")?,
                robots: match self.robots {
                    None => None,
                    Some(robots) => Some(whole(robots, MAX_LOADED, &"1 to 65535 robots")?),
                },
                seed: self.seed,
            },
            SimulatorCommandName::Drop => SimulatorCommand::Drop {
                what: match (self.obstacle, self.object) {
                    (Some(solid), None) => Dropped::Obstacle(solid.obstacle()?),
                    (None, Some(solid)) => Dropped::Object(solid.object()?),
                    (None, None) => return Err(E::missing_field("obstacle")),
                    (Some(_), Some(_)) => return Err(E::unknown_field("object", &["obstacle"])),
                },
            },
            SimulatorCommandName::Take => SimulatorCommand::Take {
                item: must(self.item, "item")?,
            },
            SimulatorCommandName::Forget => SimulatorCommand::Forget {
                name: must(self.name, "name")?,
            },
        })
    }
}

impl<'de> Deserialize<'de> for SimulatorCommand {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Fields::deserialize(deserializer)?.meaning()
    }
}
