//! Patches of floor that grip differently.

use super::arena::{Arena, Patch, Solid};
use super::geometry::Vec2;
use super::grid::{Cells, Grid};

/// All patches of an arena, by cell.
#[derive(Debug, Clone, Default)]
pub(crate) struct Patches {
    grounds: Vec<Solid>,
    grips: Vec<f32>,
    grid: Grid,
}

impl Patches {
    pub(crate) fn new(arena: &Arena, cells: &Cells) -> Self {
        if arena.patches.is_empty() {
            return Self::default();
        }
        let ground = |patch: &Patch| Solid::new(&patch.ground());
        let grounds: Vec<Solid> = arena.patches.iter().map(ground).collect();
        Self {
            grid: Grid::of_solids(cells, &grounds, 0.0),
            grips: arena.patches.iter().map(|patch| patch.grip).collect(),
            grounds,
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.grips.is_empty()
    }

    /// Grip at a point, as a share of the usual one.
    pub(crate) fn grip(&self, cells: &Cells, at: Vec2) -> f32 {
        let here = self.grid.in_cell(cells.at(at)).iter().rev();
        here.map(|&patch| patch as usize)
            .find(|&patch| self.grounds[patch].separation(at).0 <= 0.0)
            .map_or(1.0, |patch| self.grips[patch])
    }
}
