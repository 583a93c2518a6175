//! Behaviours on their own, against a robot that does what it is told.

use core::f32::consts::PI;
use std::format;
use std::string::ToString;

use crawler_hal::{Duration, Instant, Millimeters};
use crawler_protocol::Pose;
use proptest::prelude::*;

use super::{Progress, SECTORS, Scan, Sector, escape_twist, goto_twist};
use crate::config::Geometry;
use crate::motion::{Odometry, duty_for, wheel_speeds};
use crate::perception::Sight;
use crate::state::{Escape, Side};
use crate::vision::Class;

const NOW: Instant = Instant::from_millis(5_000);
const PERIOD: Duration = Duration::from_millis(20);

proptest! {
    /// From anywhere to anywhere, with the lag of the motors, without overshoot that lasts.
    #[test]
    fn goto_arrives(x in -3.0_f32..3.0, y in -3.0_f32..3.0) {
        let geometry = Geometry::default();
        let mut odometry = Odometry::default();
        let mut steps = 0;
        while let Some(twist) = goto_twist(&odometry.pose(), [x, y], 0.1, 0.3, 3.0) {
            let speeds = wheel_speeds(twist, &geometry, 0.5);
            odometry.advance(speeds.map(|speed| duty_for(speed, &geometry)), PERIOD, &geometry);
            steps += 1;
            prop_assert!(steps < 1_500, "half a minute for {} m", libm::hypotf(x, y));
        }
        let pose = odometry.pose();
        prop_assert!(libm::hypotf(pose.x - x, pose.y - y) <= 0.1);
    }
}

#[test]
fn goto_turns_in_place_for_what_is_behind() {
    let pose = Pose::default();
    let twist = goto_twist(&pose, [-1.0, 0.1], 0.1, 0.3, 3.0).expect("not there");
    assert_eq!(twist.v, 0.0);
    assert!(twist.w > 0.0, "the short way round");
}

#[test]
fn an_escape_backs_off_and_then_turns_to_its_side() {
    let escape = Escape::backing(1, Side::Right, NOW);
    let back = escape_twist(&escape, 0.5, 3.0, NOW);
    assert!(back.v < 0.0 && back.w == 0.0);
    let turn = escape_twist(&escape, 0.5, 3.0, escape.back_until);
    assert!(turn.v == 0.0 && turn.w < 0.0);
    let slow = escape_twist(&Escape::turning(Side::Left, NOW), 0.5, 0.7, NOW);
    assert_eq!(slow.w, 0.7, "no faster than permitted");
}

#[test]
fn a_scan_is_one_turn_whatever_the_side_and_wherever_it_begins() {
    for (start, step) in [(0.0_f32, 0.05_f32), (3.0, 0.05), (-1.0, -0.07)] {
        let mut scan = Scan::new(start);
        let mut heading = start;
        let mut turned = 0.0;
        let result = loop {
            heading = libm::remainderf(heading + step, 2.0 * PI);
            turned += step;
            let near = heading.abs() < 0.1;
            let sight = if near {
                Sight::Range(Millimeters(450))
            } else {
                Sight::Clear
            };
            if let Some(result) = scan.observe(heading, Some(sight)) {
                break result;
            }
        };
        assert!(turned.abs() >= 2.0 * PI - 1e-3 && turned.abs() < 2.0 * PI + 0.1);
        assert_eq!(result.sectors[0], Sector::At(45), "from {start}");
        assert_eq!(result.sectors[SECTORS - 1], Sector::At(45));
        assert_eq!(result.sectors[SECTORS / 2], Sector::Clear);
    }
}

#[test]
fn a_scan_keeps_the_nearest_and_tells_what_it_did_not_see() {
    let mut scan = Scan::new(0.0);
    for mm in [900, 500, 700] {
        scan.observe(0.01, Some(Sight::Range(Millimeters(mm))));
    }
    scan.observe(0.02, Some(Sight::Clear));
    let mut result = None;
    for index in 1..=100 {
        result = result.or(scan.observe(wrapped(index as f32 * 0.1), None));
    }
    let result = result.expect("once around");
    assert_eq!(result.sectors[0], Sector::At(50));
    assert_eq!(result.sectors[5], Sector::Unseen);
    let [first, second] = result.halves().map(|half| half.to_string());
    assert_eq!(
        first,
        format!("cm per 15 deg from 0 deg: 50{}", " ?".repeat(11))
    );
    assert!(first.len() <= 88 && second.starts_with("cm per 15 deg from 180 deg:"));
}

#[test]
fn a_scan_tells_the_directions_of_what_was_recognised() {
    let mut scan = Scan::new(0.0);
    scan.recognise(0.3, Class::Object);
    scan.recognise(0.3, Class::Robot);
    // The direction is a sum of angles.
    scan.recognise(0.3 + 2.0 * PI, Class::Obstacle);
    scan.recognise(f32::NAN, Class::Robot);
    let mut result = None;
    for index in 1..=100 {
        result = result.or(scan.observe(wrapped(index as f32 * 0.1), None));
    }
    let result = result.expect("once around");
    let told: std::vec::Vec<_> = result.recognised().map(|half| half.to_string()).collect();
    let half = format!("seen per 15 deg from 0 deg: r bor{}", " -".repeat(10));
    assert_eq!(
        told,
        [half],
        "nothing is told of a half turn that showed nothing"
    );
    for direction in 0..24 {
        for class in Class::ALL {
            scan.recognise(direction as f32 * PI / 12.0 + 0.1, class);
        }
    }
    let result = (0..100).find_map(|index| scan.observe(wrapped(index as f32 * 0.1), None));
    let result = result.expect("once around");
    let longest = result.recognised().map(|half| half.to_string().len());
    assert_eq!(longest.max(), Some(77));
}

fn wrapped(angle: f32) -> f32 {
    libm::remainderf(angle, 2.0 * PI)
}

#[test]
fn progress_is_a_changing_range() {
    let range = |mm| Sight::Range(Millimeters(mm));
    let at = |ms| NOW + Duration::from_millis(ms);
    // Caught: the same within noise.
    let mut progress = Progress::default();
    let caught = (0..40).any(|i| progress.observe(range(800 + i % 3), at(80 * u64::from(i))));
    assert!(caught);
    // Driving at the slowest towards a wall.
    let mut progress = Progress::default();
    let caught = (0..100).any(|i| progress.observe(range(2_000 - i * 4), at(80 * u64::from(i))));
    assert!(!caught);
    // In the open there is nothing to go by.
    let mut progress = Progress::default();
    assert!((0..100).all(|i| !progress.observe(Sight::Clear, at(80 * i))));
}
