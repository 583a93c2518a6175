//! Which chunks a robot asks for.

use crate::chunk::Part;

/// Most chunks that are under way to a robot at a time: 16 KiB of payload, behind which a command waits.
pub const WINDOW: u32 = u16::BITS;

/// The chunks that a robot waits for: those of a window of [`WINDOW`] that have not arrived.
///
/// This is what it asks the server for, at first and again after a time-out, and what it counts arrivals
/// against: a chunk that was not asked for, or came before, is not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Want {
    /// The transfer.
    pub tag: u32,
    /// The part.
    pub part: Part,
    /// Index of the first chunk of the window.
    pub first: u32,
    /// Bit *i* stands for chunk `first` + *i*, and is set until that has arrived.
    pub missing: u16,
}

impl Want {
    /// The window that begins at chunk `first`, of a part with `count` chunks: all of it is missing. Past
    /// the last chunk nothing is.
    #[must_use]
    pub const fn window(tag: u32, part: Part, first: u32, count: u32) -> Self {
        let left = count.saturating_sub(first);
        let missing = if left >= WINDOW {
            u16::MAX
        } else {
            (1 << left) - 1
        };
        Self {
            tag,
            part,
            first,
            missing,
        }
    }

    /// How many chunks are missing.
    #[must_use]
    pub const fn outstanding(&self) -> u32 {
        self.missing.count_ones()
    }

    /// The chunks that are missing, in rising order. What does not fit a number is left out: a peer's window
    /// may begin anywhere.
    pub fn indices(&self) -> impl Iterator<Item = u32> + use<> {
        let Self { first, missing, .. } = *self;
        (0..WINDOW)
            .filter(move |bit| missing & (1 << bit) != 0)
            .filter_map(move |bit| first.checked_add(bit))
    }

    /// Notes that a chunk has arrived. `false` when it is not missing: of another transfer or part, outside of
    /// the window, or here already.
    #[must_use]
    pub const fn take(&mut self, tag: u32, part: Part, index: u32) -> bool {
        if self.tag != tag || self.part as u8 != part as u8 {
            return false;
        }
        let bit = match index.checked_sub(self.first) {
            Some(offset) if offset < WINDOW => 1 << offset,
            _ => return false,
        };
        let missing = self.missing & bit != 0;
        self.missing &= !bit;
        missing
    }
}
