//! Both ways to wire a ranger, alone and mixed in one simulation.

use crate::common::{scenario, settle, travel};
use crawler_app::perception::Sight;
use crawler_hal::Duration;
use crawler_protocol::Action;
use crawler_sim::run::Simulation;
use crawler_sim::scenario::Scenario;
use crawler_sim::world::Wiring;

const ROBOTS: usize = 16;

fn pulse() -> Scenario {
    let mut scenario = scenario("arena", ROBOTS as u32);
    scenario.parameters.ranger.wiring = Wiring::Pulse;
    scenario
}

fn mixed() -> Scenario {
    let mut scenario = scenario("arena", ROBOTS as u32);
    scenario.spawn.pulse_share = Some(0.5);
    scenario
}

fn wired_for_pulses(simulation: &Simulation) -> usize {
    let indices = (0..ROBOTS).map(|robot| simulation.index(robot).unwrap());
    indices
        .filter(|&index| simulation.world().wiring(index) == Some(Wiring::Pulse))
        .count()
}

fn everyone_wanders(simulation: &mut Simulation) {
    for (robot, travelled) in travel(simulation, 200).iter().enumerate() {
        assert!(*travelled > 0.5, "{robot} went only {travelled} m");
    }
}

/// Robots that stand read what is there. Returns how many readings were compared.
fn readings_are_true(simulation: &mut Simulation) -> usize {
    simulation.submit_all(Action::Stop);
    simulation.run_for(Duration::from_secs(2));
    let ranger = simulation.scenario().parameters.ranger;
    let mut compared = 0;
    for _ in 0..20 {
        simulation.run_for(Duration::from_millis(240));
        for robot in 0..ROBOTS {
            let index = simulation.index(robot).unwrap();
            let truth = simulation.world().true_range(index);
            // Clocks of programs count from their boot, and nobody has booted twice.
            assert_eq!(simulation.boots(robot), 1);
            let read = simulation.robot(robot).unwrap().snapshot().reading;
            let read = read.fresh(simulation.now()).expect("the ranger works");
            let wiring = simulation.world().wiring(index).unwrap();
            let told = format!("robot {robot} ({wiring:?}) reads {read:?}, true is {truth:?}");
            match (read, truth) {
                (Sight::Range(mm), Some(metres)) => {
                    let true_mm = metres * 1e3;
                    // Five deviations, one to round, and half a percent for the temperature of
                    // the air, which a robot wired for pulses takes for 20 °C.
                    let noise = ranger.noise_mm + ranger.noise_share * true_mm;
                    let within = 5.0 * noise + 1.0 + 0.005 * true_mm;
                    assert!((f32::from(mm.0) - true_mm).abs() <= within, "{told}");
                    compared += 1;
                }
                (Sight::Clear, None) => compared += 1,
                _ => panic!("{told}"),
            }
        }
    }
    compared
}

#[test]
fn robots_wired_for_pulses_wander_and_read_what_is_there() {
    let mut simulation = Simulation::lockstep(pulse(), 3).unwrap();
    assert_eq!(wired_for_pulses(&simulation), ROBOTS);
    settle(&mut simulation);
    everyone_wanders(&mut simulation);
    assert_eq!(readings_are_true(&mut simulation), 20 * ROBOTS);
}

#[test]
fn robots_of_both_wirings_share_a_simulation() {
    let mut simulation = Simulation::lockstep(mixed(), 4).unwrap();
    assert_eq!(wired_for_pulses(&simulation), ROBOTS / 2);
    settle(&mut simulation);
    everyone_wanders(&mut simulation);
    assert_eq!(readings_are_true(&mut simulation), 20 * ROBOTS);
}

#[test]
fn a_wiring_outlives_a_reboot() {
    let mut simulation = Simulation::lockstep(mixed(), 4).unwrap();
    settle(&mut simulation);
    simulation.submit_all(Action::Reboot);
    simulation.run_for(Duration::from_secs(8));
    assert_eq!(wired_for_pulses(&simulation), ROBOTS / 2);
    for robot in 0..ROBOTS {
        assert_eq!(simulation.boots(robot), 2);
        let health = simulation.robot(robot).unwrap().snapshot().reading.health;
        assert_eq!(health, crawler_app::perception::SensorHealth::Good);
    }
}
