//! Odometry against outside position references.

use core::f32::consts::PI;

use crawler_hal::Duration;
use crawler_protocol::Pose;
use proptest::prelude::*;
use rand_core::Rng;

use super::{Correction, Odometry, wrap};
use crate::config::Geometry;
use crate::testing::TestRng;

const PERIOD: Duration = Duration::from_millis(20);

fn pose(x: f32, y: f32, theta: f32, sigma: f32) -> Pose {
    Pose { x, y, theta, sigma }
}

fn correct(odometry: &mut Odometry, fix: Pose) -> Correction {
    odometry.correct(fix, Duration::ZERO, &Geometry::default())
}

fn drive(odometry: &mut Odometry, duties: [f32; 2], periods: u32) {
    for _ in 0..periods {
        odometry.advance(duties, PERIOD, &Geometry::default());
    }
}

fn way(a: Pose, b: Pose) -> f32 {
    libm::hypotf(a.x - b.x, a.y - b.y)
}

fn any_fix() -> impl Strategy<Value = Pose> {
    let sane = (-5.0_f32..5.0, -5.0_f32..5.0, -7.0_f32..7.0, 0.0_f32..0.5);
    let wild = (any::<f32>(), any::<f32>(), any::<f32>(), any::<f32>());
    prop_oneof![4 => sane, 1 => wild].prop_map(|(x, y, theta, sigma)| pose(x, y, theta, sigma))
}

/// Roughly normal: the sum of twelve uniform numbers less six (central limit theorem).
fn normal(rng: &mut TestRng) -> f32 {
    (0..12)
        .map(|_| (rng.next_u32() >> 8) as f32 / 16_777_216.0)
        .sum::<f32>()
        - 6.0
}

proptest! {
    #[test]
    fn whatever_is_seen_the_estimate_stays_one(
        steps in prop::collection::vec(
            (any_fix(), 0_u64..2_000, -1.0_f32..1.0, -1.0_f32..1.0, 0_u32..40), 1..60),
    ) {
        let mut odometry = Odometry::default();
        for (fix, age_ms, left, right, periods) in steps {
            drive(&mut odometry, [left, right], periods);
            let before = odometry;
            let age = Duration::from_millis(age_ms);
            let verdict = odometry.correct(fix, age, &Geometry::default());
            let (was, is) = (before.pose(), odometry.pose());
            prop_assert!(is.x.is_finite() && is.y.is_finite());
            prop_assert!(is.theta > -PI && is.theta <= PI, "heading {}", is.theta);
            prop_assert!(is.sigma >= 0.0 && odometry.turn_sigma() >= 0.0);
            prop_assert!(odometry.bend().abs() <= 1.0, "bends by {}", odometry.bend());
            match verdict {
                Correction::Weighed => {
                    prop_assert!(is.sigma <= was.sigma, "{} after {}", is.sigma, was.sigma);
                    prop_assert!(odometry.turn_sigma() <= before.turn_sigma());
                }
                Correction::Doubted | Correction::Refused => prop_assert_eq!(was, is),
                Correction::Adopted => prop_assert!(is.sigma > 0.0),
            }
        }
    }

    /// The robot's left motor is stronger than it knows; fixes with noise keep it on the track.
    #[test]
    fn noisy_fixes_lead_to_the_truth(
        seed in 1_u64..,
        left in 0.3_f32..0.9,
        right in 0.3_f32..0.9,
        stronger in 0.95_f32..1.05,
        start in (-5.0_f32..5.0, -5.0_f32..5.0, -3.0_f32..3.0),
    ) {
        let mut rng = TestRng(seed);
        let sigma = 0.01;
        let (mut truth, mut odometry) = (Odometry::default(), Odometry::default());
        correct(&mut truth, pose(start.0, start.1, start.2, sigma));
        let mut doubts = 0;
        for second in 0..30 {
            let at = truth.pose();
            let fix = pose(
                at.x + sigma * normal(&mut rng),
                at.y + sigma * normal(&mut rng),
                at.theta + 0.02 * normal(&mut rng),
                sigma,
            );
            doubts += u32::from(correct(&mut odometry, fix) == Correction::Doubted);
            // Half a second at rest now and then: the best estimate is better than one fix.
            let duties = if second % 5 == 4 { [0.0; 2] } else { [left, right] };
            drive(&mut truth, [duties[0] * stronger, duties[1]], 25);
            drive(&mut odometry, duties, 25);
            let off = way(truth.pose(), odometry.pose());
            let turned = wrap(truth.pose().theta - odometry.pose().theta).abs();
            prop_assert!(off < 0.12 && turned < 0.4, "{off} m and {turned} rad off");
            prop_assert!(off < 5.0 * odometry.pose().sigma + 0.02, "{} off {:?}", off, odometry);
        }
        prop_assert!(doubts <= 1, "{doubts} honest fixes were doubted");
    }

    #[test]
    fn one_absurd_fix_among_good_ones_changes_nothing(
        x in 1.0_f32..900.0, y in -900.0_f32..900.0, theta in -3.0_f32..3.0,
    ) {
        let mut odometry = Odometry::default();
        let good = pose(0.0, 0.0, 0.1, 0.01);
        correct(&mut odometry, good);
        for _ in 0..10 {
            prop_assert_eq!(correct(&mut odometry, good), Correction::Weighed);
            let before = odometry.pose();
            // Two in a row are not enough either.
            for _ in 0..2 {
                let absurd = pose(x, y, theta, 0.01);
                prop_assert_eq!(correct(&mut odometry, absurd), Correction::Doubted);
                prop_assert_eq!(odometry.pose(), before);
            }
        }
    }
}

#[test]
fn the_first_fix_gives_the_frame() {
    let mut odometry = Odometry::default();
    drive(&mut odometry, [0.5, 0.6], 50);
    let fix = pose(3.0, -4.0, PI, 0.02);
    assert_eq!(correct(&mut odometry, fix), Correction::Adopted);
    // What it is moved on by has an age of nothing.
    assert_eq!(odometry.pose(), fix);
}

#[test]
fn weights_are_those_of_the_variances() {
    let mut odometry = Odometry::default();
    correct(&mut odometry, pose(0.0, 0.0, 3.1, 0.08));
    correct(&mut odometry, pose(0.1, 0.0, -3.1, 0.04));
    let after = odometry.pose();
    // 0.08² ÷ (0.08² + 0.04²) = 0.8; the short way round, across π.
    assert!((after.x - 0.08).abs() < 1e-5, "{after:?}");
    assert!((after.theta - wrap(3.1 + 0.8 * 0.083_185)).abs() < 1e-3);
    assert!((after.sigma - 0.04 * libm::sqrtf(0.8)).abs() < 1e-4);
}

#[test]
fn a_robot_that_was_carried_away_is_found_after_three_fixes_that_agree() {
    let mut odometry = Odometry::default();
    correct(&mut odometry, pose(0.0, 0.0, 0.0, 0.01));
    // Different places convince nobody.
    for n in 1..20 {
        let n = n as f32;
        let fix = pose(3.0 * n, -n, 0.3 * n, 0.01);
        assert_eq!(correct(&mut odometry, fix), Correction::Doubted);
    }
    let there = pose(-4.0, 4.0, -2.0, 0.01);
    assert_eq!(correct(&mut odometry, there), Correction::Doubted);
    // It goes on driving meanwhile, and the doubted place with it.
    assert_eq!(correct(&mut odometry, there), Correction::Doubted);
    assert_eq!(correct(&mut odometry, there), Correction::Adopted);
    assert_eq!(odometry.pose(), there);
    assert_eq!(correct(&mut odometry, there), Correction::Weighed);
}

#[test]
fn a_robot_held_up_by_a_wall_believes_the_next_fix() {
    let mut odometry = Odometry::default();
    let wall = pose(2.0, 1.0, 0.5, 0.01);
    correct(&mut odometry, wall);
    drive(&mut odometry, [0.8, 0.8], 25);
    assert!(way(odometry.pose(), wall) > 0.15);
    assert_eq!(correct(&mut odometry, wall), Correction::Weighed);
    assert!(way(odometry.pose(), wall) < 0.08, "{:?}", odometry.pose());
}

#[test]
fn a_late_fix_is_moved_on_by_what_was_driven_since() {
    let mut odometry = Odometry::default();
    correct(&mut odometry, pose(0.0, 0.0, 0.0, 0.01));
    drive(&mut odometry, [0.6, 0.6], 100);
    let seen = odometry.pose();
    drive(&mut odometry, [0.6, 0.6], 10);
    let before = odometry.pose();
    let late = pose(seen.x, seen.y, seen.theta, 0.01);
    odometry.correct(late, PERIOD * 10, &Geometry::default());
    assert!(way(before, odometry.pose()) < 1e-3);
}

#[test]
fn a_full_battery_drives_faster_and_a_strange_reading_does_not_count() {
    use crawler_hal::Millivolts;
    let nominal = Geometry::default();
    let same = nominal.at(Millivolts(7_400));
    assert!((same.top_speed_mps - nominal.top_speed_mps).abs() < 1e-6);
    let full = nominal.at(Millivolts(8_400));
    assert!(full.top_speed_mps > nominal.top_speed_mps);
    assert!(full.stiction_duty < nominal.stiction_duty);
    for mv in [0, 1, 3_000, u16::MAX] {
        let odd = nominal.at(Millivolts(mv));
        let share = odd.top_speed_mps / nominal.top_speed_mps;
        assert!((0.2..2.0).contains(&share), "{mv} mV: {share}");
        assert!((0.0..1.0).contains(&odd.stiction_duty));
    }
}

/// Drives straight on for `periods` of a robot that bends by `bend` radians per metre without knowing it, with a fix every half
/// second that has noise; returns the odometry and the true pose.
fn straight_on(bend: f32, periods: u32, rng: &mut TestRng) -> (Odometry, Pose) {
    const SIGMA: f32 = 0.02;
    let geometry = Geometry::default();
    let mut odometry = Odometry::default();
    let mut truth = Pose::default();
    let fix = |truth: Pose, rng: &mut TestRng| Pose {
        x: truth.x + SIGMA * normal(rng),
        y: truth.y + SIGMA * normal(rng),
        theta: truth.theta + 0.02 * normal(rng),
        sigma: SIGMA,
    };
    let _ = correct(&mut odometry, fix(truth, rng));
    let mut untold = odometry;
    for period in 1..=periods {
        let before = untold.pose();
        untold.advance([0.5, 0.5], PERIOD, &geometry);
        let forward = way(untold.pose(), before);
        odometry.advance([0.5, 0.5], PERIOD, &geometry);
        let (sin, cos) = libm::sincosf(truth.theta + bend * forward * 0.5);
        truth.x += forward * cos;
        truth.y += forward * sin;
        truth.theta = wrap(truth.theta + bend * forward);
        if period % 25 == 0 {
            let _ = correct(&mut odometry, fix(truth, rng));
        }
    }
    (odometry, truth)
}

#[test]
fn how_much_a_robot_bends_is_learned_and_its_heading_is_not_late() {
    let mut rng = TestRng(11);
    for bend in [-0.4, -0.2, 0.0, 0.2, 0.4] {
        let (odometry, truth) = straight_on(bend, 1_000, &mut rng);
        let learned = odometry.bend();
        assert!(libm::fabsf(learned - bend) < 0.05, "{learned} for {bend}");
        let off = libm::fabsf(wrap(odometry.pose().theta - truth.theta));
        // If it were not learned, the heading would be late by some six times what a fix puts right at once.
        assert!(off < 0.03, "{off} for {bend}");
    }
}

#[test]
fn carrying_a_robot_says_nothing_of_how_it_bends() {
    let (mut odometry, truth) = straight_on(0.2, 1_000, &mut TestRng(5));
    let before = odometry.bend();
    let elsewhere = pose(truth.x + 3.0, truth.y, wrap(truth.theta + 2.0), 0.02);
    let verdicts: std::vec::Vec<Correction> =
        (0..3).map(|_| correct(&mut odometry, elsewhere)).collect();
    assert_eq!(verdicts[2], Correction::Adopted);
    assert_eq!(odometry.bend(), before);
}
