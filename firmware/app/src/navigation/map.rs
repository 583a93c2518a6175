//! What the ranger has shown: a window of cells that moves along, two bits to a cell.
//!
//! | level | meaning | becomes |
//! |---|---|---|
//! | 0 | never seen | 2 at an echo |
//! | 1 | looked through since | 3 at an echo |
//! | 2 | something is here | 1 when the ranger looks through it |
//! | 3 | something is here, whatever the ranger sees past it | |
//!
//! From level 2 on a cell is blocked. The levels of a cell only ever go 0, 2, 1, 3, so that no two sights of one
//! thing, from here and from there, are believed in turn for ever. [`Map::fade`] lowers all of them,
//! and where the robot stands there is nothing. All of it is in whole cells and millimetres.

/// Cells from left to right.
pub const COLUMNS: i32 = 96;
/// Cells from bottom to top.
pub const ROWS: i32 = 80;
/// Edge of a cell, in millimetres.
pub const CELL_MM: i32 = 100;
/// Words of a row.
const WORDS: usize = COLUMNS as usize / 32;
/// From the middle of the robot to its ranger, in millimetres.
const MOUNT_MM: i32 = 60;
/// An echo from farther than this marks nothing: it may come from anywhere on an arc that is wider than a
/// door post is thick.
const MARK_WITHIN: i32 = 900;
/// An echo from nearer than this marks what is straight ahead, whatever else would explain it: the arc is
/// narrower than a cell.
const CERTAIN_WITHIN: i32 = 300;
/// Looking through a cell from nearer than this, measured from the middle of the robot, frees it. Along a wall
/// that is nearly parallel to the beam there is no echo, and beyond this the beam would be behind it.
const FREE_WITHIN: i32 = 900;
/// Nothing is freed so near to an echo.
const SHY_OF_ECHO: i32 = 150;
/// Two echoes that differ by less are of one thing; one that stands alone may be anything.
const AGREE_MM: i32 = 200;
/// Sides of the beam at which an echo may have come back, as 1024ths of its length: 6 and 12 degrees.
const SIDES: [i32; 5] = [0, -107, 107, -218, 218];
/// From nearer than this only the inner three of them count: walls are marked without gaps.
const INNER_WITHIN: i32 = 500;

/// One bit for each cell of a row, the leftmost in the lowest bit of the first word.
pub(super) type Row = [u32; WORDS];
/// One bit for each cell.
pub(super) type Plane = [Row; ROWS as usize];

/// Column and row of a cell of the plane, from its origin.
pub type Cell = [i32; 2];

/// Where the robot is: whole millimetres, and its heading as cosine and sine in 4096ths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Place {
    /// Millimetres along both axes.
    pub at: [i32; 2],
    /// Cosine and sine of the heading, in 4096ths.
    pub heading: [i32; 2],
}

impl Place {
    /// What is so many millimetres ahead of the middle of the robot and to the left of it.
    pub fn point(&self, ahead: i32, left: i32) -> [i32; 2] {
        let [c, s] = self.heading;
        [
            self.at[0] + ((c * ahead - s * left) >> 12),
            self.at[1] + ((s * ahead + c * left) >> 12),
        ]
    }

    /// How far ahead of the robot and to its left `point` is.
    pub fn seen_from(&self, point: [i32; 2]) -> [i32; 2] {
        /// So far that no product overflows.
        const FARTHEST: i32 = 100_000;
        let [c, s] = self.heading;
        let [dx, dy] = [0, 1].map(|axis| {
            point[axis]
                .saturating_sub(self.at[axis])
                .clamp(-FARTHEST, FARTHEST)
        });
        [(c * dx + s * dy) >> 12, (c * dy - s * dx) >> 12]
    }
}

/// One look of the ranger, in millimetres from the ranger.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// An echo from there.
    Echo(i32),
    /// No echo from as far as the ranger reaches.
    Nothing,
}

impl Look {
    fn reach(self) -> i32 {
        match self {
            Self::Echo(mm) => mm.max(1),
            Self::Nothing => i32::MAX / 2,
        }
    }
}

/// The window.
#[derive(Debug, Clone)]
pub struct Map {
    /// The lowest left cell, counted from the origin of coordinates.
    origin: Cell,
    /// The higher bit of the level: whether a cell is blocked.
    high: Plane,
    /// The lower bit.
    low: Plane,
    /// Whether anything was blocked or freed since that was asked last.
    changed: bool,
    /// How far the last look reached, in millimetres; 0 before the first.
    last: i32,
}

impl Map {
    /// A window in which nothing is known. All of it is zeros, so that no board keeps a copy in flash.
    pub const BLANK: Self = Self {
        origin: [0; 2],
        high: [[0; WORDS]; ROWS as usize],
        low: [[0; WORDS]; ROWS as usize],
        changed: false,
        last: 0,
    };

    /// The cell, counted from the lowest left one, that `point` in millimetres lies in; it may be
    /// outside of the window.
    pub fn cell(&self, point: [i32; 2]) -> Cell {
        let [x, y] = point.map(|along| along.div_euclid(CELL_MM));
        [x - self.origin[0], y - self.origin[1]]
    }

    /// The middle of a cell, in millimetres.
    pub fn middle(&self, [column, row]: Cell) -> [i32; 2] {
        [
            (column + self.origin[0]) * CELL_MM + CELL_MM / 2,
            (row + self.origin[1]) * CELL_MM + CELL_MM / 2,
        ]
    }

    /// Bits of the blocked cells of a row; all of them outside.
    pub(super) fn blocked_row(&self, row: i32) -> Row {
        match usize::try_from(row) {
            Ok(row) if row < self.high.len() => self.high[row],
            Ok(_) | Err(_) => [u32::MAX; WORDS],
        }
    }

    /// The higher bits of the levels of a row of the window.
    pub(super) const fn higher_bits(&self, row: usize) -> Row {
        self.high[row]
    }

    /// The lower ones.
    pub(super) const fn lower_bits(&self, row: usize) -> Row {
        self.low[row]
    }

    /// Whether a cell is blocked; all outside of the window are.
    pub fn is_blocked(&self, [column, row]: Cell) -> bool {
        !is_inside([column, row]) || bit(&self.high, [column, row])
    }

    /// What is known of a cell, 0 to 3.
    pub fn level(&self, cell: Cell) -> u8 {
        if is_inside(cell) {
            u8::from(bit(&self.high, cell)) << 1 | u8::from(bit(&self.low, cell))
        } else {
            0
        }
    }

    /// Whether anything was blocked or freed since this was asked last.
    pub fn take_changed(&mut self) -> bool {
        core::mem::take(&mut self.changed)
    }

    /// Has [`Self::take_changed`] say so again.
    pub fn note_changed(&mut self) {
        self.changed = true;
    }

    fn set(&mut self, cell: Cell, level: u8) {
        if !is_inside(cell) {
            return;
        }
        self.changed |= (level >= 2) != bit(&self.high, cell);
        put(&mut self.high, cell, level & 2 != 0);
        put(&mut self.low, cell, level & 1 != 0);
    }

    /// Takes in a look from `here`; one that is of a known robot marks nothing.
    pub fn look(&mut self, here: &Place, look: Look, is_known: bool) {
        let before = core::mem::replace(&mut self.last, look.reach());
        let nearest = before.min(look.reach());
        self.set(self.cell(here.at), 0);
        self.free(here, nearest);
        let Look::Echo(mm) = look else {
            return;
        };
        if is_known || mm > MARK_WITHIN || (mm - before).abs() > AGREE_MM || before == 0 {
            return;
        }
        let far = mm + MOUNT_MM;
        let sides = if mm <= INNER_WITHIN {
            &SIDES[..3]
        } else {
            &SIDES[..]
        };
        let straight = self.cell(here.point(far, 0));
        let explained = [far, far + CELL_MM / 2]
            .into_iter()
            .flat_map(|far| {
                sides
                    .iter()
                    .map(move |side| here.point(far, (far * side) >> 10))
            })
            .map(|point| self.cell(point))
            .any(|cell| is_inside(cell) && bit(&self.high, cell));
        if !explained || mm <= CERTAIN_WITHIN {
            self.hit(straight);
        }
    }

    /// Something is at `point`, in millimetres, although the ranger does not show it.
    pub fn block(&mut self, point: [i32; 2]) {
        self.hit(self.cell(point));
    }

    fn hit(&mut self, cell: Cell) {
        match self.level(cell) {
            0 => self.set(cell, 2),
            1 => self.set(cell, 3),
            _ => {}
        }
    }

    /// Frees what lies on the beam up to `nearest`.
    fn free(&mut self, here: &Place, nearest: i32) {
        let end = (nearest + MOUNT_MM - SHY_OF_ECHO).min(FREE_WITHIN);
        let mut last = [i32::MIN; 2];
        let mut far = MOUNT_MM + CELL_MM / 2;
        while far <= end {
            let cell = self.cell(here.point(far, 0));
            if cell != last {
                last = cell;
                if self.level(cell) == 2 {
                    self.set(cell, 1);
                }
            }
            far += CELL_MM / 2;
        }
    }

    /// Lowers every level by one.
    pub fn fade(&mut self) {
        self.changed = true;
        for (high, low) in self.high.iter_mut().zip(&mut self.low) {
            for (high, low) in high.iter_mut().zip(low) {
                // 3 → 2, 2 → 1, 1 → 0, 0 → 0.
                (*high, *low) = (*high & *low, *high & !*low);
            }
        }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        for plane in [&mut self.high, &mut self.low] {
            plane.fill([0; WORDS]);
        }
        self.changed = true;
    }

    /// Moves what is known by so many millimetres, in whole cells: the coordinates were off.
    pub fn shift(&mut self, by: [i32; 2]) {
        for (origin, by) in self.origin.iter_mut().zip(by) {
            *origin += (by + CELL_MM / 2).div_euclid(CELL_MM);
        }
        self.changed = true;
    }

    /// Moves the window so that its lowest left cell is `origin`, counted from the origin of coordinates.
    /// What is in both windows stays.
    pub fn move_to(&mut self, origin: Cell) {
        let [columns, rows] = [0, 1].map(|axis| origin[axis].saturating_sub(self.origin[axis]));
        if [columns, rows] == [0, 0] {
            return;
        }
        self.origin = origin;
        self.changed = true;
        for plane in [&mut self.high, &mut self.low] {
            scroll(plane, columns, rows);
        }
    }

    /// The lowest left cell, counted from the origin of coordinates.
    pub const fn origin(&self) -> Cell {
        self.origin
    }
}

/// Whether a cell is in the window.
pub(super) fn is_inside([column, row]: Cell) -> bool {
    (0..COLUMNS).contains(&column) && (0..ROWS).contains(&row)
}

/// The bit of a cell in the window.
pub(super) fn bit(plane: &Plane, [column, row]: Cell) -> bool {
    plane[row as usize][column as usize / 32] >> (column % 32) & 1 != 0
}

/// Sets or clears the bit of a cell in the window.
pub(super) fn put(plane: &mut Plane, [column, row]: Cell, on: bool) {
    let word = &mut plane[row as usize][column as usize / 32];
    let bit = 1 << (column % 32);
    if on {
        *word |= bit;
    } else {
        *word &= !bit;
    }
}

/// The row with every bit one column to the right.
pub(super) fn to_right([a, b, c]: Row) -> Row {
    [a << 1, b << 1 | a >> 31, c << 1 | b >> 31]
}

/// The row with every bit one column to the left.
pub(super) fn to_left([a, b, c]: Row) -> Row {
    [a >> 1 | b << 31, b >> 1 | c << 31, c >> 1]
}

/// Cells of both rows.
pub(super) fn either(a: Row, b: Row) -> Row {
    [a[0] | b[0], a[1] | b[1], a[2] | b[2]]
}

/// Moves the window over a plane, `columns` to the right and `rows` up.
fn scroll(plane: &mut Plane, columns: i32, rows: i32) {
    if columns.abs() >= COLUMNS || rows.abs() >= ROWS {
        *plane = [[0; WORDS]; ROWS as usize];
        return;
    }
    let up = rows.unsigned_abs() as usize;
    if rows >= 0 {
        plane.copy_within(up.., 0);
        plane[ROWS as usize - up..].fill([0; WORDS]);
    } else {
        plane.copy_within(..ROWS as usize - up, up);
        plane[..up].fill([0; WORDS]);
    }
    for row in plane {
        for _ in 0..columns.unsigned_abs() {
            *row = if columns > 0 {
                to_left(*row)
            } else {
                to_right(*row)
            };
        }
    }
}
