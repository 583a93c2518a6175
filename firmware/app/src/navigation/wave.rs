//! The way: a wave that spreads from the goal over what is not blocked, and back down from the robot.
//!
//! The wave takes one step over all cells at once, a row of 96 in three words; of its distance each cell
//! keeps the remainder by three, in two bits. That is enough: of two neighbours one is nearer by one, or both
//! are as near. A cell next to a blocked one is passable only near the ends of the way, or when there is
//! no other way ([`Wave::begin`]).

use super::map::{
    COLUMNS, Cell, Map, Plane, ROWS, Row, bit, either, is_inside, put, to_left, to_right,
};

/// Cells round the goal in which the robot may be next to something.
const GOAL_ROOM: i32 = 2;
/// Cells round the robot in which it may be.
const START_ROOM: i32 = 1;
/// Most standing robots that a wave goes round.
pub(super) const OTHERS: usize = 6;
/// Cells to either side of a standing robot that another one does not fit in, by how many rows they are off.
const ELBOW_ROOM: [i32; 3] = [2, 2, 1];
/// Rows of work in one slice.
pub(super) const SLICE: i32 = 32;

/// What a slice came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Spread {
    /// There is more to do.
    Goes,
    /// It has reached the robot.
    There,
    /// There is no way.
    Nowhere,
}

/// Where a wave begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Source {
    /// From one cell of the window.
    Cell(Cell),
    /// From all cells of its border within so many of one that may lie outside.
    Border(Cell, i32),
}

/// The wave.
#[derive(Debug, Clone)]
pub(super) struct Wave {
    /// One more than the remainder of the distance by three, in two bits; 0 where it has not been.
    ones: Plane,
    twos: Plane,
    /// Code of the newest cells.
    code: u8,
    /// Rows of the newest cells.
    rows: [i32; 2],
    /// Rows of the cells after them, as far as is known, and the next row to do.
    grown: [i32; 2],
    next: i32,
    start: Cell,
    /// The middle of the cells that are passable although something is next to them, at the goal.
    goal: Option<Cell>,
    /// How many cells next to blocked ones are passable only there.
    margin: u8,
    /// Cells of robots that stand, to be gone round, and how many of them count.
    others: [[i8; 2]; OTHERS],
    minded: u8,
}

/// No rows.
const NONE: [i32; 2] = [ROWS, -1];

impl Wave {
    /// A wave that has not begun. All of it is zeros, so that no board keeps a copy in flash.
    pub(super) const BLANK: Self = Self {
        ones: [[0; COLUMNS as usize / 32]; ROWS as usize],
        twos: [[0; COLUMNS as usize / 32]; ROWS as usize],
        code: 0,
        rows: [0; 2],
        grown: [0; 2],
        next: 0,
        start: [0; 2],
        goal: None,
        margin: 0,
        others: [[0; 2]; OTHERS],
        minded: 0,
    };

    /// Begins at `source` a wave towards the robot at `start`; it keeps
    /// `margin` cells, at most two, away from what is blocked.
    pub(super) fn begin(&mut self, map: &Map, source: Source, start: Cell, margin: u8) {
        for plane in [&mut self.ones, &mut self.twos] {
            plane.fill([0; COLUMNS as usize / 32]);
        }
        self.code = 1;
        (self.rows, self.grown) = (NONE, NONE);
        self.goal = None;
        self.minded = 0;
        self.start = start;
        self.margin = margin;
        match source {
            Source::Cell(goal) => {
                self.goal = Some(goal);
                self.sow(goal);
            }
            Source::Border(near, within) => {
                for column in 0..COLUMNS {
                    for row in [0, ROWS - 1] {
                        self.sow_border(map, [column, row], near, within);
                    }
                }
                for row in 1..ROWS - 1 {
                    for column in [0, COLUMNS - 1] {
                        self.sow_border(map, [column, row], near, within);
                    }
                }
            }
        }
        self.next = self.rows[0] - 1;
    }

    fn sow_border(&mut self, map: &Map, cell: Cell, near: Cell, within: i32) {
        let far = (cell[0] - near[0]).abs().max((cell[1] - near[1]).abs());
        if far <= within && !map.is_blocked(cell) {
            self.sow(cell);
        }
    }

    fn sow(&mut self, cell: Cell) {
        if is_inside(cell) {
            put(&mut self.ones, cell, true);
            self.rows = [self.rows[0].min(cell[1]), self.rows[1].max(cell[1])];
        }
    }

    /// Goes on by one slice.
    pub(super) fn spread(&mut self, map: &Map) -> Spread {
        for _ in 0..SLICE {
            if self.next > self.rows[1] + 1 || self.next >= ROWS {
                if is_inside(self.start) && self.distance_code(self.start) != 0 {
                    return Spread::There;
                }
                if self.grown == NONE {
                    return Spread::Nowhere;
                }
                self.rows = core::mem::replace(&mut self.grown, NONE);
                self.next = self.rows[0] - 1;
                self.code = after(self.code);
            }
            if self.next >= 0 {
                self.spread_over(map, self.next as usize);
            }
            self.next += 1;
        }
        Spread::Goes
    }

    fn spread_over(&mut self, map: &Map, row: usize) {
        let own = self.newest(row);
        let mut reach = either(own, either(to_left(own), to_right(own)));
        if row > 0 {
            reach = either(reach, self.newest(row - 1));
        }
        if row + 1 < ROWS as usize {
            reach = either(reach, self.newest(row + 1));
        }
        let mut any = 0;
        for (word, reach) in reach.iter_mut().enumerate() {
            *reach &= !(self.ones[row][word] | self.twos[row][word]);
            any |= *reach;
        }
        if any == 0 {
            return;
        }
        let closed = self.closed(map, row as i32, self.margin);
        let code = after(self.code);
        any = 0;
        for word in 0..reach.len() {
            let new = reach[word] & !closed[word];
            any |= new;
            if code & 1 != 0 {
                self.ones[row][word] |= new;
            }
            if code & 2 != 0 {
                self.twos[row][word] |= new;
            }
        }
        if any != 0 {
            let row = row as i32;
            self.grown = [self.grown[0].min(row), self.grown[1].max(row)];
        }
    }

    /// Cells of a row that have the code of the newest.
    fn newest(&self, row: usize) -> Row {
        let (ones, twos) = (self.ones[row], self.twos[row]);
        let of = |one: u32, two: u32| match self.code {
            1 => one & !two,
            2 => two & !one,
            _ => one & two,
        };
        [
            of(ones[0], twos[0]),
            of(ones[1], twos[1]),
            of(ones[2], twos[2]),
        ]
    }

    /// Cells of a row that a wave which keeps `margin` cells away from what is blocked does not pass.
    fn closed(&self, map: &Map, row: i32, margin: u8) -> Row {
        let blocked = map.blocked_row(row);
        let mut closed = blocked;
        let margin = i32::from(margin);
        if margin > 0 {
            // Beyond the border of the window there is nothing to keep away from.
            for next in (row - margin).max(0)..=(row + margin).min(ROWS - 1) {
                closed = either(closed, map.blocked_row(next));
            }
            for _ in 0..margin {
                closed = either(closed, either(to_left(closed), to_right(closed)));
            }
        }
        for [column, other] in self.others() {
            if let Some(room) = ELBOW_ROOM.get(row.abs_diff(other) as usize) {
                for column in (column - room).max(0)..=(column + room).min(COLUMNS - 1) {
                    closed[column as usize / 32] |= 1 << (column % 32);
                }
            }
        }
        if margin > 0 || self.minded > 0 {
            for (middle, room) in self.rooms() {
                if (row - middle[1]).abs() <= room {
                    for column in middle[0] - room..=middle[0] + room {
                        if (0..COLUMNS).contains(&column) {
                            let (word, mask) = (column as usize / 32, 1 << (column % 32));
                            closed[word] = closed[word] & !mask | blocked[word] & mask;
                        }
                    }
                }
            }
        }
        if row == self.start[1] && (0..COLUMNS).contains(&self.start[0]) {
            closed[self.start[0] as usize / 32] &= !(1 << (self.start[0] % 32));
        }
        closed
    }

    fn others(&self) -> impl Iterator<Item = Cell> {
        let minded = self.others.iter().take(usize::from(self.minded));
        minded.map(|cell| cell.map(i32::from))
    }

    /// Has it go round a robot that stands in a cell, until it begins anew.
    pub(super) fn mind(&mut self, cell: Cell) {
        if let Some(other) = self.others.get_mut(usize::from(self.minded))
            && is_inside(cell)
        {
            *other = cell.map(|along| along as i8);
            self.minded += 1;
        }
    }

    /// Where being next to something is no matter: middles, and how far.
    fn rooms(&self) -> impl Iterator<Item = (Cell, i32)> {
        let goal = self.goal.map(|goal| (goal, GOAL_ROOM));
        core::iter::once((self.start, START_ROOM)).chain(goal)
    }

    /// Whether the wave could pass a cell, if it kept `room` cells away from what is blocked.
    pub(super) fn passes(&self, map: &Map, [column, row]: Cell, room: u8) -> bool {
        let is_open = |closed: Row| closed[column as usize / 32] >> (column % 32) & 1 == 0;
        is_inside([column, row]) && is_open(self.closed(map, row, self.margin.max(room)))
    }

    /// The cell that has `room` cells round it, among one and those next to it; that one where none has.
    pub(super) fn roomiest(&self, map: &Map, [column, row]: Cell, room: u8) -> Cell {
        /// Nearest first.
        const NEXT: [Cell; 9] = [
            [0, 0],
            [1, 0],
            [-1, 0],
            [0, 1],
            [0, -1],
            [1, 1],
            [1, -1],
            [-1, 1],
            [-1, -1],
        ];
        NEXT.into_iter()
            .map(|[right, up]| [column + right, row + up])
            .find(|next| self.passes(map, *next, room))
            .unwrap_or([column, row])
    }

    /// The robot is there by now.
    pub(super) fn set_start(&mut self, start: Cell) {
        self.start = start;
    }

    /// The cell that the wave has been in and that is nearest to `cell`, within two cells of it.
    pub(super) fn nearest(&self, cell: Cell) -> Option<Cell> {
        let found = |cell: Cell| is_inside(cell) && self.distance_code(cell) != 0;
        if found(cell) {
            return Some(cell);
        }
        let mut best = None;
        for dy in -2..=2_i32 {
            for dx in -2..=2_i32 {
                let there = [cell[0] + dx, cell[1] + dy];
                let away = dx * dx + dy * dy;
                if found(there) && best.is_none_or(|(least, _)| away < least) {
                    best = Some((away, there));
                }
            }
        }
        best.map(|(_, there)| there)
    }

    fn distance_code(&self, cell: Cell) -> u8 {
        u8::from(bit(&self.ones, cell)) | u8::from(bit(&self.twos, cell)) << 1
    }

    /// The neighbour of a cell that is nearer to the source by one, rather along `towards`.
    pub(super) fn nearer(&self, cell: Cell, towards: [i32; 2]) -> Option<Cell> {
        let code = is_inside(cell).then(|| self.distance_code(cell))?;
        if code == 0 {
            return None;
        }
        let [dx, dy] = [0, 1].map(|axis| towards[axis] - cell[axis]);
        let step = |delta: i32| if delta < 0 { -1 } else { 1 };
        let (along_x, along_y) = ([step(dx), 0], [0, step(dy)]);
        let [first, second] = if dx.abs() >= dy.abs() {
            [along_x, along_y]
        } else {
            [along_y, along_x]
        };
        let back = |[x, y]: [i32; 2]| [-x, -y];
        [first, second, back(second), back(first)]
            .into_iter()
            .map(|[x, y]| [cell[0] + x, cell[1] + y])
            .find(|next| is_inside(*next) && after(self.distance_code(*next)) == code)
    }
}

/// The code of the cells that are farther by one; that of cells without one is none of these.
const fn after(code: u8) -> u8 {
    match code {
        1 => 2,
        2 => 3,
        3 => 1,
        _ => 0,
    }
}
