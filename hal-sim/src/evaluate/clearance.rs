//! How near robots come to everything.

use crate::scenario::apart;
use crate::world::{Arena, Obstacle};

/// Farther than this is not told apart, metres.
pub(super) const LIMIT_M: f32 = 0.5;
/// Side of a square that knows the obstacles near it, metres.
const SQUARE_M: f32 = 1.0;

/// The walls and obstacles of an arena, by square.
#[derive(Debug)]
pub(super) struct Near {
    half: [f32; 2],
    columns: i32,
    rows: i32,
    squares: Vec<Vec<Obstacle>>,
}

impl Near {
    pub(super) fn new(arena: &Arena) -> Self {
        let count = |length: f32| (libm::ceilf(length / SQUARE_M) as i32).max(1);
        let (columns, rows) = (count(arena.width), count(arena.height));
        let mut near = Self {
            half: [arena.width * 0.5, arena.height * 0.5],
            columns,
            rows,
            squares: vec![Vec::new(); (columns * rows) as usize],
        };
        let objects = arena.objects.iter().map(crate::world::Object::body);
        for obstacle in arena.obstacles.iter().copied().chain(objects) {
            near.add(obstacle);
        }
        near
    }

    fn add(&mut self, obstacle: Obstacle) {
        let (x, y, reach) = match obstacle {
            Obstacle::Circle { x, y, r } => (x, y, r),
            Obstacle::Box { x, y, w, h, .. } => (x, y, (w * w + h * h).sqrt() * 0.5),
        };
        // Robots have a radius, too.
        let reach = reach + LIMIT_M + 0.2;
        let (low, high) = (
            self.place(x - reach, y - reach),
            self.place(x + reach, y + reach),
        );
        for row in low.1..=high.1 {
            for column in low.0..=high.0 {
                self.squares[(row * self.columns + column) as usize].push(obstacle);
            }
        }
    }

    fn place(&self, x: f32, y: f32) -> (i32, i32) {
        let along = |at: f32, half: f32, count: i32| {
            (libm::floorf((at + half) / SQUARE_M) as i32).clamp(0, count - 1)
        };
        (
            along(x, self.half[0], self.columns),
            along(y, self.half[1], self.rows),
        )
    }

    /// Least distance of a point to a wall or an obstacle, [`LIMIT_M`] and a robot's radius at
    /// most.
    fn clearance(&self, x: f32, y: f32) -> f32 {
        let (column, row) = self.place(x, y);
        let mut alone = Arena::empty(self.half[0] * 2.0, self.half[1] * 2.0);
        alone
            .obstacles
            .clone_from(&self.squares[(row * self.columns + column) as usize]);
        alone.clearance(x, y)
    }

    /// Least distance between the rims of robots of this radius and anything else, metres, up to
    /// [`LIMIT_M`].
    pub(super) fn least(&self, places: &[[f32; 2]], movers: &[Obstacle], radius: f32) -> f32 {
        let mut least = LIMIT_M;
        let mut moving = Arena::empty(self.half[0] * 2.0, self.half[1] * 2.0);
        moving.obstacles.extend_from_slice(movers);
        for &[x, y] in places {
            let clearance = self.clearance(x, y).min(moving.clearance(x, y));
            least = least.min(clearance - radius);
        }
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.sort_by(|&a, &b| places[a][0].total_cmp(&places[b][0]));
        for (rank, &a) in order.iter().enumerate() {
            for &b in &order[rank + 1..] {
                if places[b][0] - places[a][0] >= least + 2.0 * radius {
                    break;
                }
                least = least.min(apart(places[a], places[b]) - 2.0 * radius);
            }
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_thing_counts() {
        let mut arena = Arena::empty(6.0, 4.0);
        arena.obstacles.push(Obstacle::Circle {
            x: 1.0,
            y: 0.0,
            r: 0.2,
        });
        let near = Near::new(&arena);
        let least = |places: &[[f32; 2]]| near.least(places, &[], 0.1);
        assert_eq!(least(&[]), LIMIT_M);
        assert_eq!(least(&[[-1.0, 0.0]]), LIMIT_M);
        // 2.0 − 1.7 − 0.1 from the wall.
        assert!((least(&[[-1.0, 1.7]]) - 0.2).abs() < 1e-6);
        // 1.0 − 0.5 − 0.2 − 0.1 from the post.
        assert!((least(&[[-1.0, 0.0], [0.5, 0.0]]) - 0.2).abs() < 1e-6);
        // 0.25 − 2 · 0.1 from each other.
        assert!((least(&[[-1.0, 0.0], [2.0, 1.0], [-1.25, 0.0]]) - 0.05).abs() < 1e-6);
        let mover = Obstacle::Circle {
            x: -1.0,
            y: 0.5,
            r: 0.1,
        };
        // 0.5 − 0.1 − 0.1 from what moves.
        assert!((near.least(&[[-1.0, 0.0]], &[mover], 0.1) - 0.3).abs() < 1e-6);
    }
}
