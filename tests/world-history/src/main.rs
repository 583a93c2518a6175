//! Prints the history of a few worlds, second by second: the same on every target.
//!
//! `cargo run --package crawler-world-history [threads]`; `cargo xtask histories` compares targets.

use std::error::Error;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, BehaviourSpec, Direction};
use crawler_sim::faults::{Fault, Wheel};
use crawler_sim::net::lockstep::{Cut, LinkModel};
use crawler_sim::net::radio::Radio;
use crawler_sim::run::Simulation;
use crawler_sim::run::parallel::{Plan, run};
use crawler_sim::scenario::Scenario;

/// Of the faults below, and the robots that have them.
const SOUND: &str = "a sound fault of a robot that is there";

const TICK: Duration = Duration::from_millis(500);

/// Scenario, robots, virtual seconds and whether there is a network.
const WORLDS: [(&str, u32, u64, bool); 3] = [
    ("arena", 12, 20, true),
    ("corridor", 8, 15, true),
    ("arena", 6, 15, false),
];

fn main() -> Result<(), Box<dyn Error>> {
    let threads = std::env::args().nth(1).map_or(Ok(1), |text| text.parse())?;
    for (name, robots, seconds, network) in WORLDS {
        let mut scenario = Scenario::built_in(name)?.with_robots(robots);
        scenario.spawn.pulse_share = Some(0.5);
        scenario.spawn.camera_share = 0.25;
        let loss = 0.05;
        scenario.link = Some(LinkModel {
            loss,
            ..LinkModel::default()
        });
        scenario.radio = Some(Radio::default());
        let plan = Plan {
            scenario: &scenario,
            seed: 7,
            network,
            threads,
            span: Duration::from_secs(seconds),
        };
        let outcome = run(&plan, script)?;
        println!("world {name} robots {robots} network {network}");
        for second in outcome.hashes.iter() {
            println!("{second}");
        }
        println!("history {:016x}", outcome.history);
        println!("polls {}", outcome.polls);
        println!("messages {}", outcome.statistics.received);
        // The bits, and enough to see that something happened.
        for (robot, seen) in outcome.robots.iter().enumerate() {
            let pose = [seen.pose.x, seen.pose.y, seen.pose.theta].map(f32::to_bits);
            println!(
                "robot {robot} pose {pose:08x?} contacts {} boots {}",
                seen.contacts, outcome.boots[robot]
            );
        }
    }
    Ok(())
}

/// Commands, faults, a partition, a reboot, a removal and a newcomer.
#[allow(clippy::unnecessary_wraps)] // Scripts may end; this one goes on.
fn script(simulation: &mut Simulation, now: Instant) -> Option<Instant> {
    let wheel = Wheel::Right;
    match now.as_millis() / TICK.as_millis() {
        12 => drop(simulation.submit_all(Action::Behave(BehaviourSpec::Wander { speed: 60 }))),
        14 => drop(simulation.submit(
            1,
            Action::Move {
                direction: Direction::Left,
                speed: 70,
                duration_ms: 2_000,
            },
        )),
        15 => simulation.cut(2, Cut::Silent),
        16 => {
            let strength = 0.6;
            let weak = Fault::MotorWeak { wheel, strength };
            let lasting = Some(Duration::from_secs(3));
            simulation.inject(3, weak, lasting).expect(SOUND);
        }
        17 => {
            let noise = Fault::LineNoise { flips: 0.01 };
            simulation.inject(4, noise, None).expect(SOUND);
        }
        18 => drop(simulation.submit(0, Action::Reboot)),
        20 => simulation.remove(5),
        21 => drop(simulation.spawn()),
        22 => simulation.cut(2, Cut::None),
        23 => drop(simulation.submit(0, Action::Capture)),
        _ => {}
    }
    Some(now + TICK)
}
