//! Free places: for robots, and for obstacles among others.

use std::collections::BTreeMap;

use rand_core::Rng;
use rand_pcg::Pcg32;

use crate::world::{Arena, Pose};

/// Draws for one thing before it is given up: a place for it hardly exists then.
pub(super) const TRIES: u32 = 2_000;

/// A stream of poses, see [`Scenario::spawner`](super::Scenario::spawner).
#[derive(Debug, Clone)]
pub struct Spawner {
    pub(super) half_width: f32,
    pub(super) half_height: f32,
    pub(super) rng: Pcg32,
}

impl Spawner {
    /// The first drawn pose that `free` agrees to; `None` when it refuses too many.
    pub fn find(&mut self, mut free: impl FnMut(Pose) -> bool) -> Option<Pose> {
        let mut draw = |half: f32| {
            let unit = (self.rng.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0);
            (2.0 * unit - 1.0) * half
        };
        (0..TRIES).find_map(|_| {
            let pose = Pose::new(
                draw(self.half_width),
                draw(self.half_height),
                draw(core::f32::consts::PI),
            );
            free(pose).then_some(pose)
        })
    }
}

/// Obstacles by square, while an arena is being filled.
pub(super) struct Nearby {
    side: f32,
    squares: BTreeMap<(i32, i32), Vec<u32>>,
    /// Obstacles of the scenario itself, of any size: looked at every time.
    fixed: usize,
}

impl Nearby {
    pub(super) fn new(arena: &Arena, side: f32) -> Self {
        Self {
            side: side.max(0.5),
            squares: BTreeMap::new(),
            fixed: arena.obstacles.len(),
        }
    }

    fn square(&self, x: f32, y: f32) -> (i32, i32) {
        (
            libm::floorf(x / self.side) as i32,
            libm::floorf(y / self.side) as i32,
        )
    }

    pub(super) fn add(&mut self, index: u32, x: f32, y: f32) {
        let square = self.square(x, y);
        self.squares.entry(square).or_default().push(index);
    }

    /// Distance to the nearest wall or obstacle, or something larger than `limit`.
    pub(super) fn clearance(&self, arena: &Arena, x: f32, y: f32, limit: f32) -> f32 {
        // An obstacle's centre is at most one square from any point of it.
        let reach = (limit / self.side) as i32 + 2;
        let (column, row) = self.square(x, y);
        let mut close = Arena::empty(arena.width, arena.height);
        close.obstacles.extend(&arena.obstacles[..self.fixed]);
        for (_, square) in self
            .squares
            .range((column - reach, i32::MIN)..=(column + reach, i32::MAX))
            .filter(|((_, r), _)| (row - reach..=row + reach).contains(r))
        {
            close
                .obstacles
                .extend(square.iter().map(|&index| arena.obstacles[index as usize]));
        }
        close.clearance(x, y)
    }
}
