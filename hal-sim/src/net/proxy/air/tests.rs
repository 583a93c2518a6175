//! Delays, shares and partitions in virtual time: no socket, and nobody's clock.

use super::*;
use crate::net::radio::{Partition, Radio, Setup, WINDOW_US};
use crate::world::RadioFigures;

/// A link that costs next to nothing.
const QUICK: LinkModel = LinkModel {
    latency_ms: 0.1,
    jitter_ms: 0.0,
    loss: 0.0,
    retransmit_ms: 5.0,
    rssi_dbm: -55,
};

/// Figures that leave nothing to chance.
fn figures() -> RadioFigures {
    RadioFigures {
        shadowing_db: 0.0,
        fading_db: 0.0,
        contention: 0.0,
        ..RadioFigures::default()
    }
}

fn shared(setup: Setup) -> Shared {
    Shared::new(&ProxyConfig {
        listen: ([127, 0, 0, 1], 0).into(),
        broker: Vec::new(),
        setup,
        most_connections: 1,
    })
}

fn plain(link: LinkModel) -> Shared {
    shared(Setup {
        link,
        radio: None,
        figures: figures(),
        seed: 1,
    })
}

#[test]
fn a_word_takes_the_latency_and_a_lost_one_its_repetitions() {
    let link = LinkModel {
        latency_ms: 20.0,
        ..QUICK
    };
    let calm = plain(link);
    let station = calm.station("r");
    for word in 0..1_000 {
        let arrival = calm.transit(station, Direction::Up, 1, word).unwrap();
        assert_eq!(arrival, word + 20_000);
    }
    let lossy = plain(LinkModel {
        loss: 0.3,
        retransmit_ms: 50.0,
        ..link
    });
    let station = lossy.station("r");
    let words = 20_000_u32;
    let mut delays: BTreeMap<u64, u32> = BTreeMap::new();
    for _ in 0..words {
        let arrival = lossy.transit(station, Direction::Down, 1, 0).unwrap();
        *delays.entry(arrival).or_default() += 1;
    }
    // Sent again after 50 ms, then after 100, 200 and so on. Three in ten get no further each time.
    let mut share = 1.0;
    for (times, delay) in [20_000, 70_000, 170_000, 370_000].into_iter().enumerate() {
        let want = share * 0.7;
        share *= 0.3;
        let found = f64::from(delays.remove(&delay).unwrap_or(0)) / f64::from(words);
        // Four standard deviations of the largest share.
        assert!(
            (found - want).abs() < 0.013,
            "{times} times: {found}, {want}"
        );
    }
    assert!(delays.keys().all(|&delay| delay > 370_000), "{delays:?}");
}

/// What a link at the slowest scheme carries, bytes in a second: 6.5 Mbit/s, segments of 1460
/// bytes with 90 around them and an acknowledgement of 90, 180 µs around each frame. One frame
/// in ten is lost and sent again.
const WEAK_RATE: f64 = 0.9 * 1_460.0 / (2.0 * 180e-6 + (1_460.0 + 180.0) * 8.0 / 6.5e6);

#[test]
fn a_radio_gives_what_it_has_and_shares_it() {
    // As much as a connection lets under way, in pieces as it reads them.
    const AHEAD: usize = 64 * 1_024;
    const PIECE: usize = 4 * 1_460;
    const SECONDS: u64 = 4;
    for robots in [1, 4, 9] {
        let mut setup = Setup {
            link: QUICK,
            radio: Some(Radio::default()),
            figures: figures(),
            seed: 1,
        };
        // Just as strong as it takes.
        setup.link.rssi_dbm = -90;
        setup.figures.noise_db = 2.6;
        let shared = shared(setup);
        let stations: Vec<usize> = (0..robots)
            .map(|robot| shared.station(&format!("r{robot}")))
            .collect();
        let mut under_way: Vec<Vec<u64>> = vec![Vec::new(); robots];
        let mut carried = vec![0_usize; robots];
        for now in (0..SECONDS * 1_000_000).step_by(1_000) {
            for (robot, queue) in under_way.iter_mut().enumerate() {
                let before = queue.len();
                queue.retain(|&arrival| arrival > now);
                carried[robot] += (before - queue.len()) * PIECE;
                while queue.len() < AHEAD / PIECE {
                    let sent = shared.transit(stations[robot], Direction::Up, PIECE, now);
                    queue.push(sent.expect("nothing cuts it"));
                }
            }
            if (now + 1_000).is_multiple_of(WINDOW_US) {
                shared.turn(now + 1_000);
            }
        }
        let rates: Vec<f64> = carried.iter().map(|&b| b as f64 / SECONDS as f64).collect();
        let total: f64 = rates.iter().sum();
        assert!(
            (0.93..1.03).contains(&(total / WEAK_RATE)),
            "{total:.0} of {WEAK_RATE:.0}: {rates:?}"
        );
        for rate in &rates {
            let share = rate * robots as f64 / total;
            assert!((0.9..1.1).contains(&share), "{rates:?}");
        }
    }
}

#[test]
fn a_partition_holds_everything_from_its_beginning_to_its_end() {
    let setup = Setup {
        link: QUICK,
        radio: Some(Radio {
            access_points: Vec::new(),
            partitions: vec![Partition {
                from_s: 0.5,
                until_s: 1.5,
                region: None,
                access_point: None,
                share: 1.0,
                known: false,
            }],
        }),
        figures: figures(),
        seed: 1,
    };
    let shared = shared(setup);
    let station = shared.station("r");
    let signal = shared.signal("r");
    let mut held = Vec::new();
    for window in 1..=250 {
        let now = window * WINDOW_US;
        shared.turn(now);
        let through = shared.transit(station, Direction::Up, 1, now).is_some();
        let told = signal.borrow().cut;
        assert_eq!(told, if through { Cut::None } else { Cut::Silent });
        if !through {
            held.push(now);
        }
    }
    let ends = (held.first().copied(), held.last().copied());
    assert_eq!(ends, (Some(500_000), Some(1_490_000)));
    assert_eq!(held.len(), 100, "and in between");
}
