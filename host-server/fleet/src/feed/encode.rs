//! The frames: one byte of kind, then JSON or packed little-endian numbers.

use std::collections::BTreeMap;

use bytes::Bytes;
use crawler_protocol::open::Open;
use crawler_protocol::{Fleet, Kind, RobotState};
use serde_json::{Value, json};

use super::Numbers;
use crate::{Event, FleetState, Presence, Robot};

const HELLO: u8 = 0;
const ROSTER: u8 = 1;
const POSES: u8 = 2;
const EVENT: u8 = 3;
const METRICS: u8 = 4;

/// Version of the frames.
const PROTOCOL: u8 = 2;
/// Bytes of a frame of poses before its indices.
const POSES_HEADER: usize = 20;
/// Bytes that a robot takes beside its index.
const POSE: usize = 8;
const FULL: u8 = 1;
/// Indices are told as a bitmap.
const BITMAP: u8 = 2;
/// Steps of a heading to the turn; finer than anybody can see.
const HEADINGS: f32 = 4_096.0;
/// Told where there is no reading of the range sensor.
const NO_RANGE: u16 = 0x3fff;
/// Positions are told to the millimetre as long as the fleet is within 65 m.
const FINEST_M: f32 = 0.001;
const LOW_BATTERY_PERCENT: u8 = 20;

/// What the feed tells of a robot ten times a second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    /// Millimetres, as fine as they are told.
    x_mm: i32,
    y_mm: i32,
    /// Bits 0–11 heading, 12–14 state, 15 battery low.
    course: u16,
    /// Bits 0–13 range in millimetres or [`NO_RANGE`], 14–15 presence.
    reach: u16,
}

impl Sample {
    /// `None` while there is nothing to tell: no position yet, or no roster line to go with it.
    pub(super) fn of(robot: &Robot) -> Option<Self> {
        let telemetry = robot.telemetry.as_ref()?;
        robot.status.as_ref()?;
        let presence = match robot.presence {
            Presence::Online => 0,
            Presence::Stale => 1,
            Presence::Offline => 2,
        };
        let low = telemetry.battery.percent < LOW_BATTERY_PERCENT;
        let turns = telemetry.pose.theta / std::f32::consts::TAU;
        // A turn that rounds up to a whole one is none.
        let heading = ((turns - turns.floor()) * HEADINGS).round() as u16 & 0x0fff;
        let state = state_code(robot.state().unwrap_or(telemetry.state));
        let range = telemetry
            .range_mm
            .map_or(NO_RANGE, |mm| mm.min(NO_RANGE - 1));
        Some(Self {
            x_mm: (telemetry.pose.x * 1000.0).round() as i32,
            y_mm: (telemetry.pose.y * 1000.0).round() as i32,
            course: heading | state << 12 | u16::from(low) << 15,
            reach: range | presence << 14,
        })
    }
}

/// Three bits have room for the states that are known; one that only a newer robot knows is drawn as an
/// error, so that somebody looks. The API has its name.
fn state_code(state: Open<RobotState>) -> u16 {
    match state.known().unwrap_or(RobotState::Error) {
        RobotState::Initializing => 0,
        RobotState::Idle => 1,
        RobotState::Moving => 2,
        RobotState::Scanning => 3,
        RobotState::Caution => 4,
        RobotState::Avoiding => 5,
        RobotState::Updating => 6,
        RobotState::Error => 7,
    }
}

/// What is drawn of a kind: one that only a newer robot has is one that somebody may trip over. The API has
/// its name.
pub fn drawn_kind(kind: Open<Kind>) -> Kind {
    kind.known().unwrap_or(Kind::Physical)
}

fn json_frame(kind: u8, value: &Value) -> Bytes {
    let mut frame = vec![kind];
    // A Value has string keys and no failing parts; writing to memory does not fail either.
    if let Err(error) = serde_json::to_writer(&mut frame, value) {
        tracing::error!(%error, kind, "a frame cannot be written");
    }
    frame.into()
}

pub(super) fn hello(fleet: &Fleet, time: u64, arena: &Value) -> Bytes {
    json_frame(
        HELLO,
        &json!({"protocol": PROTOCOL, "fleet": fleet.as_str(), "time": time, "arena": arena}),
    )
}

/// Robots whose status nobody has seen have no line: what they are is not known.
pub(super) fn roster<'a>(
    fleet: &FleetState,
    robots: impl Iterator<Item = &'a Robot>,
    removed: &[u16],
) -> Bytes {
    let lines: Vec<_> = robots
        .filter_map(|robot| {
            let status = robot.status.as_ref()?;
            let mut line = json!({
                "index": robot.index,
                "id": robot.id.as_str(),
                "kind": drawn_kind(status.kind).name(),
                "online": robot.presence.name(),
                "firmware": status.firmware.as_str(),
                "board": status.board.as_str(),
            });
            // Few are on the wrong side of one.
            if let Some(fence) = fleet.fence_of(robot) {
                line["fence"] = json!(fence.name);
            }
            Some(line)
        })
        .collect();
    json_frame(ROSTER, &json!({"robots": lines, "removed": removed}))
}

pub(super) fn poses(full: bool, unix_ms: u64, samples: &[(u16, Sample)]) -> Bytes {
    // The largest fleet is below 65,536; a longer list would be a mistake above.
    let count = samples.len().min(usize::from(u16::MAX));
    let samples = samples.get(..count).unwrap_or_default();
    let bounds = |value: fn(&Sample) -> i32| {
        let values = samples.iter().map(|(_, sample)| value(sample));
        let low = values.clone().min().unwrap_or(0);
        let high = values.max().unwrap_or(0);
        (low, i64::from(high) - i64::from(low))
    };
    let (x0, width) = bounds(|sample| sample.x_mm);
    let (y0, height) = bounds(|sample| sample.y_mm);
    // Millimetres per unit; 1 unless the robots are further apart than 16 bits of them.
    let unit = (width.max(height) as f32 / f32::from(u16::MAX)).max(1.0);
    let scaled =
        |value: i32, from: i32| ((i64::from(value) - i64::from(from)) as f32 / unit).round() as u16;

    let (bitmap, indices) = told_indices(samples);
    let mut frame = Vec::with_capacity(POSES_HEADER + indices.len() + POSE * count);
    frame.push(POSES);
    frame.push(if full { FULL } else { 0 } | if bitmap { BITMAP } else { 0 });
    frame.extend((count as u16).to_le_bytes());
    frame.extend((unix_ms as u32).to_le_bytes());
    frame.extend((x0 as f32 * FINEST_M).to_le_bytes());
    frame.extend((y0 as f32 * FINEST_M).to_le_bytes());
    frame.extend((unit * FINEST_M).to_le_bytes());
    frame.extend(indices);
    for (_, sample) in samples {
        frame.extend(scaled(sample.x_mm, x0).to_le_bytes());
        frame.extend(scaled(sample.y_mm, y0).to_le_bytes());
        frame.extend(sample.course.to_le_bytes());
        frame.extend(sample.reach.to_le_bytes());
    }
    frame.into()
}

/// Which robots the poses are of, and whether it is told as a bitmap: the shorter of two bytes for
/// each, and a bit for each index from the first to the last.
fn told_indices(samples: &[(u16, Sample)]) -> (bool, Vec<u8>) {
    let listed = || {
        let indices = samples.iter().flat_map(|(index, _)| index.to_le_bytes());
        (false, indices.collect())
    };
    let (Some((first, _)), Some((last, _))) = (samples.first(), samples.last()) else {
        return listed();
    };
    let ascending = samples
        .windows(2)
        .all(|pair| matches!(pair, [(a, _), (b, _)] if a < b));
    if !ascending {
        return listed();
    }
    let length = usize::from(last - first) / 8 + 1;
    if 4 + length >= 2 * samples.len() {
        return listed();
    }
    let mut bitmap = vec![0_u8; length];
    for (index, _) in samples {
        let bit = usize::from(index - first);
        if let Some(byte) = bitmap.get_mut(bit / 8) {
            *byte |= 1 << (bit % 8);
        }
    }
    let mut told = Vec::with_capacity(4 + length);
    told.extend(first.to_le_bytes());
    // At most 8,192, since indices have 16 bits.
    told.extend((length as u16).to_le_bytes());
    told.extend(bitmap);
    (true, told)
}

pub(super) fn event(event: &Event) -> Option<Bytes> {
    match serde_json::to_value(event) {
        Ok(value) => Some(json_frame(EVENT, &value)),
        Err(error) => {
            tracing::error!(%error, "an event cannot be written");
            None
        }
    }
}

pub(super) fn metrics(fleet: &FleetState, messages_per_s: f64, numbers: &Numbers) -> Bytes {
    let presences = fleet.presences();
    let mut states = BTreeMap::new();
    for robot in fleet.robots() {
        if robot.presence == Presence::Online
            && let Some(state) = robot.state()
        {
            // Robots may make up as many words as they like; they are one here.
            let name = state.known().map_or("unknown", RobotState::name);
            *states.entry(name).or_insert(0_u32) += 1;
        }
    }
    json_frame(
        METRICS,
        &json!({
            "robots": {
                "online": presences.online,
                "stale": presences.stale,
                "offline": presences.offline,
            },
            "states": states,
            "messages_per_s": (messages_per_s * 10.0).round() / 10.0,
            "commands": {"sent": numbers.commands.sent, "answered": numbers.commands.answered},
            "real_time_factor": numbers.real_time_factor.filter(|factor| factor.is_finite()),
        }),
    )
}
