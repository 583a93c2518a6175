//! The way through rooms that are drawn in full, by a robot of points.

use std::vec::Vec;

use super::next::PASS_MM;
use super::*;

/// Edge of a block, in metres.
const BLOCK: f64 = 0.5;
/// From the ranger to what it stops for, in millimetres.
const CRITICAL: i32 = 250;
/// Radius of the body, in metres.
const BODY: f64 = 0.085;

/// Solid boxes: least and greatest x and y.
struct Room {
    solid: Vec<[f64; 4]>,
}

impl Room {
    /// `rows` of blocks, `#` where one is solid, within four walls. The middle of the lowest left block
    /// is at `origin`.
    fn new(rows: &[&[bool]], origin: [f64; 2]) -> Self {
        let (height, width) = (rows.len() as f64, rows[0].len() as f64);
        let low = origin.map(|along| along - BLOCK / 2.0);
        let high = [low[0] + width * BLOCK, low[1] + height * BLOCK];
        let mut solid = std::vec![
            [low[0] - 0.1, low[0], low[1] - 0.1, high[1] + 0.1],
            [high[0], high[0] + 0.1, low[1] - 0.1, high[1] + 0.1],
            [low[0] - 0.1, high[0] + 0.1, low[1] - 0.1, low[1]],
            [low[0] - 0.1, high[0] + 0.1, high[1], high[1] + 0.1],
        ];
        for (row, blocks) in rows.iter().enumerate() {
            for (column, is_solid) in blocks.iter().enumerate() {
                if *is_solid {
                    let x = low[0] + column as f64 * BLOCK;
                    let y = low[1] + row as f64 * BLOCK;
                    solid.push([x, x + BLOCK, y, y + BLOCK]);
                }
            }
        }
        Self { solid }
    }

    /// How far it is along a ray to anything, and the cosine of the incidence there.
    fn along(&self, [x, y]: [f64; 2], angle: f64) -> (f64, f64) {
        let (dy, dx) = angle.sin_cos();
        let mut best = (f64::INFINITY, 0.0);
        for [x0, x1, y0, y1] in &self.solid {
            for (at, d, other, e, low, high) in [
                (x0 - x, dx, y, dy, y0, y1),
                (x1 - x, dx, y, dy, y0, y1),
                (y0 - y, dy, x, dx, x0, x1),
                (y1 - y, dy, x, dx, x0, x1),
            ] {
                let far = at / d;
                let met = other + e * far;
                if far > 0.0 && far < best.0 && *low <= met && met <= *high {
                    best = (far, d.abs());
                }
            }
        }
        best
    }

    fn look(&self, at: [f64; 2], heading: f64) -> Look {
        let mount = 0.06;
        let eye = [at[0] + mount * heading.cos(), at[1] + mount * heading.sin()];
        let nearest = (-8..=8)
            .map(|step| self.along(eye, heading + f64::from(step) * 0.026))
            .filter(|(_, cosine)| *cosine >= 0.5)
            .fold(f64::INFINITY, |least, (far, _)| least.min(far));
        if nearest > 4.5 {
            Look::Nothing
        } else {
            Look::Echo((nearest * 1_000.0) as i32)
        }
    }

    /// Where the body ends up that would be there: it slides along what it touches.
    fn held_off(&self, [mut x, mut y]: [f64; 2]) -> [f64; 2] {
        for _ in 0..3 {
            for [x0, x1, y0, y1] in &self.solid {
                let (dx, dy) = (x - x.clamp(*x0, *x1), y - y.clamp(*y0, *y1));
                let far = dx.hypot(dy);
                if far > 0.0 && far < BODY {
                    x += dx / far * (BODY - far);
                    y += dy / far * (BODY - far);
                }
            }
        }
        [x, y]
    }
}

#[derive(Debug, PartialEq)]
enum End {
    Arrived,
    Nowhere,
    Lost,
}

fn place(at: [f64; 2], heading: f64) -> Place {
    Place {
        at: at.map(|along| (along * 1_000.0) as i32),
        heading: [heading.cos(), heading.sin()].map(|part| (part * 4_096.0) as i32),
    }
}

/// Plans to the end of it; what came of it, and after how many slices.
fn planned(navigator: &mut Navigator) -> (Way, usize) {
    for slices in 1..100_000 {
        if let Planned::Guide(guide) = navigator.plan() {
            return (guide.way, slices);
        }
    }
    panic!("it plans for ever");
}

/// Drives from one place to another; how that ended, how many looks it took, and how far it was.
fn drive(room: &Room, from: [f64; 2], to: [f64; 2], most: usize) -> (End, usize, f64) {
    let mut navigator = Navigator::BLANK;
    let mut going = Destination {
        number: 1,
        at: to.map(|along| (along * 1_000.0) as i32),
        speed: 240,
        bumps: 0,
    };
    let (mut at, mut heading, mut way, mut held) = (from, 0.3, 0.0, 0);
    for looks in 0..most {
        if (at[0] - to[0]).hypot(at[1] - to[1]) < 0.1 {
            return (End::Arrived, looks, way);
        }
        let look = room.look(at, heading);
        navigator.set_out(place(at, heading), going);
        navigator.look(look);
        let point = match planned(&mut navigator).0 {
            Way::To(point) => point.map(|along| f64::from(along) / 1_000.0),
            Way::Nowhere => return (End::Nowhere, looks, way),
        };
        let wanted = (point[1] - at[1]).atan2(point[0] - at[0]);
        let error = (wanted - heading + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
            - std::f64::consts::PI;
        heading += error.clamp(-0.16, 0.16);
        let blocked = matches!(look, Look::Echo(mm) if mm < CRITICAL);
        if error.abs() < 0.4 && !blocked {
            let step = 0.04;
            let next = [at[0] + step * heading.cos(), at[1] + step * heading.sin()];
            let next = room.held_off(next);
            let gone = (next[0] - at[0]).hypot(next[1] - at[1]);
            (at, way) = (next, way + gone);
            held = if gone < step / 4.0 { held + 1 } else { 0 };
            if held == 10 {
                going.bumps += 1;
                held = 0;
            }
        }
    }
    (End::Lost, most, way)
}

/// Whether there is a way over the free blocks.
fn is_connected(rows: &[&[bool]], from: [usize; 2], to: [usize; 2]) -> bool {
    let mut seen = std::vec![from];
    let mut next = 0;
    while let Some([column, row]) = seen.get(next).copied() {
        next += 1;
        for [dx, dy] in [[1, 0], [0, 1], [usize::MAX, 0], [0, usize::MAX]] {
            let [column, row] = [column.wrapping_add(dx), row.wrapping_add(dy)];
            let free = rows.get(row).and_then(|blocks| blocks.get(column)) == Some(&false);
            if free && !seen.contains(&[column, row]) {
                seen.push([column, row]);
            }
        }
    }
    seen.contains(&to)
}

/// In every room of 3 × 4 blocks, from the lowest left to the highest right one: if there is a way it arrives,
/// and otherwise it says that there is none.
#[test]
fn it_arrives_in_every_small_room_or_says_that_there_is_no_way() {
    let mut sums = [0.0; 3];
    for number in 0..1_024_u32 {
        let solid = |block: u32| (1..=10).contains(&block) && number >> (block - 1) & 1 != 0;
        let blocks: Vec<[bool; 4]> = (0..3)
            .map(|row| [0, 1, 2, 3].map(|column| solid(row * 4 + column)))
            .collect();
        let rows: Vec<&[bool]> = blocks.iter().map(|row| &row[..]).collect();
        // Blocks and cells do not have the same edges.
        let origin = [
            f64::from(number % 7) * 0.017,
            f64::from(number % 5) * -0.023,
        ];
        let room = Room::new(&rows, origin);
        let to = [origin[0] + 3.0 * BLOCK, origin[1] + 2.0 * BLOCK];
        let expected = if is_connected(&rows, [0, 0], [3, 2]) {
            End::Arrived
        } else {
            End::Nowhere
        };
        let (end, looks, way) = drive(&room, origin, to, 4_000);
        assert_eq!(end, expected, "room {number:010b} after {looks} looks");
        if end == End::Arrived {
            sums = [sums[0] + 1.0, sums[1] + looks as f64, sums[2] + way];
        }
    }
    // The mean way is no longer than one that knew the room would be by half.
    let [rooms, looks, way] = sums;
    assert!(rooms > 250.0, "{rooms}");
    assert!(looks / rooms < 135.0 && way / rooms < 3.0, "{sums:?}");
}

fn going(x: i32, y: i32) -> Destination {
    Destination {
        number: 7,
        at: [x, y],
        speed: 240,
        bumps: 0,
    }
}

fn look(navigator: &mut Navigator, mm: i32) {
    // Two that agree, since one alone is not believed.
    for _ in 0..2 {
        navigator.look(Look::Echo(mm));
    }
}

fn level_at(navigator: &Navigator, point: [i32; 2]) -> u8 {
    let map = navigator.map();
    map.level(map.cell(point))
}

#[test]
fn map_and_plan_fit_in_four_kilobytes() {
    assert!(
        size_of::<Navigator>() <= 4_096,
        "{}",
        size_of::<Navigator>()
    );
}

#[test]
fn what_is_seen_is_remembered_and_what_is_seen_through_is_doubted_once() {
    let mut navigator = Navigator::BLANK;
    navigator.set_out(place([0.05, 0.05], 0.0), going(3_000, 0));
    look(&mut navigator, 500);
    let wall = [610, 50];
    assert_eq!(level_at(&navigator, wall), 2);
    // One echo that nothing repeats marks nothing.
    navigator.look(Look::Echo(200));
    assert_eq!(level_at(&navigator, [310, 50]), 0);
    look(&mut navigator, 2_000);
    assert_eq!(level_at(&navigator, wall), 1);
    look(&mut navigator, 500);
    assert_eq!(level_at(&navigator, wall), 3);
    look(&mut navigator, 2_000);
    assert_eq!(level_at(&navigator, wall), 3);
    navigator.fade();
    navigator.fade();
    assert_eq!(level_at(&navigator, wall), 1);
    navigator.forget();
    assert_eq!(level_at(&navigator, wall), 0);
}

#[test]
fn a_robot_that_is_known_is_no_wall() {
    let mut navigator = Navigator::BLANK;
    navigator.set_out(place([0.05, 0.05], 0.0), going(3_000, 0));
    meet(&mut navigator, [700, 100], [0, 0]);
    for _ in 0..20 {
        navigator.look(Look::Echo(480));
    }
    assert_eq!(level_at(&navigator, [590, 50]), 0);
    // Beside the beam, or far behind what is seen, it explains nothing.
    for other in [[600, 600], [1_500, 50], [-600, 50]] {
        let mut navigator = navigator.clone();
        meet(&mut navigator, other, [0, 0]);
        look(&mut navigator, 480);
        assert_eq!(level_at(&navigator, [590, 50]), 2, "{other:?}");
    }
}

fn meet(navigator: &mut Navigator, at: [i32; 2], velocity: [i32; 2]) {
    navigator.meet(core::iter::once(Other { at, velocity }));
}

#[test]
fn it_goes_round_who_stands_and_to_the_right_of_who_comes() {
    let goal = going(2_000, 50);
    let mut navigator = Navigator::BLANK;
    navigator.set_out(place([0.05, 0.05], 0.0), goal);
    assert_eq!(planned(&mut navigator).0, Way::To(goal.at));
    // Somebody stands on the way: the next point is beside it.
    meet(&mut navigator, [800, 50], [0, 0]);
    for _ in 0..3 {
        navigator.set_out(place([0.05, 0.05], 0.0), goal);
    }
    let Way::To(point) = planned(&mut navigator).0 else {
        panic!("there is a way");
    };
    assert!(point[0] < 1_200 && point[1].abs() > 200, "{point:?}");
    // Somebody comes: half of what both need to pass each other, and the other half is theirs.
    meet(&mut navigator, [1_050, 50], [-300, 0]);
    for _ in 0..3 {
        navigator.set_out(place([0.05, 0.05], 0.0), goal);
    }
    assert_eq!(planned(&mut navigator).0, Way::To([550, 50 - PASS_MM / 2]));
    // Far away it is the same, before the next point.
    meet(&mut navigator, [2_850, 50], [-300, 0]);
    for _ in 0..3 {
        navigator.set_out(place([0.05, 0.05], 0.0), goal);
    }
    let Way::To(point) = planned(&mut navigator).0 else {
        panic!("there is a way");
    };
    assert!(
        point[0] >= 1_000 && point[1] == 50 - PASS_MM / 2,
        "{point:?}"
    );
    // Who goes the same way, or is past, is none of that.
    for (at, velocity) in [([1_050, 50], [300, 0]), ([-300, 50], [-300, 0])] {
        meet(&mut navigator, at, velocity);
        for _ in 0..3 {
            navigator.set_out(place([0.05, 0.05], 0.0), goal);
        }
        assert_eq!(planned(&mut navigator).0, Way::To(goal.at));
    }
    // In a corridor that somebody stands in, it goes up to them.
    for column in 0..COLUMNS {
        for row in [-300, 350] {
            let [_, row] = navigator.map.cell([0, row]);
            navigator.map.block(navigator.map.middle([column, row]));
        }
    }
    meet(&mut navigator, [800, 50], [0, 0]);
    for _ in 0..3 {
        navigator.set_out(place([0.05, 0.05], 0.0), goal);
    }
    assert_eq!(planned(&mut navigator).0, Way::To(goal.at));
    // Where somebody comes it keeps two cells off the wall, though passing would want more.
    meet(&mut navigator, [1_050, -50], [-300, 0]);
    for _ in 0..3 {
        navigator.set_out(place([0.05, -0.05], 0.0), goal);
    }
    let Way::To(point) = planned(&mut navigator).0 else {
        panic!("there is a way");
    };
    assert!((-200..-50).contains(&point[1]), "{point:?}");
}

#[test]
fn the_window_moves_and_keeps_what_stays_in_it() {
    let mut navigator = Navigator::BLANK;
    let far = going(40_000, -30_000);
    navigator.set_out(place([0.05, 0.05], 0.0), far);
    look(&mut navigator, 500);
    for step in 0..=30_i32 {
        let at = f64::from(step) / 10.0;
        navigator.set_out(place([at, -at], -0.78), far);
    }
    assert_eq!(level_at(&navigator, [610, 50]), 2);
    for step in 30..=400_i32 {
        let at = f64::from(step) / 10.0;
        navigator.set_out(place([at, -at * 0.75], -0.78), far);
        let (way, _) = planned(&mut navigator);
        assert!(matches!(way, Way::To(_)), "at {at}");
    }
    let (way, _) = planned(&mut navigator);
    assert_eq!(way, Way::To([40_000, -30_000]));
}

#[test]
fn a_jump_of_the_coordinates_takes_the_map_along_and_a_turn_clears_it() {
    let mut navigator = Navigator::BLANK;
    navigator.set_out(place([0.05, 0.05], 0.0), going(3_000, 0));
    look(&mut navigator, 500);
    let mut turned = navigator.clone();
    navigator.set_out(place([0.55, -0.35], 0.0), going(3_000, 0));
    assert_eq!(level_at(&navigator, [1_110, -350]), 2);
    assert_eq!(level_at(&navigator, [610, 50]), 0);
    turned.set_out(place([0.55, -0.35], 0.5), going(3_000, 0));
    assert_eq!(level_at(&turned, [1_110, -350]), 0);
}

#[test]
fn a_slice_is_short_and_a_plan_has_an_end() {
    // The longest way there is: walls from side to side, with gaps at alternating ends.
    let mut navigator = Navigator::BLANK;
    let goal = going(4_500, 3_700);
    navigator.set_out(place([-4.5, -3.7], 0.0), goal);
    for wall in 1..26_i32 {
        for column in 0..COLUMNS - 1 {
            let column = if wall % 2 == 0 { column } else { column + 1 };
            navigator
                .map
                .block(navigator.map.middle([column, wall * 3]));
        }
    }
    let (way, slices) = planned(&mut navigator);
    assert!(matches!(way, Way::To(_)), "{way:?}");
    assert!(slices < 5_000, "{slices}");
}

#[test]
fn it_goes_through_a_door_in_the_middle_where_there_is_room_to_either_side() {
    // A wall of a cell with a door of 0.5 m; the nearest way is straight on, along a post.
    let mut navigator = Navigator::BLANK;
    let goal = going(2_000, 150);
    navigator.set_out(place([0.05, 0.15], 0.0), goal);
    for row in (-1_450..2_000).step_by(100) {
        if !(-150..350).contains(&row) {
            navigator.map.block([1_050, row]);
        }
    }
    // Others far off make it plan along walls.
    meet(&mut navigator, [-1_500, -1_500], [0, 0]);
    let mut at = [0.05, 0.15];
    let mut nearest = i32::MAX;
    for _ in 0..200 {
        for _ in 0..PLAN_EVERY {
            navigator.set_out(place(at, 0.0), goal);
        }
        let Way::To(point) = planned(&mut navigator).0 else {
            panic!("there is a way");
        };
        let to = point.map(|along| f64::from(along) / 1_000.0);
        let far = (to[0] - at[0]).hypot(to[1] - at[1]);
        if far < 0.03 {
            break;
        }
        at = [0, 1].map(|axis| at[axis] + (to[axis] - at[axis]) / far * 0.03);
        let [x, y] = at.map(|along| (along * 1_000.0) as i32);
        // To both posts, the corners of which are at 1.0 to 1.1 m.
        for post in [-200, 300] {
            let dx = x - x.clamp(1_000, 1_100);
            nearest = nearest.min((dx * dx + (y - post) * (y - post)).isqrt());
        }
    }
    assert!((at[0] - 2.0).abs() < 0.1, "{at:?}");
    assert!(nearest > 200, "{nearest}");
}

#[test]
fn an_excerpt_has_rows_of_the_map_and_with_the_first_the_plan() {
    let mut navigator = Navigator::BLANK;
    let going = going(2_550, 50);
    // Something stands in the way, half a metre ahead.
    for _ in 0..8 {
        navigator.set_out(place([0.05, 0.05], 0.0), going);
        navigator.look(Look::Echo(500));
        planned(&mut navigator);
    }
    let map = navigator.map().clone();
    let mut row = 0;
    let mut blocked = 0;
    loop {
        let excerpt = navigator.excerpt(row, true);
        assert_eq!((excerpt.row, excerpt.origin), (row, map.origin()));
        for (at, cells) in excerpt.cells.chunks(24).enumerate() {
            for column in 0..COLUMNS {
                let bit = |half: usize| {
                    let byte = cells[half * 12 + column as usize / 8];
                    byte >> (column % 8) & 1
                };
                let cell = [column, i32::from(row) + at as i32];
                assert_eq!(bit(0) << 1 | bit(1), map.level(cell), "{cell:?}");
                blocked += i32::from(bit(0));
            }
        }
        let with_plan = row == 0;
        assert_eq!(excerpt.goal, with_plan.then_some(going.at));
        assert_eq!(excerpt.next.is_some(), with_plan);
        assert_eq!(excerpt.way.is_empty(), !with_plan);
        match excerpt.row_after() {
            Some(next) => row = next,
            None => break,
        }
    }
    assert_eq!((row, blocked), (64, 1));
    assert_eq!(navigator.excerpt(0, false).goal, None, "on its way no more");
    // The way goes round what stands there, and ends at the goal.
    let way = navigator.excerpt(0, true).way;
    let cells: Vec<_> = way.iter().map(|cell| cell.map(i32::from)).collect();
    assert!(cells.iter().all(|cell| !map.is_blocked(*cell)), "{cells:?}");
    let start = map.cell([50, 50]);
    assert!(cells.iter().any(|cell| cell[1] != start[1]), "{cells:?}");
    assert_eq!(cells.last(), Some(&map.cell(going.at)));
}

#[test]
fn a_long_way_is_told_as_far_as_there_is_room() {
    let mut navigator = Navigator::BLANK;
    let going = going(8_850, 50);
    navigator.set_out(place([0.05, 0.05], 0.0), going);
    planned(&mut navigator);
    let way = navigator.excerpt(0, true).way;
    assert!(way.is_full());
    let [start, _] = navigator.map().cell([50, 50]);
    let columns: Vec<_> = way.iter().map(|cell| i32::from(cell[0]) - start).collect();
    assert_eq!(columns, (1..=16).map(|step| 4 * step).collect::<Vec<_>>());
}
