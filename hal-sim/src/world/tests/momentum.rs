//! What collisions may not do: make momentum or energy, or let one robot harm another.

use proptest::prelude::*;

use super::convergence::Fine;
use super::*;

/// Robots at rest on their wheels that are hit by a hand: places, velocities, masses by the seed.
fn thrown(places: &[(f32, f32, f32, f32)], seed: u64) -> Fine {
    let mut parameters = alike();
    parameters.spread.mass = 0.2;
    let mut fine = Fine::new(Arena::empty(4.0, 4.0), parameters, 0.01);
    for &(x, y, vx, vy) in places {
        if fine
            .space
            .place(Pose::new(x, y, x * 7.0), seed, &Body::default())
            .is_ok()
        {
            let i = fine.space.bodies.len() - 1;
            fine.space.bodies.published.velocity[i] = Vec2::new(vx, vy);
            fine.space.bodies.rolls[i] = false;
        }
    }
    fine.space.rebuild_grid();
    fine
}

fn energy(space: &Space) -> f64 {
    let bodies = &space.bodies;
    (0..bodies.len())
        .map(|i| {
            let build = &bodies.build[i];
            let (speed, turn) = (
                bodies.published.velocity[i],
                bodies.published.spin[i] / build.per_half_track,
            );
            let rotor = space.parameters.chassis.rotor_kg;
            let rims = bodies.left[i] * bodies.left[i] + bodies.right[i] * bodies.right[i];
            f64::from(build.mass_kg * speed.dot(speed) + build.turn_kg * turn * turn + rotor * rims)
                * 0.5
        })
        .sum()
}

proptest! {
    #![proptest_config(crawler_properties::cases(200))]

    #[test]
    fn impulses_between_robots_make_neither_momentum_nor_energy(
        places in proptest::collection::vec(
            (-0.6..0.6_f32, -0.6..0.6_f32, -0.9..0.9_f32, -0.9..0.9_f32), 2..24),
        seed: u64,
    ) {
        let fine = thrown(&places, seed);
        let bodies = &fine.space.bodies;
        let (mut sum, mut size) = (Vec2::default(), 0.0_f32);
        let (mut before, mut after) = (0.0_f32, 0.0_f32);
        for i in 0..bodies.len() {
            let kick = fine.space.touch(i).kick;
            let mass = bodies.build[i].mass_kg;
            let was = bodies.published.velocity[i];
            sum = sum.plus(kick.times(mass));
            size += kick.length() * mass;
            before += mass * was.dot(was);
            let is = was.plus(kick);
            after += mass * is.dot(is);
        }
        prop_assert!(sum.length() <= 1e-5 * size + 1e-7, "{sum:?} of {size}");
        prop_assert!(after <= before * (1.0 + 1e-5), "{before} {after}");
    }

    #[test]
    fn a_crowd_that_nobody_drives_only_ever_loses_energy(
        places in proptest::collection::vec(
            (-0.8..0.8_f32, -0.8..0.8_f32, -0.9..0.9_f32, -0.9..0.9_f32), 2..24),
        seed: u64,
    ) {
        let mut fine = thrown(&places, seed);
        let mut last = energy(&fine.space);
        for _ in 0..100 {
            fine.run(0.01);
            let next = energy(&fine.space);
            prop_assert!(next <= last * (1.0 + 1e-4) + 1e-7, "{last} {next}");
            last = next;
        }
        fine.run(3.0);
        prop_assert!(energy(&fine.space) < 1e-6, "all come to rest: {}", energy(&fine.space));
    }

    #[test]
    fn no_parameters_let_a_robot_into_anything(
        sides in proptest::collection::vec(0.0..=1.0_f32, 20),
        places in proptest::collection::vec((-1.9..1.9_f32, -1.9..1.9_f32, -3.0..3.0_f32), 1..25),
        seed: u64, speed in 0.1..=1.0_f32, grip in 0.05..=2.0_f32,
    ) {
        // Every number of the chassis and the pack anywhere in its range.
        let mut parameters = Parameters::default();
        let rows = TABLE.iter().filter(|row| row.key.starts_with("chassis."));
        for (row, side) in rows.zip(&sides) {
            let (least, most) = row.range(&parameters);
            row.set(&mut parameters, least + (most - least) * side);
        }
        let reach = parameters.chassis.radius_m;
        parameters.ranger.mount_m = parameters.ranger.mount_m.min(reach);
        prop_assert_eq!(parameters.validate(), Ok(()));
        let board = |x, y, theta| Obstacle::Box { x, y, w: 1.2, h: 0.004, theta };
        let arena = Arena {
            obstacles: vec![board(0.7, 0.6, 0.3), board(-0.8, -0.4, 1.2), board(0.2, -1.1, 2.3)],
            movers: vec![
                Mover { body: Obstacle::Circle { x: -1.4, y: 1.4, r: 0.15 }, path: vec![[1.4, 1.5]], speed },
                Mover {
                    body: Obstacle::Box { x: 1.5, y: -1.0, w: 0.3, h: 0.1, theta: 0.7 },
                    path: vec![[-1.5, -1.7], [-1.5, 0.0]],
                    speed,
                },
            ],
            patches: vec![Patch { x: 0.5, y: 0.0, w: 1.5, h: 4.0, theta: 0.2, grip }],
            ..Arena::empty(4.0, 4.0)
        };
        let mut fine = Fine::new(arena.clone(), parameters, 0.01);
        for (x, y, theta) in places {
            // Some places are taken.
            let _ = fine.space.place(Pose::new(x, y, theta), seed, &Body::default());
        }
        let fixed = Arena { movers: Vec::new(), ..arena };
        let robots = fine.space.bodies.len();
        for round in 0..30_i16 {
            for i in 0..robots {
                let bend = (round * 37 + i as i16 * 91) % 200;
                let sign = if (round + i as i16) % 7 == 0 { -1 } else { 1 };
                fine.drive(i, 255 * sign, (255 - bend) * sign);
            }
            for _ in 0..10 {
                fine.run(0.01);
                let space = &fine.space;
                let at = &space.bodies.published.at;
                for i in 0..robots {
                    let place = at[i];
                    prop_assert!(place.x.is_finite() && place.y.is_finite());
                    let depth = reach - fixed.clearance(place.x, place.y);
                    prop_assert!(depth <= 2e-5, "{depth} m in something fixed, round {round}");
                    for k in 0..space.movers.len() {
                        let depth = reach - space.movers.now(k).separation(place).0;
                        prop_assert!(depth <= 2e-5, "{depth} m in mover {k}, round {round}");
                    }
                    for other in &at[..i] {
                        let depth = 2.0 * reach - place.minus(*other).length();
                        prop_assert!(depth <= 5e-5, "{depth} m in another one, round {round}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_robot_of_nonsense_harms_no_other() {
    type Harm = fn(&mut bodies::Bodies);
    let harms: [Harm; 8] = [
        |b| b.left[0] = f32::NAN,
        |b| b.right[0] = f32::INFINITY,
        |b| b.supply_v[0] = f32::NAN,
        |b| b.charge_as[0] = f64::NAN,
        |b| b.published.velocity[0] = Vec2::new(f32::NAN, 0.0),
        |b| b.published.spin[0] = f32::NEG_INFINITY,
        |b| b.published.at[0] = Vec2::new(f32::NAN, f32::NAN),
        |b| b.build[0].mass_kg = f32::NAN,
    ];
    let run = |harm: Option<Harm>| {
        let mut fine = Fine::new(Arena::empty(6.0, 6.0), alike(), 0.01);
        // The first one stands far away from the others, so that its fate is not theirs.
        fine.add(-2.5, -2.5, 0.0);
        for k in 0..6_u8 {
            fine.add(f32::from(k) * 0.2, 0.5, f32::from(k));
            fine.drive(usize::from(k) + 1, 200, 180);
        }
        fine.drive(0, 90, 90);
        fine.run(0.5);
        if let Some(harm) = harm {
            harm(&mut fine.space.bodies);
        }
        fine.run(3.0);
        (1..7)
            .map(|i| fine.space.bodies.pose(i))
            .collect::<Vec<_>>()
    };
    let sound = run(None);
    for (k, harm) in harms.into_iter().enumerate() {
        assert_eq!(run(Some(harm)), sound, "harm {k}");
    }
}

#[test]
fn a_robot_pushes_another_against_a_wall_and_stays_out_of_it() {
    let mut bench = TestWorld::plain();
    bench.add(4.0, 0.0, 0.0);
    bench.add(4.5, 0.0, 0.0);
    bench.drive(0, 255, 255);
    bench.steps(400);
    let (pusher, pushed) = (bench.see(0), bench.see(1));
    assert!(
        pushed.pose.x > 4.91,
        "it was pushed to the wall: {pushed:?}"
    );
    let gap = pushed.pose.x - pusher.pose.x - 0.17;
    assert!((-EPSILON..0.002).contains(&gap), "{gap}");
    assert!(
        pusher.speed.abs() < 0.1 && pushed.speed.abs() < 0.1,
        "{pusher:?}"
    );
    assert!(pusher.slip[0] > 0.2, "its wheels spin: {pusher:?}");
    let free = {
        let mut bench = TestWorld::plain();
        bench.add(-4.0, 0.0, 0.0);
        bench.drive(0, 255, 255);
        bench.steps(400);
        bench.see(0)
    };
    assert!(
        pusher.energy_j > free.energy_j,
        "and cost more than rolling"
    );
}

/// Overlap that rounding may leave, metres.
const EPSILON: f32 = 2e-5;
