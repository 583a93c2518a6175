//! Measures what robots see, and what that costs a simulation: `cargo xtask bench vision`.
//!
//! ```text
//! vision_bench scores [FRAMES]         F1 on the first frames of the test split, seed 1
//! vision_bench robots N [SPAN-S]       robots that wander with cameras, with eyes and without
//! ```
//!
//! Prints lines of a name and a number.

use std::error::Error;
use std::time::Instant;

use cpu_time::ThreadTime;
use crawler_app::vision::{Class, Detector, Picture, Spots, spots};
use crawler_detector::BLOB;
use crawler_hal::{Duration, FrameFormat};
use crawler_micromodel::{Model, Runner};
use crawler_sim::render::Frame;
use crawler_sim::run::Simulation;
use crawler_sim::scenario::Scenario;
use crawler_sim::tools::dataset::scores::Tally;
use crawler_sim::tools::dataset::{Split, picture};

const USAGE: &str = "usage: vision_bench scores [FRAMES] | robots N [SPAN-S]";
/// Seed of the data set that the detector's README names.
const SEED: u64 = 1;
const SIZE: (u16, u16) = (96, 96);
/// The initial command has reached everyone by then.
const WARM_UP: Duration = Duration::from_secs(6);

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |place: usize, usual: u32| match arguments.get(place) {
        None => Ok(usual),
        Some(text) => text
            .parse()
            .ok()
            .filter(|number| (1..=1_000_000).contains(number))
            .ok_or_else(|| format!("{text:?} is no number from 1 to 1000000\n{USAGE}")),
    };
    match arguments.first().map(String::as_str) {
        Some("scores") => scores(number(1, 2_000)?),
        Some("robots") => robots(number(1, 1_000)?, number(2, 10)?),
        _ => Err(USAGE.into()),
    }
}

/// F1 of frames with eight bits a colour, which are what the network was trained with, and of the
/// same frames as a robot's camera gives them.
fn scores(frames: u32) -> Result<(), Box<dyn Error>> {
    let model = Model::new(BLOB)?;
    let shape = model.output();
    let mut arena = vec![0; model.arena_bytes()];
    let mut runner = Runner::new(model, &mut arena)?;
    let detector = Detector::new(BLOB).map_err(|error| format!("{error:?}"))?;
    let mut second = vec![0; detector.arena_bytes()];
    let mut finder = detector
        .run_in(&mut second)
        .map_err(|error| format!("{error:?}"))?;
    let mut camera = vec![0; usize::from(SIZE.0) * usize::from(SIZE.1) * 2];
    let mut frame = Frame::square();
    let (mut full, mut robot) = (Tally::default(), Tally::default());
    for number in 0..frames {
        let truths = picture(SEED, Split::Test, number, &mut frame);
        let pixels = frame.rgb();
        let cells = runner.run(|row, out| {
            let row = &pixels[row * out.len()..][..out.len()];
            for (out, pixel) in out.iter_mut().zip(row) {
                *out = (i16::from(*pixel) - 128) as i8;
            }
        });
        full.add(&truths, &spots(cells, shape));
        frame.rgb565(&mut camera);
        let picture = Picture::new(&camera, SIZE, FrameFormat::Rgb565)
            .map_err(|error| format!("{error:?}"))?;
        let seen: Spots = finder.find(&picture);
        robot.add(&truths, &seen);
    }
    println!("frames {frames}");
    for kind in Class::ALL {
        println!("judged_{} {}", kind.name(), full.judged(kind));
    }
    for (name, tally) in [("full", full), ("robot", robot)] {
        for kind in Class::ALL {
            println!("{name}_{} {:.4}", kind.name(), tally.of(kind));
        }
        println!("{name}_all {:.4}", tally.all());
    }
    Ok(())
}

/// Processor time of a lockstep world for each second in it. All robots have cameras and wander,
/// once without a detector and once with one.
fn robots(robots: u32, span_s: u32) -> Result<(), Box<dyn Error>> {
    let span = Duration::from_secs(u64::from(span_s));
    println!("robots {robots}");
    for (name, detector) in [("blind", None), ("seeing", Some(BLOB))] {
        let mut scenario = Scenario::built_in("arena")?.with_robots(robots);
        scenario.spawn.camera_share = 1.0;
        scenario.detector = detector;
        let mut simulation = Simulation::lockstep(scenario, SEED)?;
        simulation.run_for(WARM_UP);
        let looks = simulation.looks().taken;
        let (wall, cpu) = (Instant::now(), ThreadTime::now());
        simulation.run_for(span);
        let (wall, cpu) = (wall.elapsed(), cpu.elapsed());
        let looks = simulation.looks().taken - looks;
        let per_second = |seconds: f64| seconds / f64::from(span_s);
        println!("{name}_cpu_s {:.3}", per_second(cpu.as_secs_f64()));
        println!("{name}_wall_s {:.3}", per_second(wall.as_secs_f64()));
        println!("{name}_looks {:.1}", per_second(looks as f64));
    }
    Ok(())
}
