//! Which cells around the robot the broker sends, while it moves by where others are.
//!
//! One SUBSCRIBE or UNSUBSCRIBE is under way at a time, and what the broker may still have from an
//! earlier connection of the session is known, so that neither a lost acknowledgement nor a
//! robot on the border of two cells leaves subscriptions behind.

use crawler_hal::Instant;
use heapless::Vec;
use rust_mqtt::types::PacketIdentifier;

use crate::neighbours::{self, CELLS, CLOSE, Cell};

/// A cell that the broker was asked about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Known {
    cell: Cell,
    /// Whether it was last asked for, and the broker said yes.
    confirmed: bool,
}

/// What the session listens to: outlives a connection, as the session does.
#[derive(Debug, Default)]
pub(super) struct Cells {
    known: Vec<Known, CELLS>,
    /// The robot's own, until it is well outside.
    centre: Option<Cell>,
}

/// What is to be asked of the broker next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wish {
    Listen(Cell),
    Leave(Cell),
}

/// What the broker was asked on this connection and has not answered.
#[derive(Debug, Clone, Copy)]
pub(super) struct Asked {
    pub(super) id: PacketIdentifier,
    pub(super) wish: Wish,
    pub(super) at: Instant,
}

impl Cells {
    pub(super) const fn new() -> Self {
        Self {
            known: Vec::new(),
            centre: None,
        }
    }

    /// The session is a new one: the broker knows of no cell.
    pub(super) fn forget(&mut self) {
        self.known.clear();
    }

    /// What to ask for next, so that the broker sends the cells around `place` and no others; of these only those
    /// that are `close`, where nobody else matters.
    pub(super) fn wish(&mut self, place: Option<[f32; 2]>, close: bool) -> Option<Wish> {
        let wanted = if let Some([x, y]) = place {
            self.centre = neighbours::centre(self.centre, x, y);
            let mut wanted = self.centre.map(neighbours::around).unwrap_or_default();
            if close {
                wanted.retain(|cell| {
                    let listens = self.known.iter().any(|known| known.cell == *cell);
                    neighbours::away_from(*cell, [x, y]) <= CLOSE[usize::from(listens)]
                });
            }
            wanted
        } else {
            self.centre = None;
            Vec::new()
        };
        // First leave: there is room for as many as are wanted.
        if let Some(known) = self.known.iter_mut().find(|k| !wanted.contains(&k.cell)) {
            known.confirmed = false;
            return Some(Wish::Leave(known.cell));
        }
        let cell = wanted.into_iter().find(|cell| {
            let mut of = self.known.iter().filter(|known| known.cell == *cell);
            !of.any(|known| known.confirmed)
        })?;
        if !self.known.iter().any(|known| known.cell == cell) {
            let new = Known {
                cell,
                confirmed: false,
            };
            self.known.push(new).ok()?;
        }
        Some(Wish::Listen(cell))
    }

    /// Notes the broker's answer.
    pub(super) fn settle(&mut self, wish: Wish) {
        match wish {
            Wish::Listen(cell) => {
                if let Some(known) = self.known.iter_mut().find(|known| known.cell == cell) {
                    known.confirmed = true;
                }
            }
            Wish::Leave(cell) => self.known.retain(|known| known.cell != cell),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Asks until nothing is left to ask, and counts.
    fn follow(cells: &mut Cells, place: Option<[f32; 2]>) -> std::vec::Vec<Wish> {
        follow_all(cells, place, false)
    }

    fn follow_all(cells: &mut Cells, place: Option<[f32; 2]>, close: bool) -> std::vec::Vec<Wish> {
        let mut asked = std::vec::Vec::new();
        while let Some(wish) = cells.wish(place, close) {
            asked.push(wish);
            cells.settle(wish);
            assert!(asked.len() < 40, "no end: {asked:?}");
        }
        asked
    }

    #[test]
    fn a_robot_listens_around_itself_and_leaves_what_lies_behind() {
        let mut cells = Cells::new();
        let first = follow(&mut cells, Some([0.5, 0.5]));
        assert_eq!(first.len(), CELLS);
        assert_eq!(first[0], Wish::Listen((0, 0)), "its own first");
        assert!(follow(&mut cells, Some([1.9, 1.9])).is_empty());
        // On the border it stays with the cell it was in.
        assert!(follow(&mut cells, Some([2.1, 0.5])).is_empty());
        let next = follow(&mut cells, Some([2.5, 0.5]));
        assert_eq!(next.len(), 6, "{next:?}");
        assert_eq!(next[0], Wish::Leave((-1, 0)), "{next:?}");
        assert_eq!(follow(&mut cells, None).len(), CELLS, "all are left");
        assert!(cells.known.is_empty());
    }

    #[test]
    fn who_only_keeps_off_others_listens_to_cells_that_are_close() {
        let mut cells = Cells::new();
        let mut follow = |x, y| follow_all(&mut cells, Some([x, y]), true);
        assert_eq!(follow(1.0, 1.0), [Wish::Listen((0, 0))]);
        // Towards a border, and then towards a corner.
        assert_eq!(follow(1.5, 1.0), [Wish::Listen((1, 0))]);
        assert_eq!(follow(1.5, 1.5).len(), 2);
        // Back and forth on the threshold nothing is left or joined.
        for x in [1.1, 1.3, 1.1, 1.3] {
            assert!(follow(x, 1.5).is_empty(), "{x}");
        }
        assert_eq!(follow(0.9, 1.5).len(), 2, "both to the right are left");
        assert_eq!(
            follow(2.1, 1.5).len(),
            2,
            "and joined again across the border"
        );
    }

    #[test]
    fn what_was_not_answered_is_asked_again() {
        let mut cells = Cells::new();
        let lost = cells.wish(Some([0.5, 0.5]), false).expect("something");
        assert_eq!(
            cells.wish(Some([0.5, 0.5]), false),
            Some(lost),
            "asked again"
        );
        follow(&mut cells, Some([0.5, 0.5]));
        // An UNSUBSCRIBE whose answer was lost may or may not have come through.
        let Some(Wish::Leave(left)) = cells.wish(None, false) else {
            panic!("something to leave");
        };
        let again = follow(&mut cells, Some([0.5, 0.5]));
        assert_eq!(again, [Wish::Listen(left)]);
        cells.forget();
        assert_eq!(follow(&mut cells, Some([0.5, 0.5])).len(), CELLS);
    }

    #[test]
    fn a_place_without_a_cell_has_none_around_it() {
        let mut cells = Cells::new();
        assert!(follow(&mut cells, Some([f32::NAN, 0.0])).is_empty());
    }
}
