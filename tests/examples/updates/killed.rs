//! Server, broker and both ended as by a power cut while robots are updated, and started again.

use std::time::{Duration, Instant};

use crawler_tests::measure::sum;
use crawler_tests::{Mosquitto, wait_for};
use serde_json::json;

use super::Size;
use super::fleet::{BUILD, BYTES, Chunks, Fleet, Meeting, Progress};

/// For a rollout to go on.
const PATIENCE: Duration = Duration::from_mins(2);

/// When something is killed.
#[derive(Debug, Clone, Copy)]
enum Moment {
    /// Robots have so many percent of all bytes.
    Received(u64),
    /// So many percent of the robots try their new program.
    Trial(usize),
}

/// What is killed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Victim {
    Server,
    Broker,
    Both,
}

/// Blocks of a robot that may be sent again.
const MOST_AGAIN: f64 = 1.0;

const MOMENTS: [Moment; 3] = [
    Moment::Received(10),
    Moment::Received(60),
    Moment::Trial(50),
];

/// Each has robots and a rollout of its own: one whose session is closed three times within a minute suspects that
/// another has its id, and waits for longer.
pub(crate) fn run(size: &Size) -> Vec<String> {
    println!(
        "\n{} robots, all at once; what was killed is started again at once:\n\n\
         | broker | killed | at | goes on after, s (goal 10) | confirmed | blocks of a robot sent again (goal 1) |\n\
         |---|---|---|---:|---:|---:|",
        size.killed
    );
    let mut wrong = Vec::new();
    for (meeting, victim) in [
        (Meeting::Embedded, Victim::Both),
        (Meeting::Mosquitto, Victim::Server),
        (Meeting::Mosquitto, Victim::Broker),
        (Meeting::Mosquitto, Victim::Both),
    ] {
        for moment in MOMENTS {
            wrong.extend(one(size.killed, meeting, victim, moment));
        }
    }
    wrong
}

fn one(robots: usize, meeting: Meeting, victim: Victim, moment: Moment) -> Vec<String> {
    let mut fleet = Fleet::start(meeting);
    let _simulated = fleet.robots(fleet.port, robots);
    let release = fleet.release(&[]);
    let phases = json!([{ "select": { "share": 100 }, "soak_s": 1 }]);
    let rollout = fleet.begin(&release, &phases, robots);
    fleet.wait("the moment", &rollout, |seen| moment.is_here(seen, robots));
    let before = fleet.chunks();
    let began = Instant::now();
    kill(&mut fleet, victim);
    // What a server counts goes with it.
    let (lost, kept) = match victim {
        Victim::Broker => (Chunks::default(), before),
        Victim::Server | Victim::Both => (before, Chunks::default()),
    };
    goes_on(&fleet, moment, kept);
    let took = began.elapsed();
    fleet.server.wait_ready();
    fleet.wait("all are confirmed", &rollout, |seen| {
        seen.count("confirmed") == robots || seen.at_work() == 0 && seen.state() != "running"
    });
    let again = lost.and(fleet.chunks()).again(robots);
    let proven = fleet.running(BUILD);
    let broker = match meeting {
        Meeting::Embedded => "own",
        Meeting::Mosquitto => "Mosquitto",
    };
    let victim = match victim {
        Victim::Server => "server",
        Victim::Broker => "broker",
        Victim::Both => "both",
    };
    println!(
        "| {broker} | {victim} | {} | {:.1} | {proven} of {robots} | {again:.2} |",
        moment.name(),
        took.as_secs_f64()
    );
    let mut wrong = Vec::new();
    if proven != robots {
        wrong.push(format!(
            "{proven} of {robots} robots run the release after {victim} was killed"
        ));
    }
    if again > MOST_AGAIN {
        wrong.push(format!(
            "{again:.2} blocks of each robot were sent again after {victim} was killed"
        ));
    }
    wrong
}

/// Ends it, and starts it again.
fn kill(fleet: &mut Fleet, victim: Victim) {
    if victim != Victim::Broker {
        fleet.server.kill();
    }
    if victim != Victim::Server
        && let Some(broker) = fleet.broker.take()
    {
        broker.kill();
        fleet.broker = Some(Mosquitto::start(fleet.port));
    }
    if victim != Victim::Broker {
        fleet.server.restart();
    }
}

/// Waits until more chunks were sent than `before`; behind the transfer, until a robot has spoken about its update.
fn goes_on(fleet: &Fleet, moment: Moment, before: Chunks) {
    let name = match moment {
        Moment::Received(_) => "terracrawler_updates_chunks_total",
        Moment::Trial(_) => "terracrawler_updates_reports_total",
    };
    let mut least = match moment {
        Moment::Received(_) => Some(before.chunks as f64),
        Moment::Trial(_) => None,
    };
    if before.chunks == 0 {
        least = Some(0.0);
    }
    wait_for("it goes on", PATIENCE, || {
        let (status, text) = fleet.server.try_get("/metrics")?;
        let now = sum(text.as_str().filter(|_| status == 200)?, name);
        // What was heard up to the first look is not news.
        (now > *least.get_or_insert(now)).then_some(())
    });
}

impl Moment {
    fn is_here(self, seen: &Progress, robots: usize) -> bool {
        match self {
            Self::Received(percent) => 100 * seen.bytes() >= percent * BYTES * robots as u64,
            Self::Trial(percent) => {
                let there = seen.count("trial") + seen.count("confirmed");
                100 * there >= percent * robots
            }
        }
    }

    fn name(self) -> String {
        match self {
            Self::Received(percent) => format!("{percent} % received"),
            Self::Trial(percent) => format!("{percent} % on trial"),
        }
    }
}
