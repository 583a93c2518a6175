//! How much history an engine takes, at what cost, and how fast it answers, on this machine.
//!
//! `cargo run --release -p crawler-timeseries --example timeseries_bench -- URL PID [SECONDS] [RATE]`
//!
//! URL is an engine's, like `influx://127.0.0.1:8086/bench`, and PID its process, whose processor time
//! is told. First an hour of [`ASKED`] robots at 5 Hz goes in as fast as it is taken. Then samples of
//! [`ROBOTS`] robots come in at RATE a second (20,000 if none is said) for SECONDS (60), while
//! somebody asks for the last hour of one of the first. Before, somebody asks where all of those were.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crawler_history::Sample;
use crawler_protocol::{RobotId, RobotState};
use crawler_timeseries::{QUEUE, Remote};

const HOUR: i64 = 3_600_000;
/// Time between two samples of a robot.
const EVERY: i64 = 200;
/// Robots with an hour of history.
const ASKED: usize = 20;
/// Robots that samples come in of.
const ROBOTS: usize = 1_000;
/// Time between two questions.
const PAUSE: Duration = Duration::from_millis(500);

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn now() -> Outcome<i64> {
    Ok(SystemTime::now().duration_since(UNIX_EPOCH)?.as_millis() as i64)
}

/// Processor seconds that a process has taken: its own and the kernel's for it.
fn cpu(process: &str) -> Outcome<f64> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat"))?;
    // The name of the program, in parentheses, may hold anything.
    let (_, fields) = stat.rsplit_once(')').ok_or("no name in it")?;
    let ticks: Vec<u64> = fields
        .split_whitespace()
        .skip(11)
        .take(2)
        .map(str::parse)
        .collect::<Result<_, _>>()?;
    // Linux counts for programs in hundredths of a second, whatever its clock.
    Ok(ticks.iter().sum::<u64>() as f64 / 100.0)
}

/// A robot that drives in circles, with a battery that runs down and a noisy range.
fn sample(robot: &RobotId, n: i64, at: i64) -> Sample {
    let turn = n as f32 * 0.02;
    let noise = n.wrapping_mul(2_654_435_761) >> 7 & 0x3f;
    Sample {
        robot: robot.clone(),
        at,
        x: turn.sin() * 2.0,
        y: turn.cos() * 2.0,
        theta: turn % std::f32::consts::TAU,
        range_mm: (n % 16 != 0).then_some(800 + noise as u16),
        battery_mv: 8_400 - (n / 60) as u16 % 1_800,
        battery_percent: 100 - (n / 600) as u8 % 100,
        rssi: Some(-60 - (noise % 5) as i8),
        left: 0.6,
        right: 0.5,
        state: RobotState::Moving,
    }
}

fn robots(kind: &str, count: usize) -> Outcome<Vec<RobotId>> {
    let names = (0..count).map(|n| format!("{kind}-{n:05}").parse());
    Ok(names.collect::<Result<_, _>>()?)
}

/// Puts in an hour of every robot, waiting where the queue is full, and returns samples per second.
async fn fill(history: &Remote, robots: &[RobotId], end: i64) -> Outcome<(i64, f64)> {
    let begun = Instant::now();
    let mut count = 0;
    for n in 0..HOUR / EVERY {
        for robot in robots {
            let sample = sample(robot, n, end - HOUR + n * EVERY);
            while history.push(sample.clone()).is_err() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
            count += 1;
        }
    }
    history.flush().await?;
    Ok((count, count as f64 / begun.elapsed().as_secs_f64()))
}

/// Asks for the hour before `to` of one robot after the other until `end`, and tells how long it took.
async fn ask(
    history: &Remote,
    robots: &[RobotId],
    to: i64,
    step: i64,
    end: Instant,
) -> Outcome<String> {
    let (mut times, mut points) = (Vec::new(), 0);
    for robot in robots.iter().cycle().step_by(7) {
        if Instant::now() >= end {
            break;
        }
        let begun = Instant::now();
        let answer = history.query(robot, to - HOUR, to, step).await?;
        times.push(begun.elapsed());
        points = answer.len();
        tokio::time::sleep(PAUSE).await;
    }
    times.sort_unstable();
    let most = times.len().saturating_sub(1);
    let [median, within, longest] = [most / 2, most * 95 / 100, most].map(|place| {
        let time = times.get(place).copied().unwrap_or_default();
        time.as_secs_f64() * 1e3
    });
    Ok(format!(
        "{points} points, {} questions: median {median:.1} ms, 95 % within {within:.1} ms, longest \
         {longest:.1} ms",
        times.len()
    ))
}

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() -> Outcome<()> {
    let mut arguments = std::env::args().skip(1);
    let (url, process) = arguments
        .next()
        .zip(arguments.next())
        .ok_or("the engine's address, and the id of its process")?;
    let mut number = |or: u64| arguments.next().map_or(Ok(or), |text| text.parse());
    let (seconds, rate) = (number(60)?.max(1), number(20_000)?.max(1));

    let history = Remote::start(url.parse()?, "swarm", QUEUE)?;
    let asked = robots("asked", ASKED)?;
    let to = now()? / 10_000 * 10_000;
    println!("| what | result |\n|---|---|");
    let (before, began) = (cpu(&process)?, Instant::now());
    let (count, unpaced) = fill(&history, &asked, to).await?;
    println!(
        "| unpaced, an hour of {ASKED} robots | {count} samples, {unpaced:.0}/s, engine {:.0} % of a core |",
        (cpu(&process)? - before) / began.elapsed().as_secs_f64() * 100.0
    );
    // An engine shows what it took a moment later, and sorts it.
    tokio::time::sleep(Duration::from_secs(5)).await;
    for step in [500, 2_000, 10_000] {
        let end = Instant::now() + Duration::from_secs(10);
        let told = ask(&history, &asked, to, step, end).await?;
        println!("| last hour, every {step} ms, nothing else | {told} |");
    }

    let all = asked.iter().cloned().collect();
    let mut times = Vec::new();
    for _ in 0..5 {
        let begun = Instant::now();
        let tracks = history.frames(&all, to - HOUR, to, HOUR / 300).await?;
        times.push((begun.elapsed(), tracks.len()));
    }
    times.sort_unstable();
    println!(
        "| where {} robots were in the last hour, every 12 s | median {:.0} ms, longest {:.0} ms |",
        times[0].1,
        times[2].0.as_secs_f64() * 1e3,
        times[4].0.as_secs_f64() * 1e3
    );

    let many = robots("sim", ROBOTS)?;
    let before = (history.stats(), cpu("self")?, cpu(&process)?);
    let begun = Instant::now();
    let end = begun + Duration::from_secs(seconds);
    let asking = {
        let (history, asked) = (history.clone(), asked.clone());
        tokio::spawn(async move {
            let told = ask(&history, &asked, to, 10_000, end).await;
            told.map_err(|error| error.to_string())
        })
    };
    let (mut pushed, mut most_queued) = (0_u64, 0);
    while Instant::now() < end {
        let due = (begun.elapsed().as_secs_f64() * rate as f64) as u64;
        let at = now()?;
        while pushed < due {
            let robot = &many[pushed as usize % many.len()];
            // A refusal is counted by the history.
            let _ = history.push(sample(robot, (pushed / many.len() as u64) as i64, at));
            pushed += 1;
        }
        most_queued = most_queued.max(history.stats().queued);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    history.flush().await?;
    let took = begun.elapsed().as_secs_f64();
    let stats = history.stats();
    println!(
        "| paced at {rate}/s for {seconds} s | {:.0}/s written, {} dropped, {} refused, at most {most_queued} queued |",
        (stats.written - before.0.written) as f64 / took,
        stats.dropped - before.0.dropped,
        stats.refused - before.0.refused,
    );
    println!(
        "| processors meanwhile | this program {:.0} %, engine {:.0} % of a core |",
        (cpu("self")? - before.1) / took * 100.0,
        (cpu(&process)? - before.2) / took * 100.0
    );
    let told = asking.await??;
    println!("| last hour, every 10000 ms, meanwhile | {told} |");
    history.close().await;
    Ok(())
}
