//! Obstacles that move, floors that are slippery, and shards that agree on both.

use super::convergence::Fine;
use super::*;
use crate::world::hash;

fn circle_mover(x: f32, path: Vec<[f32; 2]>, speed: f32) -> Arena {
    Arena {
        movers: vec![Mover {
            body: Obstacle::Circle { x, y: 0.0, r: 0.2 },
            path,
            speed,
        }],
        ..Arena::empty(6.0, 4.0)
    }
}

fn place(bench: &TestWorld) -> [f32; 2] {
    bench.world.mover(0).expect("a mover")
}

#[test]
fn a_mover_goes_round_on_its_path() {
    let arena = circle_mover(0.0, vec![[1.0, 0.0], [1.0, 1.0]], 0.5);
    let length = arena.movers[0].length();
    assert!((length - (2.0 + core::f32::consts::SQRT_2)).abs() < 1e-5);
    let mut bench = TestWorld::new(arena, alike(), 1);
    assert_eq!(place(&bench), [0.0, 0.0]);
    bench.steps(100);
    let [x, y] = place(&bench);
    assert!((x - 0.5).abs() < 1e-4 && y.abs() < 1e-4, "{x} {y}");
    bench.steps(200);
    let [x, y] = place(&bench);
    assert!((x - 1.0).abs() < 1e-4 && (y - 0.5).abs() < 1e-4, "{x} {y}");
    bench.steps((length / 0.5 * 100.0) as u32);
    assert!(bench.world.mover(1).is_none());
    assert!((place(&bench)[1] - y).abs() < 0.01, "and again");
}

#[test]
fn a_mover_pushes_a_robot_and_is_seen_and_counted() {
    let arena = circle_mover(-2.0, vec![[2.0, 0.0]], 0.3);
    let mut bench = TestWorld::new(arena, alike(), 1);
    bench.add(0.0, 0.01, core::f32::consts::PI);
    let range = bench.world.true_range(RobotIndex::new(0)).expect("ahead");
    assert!((range - (2.0 - 0.2 - 0.06)).abs() < 0.01, "{range}");
    bench.steps(700);
    let seen = bench.see(0);
    let [x, _] = place(&bench);
    assert!((x - 0.1).abs() < 0.02, "it did not wait: {x}");
    assert!(seen.pose.x > 0.2, "pushed along: {seen:?}");
    assert!(seen.contacts >= 1);
    let clear = bench.world.clearance(seen.pose.x, seen.pose.y, 1.0);
    assert!(clear < 0.0, "it is within itself: {clear}");
    assert_eq!(
        bench.world.add_robot(Pose::new(x, 0.0, 0.0)).err(),
        Some(PlacementError::Occupied)
    );
}

/// Each comes up to a stride towards the other in a step, so that together they come further than
/// either looks ahead for things that stand.
#[test]
fn a_robot_and_a_mover_that_drive_at_each_other_never_overlap() {
    let bodies = [
        Obstacle::Circle {
            x: -2.0,
            y: 0.0,
            r: 0.2,
        },
        Obstacle::Box {
            x: -2.0,
            y: 0.0,
            w: 0.4,
            h: 0.1,
            theta: 0.5,
        },
    ];
    for (body, speed) in bodies.iter().flat_map(|body| [(*body, 0.4), (*body, 1.0)]) {
        // Wherever in a step they meet, and whether squarely or not.
        for k in 0..40_u8 {
            let arena = Arena {
                movers: vec![Mover {
                    body,
                    path: vec![[2.0, 0.0]],
                    speed,
                }],
                ..Arena::empty(6.0, 4.0)
            };
            let mut fine = Fine::new(arena, alike(), 0.01);
            let k = f32::from(k);
            fine.add(1.0 + k * 0.0007, k * 0.005, core::f32::consts::PI);
            fine.drive(0, 255, 255);
            let radius = fine.space.parameters.chassis.radius_m;
            for step in 0..300 {
                fine.run(0.01);
                let at = fine.space.bodies.published.at[0];
                let depth = radius - fine.space.movers.now(0).separation(at).0;
                assert!(depth <= 2e-5, "{depth} m in {body:?}, {k}, step {step}");
            }
            assert_eq!(fine.space.bodies.contacts[0], 1, "they met: {body:?}, {k}");
        }
    }
}

#[test]
fn a_mover_waits_for_a_robot_at_the_wall_and_goes_on_when_it_has_left() {
    // It wants to go on until 0.1 m before the wall; a robot is 0.17 m wide.
    let arena = circle_mover(2.0, vec![[2.7, 0.0]], 0.2);
    let mut bench = TestWorld::new(arena, alike(), 1);
    bench.add(2.8, 0.0, core::f32::consts::FRAC_PI_2);
    bench.steps(1_000);
    let [x, _] = place(&bench);
    let seen = bench.see(0);
    assert!(x < 2.64, "it waits: {x}");
    let room = (seen.pose.x - x).hypot(seen.pose.y) - 0.2 - 0.085;
    assert!((-2e-5..0.01).contains(&room), "{room}");
    assert!(seen.pose.x <= 2.915 + 2e-5, "{seen:?}");
    let before = place(&bench);
    bench.steps(100);
    assert_eq!(place(&bench), before);
    // It drives off along the wall.
    bench.drive(0, 255, 255);
    bench.steps(300);
    bench.drive(0, 0, 0);
    bench.steps(1_000);
    assert!(bench.see(0).pose.y > 0.3, "{:?}", bench.see(0));
    let mut places: Vec<[f32; 2]> = Vec::new();
    for _ in 0..20 {
        bench.steps(50);
        places.push(place(&bench));
    }
    let farthest = places.iter().fold(0.0_f32, |far, at| far.max(at[0]));
    assert!(farthest > 2.65, "it goes all the way again: {farthest}");
}

#[test]
fn a_slippery_floor_lets_wheels_slide() {
    let run = |grip: f32| {
        let arena = Arena {
            patches: vec![Patch {
                x: 0.0,
                y: 0.0,
                w: 10.0,
                h: 10.0,
                theta: 0.3,
                grip,
            }],
            ..Arena::empty(10.0, 10.0)
        };
        let mut bench = TestWorld::new(arena, alike(), 1);
        bench.add(-3.0, 0.0, 0.0);
        bench.drive(0, 255, 255);
        bench.steps(20);
        let starting = bench.see(0);
        bench.steps(180);
        let driving = bench.see(0);
        bench.drive(0, 0, 0);
        let BodyParts { left, right, .. } = &mut bench.parts[0];
        for port in [left, right] {
            port.enable.set_duty_cycle(255).expect("a duty");
        }
        bench.steps(200);
        (
            starting,
            driving.speed,
            bench.see(0).pose.x - driving.pose.x,
        )
    };
    let (dry, dry_speed, dry_way) = run(1.0);
    let (wet, wet_speed, wet_way) = run(0.1);
    assert!(wet.slip[0] > 0.2 && wet.slip[1] > 0.2, "{wet:?}");
    assert!(dry.slip[0] < 0.05, "{dry:?}");
    assert!(
        wet.speed < 0.6 * dry.speed,
        "it starts slowly: {wet:?} {dry:?}"
    );
    assert!(wet_speed < dry_speed);
    assert!(
        wet_way > 1.5 * dry_way,
        "it stops late: {wet_way} {dry_way}"
    );
}

#[test]
fn one_wheel_on_ice_turns_a_robot() {
    let arena = Arena {
        patches: vec![Patch {
            x: 0.0,
            y: 1.0,
            w: 10.0,
            h: 2.0,
            theta: 0.0,
            grip: 0.05,
        }],
        ..Arena::empty(10.0, 10.0)
    };
    let mut bench = TestWorld::new(arena, alike(), 1);
    bench.add(-3.0, 0.0, 0.0);
    bench.drive(0, 255, 255);
    bench.steps(30);
    assert!(bench.see(0).pose.theta > 0.05, "{:?}", bench.see(0));
}

#[test]
fn patches_out_of_range_and_movers_without_a_way_are_refused() {
    let clock = SimClock::new();
    let build = |arena: Arena| World::new(arena, 1, &clock).map(|_| ());
    let patch = |grip| Arena {
        patches: vec![Patch {
            x: 0.0,
            y: 0.0,
            w: 1.0,
            h: 1.0,
            theta: 0.0,
            grip,
        }],
        ..Arena::empty(4.0, 4.0)
    };
    assert_eq!(build(patch(0.5)), Ok(()));
    for grip in [0.0, -1.0, f32::NAN, 3.0] {
        assert_eq!(
            build(patch(grip)),
            Err(WorldError::Arena(ArenaError::Patch(0)))
        );
    }
    let bad = Err(WorldError::Arena(ArenaError::Mover(0)));
    for (path, speed) in [
        (vec![], 0.2),
        (vec![[0.0, 0.0]], 0.2),
        (vec![[f32::NAN, 0.0]], 0.2),
        (vec![[9.0, 0.0]], 0.2),
        (vec![[1.0, 0.0]; 65], 0.2),
        (vec![[1.0, 0.0]], 0.0),
        (vec![[1.0, 0.0]], f32::NAN),
        (vec![[1.0, 0.0]], 1.5),
    ] {
        assert_eq!(build(circle_mover(0.0, path, speed)), bad);
    }
    let many = Arena {
        patches: vec![
            Patch {
                x: 0.0,
                y: 0.0,
                w: 400.0,
                h: 400.0,
                theta: 0.0,
                grip: 1.0,
            };
            4_000
        ],
        ..Arena::empty(400.0, 400.0)
    };
    assert_eq!(
        build(many),
        Err(WorldError::Arena(ArenaError::TooManyPatches))
    );
    let object = Arena {
        objects: vec![Object {
            shape: ObjectShape::Cone,
            x: 0.0,
            y: 0.0,
            size: -0.1,
            colour: Colour::Red,
        }],
        ..Arena::empty(4.0, 4.0)
    };
    assert_eq!(build(object), Err(WorldError::Arena(ArenaError::Object(0))));
}

/// A crowd that pushes, on patches, among movers.
fn crowd() -> Fine {
    let arena = Arena {
        movers: vec![
            Mover {
                body: Obstacle::Circle {
                    x: -1.0,
                    y: 0.0,
                    r: 0.2,
                },
                path: vec![[1.0, 0.1]],
                speed: 0.4,
            },
            Mover {
                body: Obstacle::Box {
                    x: 0.0,
                    y: -1.0,
                    w: 0.4,
                    h: 0.1,
                    theta: 0.2,
                },
                path: vec![[0.0, 1.0]],
                speed: 0.3,
            },
        ],
        patches: vec![Patch {
            x: 0.5,
            y: 0.5,
            w: 1.0,
            h: 1.0,
            theta: 0.0,
            grip: 0.2,
        }],
        ..Arena::empty(3.0, 3.0)
    };
    let mut fine = Fine::new(arena, Parameters::default(), 0.01);
    for k in 0..30_u8 {
        let angle = f32::from(k) * 2.4;
        let at = Vec2::unit(angle).times(0.35 + 0.03 * f32::from(k));
        let _ = fine
            .space
            .place(Pose::new(at.x, at.y, angle + 3.0), 9, &Body::default());
    }
    for i in 0..fine.space.bodies.len() {
        fine.drive(i, 255, 255 - 9 * i as i16);
    }
    fine
}

fn fingerprint(space: &Space, members: Members) -> Vec<u64> {
    let print = |i| {
        let mut print = StateFingerprint::new();
        hash::body(&mut print, &space.bodies, i);
        hash::movers(&mut print, &space.movers);
        print.value()
    };
    members.iter(space.bodies.len()).map(print).collect()
}

#[test]
fn shards_move_a_pushing_crowd_as_one_world_does() {
    let mut alone = crowd();
    assert!(alone.space.bodies.len() > 12);
    let shards = 3;
    let mut replicas: Vec<Fine> = (0..shards).map(|_| crowd()).collect();
    let members: Vec<Members> = (0..shards)
        .map(|shard| Members::of_shard(shard, shards).expect("a shard"))
        .collect();
    for step in 0..600 {
        alone.run(0.01);
        let told: Vec<Vec<_>> = replicas
            .iter_mut()
            .zip(&members)
            .map(|(replica, &own)| {
                replica.space.step(own, |_, _| {});
                let mut out = Vec::new();
                replica.space.publish(own, &mut out);
                out
            })
            .collect();
        for (k, replica) in replicas.iter_mut().enumerate() {
            for (other, told) in told.iter().enumerate() {
                if other != k {
                    replica.space.take_over(members[other], told);
                }
            }
            assert_eq!(
                fingerprint(&replica.space, members[k]),
                fingerprint(&alone.space, members[k]),
                "step {step}, shard {k}"
            );
        }
    }
    let contacts: u32 = alone.space.bodies.contacts.iter().sum();
    assert!(contacts > 20, "they met: {contacts}");
}

#[test]
fn a_stored_crowd_goes_on_as_if_nothing_had_been() {
    let mut fine = crowd();
    for steps in [3, 10, 57, 200] {
        fine.run(0.01 * steps as f32);
        let mut again = crowd();
        again
            .space
            .restore(fine.space.state())
            .expect("its own state");
        let mut on = Fine {
            space: fine.space.clone(),
            ..again
        };
        let mut back = crowd();
        back.space.restore(fine.space.state()).expect("the same");
        on.run(0.33);
        back.run(0.33);
        assert_eq!(
            fingerprint(&on.space, Members::ALL),
            fingerprint(&back.space, Members::ALL)
        );
    }
    let mut state = fine.space.state();
    state.movers[0] = f64::NAN;
    assert_eq!(crowd().space.restore(state), Err("movers"));
}
