//! What a robot published of a drive, and what its tracker told it, from a recording.
//!
//! The truth that recordings of simulated robots have beside it is not looked at.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use crawler_protocol::open::StatusMessage;
use crawler_protocol::{PoseFix, TelemetryEncoding, open};
use crawler_sim::scenario::Scenario;
use crawler_sim::tools::replay::{Message, messages};
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_twin::around::{Robots, Room};
use crawler_twin::evidence::{Duty, Evidence, Fix, Row, Supply};

use super::told;
use crate::room::room;

/// A drive.
pub(super) struct Recorded {
    pub(super) robot: String,
    pub(super) build: String,
    /// In the order in which they came.
    pub(super) rows: Vec<Row>,
    /// Of each fix among them, whether the robot may have touched something there.
    pub(super) near: Vec<bool>,
}

impl Recorded {
    /// All of it; what is refused is counted there.
    pub(super) fn evidence(&self) -> Evidence {
        let mut evidence = Evidence::default();
        for row in &self.rows {
            let _ = evidence.take(*row);
        }
        evidence
    }
}

/// What one boot of a robot said.
#[derive(Default)]
struct Boot {
    rows: Vec<Row>,
    /// Of each fix, where it is, and whether another robot was beside it.
    beside: Vec<([f64; 2], bool)>,
    build: String,
    /// Unix milliseconds that its seconds count from.
    base_ms: Option<u64>,
    samples: usize,
    /// Telemetry repeats a voltage until there is another one.
    battery_mv: u16,
}

/// Reads the drive of a robot; that of its boot with most telemetry.
pub(super) fn read(path: &Path, robot: Option<&str>) -> Result<Recorded, CliError> {
    let file = File::open(path).or_say(|error| told(path, error))?;
    let mut boots: BTreeMap<String, BTreeMap<u32, Boot>> = BTreeMap::new();
    let mut places = Robots::default();
    let words = messages(BufReader::new(file), |message| {
        let seen = pose(&message);
        let at = seen.map(|fix| [fix.pose.x, fix.pose.y].map(f64::from));
        let at_s = message.at_us as f64 * 1e-6;
        if let Some(at) = at {
            places.see(&message.robot, at, at_s);
        }
        if robot.is_none_or(|robot| robot == message.robot) {
            let boots = boots.entry(message.robot.clone()).or_default();
            let boot = boots.entry(message.boot).or_default();
            boot.take(&message);
            if let Some(at) = at {
                let is_beside = places.is_near(&message.robot, at, at_s);
                boot.beside.push((at, is_beside));
            }
        }
    })
    .or_say(|error| told(path, error))?;
    let room = room_of(&words);
    if boots.len() > 1 {
        let names: Vec<&str> = boots.keys().take(5).map(String::as_str).collect();
        let text = format!(
            "there are several robots in it, like {}: say --robot",
            names.join(", ")
        );
        return Err(CliError::new(told(path, text)));
    }
    let (robot, boots) = boots
        .pop_first()
        .ok_or_else(|| CliError::new(told(path, "no such robot is in it")))?;
    let boot = boots.into_values().max_by_key(|boot| boot.samples);
    let boot = boot.filter(|boot| boot.samples > 0);
    let boot = boot.ok_or_else(|| CliError::new(told(path, "the robot told nothing of itself")))?;
    Ok(Recorded {
        robot,
        build: boot.build,
        rows: boot.rows,
        near: boot
            .beside
            .into_iter()
            .map(|(at, is_beside)| is_beside || room.as_ref().is_some_and(|room| room.is_near(at)))
            .collect(),
    })
}

/// Where a tracker saw the robot, by a message that reached it.
fn pose(message: &Message) -> Option<PoseFix> {
    let kind = message.topic.split('/').nth(1);
    let is_one = message.delivered && kind == Some("pose");
    is_one
        .then(|| PoseFix::from_json(message.payload.bytes()).ok())
        .flatten()
}

/// The room of the scenario that was recorded, as it was in the beginning.
fn room_of(words: &BTreeMap<String, String>) -> Option<Room> {
    let scenario = Scenario::parse(words.get("scenario")?).ok()?;
    let seed = words.get("seed")?.parse().ok()?;
    scenario.arena(seed).ok().map(|arena| room(&arena))
}

impl Boot {
    /// What cannot be read is not of this drive.
    fn take(&mut self, message: &Message) {
        let kind = message.topic.split('/').nth(1).unwrap_or_default();
        let payload = message.payload.bytes();
        let arrived_s = Some(message.at_us as f64 * 1e-6);
        match (message.delivered, kind) {
            (false, "telemetry") => {
                let encoding = match payload.first() {
                    Some(b'{') => TelemetryEncoding::Json,
                    Some(0x1e) => TelemetryEncoding::JsonSeq,
                    _ => TelemetryEncoding::CborSeq,
                };
                for sample in encoding.open_samples(payload).map_while(Result::ok) {
                    let sample = sample.message;
                    // Before its clock is set a robot has no time to tell.
                    if sample.timestamp == 0 {
                        continue;
                    }
                    self.samples += 1;
                    let at_s = self.seconds(sample.timestamp);
                    let duty = [
                        f64::from(sample.wheels.left),
                        f64::from(sample.wheels.right),
                    ];
                    self.rows.push(Row::Duty(Duty {
                        at_s,
                        arrived_s,
                        duty,
                    }));
                    let mv = sample.battery.mv;
                    if mv != 0 && mv != self.battery_mv {
                        self.battery_mv = mv;
                        let volts = f64::from(mv) * 1e-3;
                        self.rows.push(Row::Supply(Supply {
                            at_s,
                            arrived_s,
                            volts,
                        }));
                    }
                }
            }
            (true, "pose") => {
                let Some(fix) = pose(message) else {
                    return;
                };
                let fix = Fix {
                    at_s: self.seconds(fix.timestamp),
                    arrived_s,
                    x: f64::from(fix.pose.x),
                    y: f64::from(fix.pose.y),
                    theta: f64::from(fix.pose.theta),
                    sigma_m: f64::from(fix.pose.sigma),
                };
                self.rows.push(Row::Fix(fix));
            }
            (false, "status") => {
                if let Ok(status) = open::read::<StatusMessage>(payload)
                    && status.message.online
                {
                    let status = status.message;
                    status.firmware.as_str().clone_into(&mut self.build);
                }
            }
            _ => {}
        }
    }

    fn seconds(&mut self, unix_ms: u64) -> f64 {
        let base_ms = *self.base_ms.get_or_insert(unix_ms);
        (i128::from(unix_ms) - i128::from(base_ms)) as f64 * 1e-3
    }
}
