//! A release for everybody, while halts are given.

use std::time::{Duration, Instant};

use crawler_tests::measure::{cpu_seconds, metrics, sum};
use serde_json::json;

use super::Size;
use super::fleet::{BUILD, Fleet, Meeting};
use super::halts::Halts;

/// Telemetry that the server took in.
const TELEMETRY: &str = "terracrawler_mqtt_messages_in_total{kind=\"telemetry\"}";
/// Before anything is measured.
const WARM_UP: Duration = Duration::from_secs(5);

/// What is counted at a moment.
struct Counted {
    at: Instant,
    telemetry: f64,
    dropped: f64,
    server: f64,
    robots: f64,
}

pub(crate) fn run(size: &Size) -> Vec<String> {
    let Size {
        robots, parallel, ..
    } = *size;
    let fleet = Fleet::start(Meeting::Embedded);
    let simulated = fleet.robots(fleet.port, robots);
    let release = fleet.release(&[]);
    let halts = Halts::start(fleet.port, robots);
    std::thread::sleep(WARM_UP);
    halts.take();
    let count = || {
        let text = metrics(&fleet.server);
        Counted {
            at: Instant::now(),
            telemetry: sum(&text, TELEMETRY),
            dropped: sum(&text, "terracrawler_drops_total")
                + sum(&text, "terracrawler_history_dropped_total"),
            server: cpu_seconds(fleet.server.id()),
            robots: cpu_seconds(simulated.id()),
        }
    };
    let begun = count();
    std::thread::sleep(Duration::from_secs(size.quiet_s));
    let (quiet, before) = (halts.take(), count());
    let phases = json!([{ "select": { "share": 100 }, "soak_s": 1 }]);
    let rollout = fleet.begin(&release, &phases, parallel);
    let took = fleet.wait("all are confirmed", &rollout, |seen| {
        seen.count("confirmed") == robots || seen.at_work() == 0 && seen.state() != "running"
    });
    let (during, after) = (halts.take(), count());
    halts.stop();
    let chunks = fleet.chunks();
    println!(
        "\n{robots} robots, {parallel} at once, {:.0} s without a rollout and then with one:\n\n\
         | | without | during |\n|---|---:|---:|",
        (before.at - begun.at).as_secs_f64()
    );
    println!(
        "| until all were confirmed, s | | {:.0} |",
        took.as_secs_f64()
    );
    println!(
        "| `stop` answered; not within 10 s; of those by robots that restarted meanwhile | {}; {}; {} | {}; {}; {} |",
        quiet.answered(),
        quiet.unanswered,
        quiet.restarting,
        during.answered(),
        during.unanswered,
        during.restarting
    );
    for percent in [50, 99] {
        let (without, with) = (quiet.at(percent), during.at(percent));
        println!(
            "| `stop`: p{percent}, ms | {without:.1} | {with:.1}, {:.1} times |",
            with / without
        );
    }
    let rate = |from: &Counted, to: &Counted| {
        let samples = (to.telemetry - from.telemetry) / (to.at - from.at).as_secs_f64();
        samples / robots as f64
    };
    println!(
        "| telemetry of a robot, 1/s | {:.2} | {:.2} |",
        rate(&begun, &before),
        rate(&before, &after)
    );
    println!(
        "| missing in that of some robots | {} of {} | {} of {} |",
        quiet.lost,
        quiet.lost + quiet.telemetry,
        during.lost,
        during.lost + during.telemetry
    );
    println!(
        "| let go by the server, of anything | {:.0} | {:.0} |",
        before.dropped - begun.dropped,
        after.dropped - before.dropped
    );
    let share =
        |used: f64, from: &Counted, to: &Counted| 100.0 * used / (to.at - from.at).as_secs_f64();
    println!(
        "| of one core, %: server; robots | {:.0}; {:.0} | {:.0}; {:.0} |",
        share(before.server - begun.server, &begun, &before),
        share(before.robots - begun.robots, &begun, &before),
        share(after.server - before.server, &before, &after),
        share(after.robots - before.robots, &before, &after)
    );
    println!(
        "| chunks sent; blocks of a robot sent again | | {}; {:.2} |",
        chunks.chunks,
        chunks.again(robots)
    );
    let proven = fleet.running(BUILD);
    let mut wrong = Vec::new();
    if proven != robots {
        wrong.push(format!("{proven} of {robots} robots run the release"));
    }
    wrong
}
