//! A uniform grid over the arena: who is near a place, without asking everyone.

use super::arena::{Arena, Solid};
use super::geometry::Vec2;

/// Preferred side of a cell, in metres.
///
/// About as far as robots look out for each other until the grid is rebuilt.
const CELL_M: f32 = 0.5;

/// Most cells of a grid; a larger arena gets larger cells.
const MAX_CELLS: f32 = 1_000_000.0;

/// The shape of a grid: how places map to cells.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cells {
    origin: Vec2,
    per_metre: f32,
    columns: u32,
    rows: u32,
}

/// A rectangle of cells, ends included.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block {
    pub(crate) columns: (u32, u32),
    pub(crate) rows: (u32, u32),
}

impl Block {
    /// The first and the last cell of each row.
    pub(crate) fn rows_of(self, cells: Cells) -> impl Iterator<Item = (usize, usize)> {
        (self.rows.0..=self.rows.1).map(move |row| {
            (
                cells.index(self.columns.0, row),
                cells.index(self.columns.1, row),
            )
        })
    }
}

impl Cells {
    pub(crate) fn new(arena: &Arena) -> Self {
        let side = CELL_M.max((arena.width * arena.height / MAX_CELLS).sqrt());
        Self {
            origin: Vec2::new(-arena.width * 0.5, -arena.height * 0.5),
            per_metre: 1.0 / side,
            columns: (arena.width / side).ceil().max(1.0) as u32,
            rows: (arena.height / side).ceil().max(1.0) as u32,
        }
    }

    pub(crate) const fn count(&self) -> usize {
        self.columns as usize * self.rows as usize
    }

    fn column(&self, x: f32) -> u32 {
        // A float below zero or not a number becomes 0: the cast saturates.
        (((x - self.origin.x) * self.per_metre) as u32).min(self.columns - 1)
    }

    fn row(&self, y: f32) -> u32 {
        (((y - self.origin.y) * self.per_metre) as u32).min(self.rows - 1)
    }

    pub(crate) const fn index(&self, column: u32, row: u32) -> usize {
        row as usize * self.columns as usize + column as usize
    }

    pub(crate) fn at(&self, point: Vec2) -> usize {
        self.index(self.column(point.x), self.row(point.y))
    }

    /// Whether a robot listed in cell `place`, or nowhere, is found in cell `now`: that of its
    /// place, or one beside it.
    pub(crate) fn finds(&self, place: u32, now: usize) -> bool {
        let now = now as u32;
        let (row, column) = (place / self.columns, place % self.columns);
        place == NOWHERE
            || (place as usize) < self.count()
                && row.abs_diff(now / self.columns) <= 1
                && column.abs_diff(now % self.columns) <= 1
    }

    /// The cells that a rectangle around `centre` touches.
    pub(crate) fn around(&self, centre: Vec2, half: Vec2) -> Block {
        self.block(centre.minus(half), centre.plus(half))
    }

    /// The cells that the rectangle between two corners touches.
    pub(crate) fn block(&self, low: Vec2, high: Vec2) -> Block {
        Block {
            columns: (self.column(low.x), self.column(high.x)),
            rows: (self.row(low.y), self.row(high.y)),
        }
    }
}

/// Items by cell: the items of cell `c` are `items[start[c]..start[c + 1]]`, ascending.
#[derive(Debug, Clone, Default)]
pub(crate) struct Grid {
    start: Vec<u32>,
    items: Vec<u32>,
    /// Cell of each robot at the last rebuild.
    places: Vec<u32>,
}

/// The place of a robot that is not in the world.
const NOWHERE: u32 = u32::MAX;

impl Grid {
    /// Which solids reach, grown by `margin`, into which cell. Built once.
    pub(crate) fn of_solids(cells: &Cells, solids: &[Solid], margin: f32) -> Self {
        let blocks: Vec<Block> = solids
            .iter()
            .map(|solid| {
                let half = solid.half_extents().plus(Vec2::new(margin, margin));
                cells.around(solid.centre(), half)
            })
            .collect();
        let mut start = vec![0_u32; cells.count() + 1];
        let each = |mut visit: Box<dyn FnMut(usize, u32) + '_>| {
            for (item, block) in blocks.iter().enumerate() {
                for row in block.rows.0..=block.rows.1 {
                    for column in block.columns.0..=block.columns.1 {
                        visit(cells.index(column, row), item as u32);
                    }
                }
            }
        };
        each(Box::new(|cell, _| start[cell + 1] += 1));
        for cell in 1..start.len() {
            start[cell] += start[cell - 1];
        }
        let mut items = vec![0; start[cells.count()] as usize];
        let mut next = start.clone();
        each(Box::new(|cell, item| {
            items[next[cell] as usize] = item;
            next[cell] += 1;
        }));
        Self {
            start,
            items,
            places: Vec::new(),
        }
    }

    /// Sorts robots into cells, reusing the memory of the last time.
    ///
    /// `places` yields the cell of each robot, or `None` for one that is not in the world.
    pub(crate) fn rebuild(&mut self, cells: &Cells, places: impl Iterator<Item = Option<usize>>) {
        self.places.clear();
        self.places
            .extend(places.map(|cell| cell.map_or(NOWHERE, |cell| cell as u32)));
        self.start.clear();
        self.start.resize(cells.count() + 1, 0);
        let mut total = 0;
        for &cell in self.places.iter().filter(|&&cell| cell != NOWHERE) {
            self.start[cell as usize] += 1;
            total += 1;
        }
        // Turn counts into ends, then fill each cell from its end: going backwards over the
        // robots leaves them ascending, and `start` pointing at beginnings.
        let mut end = 0;
        for slot in &mut self.start {
            end += *slot;
            *slot = end;
        }
        self.items.clear();
        self.items.resize(total, 0);
        for (robot, &cell) in self.places.iter().enumerate().rev() {
            if cell != NOWHERE {
                let slot = &mut self.start[cell as usize];
                *slot -= 1;
                self.items[*slot as usize] = robot as u32;
            }
        }
    }

    /// Where each robot was at the last rebuild.
    pub(crate) fn places(&self) -> &[u32] {
        &self.places
    }

    /// Sorts robots into the cells that [`Grid::places`] told.
    pub(crate) fn restore(&mut self, cells: &Cells, places: &[u32]) {
        let places = places.iter();
        self.rebuild(
            cells,
            places.map(|&place| (place != NOWHERE).then_some(place as usize)),
        );
    }

    pub(crate) fn in_cell(&self, cell: usize) -> &[u32] {
        &self.items[self.start[cell] as usize..self.start[cell + 1] as usize]
    }

    /// Where the items of the cells from `first` to `last`, which lie in one row, are kept.
    pub(crate) fn row_range(&self, first: usize, last: usize) -> core::ops::Range<usize> {
        self.start[first] as usize..self.start[last + 1] as usize
    }

    /// The item at a place of [`Grid::row_range`].
    pub(crate) fn item(&self, place: usize) -> u32 {
        self.items[place]
    }

    /// Items in the cells from `first` to `last`, which lie in one row.
    pub(crate) fn in_row(&self, first: usize, last: usize) -> &[u32] {
        &self.items[self.start[first] as usize..self.start[last + 1] as usize]
    }
}
