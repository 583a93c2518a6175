//! The drive where a robot stands: what it takes of the floor, and what certificates from it are worth.

use crawler_twin::body::{Parameters, Pose};
use crawler_twin::certificate::{About, Certificate, Refused, certify_on};
use crawler_twin::course::{Course, Limits, Part};
use crawler_twin::predict::quantile;
use crawler_twin::rehearsal::Sweep;
use proptest::prelude::*;

use crate::reference::{Hidden, Rates, Story, drive_by};

const RATES: Rates = Rates {
    telemetry: 20,
    fixes: 10,
};
const USUAL: Limits = Limits { v: 0.5, w: 3.0 };
/// A lease of a word, seconds: orders come five times a second.
const MARGIN_M: f64 = 0.2;

/// The duties of a program that believes in the nominal body.
fn duties(v: f64, w: f64, volts: f64, limits: Limits) -> [f64; 2] {
    let p = Parameters::NOMINAL;
    let (left, right) = (v - 0.5 * w * p.track_m, v + 0.5 * w * p.track_m);
    let scale = (limits.v / left.abs().max(right.abs()).max(1e-9)).min(1.0);
    [left, right].map(|speed| {
        let motor = p.friction_v[0] + (speed * scale).abs() / p.speed_per_volt[0];
        if speed == 0.0 {
            0.0
        } else {
            (motor / (volts - p.bridge_drop_v)).min(1.0) * speed.signum()
        }
    })
}

/// A hidden robot drives the course; returns when what is held out begins.
fn course(hidden: &Hidden, limits: Limits, seed: u64) -> (Story, f64) {
    let mut course = Course::new(limits, seed);
    let (mut until, mut held, mut leg) = (0.0, f64::MAX, (0.0, 0.0));
    let story = drive_by(hidden, RATES, |now, fix, volts| {
        if now >= until {
            let at = fix.map_or_else(Pose::default, |fix| Pose {
                x: fix.x,
                y: fix.y,
                theta: fix.theta,
            });
            let ago_s = fix.map_or(0.0, |fix| now - fix.at_s);
            let (part, next) = course.next(at, ago_s)?;
            if part == Part::HeldOut && held == f64::MAX {
                held = now;
            }
            until += next.seconds;
            leg = (next.v, next.w);
        }
        Some(duties(leg.0, leg.1, volts, limits))
    });
    (story, held)
}

fn certified(hidden: &Hidden, seed: u64) -> Result<Certificate, Refused> {
    let (story, held_s) = course(hidden, USUAL, seed);
    let evidence = story.evidence();
    let (known, held) = (
        evidence.part(f64::MIN, held_s),
        evidence.part(held_s, f64::MAX),
    );
    certify_on(&known, &held, About::default(), None)
}

#[test]
fn a_short_drive_on_little_floor_finds_hidden_robots_out() {
    let (mut speed, mut ratio, mut track, mut sides) = (vec![], vec![], vec![], vec![]);
    for seed in 0..16 {
        let hidden = Hidden::draw(1_000 + seed, 0.0);
        let made = certified(&hidden, seed).expect("a certificate");
        let p = made.parameters;
        for duty in [0.4, 0.6, 0.8] {
            let got = p.settled(duty, hidden.shown(7.4));
            let [left, right] = [0, 1].map(|k| got[k] / hidden.settled(k, duty, 7.4));
            speed.extend([(left - 1.0).abs(), (right - 1.0).abs()]);
            ratio.push((left / right - 1.0).abs());
        }
        track.push((p.track_m / hidden.track - 1.0).abs());
        let (story, _) = course(&hidden, USUAL, seed);
        for axis in [|pose: &Pose| pose.x, |pose: &Pose| pose.y] {
            let ends = story.truth.iter().map(axis);
            let (low, high) = ends.fold((0.0_f64, 0.0_f64), |(low, high), at| {
                (low.min(at), high.max(at))
            });
            sides.push(high - low);
        }
    }
    let shares = |values: &mut [f64]| (quantile(values, 0.5), quantile(values, 0.9));
    let (speed, ratio) = (shares(&mut speed), shares(&mut ratio));
    let (track, sides) = (shares(&mut track), shares(&mut sides));
    println!("settled speed {speed:?}, ratio {ratio:?}, track {track:?}, floor {sides:?}");
    assert!(speed.0 <= 0.01 && speed.1 <= 0.035, "{speed:?}");
    assert!(ratio.0 <= 0.003, "{ratio:?}");
    assert!(track.0 <= 0.005, "{track:?}");
    assert!(sides.0 <= 1.0 && sides.1 <= 1.6, "{sides:?}");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..crawler_properties::cases(48) })]

    /// Whatever robot it is: it stays within what was permitted.
    #[test]
    fn no_robot_leaves_what_a_drive_may_take(
        robot in any::<u32>(),
        seed in any::<u64>(),
        odd in 0.0..1.0_f64,
        v in 0.3..1.0_f64,
        w in 1.5..6.0_f64,
    ) {
        let limits = Limits { v, w };
        let sweep = Sweep::of(limits, (0.01, 0.03));
        let (story, _) = course(&Hidden::draw(robot.into(), odd), limits, seed);
        for pose in &story.truth {
            prop_assert!(sweep.holds(Pose::default(), [pose.x, pose.y], MARGIN_M), "{pose:?}");
        }
        prop_assert!(story.truth.len() <= 90_000, "{} ms", story.truth.len());
    }
}
