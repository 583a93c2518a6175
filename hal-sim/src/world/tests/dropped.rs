//! What is put into a world while it runs is there for everybody, and gone when it is taken away.

use proptest::prelude::*;

use super::*;
use crate::render::{Frame, Seen};

fn post(x: f32, y: f32, r: f32) -> Dropped {
    Dropped::Obstacle(Obstacle::Circle { x, y, r })
}

fn block(x: f32, y: f32, w: f32, h: f32, theta: f32) -> Dropped {
    Dropped::Obstacle(Obstacle::Box { x, y, w, h, theta })
}

fn ball(x: f32, y: f32, size: f32) -> Dropped {
    Dropped::Object(Object {
        shape: ObjectShape::Ball,
        x,
        y,
        size,
        colour: Colour::Red,
    })
}

#[test]
fn a_dropped_wall_is_heard_and_never_entered_and_taking_it_opens_the_way() {
    let mut bench = TestWorld::plain();
    let robot = bench.add(0.0, 0.0, 0.0);
    let radius = alike().chassis.radius_m;
    assert_eq!(bench.world.true_range(robot), None, "the wall is too far");
    // In the middle of an interval between two looks at who is near what.
    bench.drive(0, 255, 255);
    bench.steps(3);
    let item = bench.world.drop_in(block(1.1, 0.0, 0.2, 1.0, 0.0));
    assert_eq!(item, Ok(1));
    let range = bench.world.true_range(robot).expect("an echo");
    assert!((0.8..1.0).contains(&range), "{range}");
    for _ in 0..500 {
        bench.step();
        let x = bench.see(0).pose.x;
        assert!(x <= 1.0 - radius + 2e-5, "{x}");
    }
    let held = bench.see(0);
    assert!(held.pose.x > 0.9 - radius && held.contacts >= 1, "{held:?}");
    assert!(!bench.world.take_away(2));
    assert!(bench.world.take_away(1) && !bench.world.take_away(1));
    assert_eq!(bench.world.arena(), Arena::empty(10.0, 10.0));
    bench.steps(300);
    assert!(bench.see(0).pose.x > 1.5, "{:?}", bench.see(0));
    // Numbers are given once.
    assert_eq!(bench.world.drop_in(post(-2.0, 0.0, 0.1)), Ok(2));
}

#[test]
fn a_robot_beside_which_something_is_dropped_does_not_enter_it() {
    let mut bench = TestWorld::plain();
    let radius = alike().chassis.radius_m;
    bench.add(0.0, 0.0, 0.0);
    bench.drive(0, 255, 255);
    bench.steps(107);
    let x = bench.see(0).pose.x;
    let edge = x + radius + 0.001;
    bench
        .world
        .drop_in(block(edge + 0.1, 0.0, 0.2, 0.2, 0.0))
        .expect("just beside");
    for _ in 0..100 {
        bench.step();
        assert!(bench.see(0).pose.x <= edge - radius + 2e-5);
    }
}

#[test]
fn cameras_see_what_was_dropped_as_what_it_is() {
    let arena = Arena {
        objects: vec![Object {
            shape: ObjectShape::Cone,
            x: 1.0,
            y: 0.3,
            size: 0.12,
            colour: Colour::Blue,
        }],
        ..Arena::empty(6.0, 6.0)
    };
    let mut bench = TestWorld::new(arena, alike(), 1);
    let robot = bench.add(0.0, 0.0, 0.0);
    let mut frame = Frame::square();
    let mut seen = |world: &World| -> Vec<Seen> {
        assert!(world.render(robot, &mut frame));
        frame.spots().iter().map(|spot| spot.of).collect()
    };
    let before = seen(&bench.world);
    assert!(before.contains(&Seen::Object(0)), "{before:?}");
    // An obstacle first: objects are listed behind all of them.
    bench.world.drop_in(post(1.0, -0.3, 0.06)).expect("free");
    bench.world.drop_in(ball(0.9, 0.0, 0.12)).expect("free");
    let there = seen(&bench.world);
    for what in [Seen::Object(0), Seen::Object(1), Seen::Obstacle(0)] {
        assert!(there.contains(&what), "{what:?} in {there:?}");
    }
    let arena = bench.world.arena();
    assert_eq!((arena.obstacles.len(), arena.objects.len()), (1, 2));
    let items = bench.world.dropped();
    assert_eq!(items.iter().map(|item| item.id).collect::<Vec<_>>(), [1, 2]);
    assert!(bench.world.take_away(1));
    assert!(bench.world.take_away(2));
    assert_eq!(seen(&bench.world), before);
}

#[test]
fn what_cannot_be_dropped_is_refused_and_changes_nothing() {
    let mut bench = TestWorld::plain();
    bench.add(1.0, 1.0, 0.0);
    let gone = bench.add(-1.0, -1.0, 0.0);
    let before = bench.world.hash();
    for (what, error) in [
        (post(f32::NAN, 0.0, 0.1), DropError::Numbers),
        (post(0.0, 0.0, 0.0), DropError::Numbers),
        (post(0.0, 0.0, -1.0), DropError::Numbers),
        (post(0.0, 0.0, f32::INFINITY), DropError::Numbers),
        (block(0.0, 0.0, 1.0, 1.0, f32::NAN), DropError::Numbers),
        (block(0.0, 0.0, 1.0, 1e-30, 0.0), DropError::Numbers),
        (ball(0.0, 0.0, f32::NAN), DropError::Numbers),
        (post(5.0, 0.0, 0.1), DropError::Outside),
        (post(1e30, 0.0, 0.1), DropError::Outside),
        (post(0.0, 0.0, 5.1), DropError::Outside),
        (block(0.0, 0.0, 10.0, 10.0, 0.1), DropError::Outside),
        (block(0.0, 0.0, f32::MAX, 1.0, 0.0), DropError::Outside),
        // It would have robots in it, whichever way it is looked at.
        (
            block(0.0, 0.0, 10.0, 10.0, 0.0),
            DropError::OnRobot(RobotIndex::new(0)),
        ),
        (post(1.1, 1.0, 0.05), DropError::OnRobot(RobotIndex::new(0))),
        (ball(-1.0, -1.05, 0.1), DropError::OnRobot(gone)),
    ] {
        assert_eq!(bench.world.drop_in(what), Err(error), "{what:?}");
    }
    assert_eq!(bench.world.hash(), before);
    assert!(bench.world.dropped().is_empty());
    bench.world.remove_robot(gone);
    assert!(bench.world.drop_in(ball(-1.0, -1.05, 0.1)).is_ok());
    assert_ne!(bench.world.hash(), before);
    // Flush with two walls.
    assert!(
        bench
            .world
            .drop_in(block(-4.0, -4.0, 2.0, 2.0, 0.0))
            .is_ok()
    );
    for _ in 2..MAX_DROPPED {
        assert!(bench.world.drop_in(post(3.0, -3.0, 0.1)).is_ok());
    }
    assert_eq!(
        bench.world.drop_in(post(3.0, -3.0, 0.1)),
        Err(DropError::TooMany)
    );
    assert!(bench.world.take_away(17));
    assert_eq!(bench.world.drop_in(post(3.0, -3.0, 0.1)), Ok(257));
}

/// Anything within and around the arena of the test below.
fn anything() -> impl Strategy<Value = Dropped> {
    let place = || -3.0..3.0_f32;
    let length = || 0.02..2.0_f32;
    prop_oneof![
        (place(), place(), length()).prop_map(|(x, y, r)| post(x, y, r)),
        (place(), place(), length(), length(), -4.0..4.0_f32)
            .prop_map(|(x, y, w, h, theta)| block(x, y, w, h, theta)),
        (place(), place(), length()).prop_map(|(x, y, size)| ball(x, y, size)),
    ]
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    #[test]
    fn nothing_is_ever_dropped_on_a_robot(
        things in proptest::collection::vec(anything(), 1..12),
        places in proptest::collection::vec((-2.4..2.4_f32, -2.4..2.4_f32, -3.0..3.0_f32), 1..8),
    ) {
        let mut bench = TestWorld::new(Arena::empty(5.0, 5.0), alike(), 1);
        let radius = alike().chassis.radius_m;
        for (x, y, theta) in places {
            if let Ok((_, parts)) = bench.world.add_robot(Pose::new(x, y, theta)) {
                bench.parts.push(parts);
                bench.drive(bench.parts.len() - 1, 200, 150);
            }
        }
        let robots = bench.parts.len();
        let mut lying = Vec::new();
        for what in things {
            bench.steps(7);
            let poses: Vec<Pose> = (0..robots).map(|robot| bench.see(robot).pose).collect();
            // By the arena's own measure, which looks at everything.
            let mut alone = Arena::empty(5.0, 5.0);
            match what {
                Dropped::Obstacle(obstacle) => alone.obstacles.push(obstacle),
                Dropped::Object(object) => alone.objects.push(object),
            }
            let nearest = poses.iter().fold(f32::MAX, |nearest, pose| {
                let solid = alone.solids().next().expect("one");
                nearest.min(solid.separation(pose.position()).0)
            });
            match bench.world.drop_in(what) {
                Ok(item) => {
                    prop_assert!(nearest >= radius, "{} from a robot", nearest);
                    lying.push(item);
                }
                Err(DropError::OnRobot(_)) => prop_assert!(nearest < radius + 1e-3),
                Err(error) => prop_assert_eq!(error, DropError::Outside),
            }
            prop_assert_eq!(bench.world.arena().validate(), Ok(()));
            prop_assert_eq!(bench.world.dropped().len(), lying.len());
        }
        let arena = bench.world.arena();
        for _ in 0..30 {
            bench.step();
            for robot in 0..robots {
                let pose = bench.see(robot).pose;
                let clear = arena.clearance(pose.x, pose.y);
                prop_assert!(clear >= radius - 1e-4, "{} m from what was dropped", clear);
            }
        }
        for item in lying {
            prop_assert!(bench.world.take_away(item));
        }
        prop_assert_eq!(bench.world.arena(), Arena::empty(5.0, 5.0));
    }
}
