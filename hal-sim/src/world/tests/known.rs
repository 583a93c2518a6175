//! Bodies that are known, and robots that are carried.

use super::*;

/// Where two robots get that drive straight on for two seconds, of the known body and of a drawn one.
fn drive_both(known: &Body) -> [Pose; 2] {
    let mut bench = TestWorld::plain();
    let wiring = Wiring::default();
    for (y, body) in [(-1.0, known), (1.0, &Body::default())] {
        let pose = Pose::new(-3.0, y, 0.0);
        let (_, parts) = bench.world.place(pose, wiring, body).expect("a free place");
        bench.parts.push(parts.expect("its devices"));
    }
    bench.drive(0, 200, 200);
    bench.drive(1, 200, 200);
    bench.steps(200);
    [0, 1].map(|i| bench.world.pose(RobotIndex::new(i)).expect("it is there"))
}

#[test]
fn a_known_body_moves_as_it_is_known() {
    let nothing = drive_both(&Body::default());
    assert_eq!(nothing[0].x, nothing[1].x, "robots of this world are alike");
    let strong = drive_both(&Body {
        motors: Some([1.1, 1.1]),
        ..Body::default()
    });
    let way = |pose: Pose| pose.x + 3.0;
    let share = way(strong[0]) / way(strong[1]);
    assert!((1.09..1.13).contains(&share), "{share}");
    let empty = drive_both(&Body {
        charge: Some(0.1),
        ..Body::default()
    });
    assert!(way(empty[0]) < way(empty[1]) * 0.97, "{empty:?}");
    let heavy = drive_both(&Body {
        mass_kg: Some(2.0),
        ..Body::default()
    });
    assert!(way(heavy[0]) < way(heavy[1]) - 0.02, "{heavy:?}");
    let bent = drive_both(&Body {
        motors: Some([0.95, 1.05]),
        ..Body::default()
    });
    assert!(bent[0].theta > 0.1, "{bent:?}");
    let wide = drive_both(&Body {
        motors: Some([0.95, 1.05]),
        track_m: Some(0.28),
        gyration_m: Some(0.07),
        ..Body::default()
    });
    assert!(wide[0].theta < bent[0].theta * 0.6, "{wide:?} and {bent:?}");
}

#[test]
fn the_strongest_motors_do_not_drive_through_walls() {
    let mut bench = TestWorld::plain();
    let body = Body {
        motors: Some([2.0, 2.0]),
        friction: Some([0.0, 0.0]),
        ..Body::default()
    };
    let pose = Pose::new(0.0, 0.0, 0.0);
    let placed = bench.world.place(pose, Wiring::default(), &body);
    let (robot, parts) = placed.expect("a free place");
    bench.parts.push(parts.expect("its devices"));
    bench.drive(0, 255, 255);
    bench.steps(150);
    let fast = bench.world.observe(robot).expect("it is there").speed;
    assert!(fast > bench.world.parameters().top_speed() * 1.3, "{fast}");
    bench.steps(800);
    let there = bench.world.observe(robot).expect("it is there");
    let radius = bench.world.parameters().chassis.radius_m;
    assert!((there.pose.x - (5.0 - radius)).abs() < 0.01, "{there:?}");
}

#[test]
fn a_robot_that_is_carried_drives_on_from_there() {
    let mut bench = TestWorld::plain();
    let one = bench.add(-3.0, 0.0, 0.0);
    let other = bench.add(3.0, 3.0, 0.0);
    bench.drive(0, 200, 200);
    bench.steps(100);
    let before = bench.world.observe(one).expect("it is there");
    for occupied in [[3.05, 3.0], [4.95, 0.0]] {
        let to = Pose::new(occupied[0], occupied[1], 0.0);
        assert_eq!(bench.world.carry(one, to), Err(PlacementError::Occupied));
    }
    let nowhere = Pose::new(f32::NAN, 0.0, 0.0);
    assert_eq!(
        bench.world.carry(one, nowhere),
        Err(PlacementError::NotFinite)
    );
    assert_eq!(bench.world.observe(one), Some(before));
    // Where it is itself is free for it.
    let here = Pose::new(before.pose.x + 0.01, before.pose.y, before.pose.theta);
    assert_eq!(bench.world.carry(one, here), Ok(()));
    // Towards the other one, which it runs into without passing through.
    let to = Pose::new(3.0, 2.0, std::f32::consts::FRAC_PI_2);
    assert_eq!(bench.world.carry(one, to), Ok(()));
    let after = bench.world.observe(one).expect("it is there");
    assert_eq!(after.pose.position(), to.position());
    assert!((after.speed - before.speed).abs() < 1e-5, "{after:?}");
    bench.steps(50);
    let on = bench.world.pose(one).expect("it is there");
    assert!(on.y > 2.1 && (on.x - 3.0).abs() < 0.01, "{on:?}");
    bench.steps(400);
    let [on, met] = [one, other].map(|robot| bench.world.pose(robot).expect("it is there"));
    let apart = (on.x - met.x).hypot(on.y - met.y);
    let radius = bench.world.parameters().chassis.radius_m;
    assert!(apart > 2.0 * radius - 0.002, "{apart}");
    bench.world.remove_robot(one);
    assert_eq!(bench.world.carry(one, to), Ok(()), "there is none");
}
