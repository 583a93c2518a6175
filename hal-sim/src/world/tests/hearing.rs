//! What a ranger hears of others.

use proptest::prelude::*;

use super::*;

const SPEED: f32 = 344.6e-6;

/// Two robots and one moment at which the second one has sent a ping, `age_us` before the first
/// one listens.
fn heard(a: Pose, b: Pose, obstacles: Vec<Obstacle>, age_us: u64) -> Option<f32> {
    let arena = Arena {
        obstacles,
        ..Arena::empty(20.0, 20.0)
    };
    let mut bench = TestWorld::new(arena, alike(), 1);
    for pose in [a, b] {
        bench.add(pose.x, pose.y, pose.theta);
    }
    bench.step();
    bench.world.shared.space.borrow_mut().bodies.ping(1, 10_500);
    bench.step();
    let mut space = bench.world.shared.space.borrow_mut();
    space.list_robots(0);
    space.crosstalk(0, 10_500 + age_us, SPEED, 0.02, 4.5)
}

fn facing(distance: f32) -> (Pose, Pose) {
    let mount = alike().ranger.mount_m;
    let b = Pose::new(distance + 2.0 * mount, 0.0, core::f32::consts::PI);
    (Pose::new(0.0, 0.0, 0.0), b)
}

#[test]
fn a_ping_that_comes_straight_is_taken_for_a_nearer_echo() {
    let (a, b) = facing(2.0);
    // It needs 5.8 ms. Sent at the same moment it looks like an echo from half the way.
    let told = heard(a, b, Vec::new(), 0).expect("it hears");
    assert!((told - 1.0).abs() < 1e-3, "{told}");
    let told = heard(a, b, Vec::new(), 3_000).expect("it hears");
    assert!(
        (told - (2.0 - 3_000.0 * SPEED) * 0.5).abs() < 1e-3,
        "{told}"
    );
    // Arrived before it began to listen, or in the ringing of its own burst.
    assert_eq!(heard(a, b, Vec::new(), 5_750), None);
    assert_eq!(heard(a, b, Vec::new(), 30_000), None);
}

#[test]
fn back_to_back_or_side_by_side_nobody_is_disturbed() {
    use core::f32::consts::{FRAC_PI_2, PI};
    let b = Pose::new(2.0, 0.0, 0.0);
    assert_eq!(
        heard(Pose::new(0.0, 0.0, PI), b, Vec::new(), 0),
        None,
        "back to back"
    );
    assert_eq!(
        heard(Pose::new(0.0, 0.0, 0.0), b, Vec::new(), 0),
        None,
        "it looks away"
    );
    let (a, b) = facing(2.0);
    let aside = Pose::new(a.x, a.y, FRAC_PI_2);
    assert_eq!(
        heard(aside, b, Vec::new(), 0),
        None,
        "the listener looks away"
    );
    // Just within and just beyond the beam of 12°.
    let turned = |degrees: f32| Pose::new(b.x, b.y, PI - degrees.to_radians());
    assert!(heard(a, turned(11.0), Vec::new(), 0).is_some());
    assert_eq!(heard(a, turned(13.0), Vec::new(), 0), None);
}

#[test]
fn what_stands_between_takes_the_ping() {
    let (a, b) = facing(2.0);
    let post = |y| Obstacle::Circle { x: 1.0, y, r: 0.05 };
    assert_eq!(heard(a, b, vec![post(0.0)], 0), None);
    assert!(heard(a, b, vec![post(0.3)], 0).is_some());
    let board = Obstacle::Box {
        x: 1.0,
        y: 0.0,
        w: 0.02,
        h: 0.5,
        theta: 0.3,
    };
    assert_eq!(heard(a, b, vec![board], 0), None);
}

#[test]
fn a_ping_counts_from_the_step_after_it() {
    let (a, b) = facing(2.0);
    let mut bench = TestWorld::new(Arena::empty(20.0, 20.0), alike(), 1);
    bench.add(a.x, a.y, a.theta);
    bench.add(b.x, b.y, b.theta);
    bench.step();
    let listen = |bench: &TestWorld| {
        let mut space = bench.world.shared.space.borrow_mut();
        space.list_robots(0);
        space.crosstalk(0, 12_000, SPEED, 0.02, 4.5)
    };
    bench.world.shared.space.borrow_mut().bodies.ping(1, 10_500);
    assert_eq!(listen(&bench), None);
    bench.step();
    assert!(listen(&bench).is_some());
}

#[test]
fn the_reach_of_pings_is_a_parameter() {
    let (a, b) = facing(2.0);
    for (reach, hears) in [(0.0, false), (1.9, false), (2.1, true)] {
        let mut parameters = alike();
        parameters.ranger.crosstalk_m = reach;
        let mut bench = TestWorld::new(Arena::empty(20.0, 20.0), parameters, 1);
        bench.add(a.x, a.y, a.theta);
        bench.add(b.x, b.y, b.theta);
        bench.world.shared.space.borrow_mut().bodies.ping(1, 5_000);
        bench.step();
        let space = bench.world.shared.space.borrow();
        assert_eq!(space.crosstalk(0, 5_000, SPEED, 0.02, 4.5).is_some(), hears);
    }
}

/// Robots that measure through their drivers, out of step: what facing rangers tell each other.
fn disturbed(away: bool) -> u32 {
    use crawler_drivers::us100::Us100;
    use crawler_hal::{Celsius, Duration};

    let mut parameters = alike();
    parameters.ranger = Ranger {
        noise_mm: 0.0,
        noise_share: 0.0,
        dropout: 0.0,
        multipath: 0.0,
        ghost: 0.0,
        ..parameters.ranger
    };
    let clock = SimClock::new();
    let mut scheduler = Scheduler::new(&clock);
    let arena = Arena::empty(20.0, 20.0);
    let mut world = World::with_parameters(arena, parameters, 1, &clock).expect("sound");
    let (a, b) = facing(3.0);
    let turn = if away { core::f32::consts::PI } else { 0.0 };
    let (_, one) = world
        .add_robot(Pose::new(a.x, a.y, a.theta + turn))
        .expect("free");
    let (_, two) = world
        .add_robot(Pose::new(b.x, b.y, b.theta + turn))
        .expect("free");
    let (mut one, mut two) = (Us100::new(one.ranger), Us100::new(two.ranger));
    let mut wrong = 0;
    for _ in 0..50 {
        // The second one asks 6 ms after the first, across the end of a step.
        let start = scheduler.now();
        let first = start + Duration::from_millis(6);
        let mut told = Vec::new();
        let mut measure = |driver: &mut Us100<_, _, _>, scheduler: &mut Scheduler| {
            let limit = scheduler.now() + Duration::from_secs(1);
            told.push(scheduler.block_on(driver.measure(&clock, Celsius(22)), limit));
        };
        // The echo of the first is told later; what counts is when it was asked.
        {
            use embassy_futures::poll_once;
            let pending = poll_once(one.measure(&clock, Celsius(22)));
            assert!(pending.is_pending());
        }
        scheduler.advance_to(first);
        world.step();
        measure(&mut two, &mut scheduler);
        let next = start + Duration::from_millis(200);
        scheduler.advance_to(next);
        world.step();
        if let Some(Ok(Ok(mm))) = told.pop() {
            // Its own echo comes from the other's rim, 25 mm before the ranger.
            wrong += u32::from(mm.0 < 2_900);
        }
    }
    wrong
}

#[test]
fn two_robots_face_to_face_disturb_each_other_and_back_to_back_do_not() {
    assert_eq!(disturbed(false), 50);
    assert_eq!(disturbed(true), 0);
}

proptest! {
    #![proptest_config(crawler_properties::cases(300))]

    /// Whoever hears the other would be heard by it.
    #[test]
    fn hearing_is_mutual(
        x in -2.0..2.0_f32, y in -2.0..2.0_f32, one in -3.1..3.1_f32, two in -3.1..3.1_f32,
        posts in proptest::collection::vec((-2.0..2.0_f32, -2.0..2.0_f32, 0.02..0.3_f32), 0..4),
    ) {
        prop_assume!(x * x + y * y > 0.1);
        let clear = |px: f32, py: f32, r: f32| {
            let from = |qx: f32, qy: f32| ((px - qx) * (px - qx) + (py - qy) * (py - qy)).sqrt();
            from(0.0, 0.0) > r + 0.1 && from(x, y) > r + 0.1
        };
        prop_assume!(posts.iter().all(|&(px, py, r)| clear(px, py, r)));
        let obstacles: Vec<Obstacle> =
            posts.iter().map(|&(x, y, r)| Obstacle::Circle { x, y, r }).collect();
        let (a, b) = (Pose::new(0.0, 0.0, one), Pose::new(x, y, two));
        let there = heard(a, b, obstacles.clone(), 0);
        let back = heard(b, a, obstacles, 0);
        match (there, back) {
            (Some(there), Some(back)) => prop_assert!((there - back).abs() < 1e-4),
            (there, back) => prop_assert_eq!(there, back),
        }
    }
}
