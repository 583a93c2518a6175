//! Copies of map and plan for whoever asks for them: some rows of the map at a time.

use heapless::Vec;

use super::map::{COLUMNS, Cell, ROWS};
use super::{Navigator, Stage};

/// Rows of the map in one excerpt.
pub const EXCERPT_ROWS: usize = 16;
/// Bytes of a row: a bit for each cell, twice.
const ROW_BYTES: usize = COLUMNS as usize / 4;
/// Bytes of the rows of one excerpt.
pub const EXCERPT_BYTES: usize = EXCERPT_ROWS * ROW_BYTES;
/// Most points of the way.
pub const WAY_POINTS: usize = 16;
/// Cells of the way from one point to the next. With [`WAY_POINTS`], as much as a slice of planning takes.
const WAY_STEP: usize = 4;

/// Some rows of the map, and with the lowest of them the plan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Excerpt {
    /// The lowest left cell of the map, counted from the origin of coordinates.
    pub origin: Cell,
    /// The first of these rows, counted from the lowest one.
    pub row: u8,
    /// The rows: of each the higher bits of the levels and then the lower ones, the leftmost cell in the lowest bit
    /// of the first byte.
    pub cells: Vec<u8, EXCERPT_BYTES>,
    /// Where the robot is to go, in millimetres.
    pub goal: Option<[i32; 2]>,
    /// The point to drive straight to, in millimetres.
    pub next: Option<[i32; 2]>,
    /// The way from the robot on, in cells of the map.
    pub way: Vec<[u8; 2], WAY_POINTS>,
}

impl Excerpt {
    /// One that shows nothing.
    pub const BLANK: Self = Self {
        origin: [0; 2],
        row: 0,
        cells: Vec::new(),
        goal: None,
        next: None,
        way: Vec::new(),
    };

    /// The row that follows these; `None` after the last one.
    pub fn row_after(&self) -> Option<u8> {
        let after = usize::from(self.row) + self.cells.len() / ROW_BYTES;
        (after < ROWS as usize).then_some(after as u8)
    }
}

impl Navigator {
    /// Copies the rows from `row` on, and with the lowest ones the plan of a robot that is on its way.
    pub fn excerpt(&self, row: u8, is_going: bool) -> Excerpt {
        let mut excerpt = Excerpt {
            origin: self.map.origin(),
            row,
            ..Excerpt::BLANK
        };
        let first = usize::from(row);
        for row in first..(first + EXCERPT_ROWS).min(ROWS as usize) {
            let levels = [self.map.higher_bits(row), self.map.lower_bits(row)];
            for bits in levels.as_flattened() {
                // As many as there is room for.
                let _ = excerpt.cells.extend_from_slice(&bits.to_le_bytes());
            }
        }
        if row == 0
            && is_going
            && let Some(going) = self.going
        {
            excerpt.goal = Some(going.at);
            if self.stage == Stage::Stands {
                excerpt.next = Some(self.next);
                excerpt.way = self.way_to(self.map.cell(going.at));
            }
        }
        excerpt
    }

    /// Cells of the way from the robot on.
    fn way_to(&self, goal: Cell) -> Vec<[u8; 2], WAY_POINTS> {
        let mut way = Vec::new();
        let Some(mut cell) = self.wave.nearest(self.map.cell(self.here.at)) else {
            return way;
        };
        let mut is_there = false;
        while !is_there {
            for _ in 0..WAY_STEP {
                match self.wave.nearer(cell, goal) {
                    Some(next) => cell = next,
                    None => is_there = true,
                }
            }
            // All cells of the way are in the window.
            if way.push(cell.map(|along| along as u8)).is_err() {
                break;
            }
        }
        way
    }
}
