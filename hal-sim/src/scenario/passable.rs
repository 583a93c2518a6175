//! Where a robot fits, and the ways between such places.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::world::{Arena, Obstacle};

/// Side of a square of the map, metres, where the arena is not too large for it.
const SQUARE_M: f32 = 0.05;
/// Most squares of a map.
const MOST_SQUARES: f32 = 400_000.0;
/// A place in a square that is not free counts as the nearest free one within this many squares.
const NEAR_SQUARES: i32 = 8;

/// A map of the squares in which a round body fits.
#[derive(Debug, Clone)]
pub struct Passable {
    side: f32,
    columns: i32,
    rows: i32,
    half: [f32; 2],
    free: Vec<bool>,
}

impl Passable {
    /// The map of `arena`, without its movers, for a body that keeps `margin` metres from its middle to everything.
    #[must_use]
    pub fn new(arena: &Arena, margin: f32) -> Self {
        let area = arena.width * arena.height;
        let side = SQUARE_M.max((area / MOST_SQUARES).sqrt());
        let count = |length: f32| (libm::ceilf(length / side) as i32).max(1);
        let mut map = Self {
            side,
            columns: count(arena.width),
            rows: count(arena.height),
            half: [arena.width * 0.5, arena.height * 0.5],
            free: Vec::new(),
        };
        map.free = (0..map.columns * map.rows)
            .map(|square| {
                let [x, y] = map.centre(square);
                (map.half[0] - x.abs()).min(map.half[1] - y.abs()) >= margin
            })
            .collect();
        let objects = arena.objects.iter().map(crate::world::Object::body);
        for obstacle in arena.obstacles.iter().copied().chain(objects) {
            map.block(arena, &obstacle, margin);
        }
        map
    }

    /// Takes the squares near an obstacle away.
    fn block(&mut self, arena: &Arena, obstacle: &Obstacle, margin: f32) {
        let (x, y, reach) = match *obstacle {
            Obstacle::Circle { x, y, r } => (x, y, r),
            Obstacle::Box { x, y, w, h, .. } => (x, y, (w * w + h * h).sqrt() * 0.5),
        };
        let mut alone = Arena::empty(arena.width, arena.height);
        alone.obstacles.push(*obstacle);
        let reach = reach + margin + self.side;
        let (low, high) = (
            self.column_row([x - reach, y - reach]),
            self.column_row([x + reach, y + reach]),
        );
        for row in low.1.max(0)..=high.1.min(self.rows - 1) {
            for column in low.0.max(0)..=high.0.min(self.columns - 1) {
                let square = row * self.columns + column;
                let [x, y] = self.centre(square);
                if alone.clearance(x, y) < margin {
                    self.free[square as usize] = false;
                }
            }
        }
    }

    fn centre(&self, square: i32) -> [f32; 2] {
        let (column, row) = (square % self.columns, square / self.columns);
        [
            (column as f32 + 0.5) * self.side - self.half[0],
            (row as f32 + 0.5) * self.side - self.half[1],
        ]
    }

    fn column_row(&self, [x, y]: [f32; 2]) -> (i32, i32) {
        (
            libm::floorf((x + self.half[0]) / self.side) as i32,
            libm::floorf((y + self.half[1]) / self.side) as i32,
        )
    }

    fn square(&self, column: i32, row: i32) -> Option<i32> {
        let inside = (0..self.columns).contains(&column) && (0..self.rows).contains(&row);
        inside.then_some(row * self.columns + column)
    }

    fn is_free_square(&self, column: i32, row: i32) -> bool {
        self.square(column, row)
            .is_some_and(|square| self.free[square as usize])
    }

    /// Whether the body fits at a place, to within a square.
    #[must_use]
    pub fn is_free(&self, place: [f32; 2]) -> bool {
        let (column, row) = self.column_row(place);
        self.is_free_square(column, row)
    }

    /// The middles of all free squares, row by row.
    pub fn free_places(&self) -> impl Iterator<Item = [f32; 2]> {
        let free = (0..).zip(&self.free).filter(|(_, free)| **free);
        free.map(|(square, _)| self.centre(square))
    }

    /// How much of the floor is free, square metres.
    pub(crate) fn free_area(&self) -> f32 {
        let free = self.free.iter().filter(|&&free| free).count();
        free as f32 * self.side * self.side
    }

    /// The share of the free floor that is within `reach` of one of `places`; `None` where nothing
    /// is free. `seen` is memory to work in.
    pub(crate) fn share_near(
        &self,
        places: &[[f32; 2]],
        reach: f32,
        seen: &mut Vec<bool>,
    ) -> Option<f64> {
        seen.clear();
        seen.resize(self.free.len(), false);
        for &place in places {
            let [x, y] = place;
            let low = self.column_row([x - reach, y - reach]);
            let high = self.column_row([x + reach, y + reach]);
            for row in low.1.max(0)..=high.1.min(self.rows - 1) {
                for column in low.0.max(0)..=high.0.min(self.columns - 1) {
                    let square = row * self.columns + column;
                    if apart(self.centre(square), place) <= reach {
                        seen[square as usize] = true;
                    }
                }
            }
        }
        let (mut free, mut near) = (0_u32, 0_u32);
        for (&is_free, &is_near) in self.free.iter().zip(seen.iter()) {
            free += u32::from(is_free);
            near += u32::from(is_free && is_near);
        }
        (free > 0).then(|| f64::from(near) / f64::from(free))
    }

    /// The mean square of the distance from the free floor to the nearest of `places`, as the crow flies, in square
    /// metres; `None` where there is no floor or no place.
    ///
    /// Of four by four squares one is looked at: that is as good a mean, and robots are many.
    pub(crate) fn mean_square(&self, places: &[[f32; 2]]) -> Option<f64> {
        const EACH: usize = 4;
        let (mut sum, mut count) = (0.0, 0_u32);
        for row in (2..self.rows).step_by(EACH) {
            for column in (2..self.columns).step_by(EACH) {
                let square = row * self.columns + column;
                if !self.free[square as usize] {
                    continue;
                }
                let [x, y] = self.centre(square);
                let away = places.iter().map(|at| {
                    let (dx, dy) = (at[0] - x, at[1] - y);
                    dx * dx + dy * dy
                });
                sum += f64::from(away.fold(f32::INFINITY, f32::min));
                count += 1;
            }
        }
        (count > 0 && !places.is_empty()).then(|| sum / f64::from(count))
    }

    /// The free place nearest to `place`; `None` when there is none near.
    #[must_use]
    pub fn nearest_free(&self, place: [f32; 2]) -> Option<[f32; 2]> {
        if self.is_free(place) {
            return Some(place);
        }
        self.nearest_square(place).map(|square| self.centre(square))
    }

    fn nearest_square(&self, place: [f32; 2]) -> Option<i32> {
        let (column, row) = self.column_row(place);
        let mut best: Option<(f32, i32)> = None;
        for down in -NEAR_SQUARES..=NEAR_SQUARES {
            for across in -NEAR_SQUARES..=NEAR_SQUARES {
                if !self.is_free_square(column + across, row + down) {
                    continue;
                }
                let Some(square) = self.square(column + across, row + down) else {
                    continue;
                };
                let away = apart(self.centre(square), place);
                if best.is_none_or(|(least, _)| away < least) {
                    best = Some((away, square));
                }
            }
        }
        best.map(|(_, square)| square)
    }

    /// Whether every free square can be reached from every other one.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        let Some(first) = self.free.iter().position(|&free| free) else {
            return false;
        };
        let mut seen = vec![false; self.free.len()];
        let mut open = vec![first as i32];
        seen[first] = true;
        let mut reached = 0;
        while let Some(square) = open.pop() {
            reached += 1;
            let (column, row) = (square % self.columns, square / self.columns);
            for (across, down) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                if let Some(next) = self.square(column + across, row + down)
                    && self.free[next as usize]
                    && !seen[next as usize]
                {
                    seen[next as usize] = true;
                    open.push(next);
                }
            }
        }
        reached == self.free.iter().filter(|&&free| free).count()
    }

    /// Length of the shortest way between two places, metres; `None` when there is none.
    ///
    /// Found on the squares with eight neighbours (Dijkstra 1959), then pulled straight where the
    /// straight line is free. It can be longer than the true one by a few hundredths.
    #[must_use]
    pub fn way(&self, from: [f32; 2], to: [f32; 2]) -> Option<f32> {
        if self.sees(from, to) {
            return Some(apart(from, to));
        }
        let (start, end) = (self.nearest_square(from)?, self.nearest_square(to)?);
        let squares = self.path(start, end)?;
        let mut places: Vec<[f32; 2]> = squares.iter().map(|&square| self.centre(square)).collect();
        if let Some(first) = places.first_mut() {
            *first = from;
        }
        if let Some(last) = places.last_mut() {
            *last = to;
        }
        Some(self.pulled(&places))
    }

    fn path(&self, start: i32, end: i32) -> Option<Vec<i32>> {
        // In thousandths of a square, so that no rounding depends on the order of additions.
        const STEPS: [(i32, i32, u32); 8] = [
            (1, 0, 1_000),
            (-1, 0, 1_000),
            (0, 1, 1_000),
            (0, -1, 1_000),
            (1, 1, 1_414),
            (1, -1, 1_414),
            (-1, 1, 1_414),
            (-1, -1, 1_414),
        ];
        let mut cost = vec![u32::MAX; self.free.len()];
        let mut from = vec![-1; self.free.len()];
        let mut open = BinaryHeap::new();
        cost[start as usize] = 0;
        open.push(Reverse((0, start)));
        while let Some(Reverse((so_far, square))) = open.pop() {
            if square == end {
                break;
            }
            if so_far > cost[square as usize] {
                continue;
            }
            let (column, row) = (square % self.columns, square / self.columns);
            for (across, down, length) in STEPS {
                let diagonal = across != 0 && down != 0;
                let cuts_corner = diagonal
                    && !(self.is_free_square(column + across, row)
                        && self.is_free_square(column, row + down));
                let Some(next) = self.square(column + across, row + down) else {
                    continue;
                };
                let longer = so_far + length;
                if self.free[next as usize] && !cuts_corner && longer < cost[next as usize] {
                    cost[next as usize] = longer;
                    from[next as usize] = square;
                    open.push(Reverse((longer, next)));
                }
            }
        }
        if cost[end as usize] == u32::MAX {
            return None;
        }
        let mut squares = vec![end];
        let mut square = end;
        while square != start {
            square = from[square as usize];
            squares.push(square);
        }
        squares.reverse();
        Some(squares)
    }

    /// Length of a way after cutting off every bend that can be.
    fn pulled(&self, places: &[[f32; 2]]) -> f32 {
        let mut length = 0.0;
        let mut here = 0;
        while here + 1 < places.len() {
            let mut next = here + 1;
            // The last place in sight, found by doubling and halving.
            let (mut step, mut reach) = (1, here + 1);
            while reach < places.len() && self.sees(places[here], places[reach]) {
                next = reach;
                step *= 2;
                reach = here + step;
            }
            let mut beyond = reach.min(places.len());
            while next + 1 < beyond {
                let middle = usize::midpoint(next, beyond);
                if self.sees(places[here], places[middle]) {
                    next = middle;
                } else {
                    beyond = middle;
                }
            }
            length += apart(places[here], places[next]);
            here = next;
        }
        length
    }

    /// Whether the straight line between two places is free.
    fn sees(&self, from: [f32; 2], to: [f32; 2]) -> bool {
        let steps = libm::ceilf(apart(from, to) / (self.side * 0.5)).max(1.0);
        (0..=steps as u32).all(|step| {
            let share = step as f32 / steps;
            self.is_free([
                from[0] + (to[0] - from[0]) * share,
                from[1] + (to[1] - from[1]) * share,
            ])
        })
    }
}

/// Distance of two places, metres.
pub(crate) fn apart(a: [f32; 2], b: [f32; 2]) -> f32 {
    let (x, y) = (a[0] - b[0], a[1] - b[1]);
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(x: f32, y: f32, w: f32, h: f32) -> Obstacle {
        let theta = 0.0;
        Obstacle::Box { x, y, w, h, theta }
    }

    #[test]
    fn a_straight_way_is_as_long_as_it_looks() {
        let map = Passable::new(&Arena::empty(4.0, 4.0), 0.1);
        assert_eq!(map.way([-1.0, 0.0], [1.0, 0.0]), Some(2.0));
        assert!(map.is_connected());
        assert!(!map.is_free([1.95, 0.0]));
        assert_eq!(map.nearest_free([0.0, 0.0]), Some([0.0, 0.0]));
    }

    #[test]
    fn a_way_round_a_wall_touches_its_end() {
        let mut arena = Arena::empty(4.0, 4.0);
        // From the lower wall to y = 1.
        arena.obstacles.push(wall(0.0, -0.5, 0.02, 3.0));
        let map = Passable::new(&arena, 0.1);
        assert!(map.is_connected());
        let way = map.way([-1.0, 0.0], [1.0, 0.0]).unwrap();
        // Two tangents of √(2 − 0.01) to a circle of 0.1 about the end, and 98° of it: 2.992.
        assert!((2.992..3.1).contains(&way), "{way}");
    }

    #[test]
    fn what_is_walled_off_has_no_way() {
        let mut arena = Arena::empty(4.0, 4.0);
        arena.obstacles.push(wall(0.0, 0.0, 0.02, 4.0));
        let map = Passable::new(&arena, 0.1);
        assert!(!map.is_connected());
        assert_eq!(map.way([-1.0, 0.0], [1.0, 0.0]), None);
        // A gap of 0.24 m lets a body of 0.2 m through, and one of 0.3 m not.
        arena.obstacles[0] = wall(0.0, -0.12, 0.02, 3.76);
        assert!(Passable::new(&arena, 0.1).is_connected());
        assert!(!Passable::new(&arena, 0.15).is_connected());
    }

    #[test]
    fn a_place_within_an_obstacle_counts_as_one_beside_it() {
        let mut arena = Arena::empty(4.0, 4.0);
        arena.obstacles.push(wall(0.0, 0.0, 0.2, 0.2));
        let map = Passable::new(&arena, 0.1);
        let near = map.nearest_free([0.0, 0.05]).unwrap();
        assert!(map.is_free(near) && apart(near, [0.0, 0.0]) < 0.3);
        let mut full = Arena::empty(4.0, 4.0);
        full.obstacles.push(wall(0.0, 0.0, 4.0, 4.0));
        assert_eq!(Passable::new(&full, 0.1).nearest_free([0.0, 0.0]), None);
        assert!(!Passable::new(&full, 0.1).is_connected());
    }
}
