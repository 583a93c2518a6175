//! Robots come into shape, keep it while it moves, and close up when some are lost.

use std::vec::Vec;

use crawler_protocol::{Formation, Places, Shape};

use super::super::Underway;
use super::super::tests::{Robot, pose, run};
use super::{LEAD_MM, PATIENCE, Shaped};
use crate::goal::Mission;

/// Robots stand where they are told of, not farther than this from their places at the end, in metres.
const NEAR: f32 = 0.13;
const SPACING: f32 = 0.8;

fn formation(shape: Shape, path: &[[f32; 2]]) -> Formation {
    Formation {
        shape,
        size: if shape == Shape::Circle { 1.5 } else { SPACING },
        heading: 0.5,
        path: Places::new(path).expect("few"),
    }
}

/// So many robots near the origin, nobody nearer than 0.3 m to anybody.
fn fleet(count: u32, formation: Formation) -> Vec<Robot> {
    let mut robots: Vec<Robot> = Vec::new();
    let side = 0.9 * (count as f32).sqrt();
    let mut draw = 0x2545_F491_u32;
    let mut next = || {
        draw = draw.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (draw >> 8) as f32 / (1_u32 << 24) as f32
    };
    while robots.len() < count as usize {
        let [x, y] = [(); 2].map(|()| side * (next() - 0.5));
        let near = |other: &Robot| (other.pose.x - x).hypot(other.pose.y - y) < 0.3;
        if !robots.iter().any(near) {
            let who = robots.len() as u32 + 1;
            let at = pose(x, y, 6.0 * next() - 3.0);
            robots.push(Robot::new(who, at, Some(Mission::Shaped(formation))));
        }
    }
    robots
}

fn shaped(robot: &Robot) -> &Shaped {
    match &robot.mission {
        Underway::Shaped(shaped) => shaped,
        other => panic!("{other:?}"),
    }
}

/// Where the robots are from `middle`, in metres along the axes of the shape.
fn seen(robots: &[Robot], middle: [f32; 2], heading: f32) -> Vec<[f32; 2]> {
    let (sin, cos) = heading.sin_cos();
    let places = robots.iter().map(|robot| {
        let [x, y] = [robot.pose.x - middle[0], robot.pose.y - middle[1]];
        [x * cos + y * sin, y * cos - x * sin]
    });
    places.collect()
}

/// Places that so many robots fill.
fn ideal(shape: Shape, count: usize) -> Vec<[f32; 2]> {
    // 0, 1, -1, 2, -2 and so on.
    let numbers = (0..count as i32).map(|n| if n % 2 == 1 { (n + 1) / 2 } else { -n / 2 });
    let slant = 0.5_f32.sqrt();
    let numbers = numbers.map(|n| n as f32 * SPACING);
    match shape {
        Shape::Line => numbers.map(|at| [0.0, at]).collect(),
        Shape::Wedge => numbers.map(|at| [-at.abs() * slant, at * slant]).collect(),
        Shape::Lattice | Shape::Circle => Vec::new(),
    }
}

/// The farthest that anybody is from the places that should be taken; the last of these may be on either side.
fn off(shape: Shape, seen: &[[f32; 2]]) -> f32 {
    let all = ideal(shape, seen.len() + 1);
    let sides = [all.len() - 1, all.len() - 2].map(|left_out| {
        let places = all.iter().enumerate();
        let places = places.filter(|(number, _)| seen.len() % 2 == 1 || *number != left_out);
        let places = places.take(seen.len()).map(|(_, place)| {
            let ways = seen
                .iter()
                .map(|at| (at[0] - place[0]).hypot(at[1] - place[1]));
            ways.fold(f32::INFINITY, f32::min)
        });
        places.fold(0.0, f32::max)
    });
    sides[0].min(sides[1])
}

/// The least and the largest gap on a circle, as shares of an even one, and how far the worst is from it.
fn ring(seen: &[[f32; 2]]) -> ([f32; 2], f32) {
    let mut angles: Vec<f32> = seen.iter().map(|at| at[1].atan2(at[0])).collect();
    angles.sort_by(f32::total_cmp);
    let turn = core::f32::consts::TAU;
    let nexts = angles.iter().skip(1).copied();
    let nexts = nexts.chain([angles[0] + turn]);
    let even = turn / seen.len() as f32;
    let gaps: Vec<f32> = angles
        .iter()
        .zip(nexts)
        .map(|(a, b)| (b - a) / even)
        .collect();
    let least = gaps.iter().copied().fold(f32::INFINITY, f32::min);
    let most = gaps.iter().copied().fold(0.0, f32::max);
    let off = seen.iter().map(|at| (at[0].hypot(at[1]) - 1.5).abs());
    ([least, most], off.fold(0.0, f32::max))
}

#[test]
fn lines_and_wedges_are_formed_and_close_up_when_some_are_lost() {
    for shape in [Shape::Line, Shape::Wedge] {
        for count in [3, 10, 24] {
            let mut robots = fleet(count, formation(shape, &[[0.5, -0.5]]));
            // Over to the other arm one goes after the other.
            let seconds = 60 + 16 * u64::from(count);
            run(&mut robots, 0, seconds, |_| (0.0, 0.0));
            let at = seen(&robots, [0.5, -0.5], 0.5);
            assert!(off(shape, &at) < NEAR, "{shape:?} of {count}: {at:?}");
            assert!(robots.iter().all(|robot| shaped(robot).in_place));
            // The one in the middle, and another one.
            let middle = |robot: &Robot| (robot.pose.x - 0.5).hypot(robot.pose.y + 0.5) < 0.3;
            robots.retain(|robot| !middle(robot) && (count == 3 || robot.who != 2));
            run(&mut robots, seconds * 1_000, seconds, |_| (0.0, 0.0));
            let at = seen(&robots, [0.5, -0.5], 0.5);
            assert!(off(shape, &at) < NEAR, "{shape:?} of {count}: {at:?}");
        }
    }
}

#[test]
fn a_circle_is_even_and_stays_so_when_one_is_lost() {
    let mut robots = fleet(10, formation(Shape::Circle, &[[0.0; 2]]));
    for (begun, seconds) in [(0, 150), (150_000, 100)] {
        run(&mut robots, begun, seconds, |_| (0.0, 0.0));
        let ([least, most], off) = ring(&seen(&robots, [0.0; 2], 0.5));
        assert!(
            least > 0.7 && most < 1.3 && off < NEAR,
            "{least} {most} {off}"
        );
        robots.truncate(8);
    }
}

#[test]
fn a_lattice_may_lie_anywhere() {
    let mut robots = fleet(19, formation(Shape::Lattice, &[[1.0, 1.0]]));
    run(&mut robots, 0, 120, |_| (0.0, 0.0));
    // A middle with two rings around it would be best; some may be in the third.
    let at = seen(&robots, [1.0, 1.0], 0.5);
    let far = at.iter().map(|at| at[0].hypot(at[1])).fold(0.0, f32::max);
    assert!(far < 3.0 * SPACING + NEAR, "{far}");
    let neighbours = |at: &[f32; 2]| {
        let ways = at_all(&robots).into_iter();
        let near = ways.filter(|other| {
            let way = (other[0] - at[0]).hypot(other[1] - at[1]);
            (way - SPACING).abs() < 2.0 * NEAR
        });
        near.count()
    };
    let degrees: usize = at.iter().map(neighbours).sum();
    // A hexagon of two rings has 42 pairs.
    assert!(degrees >= 2 * 38, "{degrees}");
}

fn at_all(robots: &[Robot]) -> Vec<[f32; 2]> {
    seen(robots, [1.0, 1.0], 0.5)
}

#[test]
fn a_shape_is_kept_while_it_moves() {
    let path = [[0.0, 0.0], [3.0, 0.0], [3.0, 2.0]];
    for shape in [Shape::Line, Shape::Wedge, Shape::Lattice, Shape::Circle] {
        let mut robots = fleet(10, formation(shape, &path));
        let (mut moved, mut kept, mut looks) = (0, 0, 0);
        for second in 0..200 {
            run(&mut robots, second * 1_000, 1, |_| (0.0, 0.0));
            let along: Vec<i32> = robots.iter().map(|robot| shaped(robot).along).collect();
            let [least, most] = [along.iter().min(), along.iter().max()].map(|of| *of.unwrap());
            // From one end to the other there are few who do not hear each other.
            assert!(most - least < 6 * LEAD_MM, "{shape:?}: {along:?}");
            if least > 0 && most < 5_000 {
                moved += 1;
                looks += robots.len();
                kept += robots.iter().filter(|robot| shaped(robot).in_place).count();
            }
        }
        assert!(moved > 20, "{shape:?}");
        assert!(kept * 100 >= looks * 90, "{shape:?}: {kept} of {looks}");
        let ends = robots.iter().map(|robot| shaped(robot).along);
        assert!(
            ends.clone().all(|along| (4_990..=5_010).contains(&along)),
            "{shape:?}: {:?}",
            ends.collect::<Vec<_>>()
        );
        let at = seen(&robots, path[2], 0.5);
        match shape {
            Shape::Line | Shape::Wedge => assert!(off(shape, &at) < NEAR, "{at:?}"),
            Shape::Circle => assert!(ring(&at).1 < NEAR, "{at:?}"),
            Shape::Lattice => {
                let far = at.iter().map(|at| at[0].hypot(at[1])).fold(0.0, f32::max);
                assert!(far < 2.7 * SPACING + NEAR, "{at:?}");
            }
        }
    }
}

#[test]
fn all_wait_for_one_that_is_held_up_but_not_for_ever() {
    let shape = formation(Shape::Line, &[[0.0, 0.0], [4.0, 0.0]]);
    let mut robots = fleet(5, shape);
    // One that is far away says that it is not in its place, and does not come.
    let mut lost = Robot::new(9, pose(0.0, 2.5, 0.0), Some(Mission::Shaped(shape)));
    lost.pose.x = -1.2;
    robots.push(lost);
    let hold = |robots: &mut [Robot], from: u64, seconds: u64| {
        for second in from..from + seconds {
            run(robots, second * 1_000, 1, |_| (0.0, 0.0));
            robots[5].pose = pose(-1.2, 1.2, 0.0);
        }
    };
    hold(&mut robots, 0, 15);
    // Who does not hear it goes on a little.
    let most = robots[..5].iter().map(|robot| shaped(robot).along).max();
    assert!(most < Some(5 * LEAD_MM), "{most:?}");
    hold(&mut robots, 15, PATIENCE.as_millis() / 1_000 + 60);
    let least = robots[..5].iter().map(|robot| shaped(robot).along).min();
    assert!(least > Some(3_000), "{least:?}");
}
