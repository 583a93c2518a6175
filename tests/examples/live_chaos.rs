//! Minutes of faults between real processes; see `crawler_tests::chaos`.
//!
//! `cargo xtask bench chaos [--minutes N] [--robots N] [--broker embedded|mosquitto]` runs it, by default
//! with both brokers one after the other, prints the tables that `docs/numbers.md` records, and fails
//! when a count is not what it must be. `--forget` and `--forge` show that it can fail: the first takes
//! away what the server has on disk of commands while it is down, the second gives commands that come
//! again another number.

use std::process::ExitCode;
use std::time::Duration;

use crawler_tests::chaos::{Broker, Fault, Options, run};

/// Before the first fault.
const FIRST: Duration = Duration::from_secs(10);
/// From the beginning of one fault to that of the next: robots call a session of a minute stable.
const EVERY: Duration = Duration::from_secs(70);
/// How long a fault lasts.
const LASTING: Duration = Duration::from_secs(6);
/// From the end of a fault until all robots are back, at most.
const BACK_WITHIN_MS: u64 = 10_000;
/// After which nobody waits for them any more.
const PATIENCE: Duration = Duration::from_mins(1);

fn main() -> ExitCode {
    let (mut minutes, mut robots) = (5, 200);
    let mut brokers = vec![Broker::Embedded, Broker::Mosquitto];
    let (mut forget, mut forge) = (false, false);
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_default();
        match name.as_str() {
            "--minutes" => minutes = value().parse().expect("--minutes N"),
            "--robots" => robots = value().parse().expect("--robots N"),
            "--broker" => {
                brokers = vec![match value().as_str() {
                    "embedded" => Broker::Embedded,
                    "mosquitto" => Broker::Mosquitto,
                    other => panic!("'{other}': --broker embedded or --broker mosquitto"),
                }];
            }
            "--forget" => forget = true,
            "--forge" => forge = true,
            other => panic!("there is no option {other}"),
        }
    }
    let sockets = 20 * robots as u64 + 500;
    rlimit::increase_nofile_limit(sockets).expect("enough sockets");
    let end = Duration::from_secs(60 * minutes);
    let mut wrong = Vec::new();
    for broker in brokers {
        println!("\n## {broker:?}\n");
        let report = run(Options {
            robots,
            broker,
            faults: faults(broker, end),
            lasting: LASTING,
            end,
            patience: PATIENCE,
            forget,
            forge,
        });
        println!("{report}");
        for (what, count) in report.must_be_zero() {
            if count > 0 {
                wrong.push(format!("{broker:?}: {what}: {count}"));
            }
        }
        let late = report.late(BACK_WITHIN_MS);
        if late > 0 {
            let limit = BACK_WITHIN_MS / 1_000;
            wrong.push(format!(
                "{broker:?}: not all back within {limit} s after {late} faults"
            ));
        }
    }
    for line in &wrong {
        println!("WRONG: {line}");
    }
    if wrong.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// One fault after the other, with time for the last one to end.
fn faults(broker: Broker, end: Duration) -> Vec<(Duration, Fault)> {
    let kinds = match broker {
        Broker::Embedded => [
            Fault::ServerKilled,
            Fault::Partition,
            Fault::KilledInPartition,
            Fault::Cut,
            Fault::Stall,
        ],
        Broker::Mosquitto => [
            Fault::BrokerKilled,
            Fault::ServerKilled,
            Fault::Partition,
            Fault::BothKilled,
            Fault::Cut,
        ],
    };
    let mut at = FIRST;
    let mut faults = Vec::new();
    for fault in kinds.into_iter().cycle() {
        if at + LASTING + FIRST > end {
            break;
        }
        faults.push((at, fault));
        at += EVERY;
    }
    faults
}
