//! The longest message of every kind fits, and what is left out where it would not.

use crawler_protocol::{
    Battery, BehaviourName, Boot, BootCause, BuildId, Capability, CellDigest, Detection,
    Detections, EncodeError, Heartbeat, Kind, Level, LogRecord, MAX_BUILD, MAX_DETECTIONS,
    MAX_MESSAGE, MAX_MODELS, MAX_NEIGHBOURS, MAX_PANIC, MAX_PARAMETERS, MAX_SAYS, ModelName,
    Neighbour, Outcomes, ParameterReport, ParameterValue, ParametersMessage, PolicyName, Pose,
    PoseFix, Reason, Response, ResponseStatus, RobotId, RobotState, Says, Shadow, Source,
    StatusMessage, SwarmResponse, Telemetry, TimeMessage, Wheels,
};

fn robot() -> RobotId {
    RobotId::new("sim-0001").unwrap()
}

/// The finite number with the longest spelling.
const LONG: f32 = -1.175_494_4e-38;

fn widest_robot() -> RobotId {
    RobotId::new(&"a".repeat(32)).unwrap()
}

/// What needs most bytes on the wire for its bytes here.
fn quotes<const N: usize>() -> heapless::String<N> {
    heapless::String::try_from("\"".repeat(N).as_str()).unwrap()
}

fn nulls<const N: usize>() -> heapless::String<N> {
    heapless::String::try_from("\0".repeat(N).as_str()).unwrap()
}

#[test]
fn the_longest_message_of_every_kind_fits() {
    let mut buf = [0; MAX_MESSAGE];
    assert_eq!(serde_json::to_string(&LONG).unwrap().len(), 14);
    let (robot, pose) = (
        widest_robot(),
        Pose {
            x: LONG,
            y: LONG,
            theta: LONG,
            sigma: LONG,
        },
    );

    let telemetry = Telemetry {
        robot: robot.clone(),
        seq: u64::MAX,
        timestamp: u64::MAX,
        state: RobotState::Initializing,
        behaviour: BehaviourName::Formation,
        pose,
        range_mm: Some(u16::MAX),
        temperature_c: Some(LONG),
        wheels: Wheels {
            left: LONG,
            right: LONG,
        },
        battery: Battery {
            mv: u16::MAX,
            percent: 100,
        },
        rssi_dbm: Some(i8::MIN),
        says: Says::of_numbers(&[i32::MIN; MAX_SAYS]),
    };
    assert!(telemetry.to_json(&mut buf).unwrap() <= 512);

    let status = StatusMessage {
        robot: robot.clone(),
        online: false,
        kind: Kind::Simulated,
        // A quotation mark takes twice its length; what would take six times leaves as a space.
        firmware: quotes(),
        board: quotes(),
        capabilities: [Capability::Missions; 8].into_iter().collect(),
        boot: Boot {
            count: u32::MAX,
            cause: BootCause::BrownOut,
            panic: Some("\"".repeat(MAX_PANIC).as_str().try_into().unwrap()),
        },
        protocol: u8::MAX,
        build: Some(BuildId::new(&"b".repeat(MAX_BUILD)).unwrap()),
        models: (0..MAX_MODELS)
            .map(|at| {
                let name = ModelName::new(&format!("{at:m>16}")).unwrap();
                (name, BuildId::new(&"b".repeat(MAX_BUILD)).unwrap())
            })
            .collect(),
    };
    status.to_json(&mut buf).unwrap();

    let response = Response {
        robot: robot.clone(),
        seq: u64::MAX,
        status: ResponseStatus::Completed,
        reason: Some(Reason::UnknownBehaviour),
        timestamp: u64::MAX,
        source: Some(Source::new(&"~".repeat(48)).unwrap()),
    };
    response.to_json(&mut buf).unwrap();

    let m = u32::MAX;
    let swarm = SwarmResponse {
        source: Source::new(&"~".repeat(48)).unwrap(),
        seq: u64::MAX,
        command: crawler_protocol::CommandName::Identify,
        robots: m,
        outcomes: Outcomes {
            accepted: m,
            completed: m,
            rejected: m,
            expired: m,
            stale: m,
            failed: m,
            unanswered: m,
        },
        timestamp: u64::MAX,
    };
    swarm.to_json(&mut buf).unwrap();

    let heartbeat = Heartbeat {
        robot: robot.clone(),
        seq: u64::MAX,
        timestamp: u64::MAX,
        uptime_ms: u64::MAX,
        state: RobotState::Initializing,
        shadow: Some(Shadow {
            policy: PolicyName::new(&"p".repeat(32)).unwrap(),
            decisions: m,
            agreed: m,
            vetoes: m,
            driving_vetoes: m,
        }),
    };
    heartbeat.to_json(&mut buf).unwrap();

    // A log line has no control characters left, so quotation marks are the worst.
    let log = LogRecord {
        robot: robot.clone(),
        seq: u64::MAX,
        timestamp: u64::MAX,
        level: Level::Error,
        event: quotes(),
        text: quotes(),
    };
    log.to_json(&mut buf).unwrap();
    let controls = LogRecord {
        event: nulls(),
        text: nulls(),
        ..log
    };
    let length = controls.to_json(&mut buf).unwrap();
    let read = LogRecord::from_json(&buf[..length]).unwrap();
    assert_eq!(read.text.as_str(), " ".repeat(160));

    let object = Detection {
        class: quotes(),
        x: LONG,
        y: LONG,
        bearing: LONG,
        margin: u8::MAX,
    };
    let detections = Detections {
        robot: robot.clone(),
        seq: u64::MAX,
        timestamp: u64::MAX,
        frame: u32::MAX,
        objects: (0..MAX_DETECTIONS).map(|_| object.clone()).collect(),
    };
    detections.to_json(&mut buf).unwrap();

    PoseFix {
        robot,
        timestamp: u64::MAX,
        pose,
    }
    .to_json(&mut buf)
    .unwrap();
    TimeMessage {
        timestamp: u64::MAX,
    }
    .to_json(&mut buf)
    .unwrap();
}

fn report(at: usize, value: ParameterValue) -> ParameterReport {
    ParameterReport {
        name: format!("{at:a>17}").as_str().try_into().unwrap(),
        default: Some(value.clone()),
        value,
        min: Some(LONG),
        max: Some(LONG),
        unit: Some(quotes()),
    }
}

#[test]
fn parameters_that_do_not_fit_lose_detail_but_no_value() {
    let mut buf = [0; MAX_MESSAGE];
    let mut widest = ParametersMessage {
        robot: widest_robot(),
        values: (1..MAX_PARAMETERS)
            .map(|at| report(at, ParameterValue::Number(LONG)))
            .collect(),
    };
    let plain = heapless::String::try_from("a".repeat(64).as_str()).unwrap();
    widest
        .values
        .push(report(0, ParameterValue::Text(plain)))
        .unwrap();
    let length = widest.to_json(&mut buf).expect("the longest message fits");
    let read = ParametersMessage::from_json(&buf[..length]).unwrap();
    assert_eq!(read.values.len(), MAX_PARAMETERS);
    for (read, told) in read.values.iter().zip(&widest.values) {
        assert_eq!((&read.name, &read.value), (&told.name, &told.value));
    }

    // A text full of escapes may be too much, and is said to be.
    let last = widest.values.last_mut().unwrap();
    last.value = ParameterValue::Text(quotes());
    assert_eq!(widest.to_json(&mut buf), Err(EncodeError::TooLarge));

    // One less detail after the other goes, and no more than needed.
    let mut last = (4, 4);
    for count in 1..=MAX_PARAMETERS {
        let message = ParametersMessage {
            robot: widest_robot(),
            values: (0..count)
                .map(|at| report(at, ParameterValue::Number(LONG)))
                .collect(),
        };
        let length = message.to_json(&mut buf).unwrap();
        let read = ParametersMessage::from_json(&buf[..length]).unwrap();
        let first = &read.values[0];
        let details = (
            usize::from(first.unit.is_some())
                + usize::from(first.default.is_some())
                + usize::from(first.min.is_some())
                + usize::from(first.max.is_some()),
            usize::from(first.min.is_some()) * 4,
        );
        assert!(details <= last, "{count} parameters");
        if count == 1 {
            assert_eq!(read, message);
        }
        last = details;
    }
    assert_eq!(last.0, 0, "the longest message has values alone");
}

#[test]
fn a_digest_that_is_full_tells_how_many_there_are() {
    let mut buf = [0; MAX_MESSAGE];
    let neighbour = Neighbour {
        id: widest_robot(),
        x: LONG,
        y: LONG,
        theta: LONG,
        v: LONG,
        w: LONG,
        says: None,
    };
    let digest = CellDigest {
        x: i16::MIN,
        y: i16::MIN,
        timestamp: u64::MAX,
        count: 40,
        robots: (0..MAX_NEIGHBOURS).map(|_| neighbour.clone()).collect(),
    };
    let length = digest.to_json(&mut buf).unwrap();
    let read = CellDigest::from_json(&buf[..length]).unwrap();
    assert!(
        (5..MAX_NEIGHBOURS).contains(&read.robots.len()),
        "{}",
        read.robots.len()
    );
    assert_eq!(read.count, 40);
    // What a cell usually holds fits as a whole.
    let usual = Neighbour {
        id: robot(),
        x: -12.345,
        y: 12.345,
        theta: -1.234,
        v: 0.123,
        w: -0.123,
        says: None,
    };
    let digest = CellDigest {
        robots: (0..10).map(|_| usual.clone()).collect(),
        ..digest
    };
    let length = digest.to_json(&mut buf).unwrap();
    assert_eq!(CellDigest::from_json(&buf[..length]), Ok(digest.clone()));
    // As docs/protocol.md has it.
    let full = |says: Option<Says>| {
        let robots = (0..MAX_NEIGHBOURS).map(|number| Neighbour {
            id: RobotId::new(&format!("sim-{number:04}")).unwrap(),
            x: [12.345, 1.234, -0.123][number % 3],
            says,
            ..usual.clone()
        });
        CellDigest {
            x: -7,
            y: 6,
            timestamp: 1_790_000_000_123,
            robots: robots.collect(),
            ..digest.clone()
        }
    };
    let told = |says: &[i32]| {
        let mut buf = [0; MAX_MESSAGE];
        let length = full(Says::of_numbers(says)).to_json(&mut buf).unwrap();
        CellDigest::from_json(&buf[..length]).unwrap().robots.len()
    };
    let fit = [
        told(&[]),
        told(&[9, -1_234_567_890, 750, 3]),
        told(&[8, -1_234_567_890, 12]),
        told(&[10, 22_500, 123]),
        told(&[11, 7, 812, 200, -1_234_567_890]),
    ];
    assert_eq!(fit, [12, 9, 9, 9, 8]);
}
