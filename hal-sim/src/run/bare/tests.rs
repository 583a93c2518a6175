//! Bare worlds beside worlds with programs, and as values.

use crawler_app::motion::Twist;
use crawler_protocol::{Action, BehaviourSpec, Direction};
use proptest::prelude::*;

use super::state::{head, sealed};
use super::*;
use crate::run::Simulation;

const TENTH: Duration = Duration::from_millis(100);

fn crowded() -> Scenario {
    let mut scenario = Scenario::built_in("arena")
        .expect("it ships")
        .with_robots(8);
    scenario.command = None;
    scenario.spawn.pulse_share = Some(0.5);
    scenario
}

/// Largest distance between where a robot is under the firmware and in a bare world, metres,
/// over a minute of doing `task` from the first second on.
fn apart(scenario: &Scenario, seed: u64, action: &Action) -> f32 {
    let task = Task::from_action(action).expect("control carries it out");
    let mut whole = Simulation::without_network(scenario.clone(), seed).expect("sound");
    let mut bare = BareWorld::of_scenario(scenario, seed, Steering::Shipped).expect("sound");
    let first = Instant::from_millis(1_000);
    whole.run_until(first);
    bare.step(first - Instant::BOOT);
    whole.submit_all(action.clone());
    for robot in 0..bare.robots() as u32 {
        assert!(bare.order(RobotIndex::new(robot), task));
    }
    let mut farthest = 0.0_f32;
    let mut way = 0.0;
    let mut last: Vec<Pose> = Vec::new();
    for _ in 0..600 {
        whole.run_for(TENTH);
        bare.step(TENTH);
        let here: Vec<Pose> = (0..bare.robots())
            .map(|robot| {
                let index = RobotIndex::new(robot as u32);
                let a = whole.observe(robot).expect("it exists").pose;
                let b = bare.observe(index).expect("it exists").pose;
                farthest = farthest.max(libm::hypotf(a.x - b.x, a.y - b.y));
                b
            })
            .collect();
        for (now, then) in here.iter().zip(&last) {
            way += libm::hypotf(now.x - then.x, now.y - then.y) + (now.theta - then.theta).abs();
        }
        last = here;
    }
    assert!(way > 2.0, "they drove or turned: {way} m and rad");
    farthest
}

/// Both call the same functions at the same moments on the same numbers, so there is nothing to
/// tell them apart but the order of two events on one microsecond (see the module). A robot that
/// meets such a pair takes in a reading one period, 20 ms, later: at 0.6 m/s 12 mm, of which a
/// tenth is a generous share in one minute.
const BOUND_M: f32 = 0.001;

#[test]
fn the_firmware_and_the_bare_controller_go_the_same_way() {
    let actions = [
        Action::Behave(BehaviourSpec::Wander { speed: 80 }),
        Action::Scan,
        Action::Move {
            direction: Direction::Forward,
            speed: 60,
            duration_ms: 8_000,
        },
        Action::Drive { v: 0.2, w: 1.0 },
    ];
    for seed in [1, 2, 3] {
        for action in &actions[..if seed == 1 { 4 } else { 2 }] {
            let farthest = apart(&crowded(), seed, action);
            assert!(
                farthest <= BOUND_M,
                "{action:?} of seed {seed}: {farthest} m"
            );
        }
    }
}

fn wandering(seed: u64) -> BareWorld {
    let mut world = BareWorld::of_scenario(&crowded(), seed, Steering::Shipped).expect("sound");
    world.step(Duration::from_secs(1));
    for robot in 0..world.robots() as u32 {
        assert!(world.order(RobotIndex::new(robot), Task::Wander { speed: 100 }));
    }
    world
}

#[test]
fn a_seed_is_a_history_and_a_clone_goes_on_like_its_original() {
    let run = |seed| {
        let mut world = wandering(seed);
        world.step(Duration::from_secs(20));
        world
    };
    let (mut one, two) = (run(5), run(5));
    assert_eq!(one.hash(), two.hash());
    assert_ne!(one.hash(), run(6).hash());
    let mut copy = one.clone();
    one.step(Duration::from_secs(10));
    copy.step(Duration::from_secs(10));
    assert_eq!(one.hash(), copy.hash());
    assert_ne!(one.hash(), two.hash());
}

#[test]
fn a_stored_world_goes_on_where_it_was() {
    let mut world = wandering(7);
    // Not where the grid is built anew, and with measurements under way.
    for steps in [7_u32, 333, 1] {
        world.step(PERIOD * steps);
        let bytes = world.save();
        assert_eq!(bytes, world.save());
        let mut copy = BareWorld::load(&bytes).expect("just written");
        assert_eq!(copy.hash(), world.hash());
        let mut original = world.clone();
        for _ in 0..50 {
            copy.step(Duration::from_millis(200));
            original.step(Duration::from_millis(200));
            assert_eq!(copy.hash(), original.hash());
        }
    }
}

#[test]
fn bytes_that_are_no_world_are_refused_with_a_reason() {
    let bytes = wandering(1).save();
    assert_eq!(BareWorld::load(&[]).err(), Some(StateError::Foreign));
    assert_eq!(BareWorld::load(b"PNG....").err(), Some(StateError::Foreign));
    let mut newer = bytes.clone();
    newer[4] = 200;
    assert_eq!(
        BareWorld::load(&newer).err(),
        Some(StateError::Version(200))
    );
    for len in [4, 6, 13, 14, bytes.len() / 2, bytes.len() - 1] {
        let cut = BareWorld::load(&bytes[..len]);
        assert_eq!(cut.err(), Some(StateError::Damaged), "{len}");
    }
    let mut longer = bytes[head()..].to_vec();
    longer.push(0);
    let longer = sealed(&longer);
    assert_eq!(BareWorld::load(&longer).err(), Some(StateError::Damaged));
    assert!(StateError::Unsound("time").to_string().contains("time"));
}

proptest! {
    #![proptest_config(crawler_properties::cases(400))]

    /// Whoever changes bytes and seals them again gets an error, or a world that goes on.
    #[test]
    fn forged_bytes_do_no_harm(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut scenario = crowded().with_robots(2);
        scenario.arena.scatter.per_square_metre = 0.0;
        let mut world = BareWorld::of_scenario(&scenario, 1, Steering::Shipped).expect("sound");
        world.step(Duration::from_millis(1_000));
        world.order(RobotIndex::new(0), Task::Wander { speed: 50 });
        world.order(RobotIndex::new(1), Task::Scan);
        world.step(Duration::from_millis(260));
        let mut body = world.save()[head()..].to_vec();
        for (place, value) in changes {
            let at = place.index(body.len());
            body[at] = value;
        }
        if let Ok(mut world) = BareWorld::load(&sealed(&body)) {
            world.step(Duration::from_secs(4));
            let _ = world.hash();
            for robot in 0..world.robots() as u32 {
                let seen = world.observe(RobotIndex::new(robot)).expect("it exists");
                prop_assert!(seen.pose.x.is_finite() && seen.pose.y.is_finite());
            }
        }
    }
}

/// A robot of the caller's before a wall three metres ahead.
fn handed() -> (BareWorld, RobotIndex) {
    let mut world =
        BareWorld::new(Arena::empty(6.0, 6.0), Parameters::default(), 4).expect("sound");
    let robot = world
        .add_robot(Pose::new(0.0, 0.0, 0.0), Steering::Caller)
        .expect("free");
    (world, robot)
}

#[test]
fn the_caller_steers_by_what_a_program_would_see() {
    let (mut world, robot) = handed();
    let mut asked = 0;
    for _ in 0..20 {
        world.step_with(Duration::from_secs(1), |index, senses| {
            assert_eq!(index, robot);
            asked += 1;
            let free = senses
                .reading
                .range_mm(senses.now)
                .is_none_or(|mm| mm > 800);
            Some(if free {
                Drive::Twist(Twist { v: 0.3, w: 0.0 })
            } else {
                Drive::Stop
            })
        });
    }
    assert_eq!(asked, 20 * 50);
    let truth = world.observe(robot).expect("it exists");
    // The ranger sits 60 mm before the centre, and the robot rolls out.
    let gap = 3.0 - truth.pose.x - 0.06;
    assert!((0.65..0.85).contains(&gap), "{gap}");
    assert!(truth.speed.abs() < 0.01 && truth.contacts == 0);
    let senses = world.senses(robot).expect("it exists");
    let off = libm::hypotf(senses.pose.x - truth.pose.x, senses.pose.y - truth.pose.y);
    assert!(off < 0.4, "odometry without encoders: {off}");
    assert!(senses.battery.voltage.is_some() && senses.reading.temperature.is_some());
    assert_eq!(world.state(robot), None);
    assert!(!world.order(robot, Task::Scan) && !world.halt(robot, true));
}

#[test]
fn what_the_caller_said_last_goes_on_and_changes_by_ramps() {
    let (mut world, robot) = handed();
    world.step_with(PERIOD, |_, _| Some(Drive::Duties([0.6, 0.6])));
    let first = world.senses(robot).expect("it exists").duties;
    assert!(first[0] > 0.0 && first[0] < 0.2, "{first:?}");
    world.step(Duration::from_secs(1));
    assert_eq!(world.senses(robot).expect("it exists").duties, [0.6, 0.6]);
    // A reversal stands for 40 ms before it begins.
    world.step_with(PERIOD, |_, _| Some(Drive::Duties([-0.6, -0.6])));
    let mut stood = 0;
    for _ in 0..50 {
        world.step(PERIOD);
        let duty = world.observe(robot).expect("it exists").duty;
        stood += u32::from(duty == [0, 0]);
    }
    assert!(stood >= 2, "{stood}");
    assert_eq!(world.observe(robot).expect("it exists").duty, [-153, -153]);
    world.step_with(PERIOD, |_, _| {
        Some(Drive::Twist(Twist {
            v: f32::NAN,
            w: f32::INFINITY,
        }))
    });
    world.step(Duration::from_secs(1));
    assert_eq!(world.observe(robot).expect("it exists").duty, [0, 0]);
}

#[test]
fn orders_are_answered_and_a_halt_is_obeyed_at_once() {
    let (mut world, _) = handed();
    let robot = world
        .add_robot(Pose::new(-2.0, 1.0, 0.0), Steering::Shipped)
        .expect("free");
    world.step(Duration::from_secs(1));
    assert_eq!(world.state(robot), Some(RobotState::Idle));
    let task = Task::Move {
        direction: Direction::Forward,
        speed: 50,
        duration_ms: 2_000,
    };
    assert!(world.order(robot, task));
    world.step(Duration::from_secs(1));
    assert_eq!(world.answer(robot), None);
    assert_eq!(world.state(robot), Some(RobotState::Moving));
    world.step(Duration::from_secs(2));
    assert_eq!(world.answer(robot), Some(ResponseStatus::Completed));
    assert!(world.order(robot, Task::Wander { speed: 50 }));
    world.step(Duration::from_secs(1));
    assert!(world.halt(robot, true));
    assert_eq!(world.observe(robot).expect("it exists").duty, [0, 0]);
    assert_eq!(world.state(robot), Some(RobotState::Error));
    assert!((0..4).all(|_| world.order(robot, Task::Scan)));
    assert!(!world.order(robot, Task::Scan), "four wait already");
    world.step(Duration::from_secs(1));
    assert_eq!(world.answer(robot), Some(ResponseStatus::Rejected));
    assert!(!world.halt(RobotIndex::new(9), false));
}

#[test]
fn a_pack_that_gives_out_and_comes_back_starts_the_robot_anew() {
    let mut parameters = Parameters::default();
    parameters.pack.charge = 0.3;
    parameters.spread = crate::world::Spread::NONE;
    // Sags below the brown-out voltage as soon as the motors start.
    parameters.pack.internal_ohm = 1.9;
    parameters.pack.brown_out_v = 6.6;
    let arena = Arena::empty(6.0, 6.0);
    let mut world = BareWorld::new(arena, parameters, 4).expect("sound");
    let robot = world
        .add_robot(Pose::new(0.0, 0.0, 0.0), Steering::Caller)
        .expect("free");
    world.step(Duration::from_secs(1));
    let mut before = world.senses(robot).expect("it exists").now;
    assert_eq!(before, Instant::from_millis(1_000));
    let mut boots = 0;
    for _ in 0..200 {
        world.step_with(PERIOD, |_, _| Some(Drive::Duties([1.0, 1.0])));
        let now = world.senses(robot).expect("it exists").now;
        if now < before {
            boots += 1;
            assert_eq!(world.senses(robot).expect("it exists").duties, [0.0; 2]);
            assert_eq!(now, Instant::BOOT);
        }
        before = now;
    }
    assert!(boots > 0, "it never browned out");
}
