//! What may happen to the robot on the bench, and random sequences of it.

use std::vec;
use std::vec::Vec;

use crawler_hal::Millimeters;
use crawler_protocol::{
    Action, BehaviourSpec, Direction, Formation, Measure, Places, PolicyName, Pose, RobotId, Says,
    Shape,
};
use proptest::prelude::*;

use crate::perception::{Charge, LinkHealth, SensorHealth, Sight};

/// What the ranger does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Sensor {
    Sees(Sight),
    Silent,
    Broken(SensorHealth),
}

/// How a command's number relates to what its source sent before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Number {
    Next,
    Repeated,
    Older,
}

/// One thing that happens to the robot.
#[derive(Debug, Clone)]
// A few hundred of them live in one test case.
#[allow(clippy::large_enum_variant)]
pub(super) enum Happening {
    /// So many periods pass.
    Run(u8),
    /// The loop is starved for so many milliseconds.
    Starve(u16),
    Send {
        action: Action,
        source: u8,
        number: Number,
        /// Milliseconds; negative is from the future.
        age: i64,
    },
    Bytes(Vec<u8>),
    Sensor(Sensor),
    Link(LinkHealth),
    Charge(Charge),
    Avoidance(bool),
    MotorFault(bool),
    /// Another robot is said to be there, with this speed, and to say this.
    Neighbour([f32; 3], Option<Says>),
    /// The plan leads there, in millimetres, or nowhere; it is of the present order, or of another one.
    Guide(Option<[i32; 2]>, bool),
    /// An outside reference puts the robot there, so many milliseconds ago.
    Fix {
        pose: Pose,
        age: i64,
    },
}

fn action() -> impl Strategy<Value = Action> {
    let direction = prop_oneof![
        Just(Direction::Forward),
        Just(Direction::Backward),
        Just(Direction::Left),
        Just(Direction::Right),
    ];
    let duration = prop_oneof![Just(0_u32), 1_u32..2_000, 2_000_u32..=10_000];
    prop_oneof![
        4 => (direction, 0_u8..=100, duration).prop_map(|(direction, speed, duration_ms)| {
            Action::Move { direction, speed, duration_ms }
        }),
        4 => (-1.0_f32..1.0, -4.0_f32..4.0).prop_map(|(v, w)| Action::Drive { v, w }),
        2 => Just(Action::Stop),
        1 => Just(Action::Estop),
        2 => Just(Action::Reset),
        1 => Just(Action::Scan),
        3 => (0_u8..=100).prop_map(|speed| Action::Behave(BehaviourSpec::Wander { speed })),
        1 => Just(Action::Behave(BehaviourSpec::Manual)),
        2 => Just(Action::Behave(BehaviourSpec::Flock)),
        1 => Just(Action::Behave(BehaviourSpec::Disperse)),
        1 => Just(Action::Behave(BehaviourSpec::Gather { x: 1.0, y: -2.0 })),
        1 => Just(Action::Behave(BehaviourSpec::Formation)),
        3 => prop_oneof![3 => Just("trained"), 1 => Just("other")].prop_map(|name| {
            let policy = PolicyName::new(name).expect("legal");
            Action::Behave(BehaviourSpec::Policy { policy })
        }),
        2 => prop_oneof![Just("other"), Just("rules")].prop_map(|leader| {
            let leader = RobotId::new(leader).expect("legal");
            Action::Behave(BehaviourSpec::Follow { leader, distance: 0.5 })
        }),
        1 => Just(Action::Behave(BehaviourSpec::Consensus { measure: Measure::Range, f: 1 })),
        2 => (-2.0_f32..2.0, -2.0_f32..2.0).prop_map(|(x, y)| {
            let tasks = Places::new(&[[0.0, 0.0], [x, y]]).expect("two places");
            Action::Behave(BehaviourSpec::Allocate { tasks })
        }),
        2 => (-2.0_f32..2.0, -2.0_f32..2.0).prop_map(|(x, y)| {
            let area = Places::new(&[[-2.0, -2.0], [2.0, -2.0], [x, y]]).expect("three corners");
            Action::Behave(BehaviourSpec::Cover { area })
        }),
        2 => (prop::sample::select(Shape::ALL), -2.0_f32..2.0, -2.0_f32..2.0).prop_map(|(shape, x, y)| {
            let path = Places::new(&[[0.0, 0.0], [x, y]]).expect("two places");
            let (_, _, size) = Formation::size_of(shape);
            Action::Behave(BehaviourSpec::Shaped(Formation { shape, size, heading: x, path }))
        }),
        2 => (-2.0_f32..2.0, -2.0_f32..2.0, 0_u16..2).prop_map(|(x, y, laps)| {
            let waypoints = Places::new(&[[0.0, 0.0], [x, y]]).expect("two places");
            Action::Behave(BehaviourSpec::Patrol { waypoints, laps })
        }),
        2 => (-2.0_f32..2.0, -2.0_f32..2.0).prop_map(|(x, y)| Action::Goto { x, y }),
        1 => Just(Action::Identify),
        1 => Just(Action::Capture),
        1 => prop::option::of(prop_oneof![Just("trained"), Just("other")]).prop_map(|name| {
            let policy = name.map(|name| PolicyName::new(name).expect("legal"));
            Action::Shadow { policy }
        }),
    ]
}

fn sight() -> impl Strategy<Value = Sight> {
    prop_oneof![
        4 => (20_u16..4_500).prop_map(|mm| Sight::Range(Millimeters(mm))),
        3 => Just(Sight::Clear),
        1 => Just(Sight::Touching),
    ]
}

pub(super) fn happening() -> impl Strategy<Value = Happening> {
    let sensor = prop_oneof![
        6 => sight().prop_map(Sensor::Sees),
        1 => Just(Sensor::Silent),
        1 => prop_oneof![
            Just(SensorHealth::Dead),
            Just(SensorHealth::Stuck),
            Just(SensorHealth::Absurd),
            Just(SensorHealth::Unproven),
        ]
        .prop_map(Sensor::Broken),
    ];
    let number = prop_oneof![
        6 => Just(Number::Next),
        1 => Just(Number::Repeated),
        1 => Just(Number::Older),
    ];
    let age = prop_oneof![
        8 => 0_i64..1_500,
        1 => 2_500_i64..100_000,
        1 => -1_500_i64..0,
        1 => -100_000_i64..-2_500,
    ];
    let coordinate = || prop_oneof![4 => -3.0_f32..3.0, 1 => -2_000.0_f32..2_000.0];
    let sigma = prop_oneof![8 => 0.0_f32..0.1, 1 => -1.0_f32..20.0];
    let pose = (coordinate(), coordinate(), -7.0_f32..7.0, sigma)
        .prop_map(|(x, y, theta, sigma)| Pose { x, y, theta, sigma });
    let fix = (pose, -1_000_i64..1_500).prop_map(|(pose, age)| Happening::Fix { pose, age });
    let near = (-3.0_f32..3.0, -3.0_f32..3.0, -1.0_f32..1.0);
    let point = || prop_oneof![8 => -3_000..3_000_i32, 1 => any::<i32>()];
    let point = prop::option::weighted(0.8, (point(), point()).prop_map(|(x, y)| [x, y]));
    let guide = (point, prop::bool::weighted(0.9)).prop_map(|(to, own)| Happening::Guide(to, own));
    let word = || prop_oneof![4 => 0_i32..1_001, 1 => any::<i32>()];
    let says = (8_i32..12, word(), word(), word())
        .prop_map(|(kind, a, b, c)| Says::of_numbers(&[kind, a, b, c]).expect("four"));
    let near = (near, prop::option::of(says))
        .prop_map(|((x, y, v), says)| Happening::Neighbour([x, y, v], says));
    prop_oneof![
        4 => fix,
        4 => near,
        4 => guide,
        12 => (1_u8..40).prop_map(Happening::Run),
        2 => (1_u16..3_000).prop_map(Happening::Starve),
        12 => (action(), 0_u8..3, number, age).prop_map(|(action, source, number, age)| {
            Happening::Send { action, source, number, age }
        }),
        1 => prop::collection::vec(any::<u8>(), 0..64).prop_map(Happening::Bytes),
        4 => sensor.prop_map(Happening::Sensor),
        1 => prop_oneof![
            Just(LinkHealth::Up),
            Just(LinkHealth::Up),
            Just(LinkHealth::Lost),
        ]
        .prop_map(Happening::Link),
        1 => prop_oneof![
            3 => Just(Charge::Good),
            1 => Just(Charge::Low),
            1 => Just(Charge::Critical),
            1 => Just(Charge::Unknown),
        ]
        .prop_map(Happening::Charge),
        1 => any::<bool>().prop_map(Happening::Avoidance),
        1 => prop::bool::weighted(0.2).prop_map(Happening::MotorFault),
    ]
}
