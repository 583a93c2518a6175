//! Control steps of a robot among others: sixteen neighbours, the most that it knows of, all within a metre.

use crawler_app::Robot;
use crawler_app::policy::SPREAD;
use crawler_hal::Instant;
use crawler_protocol::{
    Action, BehaviourName, BehaviourSpec, CellDigest, Formation, MAX_MESSAGE, Measure, Neighbour,
    Places, PolicyName, Pose, PoseFix, RobotId, Says, Shape,
};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;

use super::{CONTROL, DECIDE, Rig, Told, fail, tell};

/// Neighbours that a message tells.
const EACH: usize = 8;
/// Milliseconds between two messages: more than twice as many as there are.
const TOLD_EVERY_MS: u64 = 100;
/// Messages within a measurement.
const MESSAGES: u32 = 160;
const LEADER: &str = "r0";

/// Tells the dearest control step of each behaviour, with a position reference every second; `order` gives an order.
pub(super) fn measure<'a, 'b>(
    robot: &Robot<CriticalSectionRawMutex>,
    rig: &mut Rig<'a, 'b>,
    told: &mut Told,
    mut order: impl FnMut(&Rig<'a, 'b>, Action),
) {
    let places = |places: &[[f32; 2]]| Places::new(places).unwrap_or_else(|| fail("places"));
    let here = robot.snapshot().pose;
    let round = places(&[[here.x - 1.0, here.y], [here.x + 1.0, here.y + 0.5]]);
    let tasks = [0, 1, 2, 3, 4, 5, 6, 7].map(|n| [here.x + 3.0, here.y + 0.3 * n as f32 - 1.0]);
    let tasks = places(&tasks);
    let policy = PolicyName::new(SPREAD.name).unwrap_or_else(|_| fail("policy"));
    let area = [
        [-4.0, -3.0],
        [0.0, -4.0],
        [3.0, -4.0],
        [5.0, -1.0],
        [5.0, 2.0],
        [3.0, 4.0],
        [0.0, 4.0],
        [-4.0, 3.0],
    ];
    let area = places(&area.map(|[x, y]| [here.x + x, here.y + y]));
    let leader = RobotId::new(LEADER).unwrap_or_else(|_| fail("id"));
    let shaped = |shape| {
        BehaviourSpec::Shaped(Formation {
            shape,
            size: 1.0,
            heading: 0.7,
            path: round,
        })
    };
    for (name, spec) in [
        ("control_flocking", BehaviourSpec::Flock),
        (
            "control_gathering",
            BehaviourSpec::Gather { x: 40.0, y: 0.0 },
        ),
        ("control_dispersing", BehaviourSpec::Disperse),
        ("control_in_formation", BehaviourSpec::Formation),
        (
            "control_following",
            BehaviourSpec::Follow {
                leader,
                distance: 0.25,
            },
        ),
        (
            "control_patrolling",
            BehaviourSpec::Patrol {
                waypoints: round,
                laps: 0,
            },
        ),
        (
            "control_agreeing",
            BehaviourSpec::Consensus {
                measure: Measure::Value(20.0),
                f: 2,
            },
        ),
        ("control_allocating", BehaviourSpec::Allocate { tasks }),
        ("control_covering", BehaviourSpec::Cover { area }),
        ("control_in_a_line", shaped(Shape::Line)),
        ("control_in_a_wedge", shaped(Shape::Wedge)),
        ("control_in_a_lattice", shaped(Shape::Lattice)),
        ("control_in_a_circle", shaped(Shape::Circle)),
        (
            "control_wandering_among",
            BehaviourSpec::Wander { speed: 60 },
        ),
        // Last, for it goes where it likes: the areas and places of the others are around where they began.
        ("control_by_policy", BehaviourSpec::Policy { policy }),
    ] {
        let behaviour = spec.behaviour();
        locate(robot, rig);
        tell_neighbours(robot, rig, behaviour, 0);
        tell_neighbours(robot, rig, behaviour, 1);
        order(rig, Action::Behave(spec));
        told.order(rig);
        let (mut most, mut layer) = (0, 0);
        rig.decisions = 0;
        for message in 0..MESSAGES {
            tell_neighbours(robot, rig, behaviour, message);
            if message % 10 == 9 {
                locate(robot, rig);
            }
            most = most.max(rig.most_of(CONTROL, TOLD_EVERY_MS));
            layer = layer.max(rig.most[DECIDE]);
        }
        if robot.snapshot().behaviour != behaviour {
            fail(name);
        }
        tell(name, most);
        if behaviour == BehaviourName::Policy {
            tell("policy_decision", rig.decisions);
            tell("policy_layer", layer);
        }
        order(rig, Action::Stop);
        told.halt(rig);
        rig.run(1_000);
    }
}

/// Makes the robot sure of its place.
pub(super) fn locate(robot: &Robot<CriticalSectionRawMutex>, rig: &Rig<'_, '_>) {
    let fix = PoseFix {
        robot: robot.config().id.clone(),
        timestamp: 0,
        pose: Pose {
            sigma: 0.01,
            ..robot.snapshot().pose
        },
    };
    let mut buffer = [0; MAX_MESSAGE];
    let length = fix.to_json(&mut buffer).unwrap_or_else(|_| fail("a fix"));
    let now = Instant::from_micros(rig.now_us.get());
    if robot.observe_fix(&buffer[..length], now).is_err() {
        fail("a fix was refused");
    }
}

/// Tells half of the neighbours, as if they were all in one cell or in the next one.
fn tell_neighbours(
    robot: &Robot<CriticalSectionRawMutex>,
    rig: &Rig<'_, '_>,
    behaviour: BehaviourName,
    message: u32,
) {
    let known = robot.snapshot();
    let Pose { x, y, .. } = known.pose;
    let half = message as i16 % 2;
    let robots = (0..EACH).map(|n| {
        let n = n as i32 + i32::from(half) * EACH as i32;
        let mut name = heapless::String::<8>::new();
        let _ = core::fmt::Write::write_fmt(&mut name, format_args!("r{n}"));
        // On four rings of four, none of them where another one is.
        let ring = 0.35 + 0.15 * (n / 4) as f32;
        let turn = [[1.0, 0.3], [-0.3, 1.0], [-1.0, -0.3], [0.3, -1.0]][n as usize % 4];
        Neighbour {
            id: RobotId::new(&name).unwrap_or_else(|_| fail("id")),
            x: x + ring * turn[0],
            y: y + ring * turn[1],
            theta: 0.2 * n as f32 - 1.5,
            v: 0.2,
            w: 0.1,
            says: if behaviour == BehaviourName::Consensus {
                Some(Says::new(behaviour, &[20_500 - 100 * n, 3, 0]))
            } else {
                // On the same round, or for the same tasks.
                known.says
            },
        }
    });
    let digest = CellDigest {
        x: half,
        y: 0,
        timestamp: 0,
        count: EACH as u16,
        robots: robots.collect(),
    };
    let mut buffer = [0; MAX_MESSAGE];
    let length = digest
        .to_json(&mut buffer)
        .unwrap_or_else(|_| fail("a digest"));
    let now = Instant::from_micros(rig.now_us.get());
    if !robot.observe_cell((half, 0), &buffer[..length], now) {
        fail("a digest was dropped");
    }
}
