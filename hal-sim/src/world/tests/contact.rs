//! Collisions: nothing solid is ever entered, left through, or overtaken.

use proptest::prelude::*;

use super::*;

/// Overlap that rounding may leave, metres.
const EPSILON: f32 = 2e-5;

fn shapes() -> impl Strategy<Value = Vec<Obstacle>> {
    let circle = (-2.0..2.0_f32, -2.0..2.0_f32, 0.02..0.5_f32)
        .prop_map(|(x, y, r)| Obstacle::Circle { x, y, r });
    let boxed = (
        -2.0..2.0_f32,
        -2.0..2.0_f32,
        0.01..1.2_f32,
        0.01..1.2_f32,
        -4.0..4.0_f32,
    )
        .prop_map(|(x, y, w, h, theta)| Obstacle::Box { x, y, w, h, theta });
    proptest::collection::vec(prop_oneof![circle, boxed], 0..8)
}

/// The overlap of robot `i` with anything, by looking at everything.
fn deepest(bench: &TestWorld, arena: &Arena, radius: f32) -> f32 {
    let poses: Vec<Pose> = (0..bench.parts.len()).map(|i| bench.see(i).pose).collect();
    let mut deepest = f32::MIN;
    for (i, pose) in poses.iter().enumerate() {
        deepest = deepest.max(radius - arena.clearance(pose.x, pose.y));
        for other in &poses[..i] {
            let apart = pose.position().minus(other.position()).length();
            deepest = deepest.max(2.0 * radius - apart);
        }
    }
    deepest
}

proptest! {
    #![proptest_config(crawler_properties::cases(60))]

    #[test]
    fn no_robot_is_ever_inside_anything_or_faster_than_it_can_be(
        obstacles in shapes(),
        places in proptest::collection::vec((-2.3..2.3_f32, -2.3..2.3_f32, -3.0..3.0_f32), 1..30),
        duties in proptest::collection::vec((-255..=255_i16, -255..=255_i16), 1..40),
        seed: u64,
    ) {
        let arena = Arena {  obstacles, ..Arena::empty(5.0, 5.0) };
        let mut bench = TestWorld::new(arena.clone(), Parameters::default(), seed);
        for (x, y, theta) in places {
            if let Ok((_, parts)) = bench.world.add_robot(Pose::new(x, y, theta)) {
                bench.parts.push(parts);
            }
        }
        let radius = bench.world.parameters().chassis.radius_m;
        let farthest = bench.world.parameters().top_speed() * 0.01 * 1.01 + 1e-6;
        let robots = bench.parts.len();
        for round in 0..40 {
            for robot in 0..robots {
                // Mostly full speed ahead, so that they crowd.
                let (left, right) = duties[(robot + round) % duties.len()];
                if round % 3 == 0 {
                    bench.drive(robot, left, right);
                } else {
                    bench.drive(robot, 255, 255 - left.abs() / 4);
                }
            }
            for _ in 0..10 {
                let before: Vec<Observation> = (0..robots).map(|i| bench.see(i)).collect();
                bench.step();
                for (i, before) in before.iter().enumerate() {
                    let after = bench.see(i);
                    prop_assert!(after.pose.is_finite());
                    let moved = after.pose.position().minus(before.pose.position()).length();
                    prop_assert!(moved <= farthest, "moved {moved} m in a step");
                    prop_assert!(after.charge <= before.charge);
                    prop_assert!(after.contacts >= before.contacts);
                }
            }
            let overlap = deepest(&bench, &arena, radius);
            prop_assert!(overlap <= EPSILON, "overlap {overlap} m in round {round}");
        }
    }
}

#[test]
fn a_thin_board_stops_a_robot_at_full_speed_from_any_angle() {
    for degrees in 0_u8..90 {
        let theta = f32::from(degrees).to_radians() - core::f32::consts::FRAC_PI_4;
        let board = Obstacle::Box {
            x: 1.0,
            y: 0.0,
            w: 0.005,
            h: 9.9,
            theta: 0.0,
        };
        let arena = Arena {
            obstacles: vec![board],
            ..Arena::empty(10.0, 10.0)
        };
        let mut bench = TestWorld::new(arena, alike(), 1);
        bench.add(0.0, 0.0, theta);
        bench.drive(0, 255, 255);
        bench.steps(600);
        let seen = bench.see(0);
        assert!(seen.pose.x < 1.0, "through the board at {theta}: {seen:?}");
        assert!(seen.contacts > 0);
    }
}

#[test]
fn a_contact_is_counted_once_for_both_and_again_only_after_a_pause() {
    let mut bench = TestWorld::plain();
    bench.add(0.0, 0.0, 0.0);
    bench.add(0.5, 0.0, 0.0);
    bench.drive(0, 200, 200);
    bench.steps(300);
    assert_eq!((bench.see(0).contacts, bench.see(1).contacts), (1, 1));
    let gap = bench.see(1).pose.x - bench.see(0).pose.x - 0.17;
    // It pushes the other one along, and both stay together but for what they move in a step.
    assert!((0.0..0.006).contains(&gap), "{gap}");
    assert!(bench.see(1).pose.x > 1.0, "{:?}", bench.see(1));
    bench.drive(0, -200, -200);
    bench.steps(60);
    bench.drive(0, 200, 200);
    bench.steps(150);
    assert_eq!((bench.see(0).contacts, bench.see(1).contacts), (2, 2));
}

#[test]
fn a_robot_added_at_any_step_is_solid_at_once() {
    for step in 0..20 {
        let mut bench = TestWorld::plain();
        bench.add(0.0, 0.0, 0.0);
        bench.drive(0, 255, 255);
        bench.steps(60 + step);
        let ahead = bench.see(0).pose.x + 0.172;
        bench.add(ahead, 0.0, 0.0);
        bench.steps(5);
        assert_eq!(bench.see(1).contacts, 1, "added after {step} steps");
        assert!(bench.see(1).pose.x - bench.see(0).pose.x >= 0.17 - EPSILON);
    }
}

#[test]
fn a_robot_at_a_wall_slides_along_it_and_does_not_stick() {
    let mut bench = TestWorld::plain();
    bench.add(4.0, 0.0, 0.5);
    bench.drive(0, 220, 220);
    bench.steps(300);
    let pose = bench.see(0).pose;
    assert!(pose.x > 4.9 && pose.x <= 4.915 + EPSILON, "{pose:?}");
    bench.steps(200);
    let slid = bench.see(0).pose.y - pose.y;
    assert!(slid > 0.05, "it slides: {slid} m");
}

#[test]
fn a_robot_held_back_draws_more_than_one_that_rolls() {
    let mut bench = TestWorld::plain();
    bench.add(4.9, 0.0, 0.0);
    bench.add(-4.9, 1.0, 0.0);
    bench.drive(0, 255, 255);
    bench.drive(1, 255, 255);
    bench.steps(200);
    assert!(bench.see(0).battery < bench.see(1).battery);
    assert!(bench.see(0).charge < bench.see(1).charge);
}

#[test]
fn robots_are_placed_only_where_there_is_room() {
    let arena = Arena {
        obstacles: vec![Obstacle::Circle {
            x: 1.0,
            y: 0.0,
            r: 0.3,
        }],
        ..Arena::empty(4.0, 4.0)
    };
    let mut bench = TestWorld::new(arena, alike(), 1);
    bench.add(0.0, 0.0, 0.0);
    let mut refused = |x, y| {
        let error = bench.world.add_robot(Pose::new(x, y, 0.0)).err();
        assert_eq!(bench.world.robots(), 1);
        error
    };
    assert_eq!(refused(0.1, 0.1), Some(PlacementError::Occupied));
    assert_eq!(refused(0.7, 0.0), Some(PlacementError::Occupied));
    assert_eq!(refused(1.95, 0.0), Some(PlacementError::Occupied));
    assert_eq!(refused(30.0, 0.0), Some(PlacementError::Occupied));
    assert_eq!(refused(f32::NAN, 0.0), Some(PlacementError::NotFinite));
    assert_eq!(refused(0.0, f32::INFINITY), Some(PlacementError::NotFinite));
    assert!(bench.world.add_robot(Pose::new(0.0, 0.18, 0.0)).is_ok());
}

#[test]
fn a_removed_robot_is_neither_touched_nor_seen_and_frees_its_place() {
    let mut bench = TestWorld::plain();
    let mover = bench.add(0.0, 0.0, 0.0);
    let gone = bench.add(1.0, 0.0, 0.0);
    assert!(bench.world.true_range(mover).expect("in front") < 1.0);
    bench.drive(1, 255, 255);
    bench.steps(2);
    bench.world.remove_robot(gone);
    assert_eq!(
        bench.world.true_range(mover),
        None,
        "the wall is out of reach"
    );
    bench.drive(1, 255, 255);
    bench.drive(0, 200, 200);
    bench.steps(300);
    assert_eq!(bench.see(0).contacts, 0);
    assert!(bench.see(0).pose.x > 1.0);
    let seen = bench.see(1);
    assert!(!seen.present && seen.speed == 0.0 && seen.duty == [0, 0]);
    assert!(bench.world.boot(gone, ResetCause::PowerOn).is_none());
    bench.add(1.0, 1.0, 0.0);
}
