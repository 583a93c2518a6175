//! The same seed, scenario and calls give the same history.

use crate::common::{forward, lockstep, wander};
use crawler_hal::{Duration, Instant};
use crawler_protocol::Action;
use crawler_sim::net::lockstep::Cut;
use crawler_sim::run::Simulation;

const ROBOTS: u32 = 12;

fn world(seed: u64) -> Simulation {
    lockstep("arena", ROBOTS, seed)
}

/// Commands, a partition and a reboot, at the moments of a script.
fn interfere(simulation: &mut Simulation, tick: u64) {
    match tick {
        14 => {
            simulation.submit(2, forward(70, 3_000));
        }
        15 => simulation.cut(3, Cut::Silent),
        18 => {
            simulation.submit_all(Action::Stop);
        }
        20 => {
            simulation.submit(4, Action::Reboot);
        }
        21 => {
            simulation.submit_all(wander());
        }
        26 => simulation.cut(3, Cut::None),
        _ => {}
    }
}

fn run(seed: u64, commands: bool) -> u64 {
    let mut simulation = world(seed);
    for tick in 0..40 {
        if commands {
            interfere(&mut simulation, tick);
        }
        simulation.run_for(Duration::from_millis(500));
    }
    simulation.history_hash()
}

#[test]
fn repeated_runs_are_equal_and_seeds_and_commands_matter() {
    let first = run(11, false);
    assert_eq!(first, run(11, false));
    assert_ne!(first, run(12, false));
    let commanded = run(11, true);
    assert_ne!(first, commanded);
    assert_eq!(commanded, run(11, true));
}

#[test]
fn the_cut_of_a_run_into_pieces_does_not_matter() {
    let mut whole = world(5);
    whole.run_until(Instant::from_millis(12_000));
    let mut pieces = world(5);
    for at in (0..12_000).step_by(7).chain([12_000]) {
        pieces.run_until(Instant::from_millis(at));
    }
    assert_eq!(whole.history_hash(), pieces.history_hash());
}

#[test]
fn worlds_interleaved_in_one_thread_do_not_disturb_each_other() {
    let mut worlds: Vec<Simulation> = [21, 22, 21].map(world).into();
    for tick in 0..40 {
        for simulation in &mut worlds {
            interfere(simulation, tick);
            simulation.run_for(Duration::from_millis(500));
        }
    }
    let hashes: Vec<u64> = worlds.iter().map(Simulation::history_hash).collect();
    assert_eq!(hashes[0], run(21, true));
    assert_eq!(hashes[1], run(22, true));
    assert_eq!(hashes[0], hashes[2]);
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let seeds: Vec<u64> = (30..34).collect();
    let expected: Vec<u64> = seeds.iter().map(|&seed| run(seed, true)).collect();
    for threads in [1, 2, 4] {
        let found: Vec<u64> = std::thread::scope(|scope| {
            let workers: Vec<_> = seeds
                .chunks(seeds.len() / threads)
                .map(|part| {
                    scope
                        .spawn(move || part.iter().map(|&seed| run(seed, true)).collect::<Vec<_>>())
                })
                .collect();
            workers
                .into_iter()
                .flat_map(|worker| worker.join().unwrap())
                .collect()
        });
        assert_eq!(found, expected, "{threads} threads");
    }
}
