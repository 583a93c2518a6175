//! Worlds are values: same seed, same bytes.

use super::*;

fn arena() -> Arena {
    Arena {
        obstacles: vec![
            Obstacle::Circle {
                x: 1.0,
                y: 0.5,
                r: 0.2,
            },
            Obstacle::Box {
                x: -1.0,
                y: -0.5,
                w: 0.6,
                h: 0.2,
                theta: 0.4,
            },
        ],
        ..Arena::empty(6.0, 4.0)
    }
}

fn crowd(seed: u64) -> TestWorld {
    let mut bench = TestWorld::new(arena(), Parameters::default(), seed);
    for k in 0..12_u8 {
        let x = -2.5 + f32::from(k % 6);
        let y = if k < 6 { -1.5 } else { 1.5 };
        bench.add(x, y, f32::from(k));
        bench.drive(k.into(), 255, 255 - i16::from(k) * 9);
    }
    bench
}

/// All moments of a history, folded.
fn history(bench: &mut TestWorld) -> Vec<u64> {
    (0..50)
        .map(|_| {
            bench.steps(10);
            bench.world.hash()
        })
        .collect()
}

#[test]
fn the_same_seed_gives_the_same_history_and_another_seed_another_one() {
    let (first, again, other) = (
        history(&mut crowd(7)),
        history(&mut crowd(7)),
        history(&mut crowd(8)),
    );
    assert_eq!(first, again);
    for (moment, (a, b)) in first.iter().zip(&other).enumerate() {
        assert_ne!(a, b, "moment {moment}");
    }
    let mut distinct = first.clone();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), first.len(), "every moment is another state");
}

#[test]
fn worlds_side_by_side_and_on_other_threads_do_not_disturb_each_other() {
    let alone = history(&mut crowd(7));
    let (mut a, mut b) = (crowd(7), crowd(9));
    let mixed: Vec<u64> = (0..50)
        .map(|_| {
            for _ in 0..10 {
                a.step();
                b.step();
            }
            a.world.hash()
        })
        .collect();
    assert_eq!(alone, mixed);
    let threads: Vec<_> = (0..4)
        .map(|_| std::thread::spawn(|| history(&mut crowd(7))))
        .collect();
    for thread in threads {
        assert_eq!(thread.join().expect("no panic"), alone);
    }
}

#[test]
fn two_robots_of_one_world_differ_and_share_nothing() {
    use rand_core::Rng;
    let mut bench = TestWorld::new(Arena::empty(10.0, 10.0), Parameters::default(), 3);
    bench.add(0.0, -2.0, 0.0);
    bench.add(0.0, 2.0, 0.0);
    let draws: Vec<u64> = bench
        .parts
        .iter_mut()
        .map(|parts| parts.rng.next_u64())
        .collect();
    assert_ne!(draws[0], draws[1]);
    bench.drive(0, 200, 200);
    bench.steps(100);
    assert!(bench.see(0).speed > 0.1 && bench.see(1).speed == 0.0);
    bench.drive(0, 0, 0);
    bench.drive(1, 200, 200);
    bench.steps(200);
    let before = bench.see(0).pose;
    bench.steps(20);
    assert_eq!(bench.see(0).pose, before);
    // No two motors are made alike.
    bench.drive(0, 200, 200);
    bench.steps(200);
    assert!((bench.see(0).speed - bench.see(1).speed).abs() > 1e-5);
}

#[test]
fn the_hash_covers_every_part_of_the_state() {
    let mut bench = crowd(5);
    let mut last = bench.world.hash();
    assert_eq!(last, bench.world.hash(), "looking changes nothing");
    let mut changed = |bench: &TestWorld, what: &str| {
        let next = bench.world.hash();
        assert_ne!(next, last, "{what}");
        last = next;
    };
    bench.drive(0, 1, 0);
    changed(&bench, "duty");
    bench.parts[1].lamp.set_high().expect("infallible");
    changed(&bench, "lamp");
    bench.step();
    changed(&bench, "step");
    let _ = bench
        .world
        .boot(RobotIndex::new(2), ResetCause::External)
        .expect("powered");
    changed(&bench, "boot");
    bench.add(0.0, 0.0, 0.0);
    changed(&bench, "robot");
    bench.world.remove_robot(RobotIndex::new(3));
    changed(&bench, "removal");
}

type Change = (&'static str, fn(&mut bodies::Bodies));

#[test]
fn the_hash_covers_every_number_of_a_body() {
    let mut bench = TestWorld::plain();
    bench.add(0.5, 0.5, 0.5);
    let still = bench.world.hash();
    let changes: [Change; 24] = [
        ("x", |b| b.published.at[0].x += 1e-6),
        ("y", |b| b.published.at[0].y += 1e-6),
        ("heading", |b| b.published.heading[0].x += 1e-6),
        ("velocity", |b| b.published.velocity[0].y += 1e-6),
        ("spin", |b| b.published.spin[0] += 1e-6),
        ("contacts now", |b| b.published.contacts_now[0] += 1),
        ("left", |b| b.left[0] += 1e-6),
        ("right", |b| b.right[0] += 1e-6),
        ("rolls", |b| b.rolls[0] ^= true),
        ("duty", |b| b.inputs[0].left.duty ^= 1),
        ("in1", |b| b.inputs[0].right.in1 ^= true),
        ("in2", |b| b.inputs[0].right.in2 ^= true),
        ("lamp", |b| b.inputs[0].lamp ^= true),
        ("supply", |b| b.supply_v[0] += 1e-5),
        ("charge", |b| b.charge_as[0] += 1e-6),
        ("energy", |b| b.energy_j[0] += 1e-6),
        ("gain", |b| b.build[0].left += 1e-6),
        ("friction", |b| b.build[0].friction[1] += 1e-6),
        ("mass", |b| b.build[0].mass_kg += 1e-6),
        ("track", |b| b.build[0].track_m += 1e-7),
        ("internal resistance", |b| b.build[0].internal_ohm += 1e-6),
        ("contacts", |b| b.contacts[0] += 1),
        ("hold", |b| b.hold[0] += 1),
        ("presence", |b| {
            b.published.presence[0] = Presence::Unpowered;
        }),
    ];
    for (what, change) in changes {
        let mut bench = TestWorld::plain();
        bench.add(0.5, 0.5, 0.5);
        assert_eq!(bench.world.hash(), still);
        change(&mut bench.world.shared.space.borrow_mut().bodies);
        assert_ne!(bench.world.hash(), still, "{what}");
    }
}

#[test]
fn nothing_unsound_makes_a_world() {
    let clock = SimClock::new();
    let build = |arena: Arena| World::new(arena, 1, &clock).map(|_| ());
    let side = Err(WorldError::Arena(ArenaError::Side));
    for (width, height) in [
        (0.0, 1.0),
        (f32::NAN, 1.0),
        (1.0, f32::INFINITY),
        (1.0, 501.0),
        (-3.0, 3.0),
    ] {
        assert_eq!(build(Arena::empty(width, height)), side);
    }
    let with = |obstacle| {
        build(Arena {
            obstacles: vec![obstacle],
            ..Arena::empty(4.0, 4.0)
        })
    };
    let bad = Err(WorldError::Arena(ArenaError::Obstacle(0)));
    for (x, r) in [
        (9.0, 0.1),
        (0.0, 0.0),
        (0.0, -1.0),
        (f32::NAN, 0.1),
        (0.0, f32::NAN),
        (0.0, 1e9),
    ] {
        assert_eq!(with(Obstacle::Circle { x, y: 0.0, r }), bad);
    }
    let board = |theta| Obstacle::Box {
        x: 0.0,
        y: 0.0,
        w: 1.0,
        h: 0.1,
        theta,
    };
    assert_eq!(with(board(f32::INFINITY)), bad);
    assert_eq!(with(board(1e30)), Ok(()));
    let many = Arena {
        obstacles: vec![
            Obstacle::Circle {
                x: 0.0,
                y: 0.0,
                r: 200.0
            };
            1_000
        ],
        ..Arena::empty(400.0, 400.0)
    };
    assert_eq!(
        build(many),
        Err(WorldError::Arena(ArenaError::TooManyObstacles)),
        "a scenario cannot ask for gigabytes"
    );
    let mut parameters = Parameters::default();
    parameters.chassis.mass_kg = f32::NAN;
    let error = World::with_parameters(Arena::empty(2.0, 2.0), parameters, 1, &clock)
        .map(|_| ())
        .expect_err("not a number");
    assert!(error.to_string().contains("chassis.mass_kg"), "{error}");
}

#[test]
fn arenas_and_parameters_read_as_the_live_feed_writes_them() {
    let text = r#"{"width":6.0,"height":4.0,"obstacles":[
        {"shape":"circle","x":1.0,"y":0.5,"r":0.2},
        {"shape":"box","x":-1.0,"y":-0.5,"w":0.6,"h":0.2,"theta":0.4}]}"#;
    let read: Arena = serde_json::from_str(text).expect("the documented form");
    assert_eq!(read, arena());
    let written = serde_json::to_string(&read).expect("it serialises");
    assert_eq!(
        serde_json::from_str::<Arena>(&written).expect("round trip"),
        read
    );
    for wrong in [
        r#"{"width":6.0,"height":4.0,"depth":1.0}"#,
        r#"{"width":6.0,"height":4.0,"obstacles":[{"shape":"circle","x":1,"y":1,"r":1,"w":1}]}"#,
        r#"{"width":6.0,"height":4.0,"obstacles":[{"shape":"cone","x":1,"y":1,"r":1}]}"#,
    ] {
        assert!(serde_json::from_str::<Arena>(wrong).is_err(), "{wrong}");
    }
    assert!(serde_json::from_str::<Parameters>(r#"{"chassis":{"wheels":5}}"#).is_err());
    let partly: Parameters =
        serde_json::from_str(r#"{"ranger":{"dropout":0.1}}"#).expect("the rest is nominal");
    assert!(partly.ranger.dropout == 0.1 && partly.chassis == Chassis::default());
}
