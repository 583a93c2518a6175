//! Any message there can be, and any way to spell it.

mod faults;
mod respell;
mod updates;

use crawler_protocol::{
    Action, Battery, BehaviourName, BehaviourSpec, Boot, BootCause, Capability, CellDigest,
    Command, CommandName, Detection, Detections, Direction, FOLLOW_DISTANCE, Formation, Heartbeat,
    Kind, Level, LogRecord, MAX_COORDINATE, MAX_DRIVE_V, MAX_DRIVE_W, MAX_LAPS, MAX_LIARS,
    MAX_MOVE_MS, MAX_PLACES, MAX_SAYS, MAX_VALUE, MapSegment, Measure, Neighbour, Outcomes,
    ParameterReport, ParameterValue, ParametersMessage, Places, PolicyName, Pose, PoseFix, Reason,
    Response, ResponseStatus, RobotState, Says, Shadow, Shape, Source, StatusMessage,
    SwarmResponse, Telemetry, TimeMessage, Wheels,
};
use heapless::String as Text;
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use proptest::sample::select;

pub(crate) use faults::{fault_command, robot};
pub(crate) use respell::respell;
pub(crate) use updates::{update_command, update_report};

pub(crate) fn source() -> impl Strategy<Value = Source> {
    r"[ !#-\[\]-~]{1,48}".prop_map(|text| Source::new(&text).unwrap())
}

/// Finite numbers, subnormal ones included.
pub(crate) fn number() -> impl Strategy<Value = f32> {
    any::<u32>()
        .prop_map(f32::from_bits)
        .prop_filter("finite", |value| value.is_finite())
}

/// Text of at most `N` bytes without control characters.
fn text<const N: usize>() -> impl Strategy<Value = Text<N>> {
    r"\PC{0,160}".prop_map(|characters| {
        let mut text = Text::new();
        for character in characters.chars() {
            if text.push(character).is_err() {
                break;
            }
        }
        text
    })
}

fn name<const N: usize>() -> impl Strategy<Value = Text<N>> {
    vec(select(b"abcxyz019_".as_slice()), 1..=N)
        .prop_map(|bytes| Text::try_from(core::str::from_utf8(&bytes).unwrap()).unwrap())
}

fn value() -> impl Strategy<Value = ParameterValue> {
    prop_oneof![
        any::<bool>().prop_map(ParameterValue::Bool),
        number().prop_map(ParameterValue::Number),
        text().prop_map(ParameterValue::Text),
    ]
}

fn pose() -> impl Strategy<Value = Pose> {
    (number(), number(), number(), number()).prop_map(|(x, y, theta, sigma)| Pose {
        x,
        y,
        theta,
        sigma,
    })
}

fn place() -> impl Strategy<Value = (f32, f32)> {
    let axis = -MAX_COORDINATE..=MAX_COORDINATE;
    (axis.clone(), axis)
}

pub(crate) fn says() -> impl Strategy<Value = Says> {
    vec(any::<i32>(), 1..=MAX_SAYS).prop_map(|numbers| Says::of_numbers(&numbers).unwrap())
}

fn places(least: usize) -> impl Strategy<Value = Places> {
    vec(place().prop_map(|(x, y)| [x, y]), least..=MAX_PLACES)
        .prop_map(|places| Places::new(&places).unwrap())
}

fn formation() -> impl Strategy<Value = Formation> {
    let origin = Places::new(&[[0.0; 2]]).unwrap();
    (
        select(Shape::ALL),
        prop_oneof![Just(None), (0.0_f32..=1.0).prop_map(Some)],
        prop_oneof![
            Just(0.0),
            -Formation::MOST_HEADING..=Formation::MOST_HEADING
        ],
        prop_oneof![Just(origin), places(1)],
    )
        .prop_map(|(shape, share, heading, path)| {
            let (_, [least, most], usual) = Formation::size_of(shape);
            let size = share.map_or(usual, |share| least + (most - least) * share);
            Formation {
                shape,
                size: size.min(most),
                heading,
                path,
            }
        })
}

fn behaviour() -> impl Strategy<Value = BehaviourSpec> {
    prop_oneof![
        (0..=100_u8).prop_map(|speed| BehaviourSpec::Wander { speed }),
        place().prop_map(|(x, y)| BehaviourSpec::Goto { x, y }),
        place().prop_map(|(x, y)| BehaviourSpec::Gather { x, y }),
        Just(BehaviourSpec::Gather { x: 0.0, y: 0.0 }),
        (robot(), FOLLOW_DISTANCE[0]..=FOLLOW_DISTANCE[1])
            .prop_map(|(leader, distance)| BehaviourSpec::Follow { leader, distance }),
        (
            prop_oneof![
                (-MAX_VALUE..=MAX_VALUE).prop_map(Measure::Value),
                Just(Measure::Temperature),
                Just(Measure::Range),
            ],
            0..=MAX_LIARS,
        )
            .prop_map(|(measure, f)| BehaviourSpec::Consensus { measure, f }),
        places(1).prop_map(|tasks| BehaviourSpec::Allocate { tasks }),
        "[a-z0-9-]{1,32}".prop_map(|name| BehaviourSpec::Policy {
            policy: PolicyName::new(&name).unwrap(),
        }),
        places(3).prop_map(|area| BehaviourSpec::Cover { area }),
        formation().prop_map(BehaviourSpec::Shaped),
        (places(2), 0..=MAX_LAPS)
            .prop_map(|(waypoints, laps)| BehaviourSpec::Patrol { waypoints, laps }),
        select(vec![
            BehaviourSpec::Manual,
            BehaviourSpec::Disperse,
            BehaviourSpec::Flock,
            BehaviourSpec::Formation,
        ]),
    ]
}

pub(crate) fn action() -> impl Strategy<Value = Action> {
    prop_oneof![
        (select(Direction::ALL), 0..=100_u8, 0..=MAX_MOVE_MS).prop_map(
            |(direction, speed, duration_ms)| Action::Move {
                direction,
                speed,
                duration_ms
            }
        ),
        (-MAX_DRIVE_V..=MAX_DRIVE_V, -MAX_DRIVE_W..=MAX_DRIVE_W)
            .prop_map(|(v, w)| Action::Drive { v, w }),
        place().prop_map(|(x, y)| Action::Goto { x, y }),
        behaviour().prop_map(Action::Behave),
        vec((name::<32>(), value()), 1..=8).prop_map(|pairs| {
            let mut values = heapless::Vec::<(Text<32>, ParameterValue), 8>::new();
            for (name, value) in pairs {
                if !values.iter().any(|(known, _)| *known == name) {
                    values.push((name, value)).unwrap();
                }
            }
            Action::Set(values)
        }),
        option::of(name::<32>()).prop_map(|name| Action::Shadow {
            // Names of parameters have an underscore, and those of policies a hyphen.
            policy: name.map(|name| PolicyName::new(&name.replace('_', "-")).unwrap()),
        }),
        select(vec![
            Action::Stop,
            Action::Estop,
            Action::Reset,
            Action::Scan,
            Action::Capture,
            Action::ReportMap,
            Action::Identify,
            Action::Reboot,
        ]),
    ]
}

pub(crate) fn command() -> impl Strategy<Value = Command> {
    (action(), any::<u64>(), any::<u64>(), source()).prop_map(|(action, timestamp, seq, source)| {
        Command {
            action,
            timestamp,
            seq,
            source,
        }
    })
}

pub(crate) fn response() -> impl Strategy<Value = Response> {
    (
        robot(),
        any::<u64>(),
        select(ResponseStatus::ALL.as_slice()),
        option::of(select(Reason::ALL.as_slice())),
        any::<u64>(),
        option::of(source()),
    )
        .prop_map(|(robot, seq, status, reason, timestamp, source)| Response {
            robot,
            seq,
            status,
            reason,
            timestamp,
            source,
        })
}

pub(crate) fn swarm_response() -> impl Strategy<Value = SwarmResponse> {
    (
        source(),
        any::<u64>(),
        select(CommandName::ALL),
        any::<u32>(),
        any::<[u32; 7]>(),
        any::<u64>(),
    )
        .prop_map(|(source, seq, command, robots, counts, timestamp)| {
            let [
                accepted,
                completed,
                rejected,
                expired,
                stale,
                failed,
                unanswered,
            ] = counts;
            SwarmResponse {
                source,
                seq,
                command,
                robots,
                outcomes: Outcomes {
                    accepted,
                    completed,
                    rejected,
                    expired,
                    stale,
                    failed,
                    unanswered,
                },
                timestamp,
            }
        })
}

pub(crate) fn status() -> impl Strategy<Value = StatusMessage> {
    (
        (robot(), any::<bool>(), select(Kind::ALL), text(), text()),
        vec(select(Capability::ALL), 0..=8),
        (any::<u32>(), select(BootCause::ALL), option::of(text())),
        (any::<u8>(), option::of(updates::build()), updates::models()),
    )
        .prop_map(
            |((robot, online, kind, firmware, board), capabilities, boot, programs)| {
                let (protocol, build, models) = programs;
                let (count, cause, panic) = boot;
                StatusMessage {
                    robot,
                    online,
                    kind,
                    firmware,
                    board,
                    capabilities: heapless::Vec::from_slice(&capabilities).unwrap(),
                    boot: Boot {
                        count,
                        cause,
                        panic,
                    },
                    protocol,
                    build,
                    models,
                }
            },
        )
}

pub(crate) fn heartbeat() -> impl Strategy<Value = Heartbeat> {
    (
        robot(),
        any::<[u64; 3]>(),
        select(RobotState::ALL),
        option::of(shadow()),
    )
        .prop_map(
            |(robot, [seq, timestamp, uptime_ms], state, shadow)| Heartbeat {
                robot,
                seq,
                timestamp,
                uptime_ms,
                state,
                shadow,
            },
        )
}

fn shadow() -> impl Strategy<Value = Shadow> {
    (robot(), any::<[u32; 4]>()).prop_map(|(name, [decisions, agreed, vetoes, driving_vetoes])| {
        Shadow {
            policy: PolicyName::new(name.as_str()).unwrap(),
            decisions,
            agreed,
            vetoes,
            driving_vetoes,
        }
    })
}

pub(crate) fn telemetry() -> impl Strategy<Value = Telemetry> {
    (
        (robot(), any::<u64>(), any::<u64>()),
        (select(RobotState::ALL), select(BehaviourName::ALL), pose()),
        (
            option::of(any::<u16>()),
            option::of(number()),
            option::of(any::<i8>()),
            option::of(says()),
        ),
        (number(), number(), any::<u16>(), 0..=100_u8),
    )
        .prop_map(
            |((robot, seq, timestamp), (state, behaviour, pose), readings, body)| {
                let (range_mm, temperature_c, rssi_dbm, says) = readings;
                let (left, right, mv, percent) = body;
                Telemetry {
                    robot,
                    seq,
                    timestamp,
                    state,
                    behaviour,
                    pose,
                    range_mm,
                    temperature_c,
                    wheels: Wheels { left, right },
                    battery: Battery { mv, percent },
                    rssi_dbm,
                    says,
                }
            },
        )
}

pub(crate) fn detections() -> impl Strategy<Value = Detections> {
    let object = (text(), number(), number(), number(), any::<u8>()).prop_map(
        |(class, x, y, bearing, margin)| Detection {
            class,
            x,
            y,
            bearing,
            margin,
        },
    );
    (
        robot(),
        any::<u64>(),
        any::<u64>(),
        any::<u32>(),
        vec(object, 0..=8),
    )
        .prop_map(|(robot, seq, timestamp, frame, objects)| Detections {
            robot,
            seq,
            timestamp,
            frame,
            objects: objects.into_iter().collect(),
        })
}

pub(crate) fn map_segment() -> impl Strategy<Value = MapSegment> {
    let point = || option::of([number(), number()]);
    (
        (
            robot(),
            any::<u64>(),
            any::<u64>(),
            1..=u16::MAX,
            any::<[i32; 2]>(),
        ),
        (select(vec![24, 48, 72, 96]), 1..=96_u8, any::<u8>()),
        vec(any::<[u8; 3]>(), 1..=128),
        (point(), point(), vec(any::<[u8; 2]>(), 0..=16)),
    )
        .prop_map(
            |(
                (robot, seq, timestamp, cell_mm, origin),
                (columns, rows, row),
                cells,
                (goal, next, way),
            )| MapSegment {
                robot,
                seq,
                timestamp,
                cell_mm,
                origin,
                columns,
                rows,
                row,
                cells: cells.into_iter().flatten().collect(),
                goal,
                next,
                way: way.into_iter().collect(),
            },
        )
}

pub(crate) fn log_record() -> impl Strategy<Value = LogRecord> {
    (
        robot(),
        any::<u64>(),
        any::<u64>(),
        select(Level::ALL),
        text(),
        text(),
    )
        .prop_map(|(robot, seq, timestamp, level, event, text)| LogRecord {
            robot,
            seq,
            timestamp,
            level,
            event,
            text,
        })
}

/// Few enough parameters that nothing is left out.
pub(crate) fn parameters() -> impl Strategy<Value = ParametersMessage> {
    let report = (
        name::<20>(),
        value(),
        option::of(value()),
        option::of(number()),
        option::of(number()),
        option::of(text()),
    )
        .prop_map(|(name, value, default, min, max, unit)| ParameterReport {
            name,
            value,
            default,
            min,
            max,
            unit,
        });
    (robot(), vec(report, 0..=2)).prop_map(|(robot, reports)| {
        let mut values = heapless::Vec::new();
        for report in reports {
            let known = |other: &ParameterReport| other.name == report.name;
            if !values.iter().any(known) {
                values.push(report).unwrap();
            }
        }
        ParametersMessage { robot, values }
    })
}

pub(crate) fn neighbour() -> impl Strategy<Value = Neighbour> {
    let motion = (number(), number(), number(), number(), number());
    (robot(), motion, option::of(says())).prop_map(|(id, (x, y, theta, v, w), says)| Neighbour {
        id,
        x,
        y,
        theta,
        v,
        w,
        says,
    })
}

/// Few enough robots that none is left out.
pub(crate) fn cell_digest() -> impl Strategy<Value = CellDigest> {
    (
        any::<i16>(),
        any::<i16>(),
        any::<u64>(),
        any::<u16>(),
        vec(neighbour(), 0..=5),
    )
        .prop_map(|(x, y, timestamp, count, robots)| CellDigest {
            x,
            y,
            timestamp,
            count,
            robots: robots.into_iter().collect(),
        })
}

pub(crate) fn pose_fix() -> impl Strategy<Value = PoseFix> {
    (robot(), any::<u64>(), pose()).prop_map(|(robot, timestamp, pose)| PoseFix {
        robot,
        timestamp,
        pose,
    })
}

pub(crate) fn time() -> impl Strategy<Value = TimeMessage> {
    any::<u64>().prop_map(|timestamp| TimeMessage { timestamp })
}
