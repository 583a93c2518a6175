//! Taking in messages: topic, size, meaning, in this order, and nothing gets further that fails one.

use std::fmt;
use std::time::{Duration, Instant};

use crawler_protocol::open::{
    self, Heartbeat, LogRecord, Open, Read, Response, StatusMessage, Telemetry, Unknown,
};
use crawler_protocol::{
    Detection, Detections, MAX_IMAGE, MAX_MESSAGE, MapSegment, ParametersMessage, PoseFix, RobotId,
    TelemetryEncoding, Topic, TopicError,
};

use super::Incoming;
use super::images::Image;
use super::{FleetState, Level, MAX_ROBOTS, Received};
use crawler_system::clock;

/// Positions beyond this are no positions. A coordinate in `f32` is good to 6 cm there.
const FARTHEST_M: f32 = 1.0e6;
/// A message that comes by way of another server is this much later at most.
const OVERTAKEN_MS: u64 = 5_000;
/// One line per cause and interval tells of rejected messages.
const REPORT_EVERY: Duration = Duration::from_secs(5);

/// Why a message was not accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rejection {
    /// The topic is not UTF-8 or none of the contract's.
    Topic,
    /// What should be a robot id in the topic is none.
    RobotId,
    /// Longer than a message may be.
    TooLarge,
    /// Not the message that belongs on this topic.
    Malformed,
    /// It says another robot's id than its topic.
    Mismatch,
    /// Its content type is none that belongs on this topic.
    ContentType,
    /// A number no robot can mean.
    Absurd,
    /// The fleet is full.
    Full,
}

impl Rejection {
    const ALL: [Self; 8] = [
        Self::Topic,
        Self::RobotId,
        Self::TooLarge,
        Self::Malformed,
        Self::Mismatch,
        Self::ContentType,
        Self::Absurd,
        Self::Full,
    ];

    /// The name in metrics.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Topic => "topic",
            Self::RobotId => "robot_id",
            Self::TooLarge => "too_large",
            Self::Malformed => "malformed",
            Self::Mismatch => "mismatch",
            Self::ContentType => "content_type",
            Self::Absurd => "absurd",
            Self::Full => "full",
        }
    }
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Topic => "a topic outside the contract",
            Self::RobotId => "a topic with something that is no robot id",
            Self::TooLarge => "larger than a message may be",
            Self::Malformed => "not the message that belongs on its topic",
            Self::Mismatch => "names another robot than its topic",
            Self::ContentType => "written in a way that is not known",
            Self::Absurd => "numbers that cannot be meant",
            Self::Full => "from a robot beyond the largest fleet",
        })
    }
}

/// Says that messages are being rejected, without saying it for each of them.
#[derive(Debug, Default)]
pub(super) struct RejectionLog {
    lines: [(Option<Instant>, u64); Rejection::ALL.len()],
}

impl RejectionLog {
    /// Counts one; returns how many to report now, if now is a time to report.
    fn count(&mut self, rejection: Rejection, now: Instant) -> Option<u64> {
        let (reported, count) = self.lines.get_mut(rejection as usize)?;
        *count += 1;
        if reported.is_some_and(|at| now.saturating_duration_since(at) < REPORT_EVERY) {
            return None;
        }
        *reported = Some(now);
        Some(std::mem::take(count))
    }
}

impl FleetState {
    /// Takes in one message.
    ///
    /// # Errors
    /// [`Rejection`]; nothing has changed then but the count of rejections.
    pub fn receive(
        &mut self,
        message: &Incoming<'_>,
        now: Instant,
    ) -> Result<(Topic, Received), Rejection> {
        self.fences.forget_crossings();
        self.unknown = Unknown::default();
        let result = self.accept(message, now);
        if let Err(rejection) = result
            && let Some(count) = self.rejected.count(rejection, now)
        {
            // What an attacker writes goes into the log escaped and cut short.
            let shown: String = String::from_utf8_lossy(message.topic)
                .chars()
                .take(80)
                .collect();
            tracing::warn!(topic = ?shown, count, "ignored messages: {rejection}");
            let text = match count {
                1 => format!("ignored a message: {rejection}"),
                _ => format!("ignored {count} messages: {rejection}"),
            };
            self.events.push(Level::Warn, None, text);
        }
        result
    }

    fn accept(
        &mut self,
        incoming: &Incoming<'_>,
        now: Instant,
    ) -> Result<(Topic, Received), Rejection> {
        let Incoming {
            payload, retained, ..
        } = *incoming;
        let text = std::str::from_utf8(incoming.topic).map_err(|_| Rejection::Topic)?;
        let topic = Topic::parse(&self.fleet, text).map_err(|error| match error {
            TopicError::Robot => Rejection::RobotId,
            _ => Rejection::Topic,
        })?;
        let most = match topic {
            Topic::Image(_) => MAX_IMAGE,
            _ => MAX_MESSAGE,
        };
        if payload.len() > most {
            return Err(Rejection::TooLarge);
        }
        let mut unknown = Unknown::default();
        let received = match &topic {
            Topic::Status(id) if payload.is_empty() => {
                // MQTT's way to clear a retained message: somebody takes the robot off the books.
                self.remove(id);
                Received::Noted
            }
            Topic::Status(id) => {
                let message = decode::<StatusMessage>(payload, &mut unknown)?;
                same(id, &message.robot)?;
                self.status(id, message, retained, now)?;
                Received::Noted
            }
            Topic::Heartbeat(id) => {
                let message = decode::<Heartbeat>(payload, &mut unknown)?;
                same(id, &message.robot)?;
                self.heartbeat(id, message, now)?;
                Received::Noted
            }
            Topic::Telemetry(id) => {
                let (earlier, newest) = samples(id, incoming, &mut unknown)?;
                let relayed = self.relayed;
                let robot = self.entry(id, now).ok_or(Rejection::Full)?;
                let last = robot.telemetry.as_ref().map(|last| last.timestamp);
                let overtaken = relayed && was_overtaken(newest.timestamp, last);
                let newest = if overtaken {
                    Some(Box::new(newest))
                } else {
                    robot.telemetry = Some(newest);
                    None
                };
                self.spoke(id, now);
                if !overtaken && !retained {
                    self.check_fences(id, &earlier);
                }
                Received::Telemetry {
                    earlier,
                    overtaken: newest,
                }
            }
            Topic::Vision(id) => {
                let message = decode::<Detections>(payload, &mut unknown)?;
                same(id, &message.robot)?;
                // The reader knows numbers, not which of them a picture and a turn can have.
                let within = |object: &Detection| {
                    (0.0..=1.0).contains(&object.x)
                        && (0.0..=1.0).contains(&object.y)
                        && object.bearing.abs() <= core::f32::consts::PI
                };
                if !message.objects.iter().all(within) {
                    return Err(Rejection::Absurd);
                }
                let relayed = self.relayed;
                let robot = self.entry(id, now).ok_or(Rejection::Full)?;
                let last = robot.sees.as_ref().map(|last| last.timestamp);
                if !(relayed && was_overtaken(message.timestamp, last)) {
                    robot.sees = Some(Box::new(message));
                }
                self.spoke(id, now);
                Received::Noted
            }
            Topic::Map(id) => {
                let message = decode::<MapSegment>(payload, &mut unknown)?;
                same(id, &message.robot)?;
                // The reader knows numbers, not which of them fit each other.
                let points = [message.goal, message.next].into_iter().flatten().flatten();
                if !message.is_consistent() || points.into_iter().any(is_too_far) {
                    return Err(Rejection::Absurd);
                }
                self.spoke(id, now);
                Received::Map(Box::new(message))
            }
            Topic::Pose(id) => {
                let fix = PoseFix::from_json(payload).map_err(|_| Rejection::Malformed)?;
                same(id, &fix.robot)?;
                if is_too_far(fix.pose.x) || is_too_far(fix.pose.y) {
                    return Err(Rejection::Absurd);
                }
                // A tracker says nothing of whether a robot is there, and makes none known.
                if self.indices.contains_key(id) && !retained {
                    Received::Fix(Box::new(fix))
                } else {
                    Received::Noted
                }
            }
            Topic::Parameters(_) if payload.is_empty() => Received::Noted,
            Topic::Parameters(id) => {
                let message = decode::<ParametersMessage>(payload, &mut unknown)?;
                same(id, &message.robot)?;
                let robot = self.entry(id, now).ok_or(Rejection::Full)?;
                robot.parameters = Some(Box::new(message));
                Received::Noted
            }
            Topic::Logs(id) => {
                let message = decode::<LogRecord>(payload, &mut unknown)?;
                same(id, &message.robot)?;
                self.log(id, message, now)?;
                Received::Noted
            }
            Topic::Response(id) => {
                let message = decode::<Response>(payload, &mut unknown)?;
                same(id, &message.robot)?;
                Received::Response(message)
            }
            Topic::Image(id) => {
                let image = Image::read(incoming, clock::unix_ms()).ok_or(Rejection::Malformed)?;
                self.entry(id, now).ok_or(Rejection::Full)?;
                self.images.insert(id.clone(), image);
                Received::Noted
            }
            // The server subscribes to none of these; a broker that sends them anyway is wrong.
            Topic::CommandSwarm
            | Topic::CommandRobot(_)
            | Topic::CommandExperiment
            | Topic::ResponseSwarm
            | Topic::Cell { .. }
            | Topic::Time
            | Topic::Ota(_)
            | Topic::SimulatorCommand
            | Topic::SimulatorExperiment => return Err(Rejection::Topic),
        };
        self.note_unknown(&topic, unknown);
        Ok((topic, received))
    }

    /// Counts what of an accepted message was not known.
    fn note_unknown(&mut self, topic: &Topic, unknown: Unknown) {
        if unknown.is_none() {
            return;
        }
        self.unknown.add(unknown);
        let index = topic.robot().and_then(|id| self.indices.get(id)).copied();
        let robot = index.and_then(|index| self.slots.get_mut(usize::from(index))?.as_mut());
        if let Some(robot) = robot {
            robot.unknown.count(unknown);
        }
    }

    fn status(
        &mut self,
        id: &RobotId,
        message: StatusMessage,
        retained: bool,
        now: Instant,
    ) -> Result<(), Rejection> {
        let robot = self.entry(id, now).ok_or(Rejection::Full)?;
        let online = message.online;
        robot.introduce(message);
        let index = robot.index;
        if !online {
            robot.gone();
        }
        self.changed.insert(index);
        // A retained status tells what was, not that the robot is there now.
        if online && !retained {
            self.spoke(id, now);
        } else {
            self.judge(id, now);
        }
        Ok(())
    }

    fn heartbeat(
        &mut self,
        id: &RobotId,
        message: Heartbeat,
        now: Instant,
    ) -> Result<(), Rejection> {
        let relayed = self.relayed;
        let robot = self.entry(id, now).ok_or(Rejection::Full)?;
        let index = robot.index;
        let last = robot.heartbeat.as_ref().map(|last| last.uptime_ms);
        if relayed && was_overtaken(message.uptime_ms, last) {
            self.spoke(id, now);
            return Ok(());
        }
        if robot.beat(message, now) {
            self.changed.insert(index);
            tracing::error!(robot = %id, "two robots use this id, or it restarts all the time");
            self.events.heard(
                Level::Error,
                Some(id.clone()),
                "two robots use this id, or it restarts all the time".into(),
            );
        }
        self.spoke(id, now);
        Ok(())
    }

    fn log(&mut self, id: &RobotId, message: LogRecord, now: Instant) -> Result<(), Rejection> {
        use crawler_protocol::Level as Severity;
        let keep = self.logs_per_robot();
        let level = match message.level {
            Open::Known(Severity::Error) => Some(Level::Error),
            // What a newer robot ranks in another way is shown rather than passed over.
            Open::Known(Severity::Warn) | Open::Unknown(_) => Some(Level::Warn),
            Open::Known(Severity::Info | Severity::Debug) => None,
        };
        let text = level.map(|_| format!("{}: {}", message.event, message.text));
        let robot = self.entry(id, now).ok_or(Rejection::Full)?;
        robot.log(message, keep);
        if let (Some(level), Some(text)) = (level, text) {
            self.events.heard(level, Some(id.clone()), text);
        }
        Ok(())
    }

    /// Notes a live word of the robot, and that it is online at once rather than at the next sweep.
    fn spoke(&mut self, id: &RobotId, now: Instant) {
        if let Some(robot) = self.entry(id, now) {
            robot.seen(now, clock::unix_ms());
        }
        self.judge(id, now);
    }

    /// Recomputes one robot's presence. Changes for the worse, and robots coming online, are told
    /// by the next sweep, which can gather many of them into one event.
    fn judge(&mut self, id: &RobotId, now: Instant) {
        let Some(robot) = self.entry(id, now) else {
            return;
        };
        let presence = robot.presence_at(now);
        if presence != robot.presence {
            robot.presence = presence;
            let index = robot.index;
            self.changed.insert(index);
            // Emptied ten times a second; a flood between two sweeps is told in part.
            if self.moved.len() < MAX_ROBOTS {
                self.moved.push((id.clone(), presence));
            }
        }
    }
}

/// The samples of a message of telemetry: those before the newest, oldest first, and the newest. All
/// of them are good, or none is taken.
fn samples(
    id: &RobotId,
    message: &Incoming<'_>,
    unknown: &mut Unknown,
) -> Result<(Vec<Telemetry>, Telemetry), Rejection> {
    let encoding = TelemetryEncoding::of(message.content_type).ok_or(Rejection::ContentType)?;
    let mut earlier = Vec::new();
    let mut newest = None;
    for sample in encoding.open_samples(message.payload) {
        let sample = taken(sample, unknown)?;
        same(id, &sample.robot)?;
        let pose = &sample.pose;
        if is_too_far(pose.x) || is_too_far(pose.y) {
            return Err(Rejection::Absurd);
        }
        earlier.extend(newest.replace(sample));
    }
    newest
        .map(|newest| (earlier, newest))
        .ok_or(Rejection::Malformed)
}

/// Whether no robot can be there, or go there.
fn is_too_far(along: f32) -> bool {
    along.is_nan() || along.abs() > FARTHEST_M
}

/// Whether a message of the time `this` is older than one of the time `last` that has come already,
/// in milliseconds of the robot. A robot that has started anew, or whose clock was set, is further
/// behind than messages can overtake each other.
fn was_overtaken(this: u64, last: Option<u64>) -> bool {
    last.is_some_and(|last| this < last && last - this < OVERTAKEN_MS)
}

/// Reads a message of a robot that may be newer than this server.
fn decode<T: open::Report>(payload: &[u8], unknown: &mut Unknown) -> Result<T, Rejection> {
    taken(open::read(payload), unknown)
}

fn taken<T, E>(result: Result<Read<T>, E>, unknown: &mut Unknown) -> Result<T, Rejection> {
    let read = result.map_err(|_| Rejection::Malformed)?;
    unknown.add(read.unknown);
    Ok(read.message)
}

fn same(topic: &RobotId, message: &RobotId) -> Result<(), Rejection> {
    if topic == message {
        Ok(())
    } else {
        Err(Rejection::Mismatch)
    }
}
