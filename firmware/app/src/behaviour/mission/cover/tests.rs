//! Cells are what they should be, and robots that go to their middles come to rest and cover the area well.

use std::vec::Vec;

use crawler_hal::Instant;
use crawler_protocol::{Places, Pose};
use proptest::prelude::*;

use super::{AROUND, Cover, EACH, Polygon, ROUND};
use crate::behaviour::mission::{Scene, Wish};
use crate::behaviour::swarm::FULL;
use crate::neighbours::{MOST, Neighbour};
use crate::perception::Reading;

struct Draw(u64);

impl Draw {
    /// Uniform in 0 to 1.
    fn next(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1_u32 << 24) as f32
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    #[test]
    fn a_cell_is_what_is_nearer_to_nobody_else(
        x in -3_000_i32..-500,
        y in -3_000_i32..-500,
        others in prop::collection::vec([-4_000_i32..4_000, -4_000_i32..4_000], 0..16),
    ) {
        // The robot is in the rectangle.
        let (right, top) = (x + 4_000, y + 5_000);
        let area = [[x, y], [right, y], [right, top], [x, top]];
        let mut cell = Polygon::NONE;
        for corner in area {
            cell.push(corner);
        }
        for other in &others {
            cell.cut(*other);
        }
        let found = cell.centroid();
        let (mut sum, mut count) = ([0_i64; 2], 0_i64);
        for column in 0..80 {
            for row in 0..100 {
                let [at_x, at_y] = [x + 25 + column * 50, y + 25 + row * 50];
                let own = at_x * at_x + at_y * at_y;
                let nearer = |other: &[i32; 2]| {
                    let (dx, dy) = (at_x - other[0], at_y - other[1]);
                    dx * dx + dy * dy < own
                };
                if !others.iter().any(nearer) {
                    sum = [sum[0] + i64::from(at_x), sum[1] + i64::from(at_y)];
                    count += 1;
                }
            }
        }
        // Of a cell of a few squares their middles say little.
        if count > 40 {
            let found = found.expect("there is a cell");
            for (found, sum) in found.into_iter().zip(sum) {
                let off = i64::from(found) - sum / count;
                prop_assert!(off.abs() < 40, "{found} and {}", sum / count);
            }
        }
    }

    #[test]
    fn no_area_and_no_place_is_too_odd(
        corners in prop::collection::vec([-10_000.0_f32..10_000.0, -10_000.0_f32..10_000.0], 3..=8),
        at in [-10_000.0_f32..10_000.0, -10_000.0_f32..10_000.0],
        others in prop::collection::vec([-9.0_f32..9.0, -9.0_f32..9.0], 0..16),
    ) {
        let area = Places::new(&corners).expect("few and near");
        let said = Some(Cover::new(area).says());
        let near: Vec<Neighbour> = others
            .iter()
            .map(|[x, y]| Neighbour {
                says: said,
                ..Neighbour::new([at[0] + x, at[1] + y], 0.0, 0.0, 0.0)
            })
            .collect();
        let pose = Pose { x: at[0], y: at[1], ..Pose::default() };
        let wish = think(&mut Cover::new(area), &scene(&pose, &near, &Reading::default(), 0));
        if let Wish::Place(to, _) = wish {
            prop_assert!(to.iter().all(|along| along.is_finite() && along.abs() <= 10_100.0));
        }
    }
}

fn scene<'a>(pose: &'a Pose, near: &'a [Neighbour], reading: &'a Reading, round: u32) -> Scene<'a> {
    Scene {
        pose,
        near,
        own: 1,
        reading,
        speed: 0.3,
        now: Instant::BOOT + ROUND * round,
    }
}

/// A round of reckoning, from the beginning to what comes of it.
fn think(robot: &mut Cover, scene: &Scene<'_>) -> Wish {
    let steps = 2 + (AROUND.len() + scene.near.len()).div_ceil(EACH);
    let wishes = (0..steps).map(|_| robot.step(scene).0);
    wishes.last().expect("at least two steps")
}

/// Robots that go where they want to, as fast as they can; what they say is heard half a second later, one word in
/// twenty is lost, and nobody is where it takes itself to be by more than a few centimetres.
struct Fleet {
    at: Vec<[f32; 2]>,
    robots: Vec<Cover>,
    told: Vec<Option<Neighbour>>,
    round: u32,
    draw: Draw,
}

/// How far a robot hears at least, in metres.
const HEARS: f32 = 2.0;
/// What it drives in a round, in metres.
const STRIDE: f32 = 0.15;
/// Metres per half a second at a wish of one: less than what it lacks, as of one that slows down.
const SPEED: f32 = 0.15;

impl Fleet {
    /// So many robots in a corner of the area.
    fn new(robots: usize, area: Places, seed: u64) -> Self {
        let mut draw = Draw(seed);
        let side = 0.4 * (robots as f32).sqrt();
        Self {
            at: (0..robots)
                .map(|_| [(); 2].map(|()| -3.4 + side * draw.next()))
                .collect(),
            robots: std::vec![Cover::new(area); robots],
            told: std::vec![None; robots],
            round: 0,
            draw,
        }
    }

    /// How many robots want to go somewhere after so many seconds.
    fn run(&mut self, seconds: u32) -> usize {
        let mut moving = 0;
        for _ in 0..2 * seconds {
            self.round += 1;
            moving = 0;
            let before: Vec<Neighbour> = self
                .at
                .iter()
                .zip(&self.robots)
                .zip(1..)
                .map(|((at, robot), who)| Neighbour {
                    who,
                    says: Some(robot.says()),
                    ..Neighbour::new(*at, 0.0, 0.0, 0.0)
                })
                .collect();
            for own in 0..self.at.len() {
                let noise = [(); 2].map(|()| 0.04 * (self.draw.next() - 0.5));
                let at = self.at[own];
                let pose = Pose {
                    x: at[0] + noise[0],
                    y: at[1] + noise[1],
                    ..Pose::default()
                };
                let away = |other: &Neighbour| {
                    let [x, y] = other.at.map(|mm| mm as f32 * 0.001);
                    (x - at[0]).hypot(y - at[1])
                };
                let mut near: Vec<Neighbour> = (0..self.at.len())
                    .filter(|other| *other != own)
                    .filter_map(|other| self.told[other])
                    .filter(|other| away(other) <= HEARS)
                    .collect();
                near.sort_by(|a, b| away(a).total_cmp(&away(b)));
                near.truncate(MOST);
                let reading = Reading::default();
                let wish = think(
                    &mut self.robots[own],
                    &scene(&pose, &near, &reading, self.round),
                );
                let way = match wish {
                    Wish::Place(to, _) => [to[0] - pose.x, to[1] - pose.y],
                    // As far as it gets before it thinks again.
                    Wish::Velocity(wish) => wish.map(|along| along as f32 * SPEED / FULL as f32),
                    Wish::Rest | Wish::Done => continue,
                };
                moving += 1;
                let share = (STRIDE / way[0].hypot(way[1])).min(1.0);
                let at = &mut self.at[own];
                *at = [at[0] + way[0] * share, at[1] + way[1] * share];
            }
            for (told, new) in self.told.iter_mut().zip(before) {
                if self.draw.next() >= 0.05 {
                    *told = Some(new);
                }
            }
        }
        moving
    }

    /// The mean square of the distance from a place of a square of `side` metres round the origin to the nearest robot.
    fn cost(&self, side: f32) -> f32 {
        let steps = 60;
        let along = |step: i32| side * ((step as f32 + 0.5) / steps as f32 - 0.5);
        let mut sum = 0.0;
        for column in 0..steps {
            for row in 0..steps {
                let [x, y] = [along(column), along(row)];
                let squares = self
                    .at
                    .iter()
                    .map(|at| (at[0] - x).powi(2) + (at[1] - y).powi(2));
                sum += squares.fold(f32::INFINITY, f32::min);
            }
        }
        sum / (steps * steps) as f32
    }
}

#[test]
fn an_area_is_covered_well_and_all_come_to_rest() {
    let half = 3.5;
    let area = [[-half, -half], [half, -half], [half, half], [-half, half]];
    let area = Places::new(&area).expect("four corners");
    for (robots, seed) in [(16, 1), (16, 2), (30, 3), (50, 4), (50, 5)] {
        let mut fleet = Fleet::new(robots, area, seed);
        fleet.run(180);
        // Over a while, since one that looks once more is no news.
        let moving: usize = (0..20).map(|_| fleet.run(1)).sum();
        assert!(
            moving <= 4 * robots,
            "{robots} robots, seed {seed}: {moving}"
        );
        // Of all patterns one of hexagons is the best: 5/(18√3) of the area of each.
        let best = 0.1604 * (2.0 * half).powi(2) / robots as f32;
        let cost = fleet.cost(2.0 * half);
        assert!(
            cost < 1.45 * best,
            "{robots} robots, seed {seed}: {cost} and {best}"
        );
    }
}

#[test]
fn what_a_lost_robot_leaves_is_covered_by_others() {
    let half = 3.5;
    let area = [[-half, -half], [half, -half], [half, half], [-half, half]];
    let area = Places::new(&area).expect("four corners");
    let mut fleet = Fleet::new(16, area, 7);
    fleet.run(180);
    let before = fleet.cost(2.0 * half);
    for gone in [3, 7, 11] {
        fleet.at.remove(gone);
        fleet.robots.remove(gone);
        fleet.told.remove(gone);
    }
    let lost = fleet.cost(2.0 * half);
    fleet.run(120);
    let after = fleet.cost(2.0 * half);
    assert!(
        lost > 1.1 * before && after < lost,
        "{before}, {lost}, {after}"
    );
}

#[test]
fn who_covers_something_else_does_not_count() {
    let square = |half: f32| {
        Places::new(&[[-half, -half], [half, -half], [half, half], [-half, half]]).expect("four")
    };
    let pose = Pose {
        x: 1.5,
        ..Pose::default()
    };
    let goes = |says| {
        let other = Neighbour {
            says,
            ..Neighbour::new([0.0, 0.0], 0.0, 0.0, 0.0)
        };
        let reading = Reading::default();
        match think(
            &mut Cover::new(square(2.0)),
            &scene(&pose, &[other], &reading, 1),
        ) {
            Wish::Velocity([x, _]) => Some(pose.x + x as f32 * 0.16 / FULL as f32),
            _ => None,
        }
    };
    // Half of what it reaches to the right is outside.
    let alone = goes(None).expect("goes somewhere");
    assert!(alone < 1.45, "{alone}");
    assert_eq!(goes(Some(Cover::new(square(2.5)).says())), Some(alone));
    // What is left of the middle is nearer to the other one.
    let shared = goes(Some(Cover::new(square(2.0)).says()));
    assert!(shared.is_none_or(|x| x > alone + 0.05), "{shared:?}");
}
