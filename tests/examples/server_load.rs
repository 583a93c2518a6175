//! What the server takes from a thousand robots: its embedded broker beside Mosquitto under the same
//! load in the same run, and telemetry on its way into the history.
//!
//! `cargo xtask bench server [--seconds N] [--rounds N] [--clients N]` runs it and prints the tables
//! that `docs/numbers.md` records. Brokers take turns, so that what else the machine does meets both.

use std::time::{Duration, Instant};

use crawler_tests::load::{Heard, Plan, Publishers, Qos, Sent, Subscriber, stamp};
use crawler_tests::measure::{cpu_seconds, metrics, percentile, resident_mib, sum, unix_ms};
use crawler_tests::{Mosquitto, ReservedPort, Terracrawler};

/// Bytes of a message.
const PAYLOAD: usize = 200;
/// Pause between two messages of one publisher.
const EVERY: Duration = Duration::from_millis(100);
/// The same for telemetry.
const TELEMETRY_EVERY: Duration = Duration::from_millis(200);
/// Before anything is measured.
const WARM_UP: Duration = Duration::from_secs(4);
/// For what is under way at the end.
const PATIENCE: Duration = Duration::from_secs(15);

struct Options {
    span: Duration,
    rounds: u32,
    clients: usize,
}

fn main() {
    let mut options = Options {
        span: Duration::from_secs(20),
        rounds: 2,
        clients: 1_000,
    };
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let number: Option<u32> = arguments.next().and_then(|text| text.parse().ok());
        let number = number.filter(|number| *number > 0);
        let number = number.unwrap_or_else(|| panic!("{name} takes a number above 0"));
        match name.as_str() {
            "--seconds" => options.span = Duration::from_secs(number.into()),
            "--rounds" => options.rounds = number,
            "--clients" => options.clients = number as usize,
            _ => panic!("{name}: --seconds N, --rounds N or --clients N"),
        }
    }
    rlimit::increase_nofile_limit(3 * options.clients as u64 + 500).expect("enough sockets");
    brokers(&options);
    println!();
    telemetry(&options);
}

/// One run with one broker.
struct Run {
    sent: Sent,
    settled: Sent,
    heard: Heard,
    cpu: f64,
    memory: f64,
}

fn brokers(options: &Options) {
    println!(
        "{} publishers, {} B each {} ms to one subscriber; {} rounds of {} s, brokers in turns.\n",
        options.clients,
        PAYLOAD,
        EVERY.as_millis(),
        options.rounds,
        options.span.as_secs()
    );
    println!(
        "| QoS | broker | sent | delivered | twice | refused | turns skipped | p50, ms | p99, ms \
         | worst, ms | CPU, % of one core | memory, MiB |"
    );
    println!("|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|");
    let mut ratios = Vec::new();
    for qos in [Qos::Zero, Qos::One] {
        let (mut own, mut other) = (Vec::new(), Vec::new());
        for _ in 0..options.rounds {
            let server = Terracrawler::start(&["serve"]);
            own.push(run(server.id(), server.mqtt(), qos, options));
            drop(server);
            let reserved = ReservedPort::new();
            let port = reserved.number();
            let mosquitto = Mosquitto::start(port);
            other.push(run(mosquitto.id(), port, qos, options));
            mosquitto.kill();
        }
        let own = row("embedded", qos, own);
        let other = row("Mosquitto", qos, other);
        ratios.push(format!(
            "| {} | {:.2} | {:.2} | {:.2} |",
            qos.number(),
            own[0] / other[0],
            own[1] / other[1],
            own[2] / other[2]
        ));
    }
    println!("\n| QoS | p50, embedded ÷ Mosquitto | p99 | CPU |\n|---:|---:|---:|---:|");
    println!("{}", ratios.join("\n"));
}

fn run(process: u32, port: u16, qos: Qos, options: &Options) -> Run {
    let begun = Instant::now();
    let subscriber = Subscriber::start(port, "swarm/pose/+", qos, begun);
    let mut publishers = Publishers::connect(
        Plan {
            port,
            qos,
            clients: options.clients,
            every: EVERY,
            topic: &|client| format!("swarm/pose/load-{client:04}"),
            payload: &|client, number, at| {
                let mut payload = stamp(client, number, at).to_vec();
                payload.resize(PAYLOAD, b'x');
                payload
            },
        },
        begun,
    );
    let warm = publishers.run(WARM_UP);
    let (from, before) = (begun.elapsed(), cpu_seconds(process));
    let sent = publishers.run(options.span);
    let (to, after) = (begun.elapsed(), cpu_seconds(process));
    let settled = publishers.settle(PATIENCE);
    subscriber.wait(warm.messages + sent.messages, PATIENCE);
    Run {
        sent,
        settled,
        memory: resident_mib(process),
        heard: subscriber.finish(from.as_nanos() as u64..to.as_nanos() as u64),
        cpu: (after - before) / to.saturating_sub(from).as_secs_f64() * 100.0,
    }
}

/// Prints what all rounds of a broker came to; returns p50, p99 and CPU.
fn row(name: &str, qos: Qos, runs: Vec<Run>) -> [f64; 3] {
    let total = |of: fn(&Run) -> u64| runs.iter().map(of).sum::<u64>();
    let mean = |of: fn(&Run) -> f64| runs.iter().map(of).sum::<f64>() / runs.len() as f64;
    let (sent, delivered) = (
        total(|run| run.sent.messages),
        total(|run| run.heard.messages),
    );
    let (again, refused) = (
        total(|run| run.heard.again),
        total(|run| run.settled.refused),
    );
    let skipped = total(|run| run.sent.skipped);
    let (cpu, memory) = (mean(|run| run.cpu), mean(|run| run.memory));
    let mut latencies: Vec<u32> = runs
        .into_iter()
        .flat_map(|run| run.heard.latencies_us)
        .collect();
    latencies.sort_unstable();
    let at = |percent| {
        let us = percentile(&latencies, percent);
        us.map_or(f64::INFINITY, |us| f64::from(us) / 1e3)
    };
    println!(
        "| {} | {name} | {sent} | {delivered} ({:.3} %) | {again} | {refused} | {skipped} | {:.2} \
         | {:.2} | {:.1} | {cpu:.1} | {memory:.0} |",
        qos.number(),
        delivered as f64 / sent as f64 * 100.0,
        at(50),
        at(99),
        at(100),
    );
    [at(50), at(99), cpu]
}

fn telemetry(options: &Options) {
    let server = Terracrawler::start(&["serve"]);
    let begun = Instant::now();
    let mut publishers = Publishers::connect(
        Plan {
            port: server.mqtt(),
            qos: Qos::Zero,
            clients: options.clients,
            every: TELEMETRY_EVERY,
            topic: &|client| format!("swarm/telemetry/load-{client:04}"),
            payload: &|client, number, _| message(client, number).into_bytes(),
        },
        begun,
    );
    publishers.run(WARM_UP);
    // What is under way at both ends of the span evens out.
    let (text, from, cpu) = (metrics(&server), Instant::now(), cpu_seconds(server.id()));
    let sent = publishers.run(options.span);
    let (seconds, cpu) = (from.elapsed().as_secs_f64(), cpu_seconds(server.id()) - cpu);
    let first = sum(&text, RECEIVED);
    let end = Instant::now() + PATIENCE;
    let text = loop {
        let text = metrics(&server);
        let all = sum(&text, RECEIVED) - first >= sent.messages as f64;
        if (all && sum(&text, "terracrawler_history_queued") == 0.0) || Instant::now() > end {
            break text;
        }
        std::thread::sleep(Duration::from_millis(200));
    };
    let count = |name| sum(&text, name);
    println!(
        "{} robots, telemetry each {} ms into broker, fleet and history for {seconds:.0} s.\n",
        options.clients,
        TELEMETRY_EVERY.as_millis()
    );
    println!(
        "| sent | received | rejected | turns skipped | samples kept, of all received | on disk \
         | dropped | CPU, % of one core | memory, MiB |"
    );
    println!("|---:|---:|---:|---:|---:|---:|---:|---:|---:|");
    println!(
        "| {} | {} | {} | {} | {} of {} | {} | {} | {:.1} | {:.0} |",
        sent.messages,
        count(RECEIVED) - first,
        count("terracrawler_mqtt_messages_rejected_total"),
        sent.skipped,
        count("terracrawler_history_accepted_total"),
        count(RECEIVED),
        count("terracrawler_history_written_total"),
        count("terracrawler_history_dropped_total"),
        cpu / seconds * 100.0,
        resident_mib(server.id()),
    );
    let (status, log) = server.interrupt();
    assert!(status.success(), "{log}");
}

const RECEIVED: &str = "terracrawler_mqtt_messages_in_total{kind=\"telemetry\"}";

/// What a robot tells that goes round in a circle.
fn message(client: usize, number: u64) -> String {
    let angle = number as f64 * 0.05;
    let (x, y) = (client as f64 % 30.0 + angle.cos(), angle.sin());
    format!(
        "{{\"robot\":\"load-{client:04}\",\"seq\":{number},\"timestamp\":{},\"state\":\"MOVING\",\
         \"behaviour\":\"manual\",\"pose\":{{\"x\":{x:.3},\"y\":{y:.3},\"theta\":{:.3},\
         \"sigma\":0.08}},\"range_mm\":812,\"temperature_c\":22.5,\"wheels\":{{\"left\":0.60,\
         \"right\":0.55}},\"battery\":{{\"mv\":7610,\"percent\":71}},\"rssi_dbm\":-61}}",
        unix_ms(),
        angle.sin() * 3.0,
    )
}
