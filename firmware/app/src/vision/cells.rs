//! From the cells of a detector to things.

use crawler_micromodel::{Shape, best};
use heapless::Vec;

use super::class::Class;

/// Most cells of a detector's output.
pub const MAX_CELLS: usize = 256;
/// Most things in one frame: as many as a message has places.
pub const MAX_SPOTS: usize = crawler_protocol::MAX_DETECTIONS;
/// A cell shows something when its class leads by so much, in steps of the detector's output.
pub const LEAST_MARGIN: u8 = 16;

/// The middle of one thing in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// What it is.
    pub class: Class,
    /// From the left edge, as a share of the width.
    pub x: f32,
    /// From the top edge, as a share of the height.
    pub y: f32,
    /// The largest lead of its cells.
    pub margin: u8,
}

/// Things in one frame, clearest first.
pub type Spots = Vec<Spot, MAX_SPOTS>;

/// What the cells of `output` show: rows of cells with a logit for nothing and one for each
/// [`Class`].
///
/// Cells of one class that touch, at a side or a corner, are one thing. Its middle is the mean of
/// their middles, by lead and one more: a cell that was just decided counts little. Of more than
/// [`MAX_SPOTS`] things the clearest remain. An output of another shape shows nothing.
pub fn spots(output: &[i8], shape: Shape) -> Spots {
    let (columns, rows) = (usize::from(shape.width), usize::from(shape.height));
    let channels = usize::from(shape.channels);
    let count = columns * rows;
    let mut found = Spots::new();
    if channels != 1 + Class::ALL.len() || count > MAX_CELLS || output.len() != count * channels {
        return found;
    }
    let mut cells = [Cell::default(); MAX_CELLS];
    for (cell, logits) in cells.iter_mut().zip(output.chunks_exact(channels)) {
        let best = best(logits);
        if best.margin >= LEAST_MARGIN {
            cell.class = best
                .index
                .checked_sub(1)
                .and_then(|at| Class::ALL.get(at).copied());
            cell.margin = best.margin;
        }
    }
    let mut patch = Patch {
        cells: &mut cells[..count],
        columns,
        queue: [0; MAX_CELLS],
    };
    for start in 0..count {
        if let Some(spot) = patch.take(start) {
            insert(&mut found, spot);
        }
    }
    found
}

#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    /// What it shows, until it was taken.
    class: Option<Class>,
    margin: u8,
}

struct Patch<'c> {
    cells: &'c mut [Cell],
    columns: usize,
    /// Cells that were taken, in the order in which they were found.
    queue: [u8; MAX_CELLS],
}

impl Patch<'_> {
    /// Takes the thing that the cell `start` belongs to.
    fn take(&mut self, start: usize) -> Option<Spot> {
        let class = self.cells.get_mut(start)?.class.take()?;
        let rows = self.cells.len() / self.columns;
        let (mut done, mut end) = (0, 1);
        self.queue[0] = start as u8;
        // Whole numbers below 2²⁴, so that their sums are exact in f32 as well.
        let (mut weights, mut across, mut down, mut clearest) = (0_u32, 0_u32, 0_u32, 0_u8);
        while done < end {
            let at = usize::from(self.queue[done]);
            done += 1;
            let (row, column) = (at / self.columns, at % self.columns);
            let margin = self.cells[at].margin;
            let weight = u32::from(margin) + 1;
            weights += weight;
            across += weight * column as u32;
            down += weight * row as u32;
            clearest = clearest.max(margin);
            for row in row.saturating_sub(1)..(row + 2).min(rows) {
                for column in column.saturating_sub(1)..(column + 2).min(self.columns) {
                    let next = row * self.columns + column;
                    let cell = &mut self.cells[next];
                    if cell.class == Some(class) {
                        cell.class = None;
                        // Every cell is found once, and there are no more of them than places.
                        self.queue[end] = next as u8;
                        end += 1;
                    }
                }
            }
        }
        let middle = |sum: u32, cells: usize| (sum as f32 / weights as f32 + 0.5) / cells as f32;
        Some(Spot {
            class,
            x: middle(across, self.columns),
            y: middle(down, rows),
            margin: clearest,
        })
    }
}

/// Keeps the clearest, and of equals those found first.
fn insert(spots: &mut Spots, spot: Spot) {
    let place = spots
        .iter()
        .position(|other| other.margin < spot.margin)
        .unwrap_or(spots.len());
    if place < MAX_SPOTS {
        if spots.is_full() {
            spots.pop();
        }
        // There is room: made above.
        let _ = spots.insert(place, spot);
    }
}
