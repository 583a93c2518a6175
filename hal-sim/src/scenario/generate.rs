//! Walls drawn from a seed: rooms with doors, corridors, mazes.

use rand_core::Rng;
use serde::{Deserialize, Serialize};

use crate::world::Obstacle;

/// Most squares between walls along one side of an arena.
const MOST_ALONG: f32 = 64.0;

/// How walls are drawn. Whatever comes out, a robot can get from everywhere to everywhere.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Generate {
    /// What it looks like.
    pub kind: Layout,
    /// Side of a room, or width of a corridor, metres.
    #[serde(default = "two")]
    pub side: f32,
    /// Width of doors and gaps, metres.
    #[serde(default = "door")]
    pub door: f32,
    /// Thickness of walls, metres.
    #[serde(default = "thin")]
    pub wall: f32,
    /// Share of the walls that have a door although no way needs it, 0 to 1.
    #[serde(default = "some")]
    pub loops: f32,
}

const fn two() -> f32 {
    2.0
}

const fn door() -> f32 {
    0.7
}

const fn thin() -> f32 {
    0.06
}

const fn some() -> f32 {
    0.2
}

/// Kinds of drawn arenas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// Rooms in rows and columns, with doors in their walls.
    Rooms,
    /// Corridors side by side, with a gap in each wall between two.
    Corridors,
    /// A maze of corridors.
    Maze,
}

impl Generate {
    /// The first key out of range, and the rule, for a robot of this radius.
    pub(super) fn validate(&self, radius: f32) -> Result<(), (&'static str, String)> {
        // Less, and a robot would only get through by luck.
        let least = 2.0 * radius + 0.1;
        for (key, value, low, high) in [
            ("wall", self.wall, 0.01, 1.0),
            ("door", self.door, least, 50.0),
            ("side", self.side, self.door + 2.0 * self.wall, 100.0),
            ("loops", self.loops, 0.0, 1.0),
        ] {
            if !(low..=high).contains(&value) {
                return Err((key, format!("must be {low} to {high}, not {value}")));
            }
        }
        Ok(())
    }

    /// Draws the walls of an arena of `width` by `height` metres.
    pub(super) fn walls<R: Rng>(&self, width: f32, height: f32, rng: &mut R) -> Vec<Obstacle> {
        let along = |length: f32| libm::floorf(length / self.side).clamp(1.0, MOST_ALONG) as usize;
        let (columns, rows) = match self.kind {
            Layout::Rooms | Layout::Maze => (along(width), along(height)),
            Layout::Corridors => (1, along(height)),
        };
        let plan = Plan {
            columns,
            rows,
            step: [width / columns as f32, height / rows as f32],
            half: [width * 0.5, height * 0.5],
            shape: *self,
        };
        plan.draw(rng)
    }
}

struct Plan {
    columns: usize,
    rows: usize,
    /// Size of a square.
    step: [f32; 2],
    half: [f32; 2],
    shape: Generate,
}

impl Plan {
    fn draw<R: Rng>(&self, rng: &mut R) -> Vec<Obstacle> {
        let needed = self.spanning_tree(rng);
        let mut walls = Vec::new();
        for row in 0..self.rows {
            for column in 0..self.columns {
                let here = row * self.columns + column;
                let neighbours = [
                    (column + 1 < self.columns).then_some((here + 1, true)),
                    (row + 1 < self.rows).then_some((here + self.columns, false)),
                ];
                for (there, upright) in neighbours.into_iter().flatten() {
                    let open = needed.contains(&(here, there)) || unit(rng) < self.shape.loops;
                    self.wall(column, row, upright, open, rng, &mut walls);
                }
            }
        }
        walls
    }

    /// Pairs of neighbouring squares (the lower number first, in order) that connect all squares
    /// without a loop: a depth-first walk in random order.
    fn spanning_tree<R: Rng>(&self, rng: &mut R) -> std::collections::BTreeSet<(usize, usize)> {
        let mut seen = vec![false; self.columns * self.rows];
        let mut stack = vec![0];
        seen[0] = true;
        let mut pairs = std::collections::BTreeSet::new();
        while let Some(&here) = stack.last() {
            let (column, row) = (here % self.columns, here / self.columns);
            let mut open = Vec::with_capacity(4);
            if column > 0 {
                open.push(here - 1);
            }
            if column + 1 < self.columns {
                open.push(here + 1);
            }
            if row > 0 {
                open.push(here - self.columns);
            }
            if row + 1 < self.rows {
                open.push(here + self.columns);
            }
            open.retain(|&next| !seen[next]);
            if open.is_empty() {
                stack.pop();
                continue;
            }
            let next = open[rng.next_u32() as usize % open.len()];
            seen[next] = true;
            pairs.insert((here.min(next), here.max(next)));
            stack.push(next);
        }
        pairs
    }

    /// The wall beyond a square, to its right (`upright`) or above it.
    fn wall<R: Rng>(
        &self,
        column: usize,
        row: usize,
        upright: bool,
        open: bool,
        rng: &mut R,
        walls: &mut Vec<Obstacle>,
    ) {
        let Generate {
            kind, wall, door, ..
        } = self.shape;
        let low = [
            column as f32 * self.step[0] - self.half[0],
            row as f32 * self.step[1] - self.half[1],
        ];
        let length = if upright { self.step[1] } else { self.step[0] };
        // Along the wall, from 0 to `length`, both ends a little longer so that walls meet.
        let mut piece = |from: f32, to: f32| {
            if to - from < 1e-3 {
                return;
            }
            let middle = f32::midpoint(from, to);
            let (x, y, w, h) = if upright {
                (low[0] + self.step[0], low[1] + middle, wall, to - from)
            } else {
                (low[0] + middle, low[1] + self.step[1], to - from, wall)
            };
            let theta = 0.0;
            walls.push(Obstacle::Box { x, y, w, h, theta });
        };
        let (start, end) = (0.0, length);
        if !open {
            piece(start, end);
            return;
        }
        if kind == Layout::Maze {
            return;
        }
        let room = (length - door - 2.0 * wall).max(0.0);
        let gap = wall + room * unit(rng);
        piece(start, gap);
        piece(gap + door, end);
    }
}

fn unit<R: Rng>(rng: &mut R) -> f32 {
    (rng.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
}
