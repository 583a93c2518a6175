//! How often what really happened lies in the region in which a counterfactual has it that changes nothing.
//!
//! `cargo run --release --example null_test [REALITIES]`: realities with bodies of `wild` that nobody can look into. In each
//! a robot was calibrated before, by a drive; then it and three others, which were not, are told where to go: each in a lane of its
//! own, or across each other's way; or they wander. What became of them is held against the draws.

#[path = "../tests/suite/recorded.rs"]
mod recorded;

use std::error::Error;
use std::sync::Arc;

use crawler_counterfactuals::Certificates;
use crawler_counterfactuals::answer::Answer;
use crawler_protocol::RobotId;
use crawler_sim::run::{Duration, Simulation};
use crawler_sim::scenario::Scenario;
use crawler_twin::certificate::{About, Certificate, certify};
use crawler_twin::evidence::{Duty, Evidence, Fix, Row, Supply};
use crawler_twin::script;
use rand_core::Rng as _;
use rand_pcg::Pcg32;
use serde_json::{Value, json};

use recorded::Recorded;

const HALL: &str = r#"
name = "hall"
robots = 4
randomisation = "wild"
link = {}
bodies = [{ charge = 0.7 }]
arena = { width = 6.0, height = 6.0, scatter = { per_square_metre = 0.0 } }
tracker = { rate_hz = 10.0 }
[spawn]
poses = [{ x = -2.4, y = -2.1 }, { x = -2.4, y = -0.7 }, { x = 2.4, y = 0.7, theta = 3.1 }, { x = 2.4, y = 2.1, theta = 3.1 }]
"#;

/// When robots have booted, milliseconds.
const BOOTED_MS: u64 = 8_000;
/// When they have gone to and fro in their lanes, milliseconds.
const DRIVEN_MS: u64 = 54_000;
/// The calibrated one.
const ROBOT: &str = "sim-0001";
/// Noise of its tracker while it was calibrated, metres and radians.
const NOISE: [f64; 2] = [0.005, 0.01];

/// What robots are told.
#[derive(Clone, Copy)]
enum Task {
    /// To the other side, each in its lane.
    Lanes,
    /// To the other side, across each other's way.
    Across,
    /// To wander.
    Wander,
    /// To where they began.
    Back,
}

impl Task {
    /// For robots by their places.
    fn command(self, robot: usize) -> Value {
        let ends = match self {
            Self::Wander => {
                return json!({ "command": "behave", "parameters": { "behaviour": "wander" } });
            }
            Self::Lanes => [[2.4, -2.1], [2.4, -0.7], [-2.4, 0.7], [-2.4, 2.1]],
            Self::Back => [[-2.4, -2.1], [-2.4, -0.7], [2.4, 0.7], [2.4, 2.1]],
            Self::Across => [[2.4, 2.1], [2.4, 0.7], [-2.4, -0.7], [-2.4, -2.1]],
        };
        let [x, y]: [f64; 2] = ends[robot];
        json!({ "command": "goto", "parameters": { "x": x, "y": y } })
    }
}

/// Records that were tested, and those of them inside.
#[derive(Default)]
struct Tally {
    tested: u32,
    inside: u32,
    /// Radius of the regions in the end, added up, metres.
    within_m: f64,
}

impl Tally {
    fn add(&mut self, answer: &Answer, only: bool) {
        let robots = answer.robots.iter();
        for robot in robots.filter(|robot| (robot.robot.as_str() == ROBOT) == only) {
            if let Some(inside) = robot.inside {
                self.tested += 1;
                self.inside += u32::from(inside);
                self.within_m += f64::from(*robot.was.within.last().unwrap_or(&0.0));
            }
        }
    }

    fn print(&self, what: &str) {
        let Self {
            tested,
            inside,
            within_m,
        } = self;
        let share = 100.0 * f64::from(*inside) / f64::from(*tested).max(1.0);
        let mean = within_m / f64::from(*tested).max(1.0);
        println!("{what:<44}{inside:>6} of {tested:<6}{share:>6.1} %{mean:>10.2} m");
    }
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    // `cargo bench` and `xtask` hand on more than a number.
    let number = std::env::args().skip(1).find_map(|word| word.parse().ok());
    let realities: u64 = number.unwrap_or(25);
    println!(
        "{:<44}{:>16}{:>12}{:>12}",
        "what is held against its draws", "inside", "share", "region"
    );
    let rows = [
        ("in its lane, by its certificate", true),
        ("the same by what it did before", true),
        ("the same, it has just begun to move", true),
        ("others in their lanes, by what they did", false),
        ("across, by its certificate", true),
        ("others across, by what they did", false),
        ("wandering, by its certificate", true),
        ("others wandering, by what they did", false),
    ];
    let mut tallies: [Tally; 8] = Default::default();
    let mut refused = 0;
    for seed in 1..=realities {
        let Some(certificate) = calibrate(seed)? else {
            refused += 1;
            continue;
        };
        let certificate = Arc::new(certificate);
        let known: Arc<Certificates> = Arc::new(move |robot: &RobotId| {
            (robot.as_str() == ROBOT).then(|| Arc::clone(&certificate))
        });
        let none: Arc<Certificates> = Arc::new(|_| None);
        let lanes = ask(seed, Arc::clone(&known), Task::Lanes, true).await;
        let seen = ask(seed, Arc::clone(&none), Task::Lanes, true).await;
        let fresh = ask(seed, none, Task::Lanes, false).await;
        let across = ask(seed, Arc::clone(&known), Task::Across, true).await;
        let wander = ask(seed, known, Task::Wander, true).await;
        let answers = [
            &lanes, &seen, &fresh, &lanes, &across, &across, &wander, &wander,
        ];
        for ((tally, (_, own)), answer) in tallies.iter_mut().zip(rows).zip(answers) {
            tally.add(answer, own);
        }
    }
    for ((what, _), tally) in rows.iter().zip(&tallies) {
        tally.print(what);
    }
    println!("{refused} of {realities} drives gave no certificate");
    Ok(())
}

/// Lets a reality pass, and asks what would have become of it without any change; before that robots may have driven, in
/// their lanes, or as they do anyhow.
async fn ask(seed: u64, certificates: Arc<Certificates>, task: Task, driven: bool) -> Answer {
    let robots = [ROBOT, "sim-0002", "sim-0003", "sim-0004"];
    let all =
        |at: u64, task: Task| [0, 1, 2, 3].map(|robot| (at, robots[robot], task.command(robot)));
    let (begin, told) = (BOOTED_MS, if driven { DRIVEN_MS } else { BOOTED_MS });
    let mut orders = Vec::new();
    if matches!(task, Task::Wander) {
        orders.extend(all(begin, task));
    } else {
        if driven {
            orders.extend(all(begin, Task::Lanes));
            orders.extend(all(u64::midpoint(begin, told), Task::Back));
        }
        orders.extend(all(told, task));
    }
    let past = Recorded::of(HALL, seed, told / 1_000 + 16, &orders, certificates).await;
    // Only the world as it was counts here.
    let at_ms = told as i64 + 3_000;
    let mut question = past.question(at_ms, Some(&[ROBOT]), &json!({ "command": "stop" }));
    (question.seconds, question.draws) = (8, 40);
    Arc::unwrap_or_clone(past.answer(question).await)
}

/// Drives the robot of a reality as a calibration does; `None` where that gives no certificate.
fn calibrate(seed: u64) -> Result<Option<Certificate>, Box<dyn Error>> {
    let mut scenario = Scenario::parse(&script::scenario())?;
    scenario.randomisation = Scenario::parse(HALL)?.randomisation;
    let end = scenario.duration_s;
    let mut world = Simulation::lockstep(scenario, seed)?;
    let mut rng = Pcg32::new(seed, 1);
    let mut noise = |sigma: f64| {
        let mut unit = || (f64::from(rng.next_u32()) + 0.5) / 4_294_967_296.0;
        let (one, other) = (unit(), unit());
        sigma * (-2.0 * one.ln()).sqrt() * (std::f64::consts::TAU * other).cos()
    };
    let mut evidence = Evidence::default();
    while (world.now().as_micros() as f32) < end * 1e6 {
        world.run_for(Duration::from_millis(50));
        let at_s = world.now().as_micros() as f64 * 1e-6;
        let own = world.robot(0).ok_or("there is no robot")?.snapshot();
        let pose = world.pose(0).ok_or("there is no robot")?;
        let rows = [
            Row::Duty(Duty {
                at_s,
                arrived_s: None,
                duty: own.wheels.map(f64::from),
            }),
            Row::Fix(Fix {
                at_s,
                arrived_s: None,
                x: f64::from(pose.x) + noise(NOISE[0]),
                y: f64::from(pose.y) + noise(NOISE[0]),
                theta: f64::from(pose.theta) + noise(NOISE[1]),
                sigma_m: NOISE[0],
            }),
        ];
        let supply = own.battery.voltage.map(|millivolts| {
            Row::Supply(Supply {
                at_s,
                arrived_s: None,
                volts: f64::from(millivolts.0) * 1e-3,
            })
        });
        for row in rows.into_iter().chain(supply) {
            evidence
                .take(row)
                .map_err(|refusal| format!("{refusal:?}"))?;
        }
    }
    let about = About {
        robot: ROBOT.to_owned(),
        ..About::default()
    };
    Ok(certify(&evidence, about, None).ok())
}
