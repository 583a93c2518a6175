//! Runs robots in real time against a broker, and prints how they do.
//!
//! `cargo run --release -p crawler-sim --features live --example live_load HOST PORT ROBOTS SECONDS
//! [SCENARIO]`; a scenario with a radio puts the proxy between.

use std::error::Error;
use std::time::{Duration, Instant};

use cpu_time::ProcessTime;
use crawler_sim::live::{LiveConfig, start};
use crawler_sim::scenario::Scenario;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [host, port, robots, seconds, rest @ ..] = arguments.as_slice() else {
        return Err("usage: live_load HOST PORT ROBOTS SECONDS [SCENARIO]".into());
    };
    let scenario = match rest.first() {
        Some(file) => Scenario::parse(&std::fs::read_to_string(file)?)?,
        None => Scenario::built_in("arena")?,
    };
    let handle = start(LiveConfig {
        fleet: crawler_protocol::Fleet::default(),
        broker_host: host.clone(),
        broker_port: port.parse()?,
        credentials: None,
        scenario: scenario.with_robots(robots.parse()?),
        seed: 1,
        release_keys: None,
        radio_proxy: None,
        other_ends: 0,
        authority: None,
    })?;
    println!("| second | real-time factor | lateness ms | connected | CPU % of one core |");
    println!("|---:|---:|---:|---:|---:|");
    for second in 1..=seconds.parse::<u64>()? {
        let (begun, cpu) = (Instant::now(), ProcessTime::now());
        std::thread::sleep(Duration::from_secs(1));
        let metrics = handle.metrics();
        println!(
            "| {second} | {:.3} | {:.1} | {} | {:.0} |",
            metrics.real_time_factor,
            metrics.lateness_s * 1e3,
            metrics.connected,
            100.0 * cpu.elapsed().as_secs_f64() / begun.elapsed().as_secs_f64(),
        );
    }
    if let Some(radio) = handle.radio() {
        println!("{:?}", radio.metrics());
    }
    let begun = Instant::now();
    let report = handle.stop(Duration::from_secs(10))?;
    println!("{report:?} after {:.2} s", begun.elapsed().as_secs_f64());
    Ok(())
}
