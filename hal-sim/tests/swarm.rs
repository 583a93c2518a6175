//! Robots that move by where others are: the whole program, told by the broker who is near.

use crate::common::{lockstep, scenario, settle};
use crawler_hal::Duration;
use crawler_protocol::{Action, BehaviourName, BehaviourSpec, Topic};
use crawler_sim::run::Simulation;
use crawler_sim::run::parallel::{Plan, run};
use crawler_sim::scenario::Scenario;

const ROBOTS: u32 = 12;

fn poses(simulation: &Simulation) -> Vec<[f32; 3]> {
    (0..simulation.robots())
        .map(|robot| simulation.pose(robot).expect("is there"))
        .map(|pose| [pose.x, pose.y, pose.theta])
        .collect()
}

/// Distance of each robot to the one nearest to it.
fn nearest(poses: &[[f32; 3]]) -> Vec<f32> {
    let apart = |a: &[f32; 3], b: &[f32; 3]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let all = poses.iter().enumerate();
    all.map(|(own, a)| {
        let others = poses.iter().enumerate().filter(|(other, _)| *other != own);
        others
            .map(|(_, b)| apart(a, b))
            .fold(f32::INFINITY, f32::min)
    })
    .collect()
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}

fn cells_listened_to(simulation: &Simulation) -> usize {
    let network = simulation.network().expect("lockstep");
    let near = -12..12_i16;
    near.clone()
        .flat_map(|x| near.clone().map(move |y| Topic::Cell { x, y }))
        .map(|topic| topic.render(simulation.fleet()))
        .filter(|topic| network.listens("sim-0001", topic))
        .count()
}

/// After `seconds` of the behaviour.
fn behave(spec: BehaviourSpec, seconds: u64) -> Simulation {
    let mut simulation = lockstep("empty", ROBOTS, 5);
    settle(&mut simulation);
    assert_eq!(cells_listened_to(&simulation), 0, "nobody needs to know");
    simulation.submit_all(Action::Behave(spec));
    simulation.run_for(Duration::from_secs(seconds));
    simulation
}

#[test]
fn dispersing_robots_leave_each_other_room_and_stop_listening_when_told() {
    let mut simulation = behave(BehaviourSpec::Disperse, 60);
    let apart = nearest(&poses(&simulation));
    assert!(mean(&apart) > 1.0, "{apart:?}");
    assert_eq!(cells_listened_to(&simulation), 9);
    let robot = simulation.robot(0).expect("is there").snapshot();
    assert_eq!(robot.behaviour, BehaviourName::Disperse);
    simulation.submit_all(Action::Stop);
    simulation.run_for(Duration::from_secs(5));
    assert_eq!(cells_listened_to(&simulation), 0);
}

#[test]
fn gathering_robots_come_together() {
    let mut simulation = behave(BehaviourSpec::Disperse, 40);
    let before = mean(&nearest(&poses(&simulation)));
    simulation.submit_all(Action::Behave(BehaviourSpec::Gather { x: 0.0, y: 0.0 }));
    simulation.run_for(Duration::from_secs(90));
    let apart = nearest(&poses(&simulation));
    assert!(mean(&apart) < 0.6, "{apart:?}");
    assert!(mean(&apart) < 0.6 * before, "{before} before, {apart:?}");
}

#[test]
fn a_formation_keeps_its_distances() {
    let simulation = behave(BehaviourSpec::Formation, 90);
    let apart = nearest(&poses(&simulation));
    let in_place = apart.iter().filter(|d| (0.55..1.05).contains(*d)).count();
    assert!(in_place * 4 >= apart.len() * 3, "{apart:?}");
}

#[test]
fn a_flock_keeps_moving_and_nobody_is_run_into_for_long() {
    let mut simulation = behave(BehaviourSpec::Flock, 30);
    let before = poses(&simulation);
    simulation.run_for(Duration::from_secs(10));
    let after = poses(&simulation);
    let ways: Vec<f32> = before
        .iter()
        .zip(&after)
        .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
        .collect();
    assert!(mean(&ways) > 0.3, "{ways:?}");
}

/// Thirty on nine square metres, of whom each had six contacts in a minute before they kept off each other.
#[test]
fn who_wanders_in_a_crowd_gets_on_and_hardly_touches_anybody() {
    let (mut contacts, mut driven) = (0, 0.0);
    for seed in [1, 2] {
        let mut simulation = Simulation::lockstep(scenario("crowd", 30), seed).expect("a world");
        settle(&mut simulation);
        let mut before = poses(&simulation);
        for _ in 0..120 {
            simulation.run_for(Duration::from_millis(500));
            let after = poses(&simulation);
            let ways = before.iter().zip(&after);
            driven += ways
                .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
                .sum::<f32>();
            before = after;
        }
        let each = (0..simulation.robots()).filter_map(|robot| simulation.observe(robot));
        contacts += each.map(|seen| seen.contacts).sum::<u32>();
    }
    // Measured: 0.25 contacts each, nearly all with walls, and 6 m.
    assert!(contacts <= 60, "{contacts} contacts of sixty robots");
    assert!(driven > 60.0 * 4.0, "{driven} m");
}

#[test]
fn the_history_of_a_swarm_is_the_same_on_two_threads() {
    let arena: Scenario = scenario("arena", 16);
    let outcome = |threads| {
        let plan = Plan {
            scenario: &arena,
            seed: 9,
            network: true,
            threads,
            span: Duration::from_secs(14),
        };
        let script = |simulation: &mut Simulation, now: crawler_hal::Instant| {
            if now.as_millis() == 6_000 {
                simulation.submit_all(Action::Behave(BehaviourSpec::Formation));
            }
            Some(now + Duration::from_secs(1))
        };
        run(&plan, script).expect("runs")
    };
    let (one, two) = (outcome(1), outcome(2));
    assert_eq!(one.history, two.history);
}
