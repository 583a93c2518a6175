//! The robot's own messages, composed from the shared context.
//!
//! Each function but [`telemetry()`] writes JSON to the front of `buf` and returns its length; `None`
//! when the message cannot be written, which the caller reports.

use crawler_hal::{Instant, ResetCause};
use crawler_protocol::{
    Battery, Boot, BootCause, Capability, Detection, Detections, EncodeError, Heartbeat, LogRecord,
    MAX_MAP_BYTES, MAX_WAY, MapSegment, Models, PROTOCOL_VERSION, ParameterReport, ParameterValue,
    ParametersMessage, Response, RobotState, StatusMessage, Telemetry, TelemetryEncoding, Wheels,
};
use embassy_sync::blocking_mutex::raw::RawMutex;
use heapless::Vec;

use crate::context::{Robot, cut};
use crate::navigation::{CELL_MM, COLUMNS, EXCERPT_BYTES, ROWS, WAY_POINTS};
use crate::outbox::{LogEntry, Outgoing};
use crate::parameters::{Domain, Parameters};
use crate::update::UpdatePort;
use crate::vision::Seen;

const _: () = assert!(EXCERPT_BYTES == MAX_MAP_BYTES && WAY_POINTS == MAX_WAY);

const fn cause(cause: ResetCause) -> BootCause {
    match cause {
        ResetCause::PowerOn => BootCause::PowerOn,
        ResetCause::Software => BootCause::Software,
        ResetCause::Watchdog => BootCause::Watchdog,
        ResetCause::BrownOut => BootCause::BrownOut,
        ResetCause::Panic => BootCause::Panic,
        // The enum may grow; what the wire does not name is as unknown as what the chip does not.
        _ => BootCause::External,
    }
}

/// Status, or last will when `online` is false.
pub(super) fn status<M: RawMutex>(
    robot: &Robot<M>,
    updates: &dyn UpdatePort,
    online: bool,
    buf: &mut [u8],
) -> Option<usize> {
    let (config, boot) = (robot.config(), robot.boot());
    let mut capabilities = Vec::new();
    // Eight places, and as many of them at most.
    let _ = capabilities.push(Capability::Drive);
    let _ = capabilities.push(Capability::Range);
    if config.camera {
        let _ = capabilities.push(Capability::Camera);
    }
    if config.eyes.is_some() {
        let _ = capabilities.push(Capability::Vision);
    }
    if config.takes_faults() {
        let _ = capabilities.push(Capability::Faults);
    }
    let _ = capabilities.push(Capability::Missions);
    let _ = capabilities.push(Capability::Map);
    if updates.takes_policies() {
        let _ = capabilities.push(Capability::Policies);
    }
    let message = StatusMessage {
        robot: config.id.clone(),
        online,
        kind: config.kind,
        firmware: cut(config.firmware),
        board: cut(config.board),
        capabilities,
        boot: Boot {
            count: boot.count,
            cause: cause(boot.cause),
            panic: robot.last_panic(),
        },
        protocol: PROTOCOL_VERSION,
        build: config.build.clone(),
        models: Models::new(),
    };
    let len = message.to_json(buf).ok()?;
    updates.add_models(buf, len)
}

pub(super) fn heartbeat<M: RawMutex>(
    robot: &Robot<M>,
    seq: u64,
    now: Instant,
    buf: &mut [u8],
) -> Option<usize> {
    Heartbeat {
        robot: robot.config().id.clone(),
        seq,
        timestamp: robot.unix_ms(now).unwrap_or(0),
        uptime_ms: now.as_millis(),
        state: robot.snapshot().state,
        shadow: robot.shadow(),
    }
    .to_json(buf)
    .ok()
}

/// What telemetry tells beside what the robot knows of itself.
pub(super) struct Look {
    pub(super) seq: u64,
    pub(super) rssi_dbm: Option<i8>,
    pub(super) now: Instant,
}

/// Writes a sample behind the first `at` bytes of `buf`; the length of it all, and the state that the
/// sample tells.
// Inlined, it would lie on the stack of the whole link, twice.
#[inline(never)]
pub(super) fn telemetry<M: RawMutex>(
    robot: &Robot<M>,
    look: &Look,
    how: TelemetryEncoding,
    buf: &mut [u8],
    at: usize,
) -> Result<(usize, RobotState), EncodeError> {
    let Look { seq, rssi_dbm, now } = *look;
    let snapshot = robot.snapshot();
    let [left, right] = snapshot.wheels;
    let sample = Telemetry {
        robot: robot.config().id.clone(),
        seq,
        timestamp: robot.unix_ms(now).unwrap_or(0),
        state: snapshot.state,
        behaviour: snapshot.behaviour,
        pose: snapshot.pose,
        range_mm: snapshot.reading.range_mm(now),
        temperature_c: snapshot
            .reading
            .temperature
            .map(|celsius| f32::from(celsius.0)),
        wheels: Wheels { left, right },
        battery: Battery {
            mv: snapshot
                .battery
                .voltage
                .map_or(0, |millivolts| millivolts.0),
            percent: snapshot
                .battery
                .percent
                .map_or(0, crawler_hal::Percent::get),
        },
        rssi_dbm,
        says: snapshot.says,
    };
    let len = how.append(&sample, buf, at)?;
    Ok((len, sample.state))
}

/// `None` also when nothing is left to tell.
// Inlined, it would lie on the stack of the whole link.
#[inline(never)]
pub(super) fn detections<M: RawMutex>(
    robot: &Robot<M>,
    seq: u64,
    now: Instant,
    buf: &mut [u8],
) -> Option<usize> {
    let view = robot.link_handle().take_news(now)?;
    let age = (now - view.at).as_millis();
    let detection = |seen: &Seen| Detection {
        class: cut(seen.spot.class.name()),
        x: seen.spot.x,
        y: seen.spot.y,
        bearing: seen.bearing,
        margin: seen.spot.margin,
    };
    let unix = robot.unix_ms(now);
    Detections {
        robot: robot.config().id.clone(),
        seq,
        timestamp: unix.map_or(0, |unix| unix.saturating_sub(age)),
        frame: view.frame,
        objects: view.things.iter().map(detection).collect(),
    }
    .to_json(buf)
    .ok()
}

/// `None` also when nothing waits.
// Inlined, it would lie on the stack of the whole link.
#[inline(never)]
pub(super) fn map<M: RawMutex>(robot: &Robot<M>, now: Instant, buf: &mut [u8]) -> Option<usize> {
    let (seq, excerpt) = robot.link_handle().map_excerpt()?;
    let metres = |point: [i32; 2]| point.map(|along| along as f32 / 1_000.0);
    MapSegment {
        robot: robot.config().id.clone(),
        seq,
        timestamp: robot.unix_ms(now).unwrap_or(0),
        cell_mm: CELL_MM as u16,
        origin: excerpt.origin,
        columns: COLUMNS as u8,
        rows: ROWS as u8,
        row: excerpt.row,
        cells: excerpt.cells,
        goal: excerpt.goal.map(metres),
        next: excerpt.next.map(metres),
        way: excerpt.way,
    }
    .to_json(buf)
    .ok()
}

pub(super) fn response<M: RawMutex>(
    robot: &Robot<M>,
    answer: Outgoing,
    buf: &mut [u8],
) -> Option<usize> {
    Response {
        robot: robot.config().id.clone(),
        seq: answer.seq,
        status: answer.status,
        reason: answer.reason,
        timestamp: answer.timestamp,
        source: (robot.config().build.is_some())
            .then(|| robot.source(answer.source))
            .flatten(),
    }
    .to_json(buf)
    .ok()
}

pub(super) fn log<M: RawMutex>(
    robot: &Robot<M>,
    entry: &LogEntry,
    buf: &mut [u8],
) -> Option<usize> {
    LogRecord {
        robot: robot.config().id.clone(),
        seq: entry.seq,
        timestamp: entry.timestamp,
        level: entry.level,
        event: cut(entry.event),
        text: cut(&entry.text),
    }
    .to_json(buf)
    .ok()
}

// Inlined, the reports of all passes would lie side by side on the stack of the whole link.
#[inline(never)]
pub(super) fn parameters<M: RawMutex>(robot: &Robot<M>, buf: &mut [u8]) -> Option<usize> {
    // One at a time: neither the stack nor the lock has to hold them all.
    let reports = || (0..).map_while(|index| robot.with_parameters(|all| report(all, index)));
    ParametersMessage::encode(&robot.config().id, reports, buf).ok()
}

#[inline(never)]
fn report(parameters: &Parameters, index: usize) -> Option<ParameterReport> {
    let (definition, value) = parameters.iter().nth(index)?;
    let (min, max, default) = match definition.domain {
        Domain::Number {
            min, max, default, ..
        } => (Some(min), Some(max), Some(ParameterValue::Number(default))),
        Domain::Switch { default } => (None, None, Some(ParameterValue::Bool(default))),
        Domain::Text { .. } => (None, None, None),
    };
    Some(ParameterReport {
        name: cut(definition.name),
        value,
        default,
        min,
        max,
        unit: definition.unit.map(cut),
    })
}
