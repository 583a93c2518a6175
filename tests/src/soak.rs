//! A server at work for an hour: robots, operators, viewers, floods, faults and restarts, in cycles that are all
//! alike. After each everybody rests, and what the server holds then is noted: a leak grows from rest to rest.

mod crowd;
mod floods;
mod follow;
mod graph;
mod judge;
mod reading;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde_json::json;

use crate::measure::{self, sum};
use crate::{Simulated, Terracrawler, wait_for_with};
use crowd::Crowd;
use follow::Follower;

pub use judge::{Finding, judge};
pub use reading::{Reading, table};

/// For all robots to be online.
const ONLINE: Duration = Duration::from_mins(3);
/// For everything to come to rest behind a cycle.
const REST: Duration = Duration::from_mins(3);
/// Connections that say nothing are closed after 10 s, those that were cut off are noticed as soon.
const SETTLE: Duration = Duration::from_secs(15);

/// What is to be done.
#[derive(Debug, Clone)]
pub struct Options {
    /// Robots, in a process of their own.
    pub robots: usize,
    /// Cycles in all.
    pub cycles: usize,
    /// How long everybody is at work in one.
    pub work: Duration,
    /// Where readings and graph are written.
    pub out: Option<PathBuf>,
}

impl Options {
    /// How many cycles, of those at the beginning, the server is restarted in. Its memory begins anew by that,
    /// so there are more of the others.
    const fn with_restart(&self) -> usize {
        self.cycles / 4
    }
}

/// Runs all cycles. Prints a line when one has ended.
///
/// # Panics
/// When something cannot be started, does not come to rest, or the files cannot be written.
pub fn run(options: &Options) -> Vec<Reading> {
    let mut server = Terracrawler::start(&["serve"]);
    let robots = options.robots.to_string();
    let simulated = Simulated::start(server.mqtt(), &["--robots", &robots]);
    server.wait_online(options.robots, ONLINE);
    let began = Instant::now();
    let mut readings: Vec<Reading> = Vec::new();
    for cycle in 0..options.cycles {
        let follower = Follower::start(&server.url());
        let crowd = Crowd::start(&server, options.robots, cycle, &follower);
        let restarts = cycle < options.with_restart();
        if restarts {
            std::thread::sleep(options.work / 2);
            // What was acknowledged before it goes has to be there when it is back.
            if cycle % 2 == 0 {
                server.kill();
            } else {
                server.end();
            }
            follower.note_restart();
            server.resume();
            std::thread::sleep(options.work / 2);
        } else {
            std::thread::sleep(options.work);
        }
        let told = crowd.stop();
        rest(&server, options.robots);
        std::thread::sleep(SETTLE);
        let fates = follower.stop();
        let reading = Reading {
            cycle: cycle + 1,
            at: began.elapsed(),
            restarted: restarts,
            ..Reading::take(&server, told, fates)
        };
        println!("{}", reading.row());
        readings.push(reading);
        if let Some(folder) = &options.out {
            graph::write(folder, &readings).expect("a folder to write into");
        }
    }
    drop(simulated);
    server.end();
    readings
}

/// Waits until all robots are there, and nothing is under way.
fn rest(server: &Terracrawler, robots: usize) {
    let halted = server.post("/api/v1/swarm/commands", &json!({ "command": "stop" }));
    assert_eq!(halted.0, 202, "{}", halted.1);
    server.wait_online(robots, ONLINE);
    let mut last = Vec::new();
    wait_for_with("nothing is under way", REST, &mut last, |last| {
        let text = measure::metrics(server);
        *last = [
            "terracrawler_commands_open",
            "terracrawler_live_clients",
            "terracrawler_embedded_broker_queued",
        ]
        .map(|name| (name, sum(&text, name)))
        .to_vec();
        last.iter().all(|(_, count)| *count == 0.0).then_some(())
    });
}
