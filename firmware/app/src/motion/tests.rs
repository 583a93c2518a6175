//! Kinematics, ramps and dead reckoning.

use core::f32::consts::PI;

use crawler_hal::{Duration, Instant};
use proptest::prelude::*;

use super::{DEAD_TIME, Odometry, Ramp, Twist, duty_for, settled_speed, wheel_speeds, wrap};
use crate::config::Geometry;

const PERIOD: Duration = Duration::from_millis(20);

fn geometry() -> Geometry {
    Geometry::default()
}

proptest! {
    #[test]
    fn saturation_keeps_the_curve(v in -5.0_f32..5.0, w in -40.0_f32..40.0, limit in 0.05_f32..1.0) {
        let geometry = geometry();
        let [left, right] = wheel_speeds(Twist { v, w }, &geometry, limit);
        prop_assert!(left.abs() <= limit * 1.000_1 && right.abs() <= limit * 1.000_1);
        // v/w is the radius; compared crosswise, so that zero is no special case.
        let (got_v, got_w) = (f32::midpoint(left, right), (right - left) / geometry.wheel_base_m);
        prop_assert!((got_v * w - got_w * v).abs() <= 1e-3 * (1.0 + v.abs() * w.abs()));
        prop_assert!(got_v * v >= 0.0 && got_w * w >= -1e-6, "same way round");
        let free = (v.abs() + w.abs() * geometry.wheel_base_m / 2.0) <= limit;
        prop_assert!(!free || (got_v - v).abs() < 1e-4 && (got_w - w).abs() < 1e-3);
    }

    #[test]
    fn duty_and_speed_are_inverse(speed in -0.6_f32..0.6) {
        let geometry = geometry();
        let duty = duty_for(speed, &geometry);
        prop_assert!(duty.abs() <= 1.0);
        if speed.abs() > 1e-3 {
            prop_assert!((settled_speed(duty, &geometry) - speed).abs() < 1e-4);
        }
    }

    /// Any targets at any moments: bounded steps, no jump across zero, a rest before a reversal.
    #[test]
    fn ramps_are_bounded_and_rest_before_reversing(
        targets in prop::collection::vec((any::<f32>(), 1_u64..60, any::<bool>()), 1..200),
        step in 0.01_f32..0.2,
    ) {
        let mut ramp = Ramp::default();
        let mut now = Instant::from_millis(1_000);
        let mut direction = 0.0_f32;
        let mut zero_since = now;
        for (target, ms, cut) in targets {
            now += Duration::from_millis(ms);
            let before = ramp.duty();
            if cut {
                ramp.cut(now);
                prop_assert_eq!(ramp.duty(), 0.0);
            } else {
                ramp.towards(target, step, now);
                prop_assert!((ramp.duty() - before).abs() <= step * 1.000_01);
            }
            let after = ramp.duty();
            prop_assert!((-1.0..=1.0).contains(&after));
            prop_assert!(before * after >= 0.0, "from {} to {}", before, after);
            if after == 0.0 && before != 0.0 {
                zero_since = now;
            }
            if before == 0.0 && after * direction < 0.0 {
                prop_assert!(now - zero_since >= DEAD_TIME);
            }
            if after != 0.0 {
                direction = after;
            }
        }
    }
}

#[test]
fn nonsense_stands_still() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let twist = Twist { v: bad, w: 0.0 };
        assert_eq!(wheel_speeds(twist, &geometry(), 0.5), [0.0; 2]);
        let twist = Twist { v: 0.1, w: bad };
        assert_eq!(wheel_speeds(twist, &geometry(), 0.5), [0.0; 2]);
    }
    let mut ramp = Ramp::default();
    assert_eq!(ramp.towards(f32::NAN, 0.1, Instant::BOOT), 0.0);
    assert_eq!(duty_for(f32::NAN, &geometry()), 0.0);
}

#[test]
fn straight_on_covers_what_the_model_says() {
    let geometry = geometry();
    let mut odometry = Odometry::default();
    for _ in 0..100 {
        odometry.advance([0.5, 0.5], PERIOD, &geometry);
    }
    // First-order lag: two seconds at the settled speed, less one time constant of it.
    let settled = settled_speed(0.5, &geometry);
    let expected = settled * (2.0 - geometry.time_constant_s);
    let pose = odometry.pose();
    assert!((pose.x - expected).abs() < 1e-3, "{pose:?}, not {expected}");
    assert!(pose.y.abs() < 1e-6 && pose.theta.abs() < 1e-6);
    // A tenth of the way, and what the heading that grows vaguer adds: 0.08 rad/m · way² ÷ 2.
    assert!((pose.sigma - 0.10 * expected - 0.04 * expected * expected).abs() < 2e-3);
    assert!((odometry.turn_sigma() - 0.08 * expected).abs() < 1e-3);
}

#[test]
fn one_late_step_is_as_good_as_many_in_time() {
    let geometry = geometry();
    let (mut often, mut once) = (Odometry::default(), Odometry::default());
    for _ in 0..50 {
        often.advance([0.6, 0.6], PERIOD, &geometry);
    }
    once.advance([0.6, 0.6], PERIOD * 50, &geometry);
    assert!((often.pose().x - once.pose().x).abs() < 1e-3);
}

#[test]
fn turning_in_place_turns_and_counts_into_sigma() {
    let geometry = geometry();
    let mut odometry = Odometry::default();
    let mut turned = 0.0;
    let mut last = 0.0;
    for _ in 0..200 {
        odometry.advance([-0.5, 0.5], PERIOD, &geometry);
        let theta = odometry.pose().theta;
        assert!((-PI..=PI).contains(&theta));
        turned += wrap(theta - last);
        last = theta;
    }
    let rate = 2.0 * settled_speed(0.5, &geometry) / geometry.wheel_base_m;
    let expected = rate * (4.0 - geometry.time_constant_s);
    assert!((turned - expected).abs() < 0.01, "{turned}, not {expected}");
    let pose = odometry.pose();
    assert!(libm::hypotf(pose.x, pose.y) < 1e-3);
    assert!((pose.sigma - 0.02 * expected).abs() < 0.01);
}

#[test]
fn sigma_never_shrinks_and_nothing_becomes_infinite() {
    let geometry = geometry();
    let mut odometry = Odometry::default();
    let mut sigma = 0.0;
    for seconds in [1, 60, 3_600, 86_400, 31_536_000] {
        odometry.advance([1.0, 0.7], Duration::from_secs(seconds), &geometry);
        let pose = odometry.pose();
        assert!(pose.sigma >= sigma && pose.sigma.is_finite());
        assert!(pose.x.is_finite() && pose.y.is_finite());
        sigma = pose.sigma;
    }
}

#[test]
fn standing_costs_nothing_and_changes_nothing() {
    let geometry = geometry();
    let mut odometry = Odometry::default();
    let before = odometry;
    // Below stiction nothing turns.
    odometry.advance([0.1, -0.1], Duration::from_secs(10), &geometry);
    assert_eq!(odometry, before);
}

#[test]
fn a_curve_goes_to_the_side_of_the_slower_wheel() {
    let geometry = geometry();
    let mut odometry = Odometry::default();
    for _ in 0..50 {
        odometry.advance([0.4, 0.6], PERIOD, &geometry);
    }
    let pose = odometry.pose();
    assert!(pose.theta > 0.1 && pose.y > 0.0 && pose.x > 0.0, "{pose:?}");
}
