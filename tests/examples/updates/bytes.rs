//! What a release takes on the way to robots, without loss and with, through the bad network of the simulator.

use std::time::{Duration, Instant};

use crawler_sim::net::lockstep::LinkModel;
use crawler_sim::net::proxy::{Proxy, ProxyConfig};
use crawler_sim::net::radio::Setup;
use crawler_sim::world::RadioFigures;
use serde_json::json;

use super::Size;
use super::fleet::{BUILD, BYTES, Fleet, Meeting};

/// Before and between what is measured.
const QUIET: Duration = Duration::from_secs(10);
/// Bytes that a segment carries, and those around one, or around its acknowledgement, of which there is one for
/// two of them.
const SEGMENT: f64 = 1_460.0;
const AROUND: f64 = 40.0 + 40.0 / 2.0;

pub(crate) fn run(size: &Size) -> Vec<String> {
    println!(
        "\n{} robots, all at once, over the payload of {BYTES} bytes for each, in both directions; what robots say \
         without a rollout is taken off:\n\n\
         | lost | until all were confirmed, s | in the stream | with TCP and IP, sent again | blocks of a robot \
         sent again |\n|---:|---:|---:|---:|---:|",
        size.counted
    );
    let mut wrong = Vec::new();
    for loss in [0.0, 0.05] {
        wrong.extend(one(size.counted, loss));
    }
    wrong
}

fn one(robots: usize, loss: f32) -> Vec<String> {
    let fleet = Fleet::start(Meeting::Embedded);
    let config = ProxyConfig {
        listen: ([127, 0, 0, 1], 0).into(),
        broker: vec![([127, 0, 0, 1], fleet.port).into()],
        setup: Setup {
            link: LinkModel {
                loss,
                ..LinkModel::default()
            },
            radio: None,
            figures: RadioFigures::default(),
            seed: 1,
        },
        most_connections: 4 * robots + 16,
    };
    let proxy = Proxy::start(&config).expect("a proxy");
    let _simulated = fleet.robots(proxy.address().port(), robots);
    let release = fleet.release(&[]);
    let count = || {
        let metrics = proxy.metrics();
        (Instant::now(), metrics.up_bytes + metrics.down_bytes)
    };
    std::thread::sleep(QUIET);
    let begun = count();
    std::thread::sleep(QUIET);
    let before = count();
    let phases = json!([{ "select": { "share": 100 }, "soak_s": 1 }]);
    let rollout = fleet.begin(&release, &phases, robots);
    let took = fleet.wait("all are confirmed", &rollout, |seen| {
        seen.count("confirmed") == robots || seen.at_work() == 0 && seen.state() != "running"
    });
    let after = count();
    let rate = (before.1 - begun.1) as f64 / (before.0 - begun.0).as_secs_f64();
    let quiet = rate * (after.0 - before.0).as_secs_f64();
    let payload = (BYTES * robots as u64) as f64;
    let stream = ((after.1 - before.1) as f64 - quiet) / payload;
    let wire = stream * (1.0 + AROUND / SEGMENT) / (1.0 - f64::from(loss));
    let over = |share: f64| 100.0 * (share - 1.0);
    println!(
        "| {:.0} % | {:.0} | {:.1} % | {:.1} % | {:.2} |",
        100.0 * loss,
        took.as_secs_f64(),
        over(stream),
        over(wire),
        fleet.chunks().again(robots)
    );
    let proven = fleet.running(BUILD);
    if proven == robots {
        return Vec::new();
    }
    vec![format!(
        "{proven} of {robots} robots run the release at a loss of {loss}"
    )]
}
