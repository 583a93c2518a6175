//! How much history can be taken in, and how fast it answers, on this machine.
//!
//! `cargo run --release -p crawler-records --example history_bench -- [SECONDS] [ROBOTS] [RATE]`
//!
//! First an hour of every robot at 5 Hz goes in as fast as it is taken. Then samples come in at RATE
//! a second (20,000 if none is said) for SECONDS (15), while somebody asks ten times a second for
//! the last hour of one robot. Then somebody asks where all of them were in the last hour.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crawler_history::{HISTORY_FILE, History, Sample};
use crawler_protocol::{RobotId, RobotState};
use crawler_records::Records;

const HOUR: i64 = 3_600_000;
/// Time between two samples of a robot.
const EVERY: i64 = 200;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// The directory, gone with the value.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn now() -> Outcome<i64> {
    Ok(SystemTime::now().duration_since(UNIX_EPOCH)?.as_millis() as i64)
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

/// Median, the time that 95 % stay within, and the longest of `times`, in milliseconds.
fn spread(times: &mut [Duration]) -> [f64; 3] {
    times.sort_unstable();
    let most = times.len().saturating_sub(1);
    [most / 2, most * 95 / 100, most].map(|place| {
        let time = times.get(place).copied().unwrap_or_default();
        time.as_secs_f64() * 1e3
    })
}

/// Puts in an hour of every robot, waiting where the queue is full, and returns samples per second.
async fn fill(history: &History, robots: &[RobotId], end: i64) -> Outcome<(i64, f64)> {
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

/// Asks for the last hour of one robot after the other until told to stop.
async fn ask(
    history: History,
    robots: Vec<RobotId>,
    step: i64,
    end: Instant,
) -> Result<(Vec<Duration>, usize), String> {
    let (mut times, mut points) = (Vec::new(), 0);
    for robot in robots.iter().cycle().step_by(7) {
        if Instant::now() >= end {
            break;
        }
        let to = now().map_err(|error| error.to_string())?;
        let begun = Instant::now();
        let answer = history.query(robot, to - HOUR, to, step).await;
        times.push(begun.elapsed());
        points = answer.map_err(|error| error.to_string())?.len();
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    Ok((times, points))
}

/// Asks where all robots were in the last hour, a few times, at 300 times and at ten.
async fn ask_for_all(history: &History, robots: &[RobotId]) -> Outcome<()> {
    let robots: BTreeSet<RobotId> = robots.iter().cloned().collect();
    for step in [HOUR / 300, HOUR / 10] {
        let (mut times, mut frames) = (Vec::new(), 0);
        for _ in 0..5 {
            let to = now()?;
            let begun = Instant::now();
            let tracks = history.frames(&robots, to - HOUR, to, step).await?;
            times.push(begun.elapsed());
            frames = tracks.iter().map(|track| track.frames.len()).sum();
        }
        let [median, _, longest] = spread(&mut times);
        println!(
            "| last hour of {} robots, step {step} ms | {frames} frames: median {median:.0} ms, longest {longest:.0} ms |",
            robots.len()
        );
    }
    Ok(())
}

fn report(step: i64, points: usize, times: &mut [Duration]) {
    let count = times.len();
    let [median, most, longest] = spread(times);
    println!(
        "| last hour, step {step} ms | {points} points, {count} questions: median {median:.1} ms, \
         95 % within {most:.1} ms, longest {longest:.1} ms |"
    );
}

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() -> Outcome<()> {
    let argument = |index, or: i64| {
        std::env::args()
            .nth(index)
            .map_or(Ok(or), |text| text.parse())
    };
    let (seconds, robots, rate) = (
        argument(1, 15)?.max(1),
        argument(2, 1_000)?.clamp(1, 10_000),
        argument(3, 20_000)?.max(1),
    );
    let folder = Folder(std::env::temp_dir().join(format!("history-bench-{}", std::process::id())));
    let records = Records::open(&folder.0).await?;
    let history = records.history().clone();
    let robots: Vec<RobotId> = (0..robots)
        .map(|n| format!("sim-{n:05}").parse())
        .collect::<Result<_, _>>()?;

    println!("| what | result |\n|---|---|");
    let (count, unpaced) = fill(&history, &robots, now()?).await?;
    println!(
        "| unpaced, an hour of {} robots | {count} samples, {unpaced:.0}/s |",
        robots.len()
    );
    history.settle().await?;

    let before = history.stats();
    let begun = Instant::now();
    let end = begun + Duration::from_secs(seconds as u64);
    let asked = [500, 1_000, 10_000].map(|step| {
        (
            step,
            tokio::spawn(ask(history.clone(), robots.clone(), step, end)),
        )
    });
    let (mut pushed, mut most_queued) = (0_i64, 0);
    let mut order = robots.iter().cycle();
    while Instant::now() < end {
        let due = (begun.elapsed().as_secs_f64() * rate as f64) as i64;
        let at = now()?;
        while pushed < due {
            if let Some(robot) = order.next() {
                // A refusal is counted by the history.
                let _ = history.push(sample(robot, pushed / robots.len() as i64, at));
            }
            pushed += 1;
        }
        most_queued = most_queued.max(history.stats().queued);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    history.flush().await?;
    let took = begun.elapsed().as_secs_f64();
    let after = history.stats();
    let written = after.written - before.written;
    println!(
        "| paced at {rate}/s for {seconds} s | {written} written, {:.0}/s, {} dropped, at most {most_queued} queued |",
        written as f64 / took,
        after.dropped - before.dropped
    );
    for (step, task) in asked {
        let (mut times, points) = task.await??;
        report(step, points, &mut times);
    }
    history.settle().await?;
    ask_for_all(&history, &robots).await?;
    records.close().await;
    let bytes = std::fs::metadata(folder.0.join(HISTORY_FILE))?.len();
    println!(
        "| size of the file, all levels | {:.1} bytes per sample |",
        bytes as f64 / history.stats().written as f64
    );
    Ok(())
}
