//! How far robots are from the places of the shape that they form.

use core::f64::consts::{FRAC_1_SQRT_2, TAU};

use crawler_protocol::{Formation, Shape};

use super::metrics::mean;

type Place = [f64; 2];

/// The mean distance of robots at `places` from the places of a shape for as many robots, which lies where they are on
/// average and heads where it should; a circle may be turned. A lattice can be filled in many ways, so there is
/// none of one.
pub(super) fn shape_error(formation: &Formation, places: &[[f32; 2]]) -> Option<f64> {
    let size = f64::from(formation.size);
    let mut robots = in_axes(places, f64::from(formation.heading));
    centre(&mut robots);
    let robots = robots;
    match formation.shape {
        Shape::Lattice => None,
        Shape::Line => {
            let line = robots.iter().enumerate();
            let line = line.map(|(rank, _)| [0.0, rank as f64 * size]).collect();
            off(robots, line)
        }
        Shape::Wedge => {
            let half = robots.len() as i32 / 2;
            // With an even number one arm is longer.
            let firsts = [half, (robots.len() as i32 - 1) / 2];
            let arms = firsts.into_iter().filter_map(|first| {
                let numbers = robots
                    .iter()
                    .zip(-first..)
                    .map(|(_, number)| f64::from(number));
                let slant = size * FRAC_1_SQRT_2;
                let wedge = numbers.map(|number| [-number.abs() * slant, number * slant]);
                off(robots.clone(), wedge.collect())
            });
            arms.reduce(f64::min)
        }
        Shape::Circle => {
            let angle = |[x, y]: Place| libm::atan2(y, x);
            let mut robots = robots;
            robots.sort_by(|a, b| angle(*a).total_cmp(&angle(*b)));
            let even = TAU / robots.len() as f64;
            // By how much the even circle is turned: the mean direction of what each is ahead of it.
            let ahead = |(rank, at): (usize, &Place)| angle(*at) - rank as f64 * even;
            let turns: Vec<f64> = robots.iter().enumerate().map(ahead).collect();
            let sum = |of: fn(f64) -> f64| turns.iter().map(|turn| of(*turn)).sum::<f64>();
            let turn = libm::atan2(sum(libm::sin), sum(libm::cos));
            mean(robots.iter().enumerate().map(|(rank, [x, y])| {
                let (sin, cos) = libm::sincos(turn + rank as f64 * even);
                libm::hypot(x - size * cos, y - size * sin)
            }))
        }
    }
}

/// The places in axes of which the first heads so many radians from that of the floor.
fn in_axes(places: &[[f32; 2]], heading: f64) -> Vec<Place> {
    let (sin, cos) = libm::sincos(heading);
    let places = places.iter().map(|place| place.map(f64::from));
    places
        .map(|[x, y]| [x * cos + y * sin, y * cos - x * sin])
        .collect()
}

/// Moves places so that they are round the origin.
fn centre(places: &mut [Place]) {
    for axis in 0..2 {
        let middle = mean(places.iter().map(|place| place[axis])).unwrap_or(0.0);
        for place in &mut *places {
            place[axis] -= middle;
        }
    }
}

/// The mean distance of robots from as many places, one after the other across.
fn off(mut robots: Vec<Place>, mut places: Vec<Place>) -> Option<f64> {
    centre(&mut places);
    robots.sort_by(|a, b| a[1].total_cmp(&b[1]));
    let ways = robots.iter().zip(&places);
    mean(ways.map(|(at, to)| libm::hypot(at[0] - to[0], at[1] - to[1])))
}

#[cfg(test)]
mod tests {
    use crawler_protocol::Places;

    use super::*;

    fn error(shape: Shape, places: &[[f32; 2]]) -> f64 {
        let formation = Formation {
            shape,
            size: 1.0,
            heading: 0.0,
            path: Places::new(&[[0.0; 2]]).unwrap(),
        };
        shape_error(&formation, places).unwrap()
    }

    #[test]
    fn shapes_have_no_error_wherever_they_are() {
        assert!(error(Shape::Line, &[[3.0, 1.0], [3.0, -1.0], [3.0, 0.0]]) < 1e-6);
        let slant = 0.5_f32.sqrt();
        for side in [1.0, -1.0] {
            let wedge = [
                [5.0, 0.0],
                [5.0 - slant, slant],
                [5.0 - slant, -slant],
                [5.0 - 2.0 * slant, 2.0 * slant * side],
            ];
            assert!(error(Shape::Wedge, &wedge) < 1e-6, "{side}");
            assert!(error(Shape::Line, &wedge) > 0.3);
        }
        for turn in [0.0_f32, 0.3, 1.1, 2.9] {
            let ring = [0.0, 1.0, 2.0, 3.0, 4.0_f32].map(|n| {
                let angle = turn + n * 1.256_637;
                [2.0 + angle.cos(), angle.sin() - 4.0]
            });
            assert!(error(Shape::Circle, &ring) < 1e-5, "{turn}");
        }
    }

    #[test]
    fn errors_are_in_metres() {
        // The middle one is 0.3 m ahead: 0.2 m from where it would be with the others a third behind.
        let line = [[0.0, 1.0], [0.3, 0.0], [0.0, -1.0]];
        let value = error(Shape::Line, &line);
        assert!((value - 0.4 / 3.0).abs() < 1e-6, "{value}");
        let quarter = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -0.6]];
        assert!((0.05..0.3).contains(&error(Shape::Circle, &quarter)));
    }

    #[test]
    fn a_heading_turns_the_shape() {
        let formation = Formation {
            shape: Shape::Line,
            size: 1.0,
            heading: core::f32::consts::FRAC_PI_2,
            path: Places::new(&[[0.0; 2]]).unwrap(),
        };
        let column = [[1.0, 2.0], [2.0, 2.0], [0.0, 2.0]];
        assert!(shape_error(&formation, &column).unwrap() < 1e-6);
        let lattice = Formation {
            shape: Shape::Lattice,
            ..formation
        };
        assert_eq!(shape_error(&lattice, &column), None);
    }
}
