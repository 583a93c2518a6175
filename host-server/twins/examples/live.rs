//! What twins of a large fleet cost a server: a thousand robots of the reference reality, heard in real time as a server
//! hears them. Prints a table; `cargo xtask bench twin` runs it.

#[path = "../../twin/tests/suite/reference.rs"]
mod reference;

use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use cpu_time::ThreadTime;
use crawler_protocol::open::{self, Telemetry};
use crawler_protocol::{Pose, PoseFix, RobotId};
use crawler_twin::certificate::{About, certify};
use crawler_twin::evidence::Row;
use crawler_twins::Twins;

use reference::{CALIBRATING, Hidden, Random, Rates, anyhow, calibration, drive};

const ROBOTS: usize = 1_000;
/// Bodies; robots of one drive the same way, not at the same time.
const BODIES: usize = 8;
/// Seconds that are measured, after as many in which twins begin.
const SECONDS: f64 = 20.0;
const RATES: Rates = Rates {
    telemetry: 5,
    fixes: 2,
};

fn unix_ms() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0, |now| now.as_millis() as u64)
}

/// What is told of a robot, at a second of the drive.
struct Due {
    second: f64,
    robot: usize,
    row: Row,
}

/// Everything that is said, in order, and certificates of the robots in `folder`.
fn evidence(folder: &std::path::Path) -> Vec<Due> {
    let mut due = Vec::new();
    for body in 0..BODIES {
        let hidden = Hidden::draw(1_000 + body as u64, 0.0);
        let evidence = calibration(&hidden, CALIBRATING).evidence();
        let made = certify(&evidence, About::default(), None).expect("a certificate");
        let way = anyhow(2.0 * SECONDS + 2.0, &mut Random::new(body as u64));
        let rows = drive(&hidden, &way, RATES).rows();
        for robot in (body..ROBOTS).step_by(BODIES) {
            let mut own = made.clone();
            own.about.robot = name(robot);
            let file = folder.join(format!("{}.json", name(robot)));
            fs::write(file, own.write()).expect("written");
            // Robots do not speak all at once.
            let shift = 0.2 * (robot as f64 / ROBOTS as f64);
            due.extend(rows.iter().map(|row| Due {
                second: row.arrived_s().unwrap_or(0.0) + shift,
                robot,
                row: *row,
            }));
        }
    }
    due.sort_by(|a, b| a.second.total_cmp(&b.second));
    due
}

fn name(robot: usize) -> String {
    format!("robot-{robot:04}")
}

fn main() {
    let folder = std::env::temp_dir().join(format!("crawler-twins-live-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder");
    let due = evidence(&folder);
    let text = r#"{"robot":"robot","seq":1,"timestamp":6,"state":"MOVING","behaviour":"wander","pose":{"x":0,"y":0,"theta":0,"sigma":0.1},"range_mm":812,"temperature_c":22.5,"wheels":{"left":0.5,"right":0.5},"battery":{"mv":7610,"percent":71},"rssi_dbm":-61}"#;
    let samples = (0..ROBOTS).map(|robot| {
        let read = open::read::<Telemetry>(text.as_bytes());
        let mut sample = read.expect("telemetry").message;
        sample.robot = RobotId::new(&name(robot)).expect("an id");
        sample
    });
    let mut samples: Vec<Telemetry> = samples.collect();
    let (begun, begun_ms) = (Instant::now(), unix_ms());
    let (twins, worker) = Twins::new(ROBOTS, folder.clone(), (begun, begun_ms), |_: &RobotId| {
        None
    });
    let (ends, measures) = (AtomicBool::new(false), AtomicBool::new(false));
    let stamp = |second: f64| (begun_ms as f64 + second * 1e3).max(1.0) as u64;

    let (mut calls, mut refused, mut fixes, mut ages) = (Vec::new(), 0_u64, 0_u64, Vec::new());
    let (mut stepped, mut asked) = (Duration::ZERO, Duration::ZERO);
    let (mut gap, mut measured) = (None, Duration::ZERO);
    std::thread::scope(|scope| {
        let stepping = scope.spawn(|| {
            let before = std::cell::Cell::new(None);
            let stops = || {
                if measures.load(Ordering::Relaxed) && before.get().is_none() {
                    before.set(Some(ThreadTime::now()));
                }
                ends.load(Ordering::Relaxed)
            };
            worker.run(stops, unix_ms, |notices| {
                for notice in notices {
                    println!("named: {:?} {}", notice.robot, notice.text);
                }
            });
            before
                .get()
                .map_or(Duration::ZERO, |before: ThreadTime| before.elapsed())
        });
        // Somebody looks at every twin and its forecasts once a second.
        let asking = scope.spawn(|| {
            let mut spent = Duration::ZERO;
            let robots: Vec<RobotId> = (0..ROBOTS)
                .map(|robot| RobotId::new(&name(robot)).expect("an id"))
                .collect();
            while !ends.load(Ordering::Relaxed) {
                let (before, due) = (ThreadTime::now(), Instant::now() + Duration::from_secs(1));
                for robot in &robots {
                    let now = Instant::now();
                    std::hint::black_box((
                        twins.state(robot, now, unix_ms()).ok(),
                        twins.forecast(robot, now, unix_ms()).ok(),
                    ));
                }
                if measures.load(Ordering::Relaxed) {
                    spent += before.elapsed();
                }
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
            }
            spent
        });
        for Due { second, robot, row } in &due {
            if *second > 2.0 * SECONDS {
                break;
            }
            let at = begun + Duration::from_secs_f64(*second);
            std::thread::sleep(at.saturating_duration_since(Instant::now()));
            let is_measured = *second > SECONDS;
            measures.store(is_measured, Ordering::Relaxed);
            let sample = &mut samples[*robot];
            let before = Instant::now();
            let taken = match row {
                Row::Duty(duty) => {
                    sample.timestamp = stamp(duty.at_s + *second - row.arrived_s().unwrap_or(0.0));
                    (sample.wheels.left, sample.wheels.right) =
                        (duty.duty[0] as f32, duty.duty[1] as f32);
                    twins.telemetry(sample, before)
                }
                Row::Supply(supply) => {
                    sample.battery.mv = (supply.volts * 1e3) as u16;
                    continue;
                }
                Row::Fix(fix) => {
                    fixes += u64::from(is_measured);
                    let fix = PoseFix {
                        robot: sample.robot.clone(),
                        timestamp: stamp(fix.at_s + *second - row.arrived_s().unwrap_or(0.0)),
                        pose: Pose {
                            x: fix.x as f32,
                            y: fix.y as f32,
                            theta: fix.theta as f32,
                            sigma: fix.sigma_m as f32,
                        },
                    };
                    twins.fix(&fix, before)
                }
            };
            if is_measured {
                calls.push(before.elapsed());
            }
            refused += u64::from(taken.is_err());
        }
        for sample in &samples {
            let state = twins.state(&sample.robot, Instant::now(), unix_ms());
            ages.extend(state.map(|state| (state.age, state.body.is_some(), state.view.fixes)));
        }
        let before = ThreadTime::now();
        gap = twins.gap(Instant::now(), unix_ms()).ok();
        measured = before.elapsed();
        ends.store(true, Ordering::Relaxed);
        stepped = stepping.join().expect("stepped");
        asked = asking.join().expect("asked");
    });
    let _ = fs::remove_dir_all(&folder);

    calls.sort();
    ages.sort();
    let of = |share: f64| {
        let place = (calls.len() as f64 * share) as usize;
        calls[place.min(calls.len() - 1)].as_secs_f64() * 1e6
    };
    let certified = ages.iter().filter(|(_, certified, _)| *certified).count();
    println!("\n| {ROBOTS} twins in a server, for {SECONDS:.0} s | |\n|---|---:|");
    println!(
        "| samples and fixes a second | {:.0} |",
        calls.len() as f64 / SECONDS
    );
    println!("| of them fixes | {:.0} |", fixes as f64 / SECONDS);
    println!(
        "| stepping them, of a core | {:.2} |",
        stepped.as_secs_f64() / SECONDS
    );
    println!(
        "| a state and forecasts of each, every second, of a core | {:.2} |",
        asked.as_secs_f64() / SECONDS
    );
    println!(
        "| what whoever hears a robot waits, µs (median, 99 %, 99.9 %, longest) | {:.1}, {:.1}, {:.1}, {:.0} |",
        of(0.5),
        of(0.99),
        of(0.999),
        of(1.0)
    );
    println!("| samples and fixes that found no room | {refused} |");
    println!(
        "| twins at the end, with their certificates | {}, {certified} |",
        ages.len()
    );
    println!(
        "| the gap of all, measured once, s | {:.2} |",
        measured.as_secs_f64()
    );
    let gap = gap.expect("a gap");
    let enough = |gap: &&crawler_twins::RobotGap| gap.measures.errors[0].value.is_some();
    println!(
        "| robots with enough for a gap 1 s ahead | {} |",
        gap.robots.iter().filter(enough).count()
    );
    if let (Some(middle), Some(last)) = (ages.get(ages.len() / 2), ages.last()) {
        println!(
            "| behind the robot, s (median, longest) | {:.2}, {:.2} |",
            middle.0.as_secs_f64(),
            last.0.as_secs_f64()
        );
    }
}
