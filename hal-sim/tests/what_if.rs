//! A recorded run is made again, and with something else in it.

use std::fs;

use crate::recording::{END, Scratch, record};
use crawler_detector::BLOB;
use crawler_hal::Instant;
use crawler_sim::faults::{Fault, FaultError};
use crawler_sim::run::{Link, Simulation};
use crawler_sim::what_if::{Answer, NoAnswer, Run};

fn read(bytes: &[u8]) -> Run {
    Run::read(bytes, Some(BLOB)).expect("a run")
}

#[expect(
    clippy::unnecessary_wraps,
    reason = "a change says whether it could be made"
)]
fn nothing(_: &mut Simulation) -> Result<(), FaultError> {
    Ok(())
}

fn ms(moment: u64) -> Instant {
    Instant::from_millis(moment)
}

#[test]
fn a_run_that_nothing_is_done_to_is_the_run_itself() {
    for (link, name) in [(Link::Lockstep, "null"), (Link::None, "null-alone")] {
        let file = Scratch::new(name);
        let world = record(link, &file);
        let run = read(&fs::read(&file.0).expect("a file"));
        assert_eq!((run.seed(), run.end()), (5, ms(END)));
        let answer = run.ask(ms(9_500), run.end(), nothing).expect("an answer");
        assert_eq!(answer.same_s, 22);
        assert_eq!(answer.was, answer.would);
        assert_eq!(answer.was.history, world.history_hash(), "{link:?}");
        assert_eq!(answer.robots.len(), 5, "one was added");
        let parted = answer.robots.iter().filter_map(|robot| robot.parted_s);
        assert_eq!(parted.count(), 0, "{:?}", answer.robots);
        // It can be asked further than it was recorded, and again, to the same answer.
        let further = |run: &Run| {
            let broken = |world: &mut Simulation| {
                let fault = Fault::BrownOut;
                world.inject(3, fault, None)
            };
            run.ask(ms(20_000), ms(30_000), broken).expect("an answer")
        };
        let [one, other] = [further(&run), further(&run)];
        assert_eq!(one.was, other.was);
        assert_eq!(one.would, other.would);
        assert_eq!(one.robots, other.robots);
        assert!(
            (one.was.ran_s - 30.0).abs() < 1e-3 && one.same_s == 22,
            "{:?}",
            one.was
        );
    }
}

#[test]
fn something_else_changes_what_comes_after_it_and_nothing_before() {
    let file = Scratch::new("what-if");
    record(Link::Lockstep, &file);
    let run = read(&fs::read(&file.0).expect("a file"));
    let stuck = |world: &mut Simulation| -> Result<(), FaultError> {
        for wheel in [
            crawler_sim::faults::Wheel::Left,
            crawler_sim::faults::Wheel::Right,
        ] {
            let fault = Fault::MotorDead { wheel };
            world.inject(1, fault, None)?;
        }
        Ok(())
    };
    let asked = |at: u64| run.ask(ms(at), run.end(), stuck).expect("an answer");
    let parted = |answer: &Answer| answer.robots[1].parted_s.expect("it stands");
    let [early, late] = [asked(13_500), asked(16_000)];
    assert!((13.5..16.0).contains(&parted(&early)), "{early:?}");
    assert!((16.0..18.5).contains(&parted(&late)), "{late:?}");
    for answer in [early, late] {
        let first = answer.robots.iter().filter_map(|robot| robot.parted_s);
        let first = first.fold(f64::INFINITY, f64::min);
        assert!(
            (first - parted(&answer)).abs() < 1e-9,
            "it is the first: {answer:?}"
        );
        assert!(answer.robots[1].apart_m > Some(0.05), "{answer:?}");
        assert_ne!(answer.was.history, answer.would.history);
    }
}

#[test]
fn what_cannot_be_asked_is_said() {
    let file = Scratch::new("asked");
    record(Link::None, &file);
    let bytes = fs::read(&file.0).expect("a file");
    let run = read(&bytes);
    for (at, until) in [
        (23_000, 30_000),
        (5_000, 5_000),
        (9_000, 4_000),
        (0, 90_000_000),
    ] {
        let error = run.ask(ms(at), ms(until), nothing).expect_err("no run");
        assert!(matches!(error, NoAnswer::Moments { .. }), "{error}");
    }
    let refused = |world: &mut Simulation| {
        let fault = Fault::RangerDead;
        world.inject(77, fault, None)
    };
    let error = run
        .ask(ms(5_000), run.end(), refused)
        .expect_err("no robot");
    assert!(error.to_string().contains("no such robot"), "{error}");

    // A run of another seed is another one: where its fingerprints are known, that is found out.
    let other = run.with_seed(6).ask(ms(5_000), run.end(), nothing);
    assert_eq!(other.expect("an answer").same_s, 0);
    let told = |from: &str, to: &str| {
        let at = bytes
            .windows(from.len())
            .position(|part| part == from.as_bytes());
        let at = at.expect("it is there");
        let mut bytes = bytes.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        match Run::read(bytes.as_slice(), Some(BLOB)) {
            Err(error) => error.to_string(),
            Ok(run) => match run.ask(ms(5_000), run.end(), nothing) {
                Err(error) => error.to_string(),
                Ok(answer) => format!("{answer:?}"),
            },
        }
    };
    let seed = told("seed\u{1}\0\0\u{0}5", "seed\u{1}\0\0\u{0}6");
    assert!(
        seed.contains("another run of it, from second 1 on"),
        "{seed}"
    );
    let live = told("link\u{4}\0\0\0none", "link\u{4}\0\0\0live");
    assert!(live.contains("it ran in real time"), "{live}");
}
