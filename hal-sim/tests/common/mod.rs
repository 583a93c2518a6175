//! What the tests of simulations share.

pub(crate) mod chaos;
#[cfg(feature = "live")]
pub(crate) mod port;
pub(crate) mod watch;

use std::collections::BTreeMap;

use crawler_protocol::{Action, BehaviourSpec, Direction, Response, ResponseStatus, Topic};
use crawler_sim::net::lockstep::Origin;
use crawler_sim::run::Simulation;
use crawler_sim::scenario::Scenario;
use crawler_sim::world::PHYSICS_STEP;

pub(crate) fn scenario(name: &str, robots: u32) -> Scenario {
    Scenario::built_in(name).unwrap().with_robots(robots)
}

pub(crate) fn lockstep(name: &str, robots: u32, seed: u64) -> Simulation {
    let simulation = Simulation::lockstep(scenario(name, robots), seed).unwrap();
    simulation.network().unwrap().record(200_000);
    simulation
}

pub(crate) fn forward(speed: u8, duration_ms: u32) -> Action {
    Action::Move {
        direction: Direction::Forward,
        speed,
        duration_ms,
    }
}

pub(crate) fn wander() -> Action {
    Action::Behave(BehaviourSpec::Wander { speed: 60 })
}

/// Lets the robots boot, connect and learn the time.
pub(crate) fn settle(simulation: &mut Simulation) {
    simulation.run_until(crawler_hal::Instant::from_millis(5_500));
}

/// Answers to a command of each robot so far, without repetitions on the wire.
pub(crate) type Answers = BTreeMap<(String, u64), Vec<ResponseStatus>>;

/// Adds the answers recorded since the last call.
pub(crate) fn collect(simulation: &Simulation, answers: &mut Answers) {
    let network = simulation.network().unwrap();
    for published in network.take_record() {
        let topic = Topic::parse(simulation.fleet(), &published.topic).unwrap();
        if let Topic::Response(robot) = topic
            && published.origin != Origin::Repeated
        {
            let response = Response::from_json(&published.payload).unwrap();
            assert_eq!(response.robot, robot);
            let key = (robot.as_str().to_owned(), response.seq);
            answers.entry(key).or_default().push(response.status);
        }
    }
    assert_eq!(network.statistics().unrecorded, 0);
}

pub(crate) fn duty(simulation: &Simulation, robot: usize) -> [i16; 2] {
    simulation.observe(robot).unwrap().duty
}

/// Overlap with something fixed that rounding may leave, metres.
const OVERLAP_M: f32 = 2e-5;
/// The same of two robots, of which both round.
const MUTUAL_M: f32 = 5e-5;

/// Lets tenths of a second pass, and returns how far each robot went. In no step of the physics may
/// a robot be where anything else is, nor go so far that it could have passed through something
/// between two steps.
pub(crate) fn travel(simulation: &mut Simulation, tenths: u32) -> Vec<f32> {
    let arena = simulation.world().arena();
    let parameters = simulation.scenario().parameters;
    let radius = parameters.chassis.radius_m;
    // A push may make a robot a quarter faster than it is by itself.
    let stride = parameters.top_speed() * 1.25 * PHYSICS_STEP.as_secs_f32() + OVERLAP_M;
    assert!(stride < radius * 0.5, "the steps are short enough to tell");
    let poses = |simulation: &Simulation| -> Vec<_> {
        let seen = (0..simulation.robots()).map(|robot| simulation.observe(robot).unwrap());
        seen.map(|seen| seen.pose).collect()
    };
    let mut last = poses(simulation);
    let mut travelled = vec![0.0_f32; last.len()];
    for _ in 0..tenths * 10 {
        simulation.run_for(PHYSICS_STEP);
        let now = poses(simulation);
        for (robot, pose) in now.iter().enumerate() {
            let depth = radius - arena.clearance(pose.x, pose.y);
            assert!(depth <= OVERLAP_M, "{robot} is {depth} m in something");
            for (other, there) in now.iter().enumerate().skip(robot + 1) {
                let depth = 2.0 * radius - (pose.x - there.x).hypot(pose.y - there.y);
                assert!(depth <= MUTUAL_M, "{robot} is {depth} m in {other}");
            }
            let way = (pose.x - last[robot].x).hypot(pose.y - last[robot].y);
            assert!(way <= stride, "{robot} went {way} m in a step");
            travelled[robot] += way;
        }
        last = now;
    }
    travelled
}
