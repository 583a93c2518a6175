//! The cone against a second opinion: thousands of points on every surface.

use proptest::prelude::*;

use super::*;
use crate::world::geometry::{Beam, Cone};

/// Nearest point of `points` (with outward normals) that lies in a cone as wide as `width`, half
/// angle and largest incidence, and faces it enough.
fn by_points(
    cone: &Cone,
    width: [f32; 2],
    points: impl Iterator<Item = (Vec2, Option<Vec2>)>,
) -> Option<f32> {
    points
        .filter_map(|(point, normal)| {
            let ray = point.minus(cone.apex);
            let distance = ray.length();
            let local = ray.into_frame(cone.axis);
            let bearing = libm::atan2f(local.y, local.x).abs();
            let facing = match normal {
                // Seen from behind, a point of a disc lies behind its near side anyway.
                Some(normal) => -ray.dot(normal) / distance,
                None => 1.0,
            };
            let steep = facing >= libm::cosf(width[1]);
            (bearing <= width[0] && steep).then_some(distance)
        })
        .fold(None, |nearest: Option<f32>, distance| {
            Some(nearest.map_or(distance, |nearest| nearest.min(distance)))
        })
}

fn agree(exact: Option<f32>, sampled: Option<f32>, widened: Option<f32>) -> bool {
    match (exact, sampled) {
        // Along a wall that is nearly missed, a thousandth of a radian is centimetres: between the two.
        (Some(exact), Some(sampled)) => {
            let between =
                widened.is_some_and(|wide| (wide - 1e-3..=sampled + 1e-3).contains(&exact));
            (exact - sampled).abs() < 0.01 || between
        }
        (None, None) => true,
        // Between two samples, or at the very edge: a slightly wider cone decides.
        (Some(exact), None) => widened.is_some_and(|wide| (exact - wide).abs() < 0.05),
        (None, Some(_)) => false,
    }
}

const SAMPLES: u16 = 20_000;

proptest! {
    #![proptest_config(crawler_properties::cases(400))]

    #[test]
    fn a_disc_echoes_from_its_nearest_point_in_the_cone(
        x in -3.0..3.0_f32, y in -3.0..3.0_f32, radius in 0.02..0.6_f32,
        heading in -3.1..3.1_f32, half in 0.05..0.5_f32, incidence in 0.3..1.4_f32,
    ) {
        let centre = Vec2::new(x, y);
        prop_assume!(centre.length() > radius + 0.02);
        let cone = Cone::new(Vec2::default(), Vec2::unit(heading), Beam::new(half, incidence));
        let points = || (0..SAMPLES).map(|k| {
            let normal = Vec2::unit(f32::from(k) / f32::from(SAMPLES) * core::f32::consts::TAU);
            (centre.plus(normal.times(radius)), Some(normal))
        });
        let exact = cone.echo_of_circle(centre, radius);
        let sampled = by_points(&cone, [half, incidence].map(|angle| angle - 1e-3), points());
        let widened = by_points(&cone, [half, incidence].map(|angle| angle + 2e-3), points());
        prop_assert!(
            agree(exact, sampled, widened),
            "exact {exact:?}, sampled {sampled:?}, widened {widened:?}"
        );
    }

    #[test]
    fn a_wall_echoes_from_its_nearest_point_in_the_cone(
        ax in -3.0..3.0_f32, ay in -3.0..3.0_f32, bx in -3.0..3.0_f32, by in -3.0..3.0_f32,
        heading in -3.1..3.1_f32, half in 0.05..0.5_f32, incidence in 0.3..1.4_f32,
    ) {
        let (a, b) = (Vec2::new(ax, ay), Vec2::new(bx, by));
        let along = b.minus(a);
        prop_assume!(along.length() > 0.05);
        let normal = Vec2::new(-along.y, along.x).times(1.0 / along.length());
        let offset = a.dot(normal);
        prop_assume!(offset.abs() > 0.02);
        // Towards the apex.
        let normal = normal.times(-offset.signum());
        let cone = Cone::new(Vec2::default(), Vec2::unit(heading), Beam::new(half, incidence));
        let points = || (0..=SAMPLES).map(|k| {
            (a.plus(along.times(f32::from(k) / f32::from(SAMPLES))), Some(normal))
        });
        let exact = cone.echo_of_segment(a, b);
        let sampled = by_points(&cone, [half, incidence].map(|angle| angle - 1e-3), points());
        let widened = by_points(&cone, [half, incidence].map(|angle| angle + 2e-3), points());
        // At grazing incidence a milliradian moves the point far along the wall.
        let grazing = exact.is_some_and(|exact| exact > 4.0 * offset.abs());
        prop_assert!(
            grazing || agree(exact, sampled, widened),
            "exact {exact:?}, sampled {sampled:?}, widened {widened:?}"
        );
    }

    #[test]
    fn the_grid_hides_nothing_from_the_cone(
        x in -4.0..4.0_f32, y in -4.0..4.0_f32, theta in -3.1..3.1_f32,
        others in proptest::collection::vec((-4.5..4.5_f32, -4.5..4.5_f32), 0..40),
        solids in proptest::collection::vec((-4.5..4.5_f32, -4.5..4.5_f32, 0.05..1.5_f32, 0.0..3.0_f32), 0..10),
        steps in 0..15_u32,
    ) {
        let obstacles: Vec<Obstacle> = solids
            .iter()
            .enumerate()
            .map(|(k, &(x, y, size, theta))| if k % 2 == 0 {
                Obstacle::Circle { x, y, r: size }
            } else {
                Obstacle::Box { x, y, w: size, h: size * 0.5, theta }
            })
            .collect();
        let arena = Arena {  obstacles, ..Arena::empty(10.0, 10.0) };
        let mut bench = TestWorld::new(arena, alike(), 2);
        prop_assume!(bench.world.add_robot(Pose::new(x, y, theta)).is_ok());
        for (x, y) in others {
            if let Ok((_, parts)) = bench.world.add_robot(Pose::new(x, y, x * y)) {
                bench.parts.push(parts);
                let last = bench.parts.len() - 1;
                bench.drive(last, 255, 240);
            }
        }
        bench.steps(steps);
        let told = bench.world.true_range(RobotIndex::new(0));

        // The same question asked of everything there is.
        let space = bench.world.shared.space.borrow();
        let ranger = space.parameters.ranger;
        let seen = &space.bodies.published;
        let apex = seen.at[0].plus(seen.heading[0].times(ranger.mount_m));
        let cone = Cone::new(apex, seen.heading[0], Beam::new(ranger.half_angle, ranger.max_incidence));
        let mut echoes: Vec<Option<f32>> = Vec::new();
        for &at in &seen.at[1..] {
            echoes.push(cone.echo_of_circle(at, space.parameters.chassis.radius_m));
        }
        for solid in &space.solids {
            match *solid {
                arena::Solid::Circle { centre, radius } => echoes.push(cone.echo_of_circle(centre, radius)),
                arena::Solid::Box { centre, axis, half } => {
                    let c = arena::Solid::corners(centre, axis, half);
                    for k in 0..4 {
                        echoes.push(cone.echo_of_segment(c[k], c[(k + 1) % 4]));
                    }
                }
            }
        }
        let w = 5.0;
        let c = [Vec2::new(w, w), Vec2::new(-w, w), Vec2::new(-w, -w), Vec2::new(w, -w)];
        for k in 0..4 {
            echoes.push(cone.echo_of_segment(c[k], c[(k + 1) % 4]));
        }
        let nearest = echoes
            .into_iter()
            .flatten()
            .filter(|&distance| (0.02..=4.5).contains(&distance))
            .fold(None, |nearest: Option<f32>, distance| {
                Some(nearest.map_or(distance, |nearest| nearest.min(distance)))
            });
        prop_assert_eq!(told, nearest);
    }
}

#[test]
fn a_slanted_wall_sends_the_sound_away() {
    // Looking along x at a wall through (1, 0) whose normal is turned away by some angle.
    let echo = |degrees: f32| {
        let along = Vec2::unit((90.0 + degrees).to_radians()).times(5.0);
        let foot = Vec2::new(1.0, 0.0);
        let cone = Cone::new(
            Vec2::default(),
            Vec2::new(1.0, 0.0),
            Beam::new(0.2, core::f32::consts::FRAC_PI_3),
        );
        cone.echo_of_segment(foot.minus(along), foot.plus(along))
    };
    assert!((echo(0.0).expect("square on") - 1.0).abs() < 1e-5);
    // The near edge of the cone is 0.2 rad towards the wall: 1 · cos φ / cos(φ − 0.2).
    let want = libm::cosf(0.7) / libm::cosf(0.5);
    let near = echo(0.7_f32.to_degrees()).expect("not too steep");
    assert!((near - want).abs() < 1e-4, "{near} {want}");
    assert!(echo(60.0 + 11.0).is_some(), "the edge of the cone helps");
    assert!(echo(60.0 + 12.0).is_none());
    assert!(echo(-75.0).is_none());
}
