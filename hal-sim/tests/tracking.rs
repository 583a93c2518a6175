//! Where robots think they are, against where they are.

use crate::common::{lockstep, scenario};
use crawler_hal::{Duration, Instant};
use crawler_protocol::{Telemetry, Topic};
use crawler_sim::run::Simulation;

const ROBOTS: usize = 10;

/// Distance, angle and the robot's own sigma.
#[derive(Debug, Clone, Copy)]
struct Error {
    way: f32,
    turn: f32,
    sigma: f32,
}

fn error(simulation: &Simulation, robot: usize, told: crawler_protocol::Pose) -> Error {
    let truth = simulation.observe(robot).unwrap().pose;
    Error {
        way: (told.x - truth.x).hypot(told.y - truth.y),
        turn: libm::remainderf(told.theta - truth.theta, core::f32::consts::TAU).abs(),
        sigma: told.sigma,
    }
}

fn errors(simulation: &Simulation) -> Vec<Error> {
    (0..ROBOTS)
        .map(|robot| {
            error(
                simulation,
                robot,
                simulation.robot(robot).unwrap().snapshot().pose,
            )
        })
        .collect()
}

#[test]
fn with_a_tracker_telemetry_says_where_robots_are() {
    let mut all = Vec::new();
    for seed in [1, 2, 3] {
        let mut simulation = lockstep("arena", ROBOTS as u32, seed);
        simulation.run_until(Instant::from_millis(3_000));
        let _ = simulation.network().unwrap().take_record();
        let mut contacts = 0;
        // In steps so short that a message of the last one is not old.
        for _ in 0..5_700 {
            simulation.run_for(Duration::from_millis(10));
            for message in simulation.network().unwrap().take_record() {
                let Ok(Topic::Telemetry(id)) = Topic::parse(simulation.fleet(), &message.topic)
                else {
                    continue;
                };
                let robot = (0..ROBOTS)
                    .find(|&robot| simulation.id(robot) == Some(&id))
                    .unwrap();
                let telemetry = Telemetry::from_json(&message.payload).unwrap();
                all.push(error(&simulation, robot, telemetry.pose));
            }
        }
        for robot in 0..ROBOTS {
            contacts += simulation.observe(robot).unwrap().contacts;
        }
        println!("seed {seed}: {contacts} contacts");
    }
    let worst = |of: fn(&Error) -> f32| all.iter().map(of).fold(0.0, f32::max);
    let mean = all.iter().map(|e| e.way).sum::<f32>() / all.len() as f32;
    let beyond = all.iter().filter(|e| e.way > 0.10 || e.turn > 0.2).count();
    println!(
        "{} messages, {mean} m mean, {} m and {} rad worst, {beyond} beyond",
        all.len(),
        worst(|e| e.way),
        worst(|e| e.turn)
    );
    assert!(all.len() > 3 * ROBOTS * 57 * 4);
    assert!(worst(|e| e.turn) <= 0.2);
    // A robot that pushes against something goes on in its mind until the next fix, half a second
    // later: rare, and no more than what it drives in that time.
    assert!(beyond * 1_000 <= all.len(), "{beyond} of {}", all.len());
    assert!(worst(|e| e.way) <= 0.2);
}

#[test]
fn without_a_tracker_sigma_grows_with_the_error() {
    let mut scenario = scenario("arena", ROBOTS as u32);
    scenario.tracker.on = false;
    let mut simulation = Simulation::lockstep(scenario, 1).unwrap();
    // Without a reference the frame of a robot is its own: errors are those of its way.
    let starts: Vec<_> = (0..ROBOTS)
        .map(|robot| simulation.observe(robot).unwrap().pose)
        .collect();
    let (mut within, mut looks) = (0, 0);
    let mut last = [0.0; ROBOTS];
    for second in 1..=60_u64 {
        simulation.run_until(Instant::from_millis(second * 1_000));
        for (robot, start) in starts.iter().enumerate() {
            let told = simulation.robot(robot).unwrap().snapshot().pose;
            let (sin, cos) = start.theta.sin_cos();
            let moved = crawler_protocol::Pose {
                x: start.x + told.x * cos - told.y * sin,
                y: start.y + told.x * sin + told.y * cos,
                theta: start.theta + told.theta,
                sigma: told.sigma,
            };
            let error = error(&simulation, robot, moved);
            assert!(error.sigma >= last[robot], "sigma shrinks by itself");
            last[robot] = error.sigma;
            looks += 1;
            within += u32::from(error.way <= 2.0 * error.sigma + 0.001);
            if second % 20 == 0 {
                println!("{second} s, {robot}: {error:?}");
            }
        }
    }
    println!("{within} of {looks} within two sigmas");
    assert!(last.iter().all(|&sigma| sigma > 0.3), "{last:?}");
    assert!(within * 10 >= looks * 9, "{within} of {looks}");
}

#[test]
fn a_robot_that_reboots_is_found_again() {
    let mut simulation = lockstep("arena", ROBOTS as u32, 4);
    simulation.run_until(Instant::from_millis(8_000));
    simulation.submit(3, crawler_protocol::Action::Reboot);
    simulation.run_for(Duration::from_millis(6_000));
    assert_eq!(simulation.boots(3), 2);
    let found = errors(&simulation)[3];
    assert!(found.way < 0.1 && found.turn < 0.2, "{found:?}");
}
