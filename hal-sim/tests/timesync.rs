//! How wrong the clocks of robots are that only hear the server's time messages.

use crawler_app::timesync::TimeSync;
use crawler_hal::{Duration, Instant};
use crawler_sim::net::lockstep::LinkModel;
use crawler_sim::run::{EPOCH_MS, Simulation};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg32;

/// What was measured over a link.
#[derive(Debug)]
struct Errors {
    /// After the first message, before there was a second one, and after a minute; milliseconds.
    first: i64,
    settled: i64,
    /// Ever ahead of the server.
    ahead: i64,
}

fn measure(link: LinkModel, robots: usize, seed: u64) -> Errors {
    let mut scenario = crate::common::scenario("arena", robots as u32);
    scenario.command = None;
    scenario.link = Some(link);
    let mut simulation = Simulation::lockstep(scenario, seed).unwrap();
    let mut errors = Errors {
        first: 0,
        settled: 0,
        ahead: 0,
    };
    for tenth in 1..6_000_u64 {
        simulation.run_until(Instant::BOOT + Duration::from_millis(100 * tenth));
        for robot in 0..robots {
            let now = simulation.now();
            let Some(told) = simulation.robot(robot).unwrap().unix_ms(now) else {
                // The second message comes at 5 s, and loss can hold it up.
                assert!(tenth < 150, "no time at all");
                continue;
            };
            let behind = simulation.unix_ms() as i64 - told as i64;
            errors.first = errors.first.max(behind);
            if tenth >= 600 {
                errors.settled = errors.settled.max(behind);
            }
            errors.ahead = errors.ahead.max(-behind);
        }
    }
    errors
}

/// A robot's clock is behind by the shortest delay that a message has had, never ahead.
#[test]
fn clocks_are_behind_by_the_shortest_delay_and_never_ahead() {
    let link = |latency_ms, jitter_ms, loss| LinkModel {
        latency_ms,
        jitter_ms,
        loss,
        ..LinkModel::default()
    };
    println!(
        "| latency, ms | jitter, ms | loss, % | at first, ms | after a minute, ms | ahead, ms |"
    );
    println!("|---:|---:|---:|---:|---:|---:|");
    for (model, most) in [
        (link(2.0, 3.0, 0.0), 6),
        (link(20.0, 50.0, 0.01), 60),
        (link(5.0, 200.0, 0.05), 130),
        (link(100.0, 500.0, 0.1), 450),
    ] {
        let errors = measure(model, 20, 5);
        println!(
            "| {} | {} | {} | {} | {} | {} |",
            model.latency_ms,
            model.jitter_ms,
            model.loss * 100.0,
            errors.first,
            errors.settled,
            errors.ahead
        );
        assert!(errors.settled <= most, "{model:?}: {errors:?}");
        // Whole milliseconds are rounded down on both sides.
        assert!(errors.ahead <= 1, "{model:?}: {errors:?}");
        let least = model.latency_ms as i64 - 1;
        assert!(errors.first >= least, "nothing was measured: {errors:?}");
    }
}

/// The same with clocks that drift as crystals may, for an hour: 100 ppm either way.
#[test]
fn a_drifting_clock_is_followed() {
    println!("| drift, ppm | behind, ms | ahead, ms |");
    println!("|---:|---:|---:|");
    for ppm in [-100_i64, 0, 100] {
        let mut rng = Pcg32::seed_from_u64(9);
        let sync = TimeSync::<NoopRawMutex>::new();
        let local = |server_us: i64| {
            let drifted = server_us + server_us / 1_000_000 * ppm;
            Instant::from_micros(u64::try_from(drifted).unwrap())
        };
        let (mut behind, mut ahead) = (0, 0);
        for message in 1..720_i64 {
            let sent_us = message * 5_000_000;
            // 5 ms, up to 200 ms more, and in one of twenty cases a segment sent again.
            let mut delay_us = 5_000 + i64::from(rng.next_u32() % 200_000);
            if rng.next_u32().is_multiple_of(20) {
                delay_us += 200_000;
            }
            let now = local(sent_us + delay_us);
            sync.observe(EPOCH_MS + sent_us.unsigned_abs() / 1_000, now);
            if message < 12 {
                continue;
            }
            for later_us in [0, 4_500_000] {
                let at = sent_us + delay_us + later_us;
                let told = sync.unix_ms(local(at)).unwrap() as i64 - EPOCH_MS as i64;
                behind = behind.max(at / 1_000 - told);
                ahead = ahead.max(told - at / 1_000);
            }
        }
        println!("| {ppm} | {behind} | {ahead} |");
        assert!(behind <= 80 && ahead <= 25, "{ppm} ppm: {behind}, {ahead}");
    }
}
