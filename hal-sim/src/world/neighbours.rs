//! Who may come near whom until the grid is rebuilt: most robots have nobody to look out for.

use super::bodies::{Bodies, Presence};
use super::geometry::Vec2;
use super::grid::{Cells, Grid};
use super::members::Members;

/// Robots within reach of each member, in order of their index.
#[derive(Debug, Clone, Default)]
pub(crate) struct Neighbours {
    /// Of each robot, where its list begins and ends in `robots`; empty for those that are not
    /// members.
    lists: Vec<(u32, u32)>,
    robots: Vec<u32>,
}

impl Neighbours {
    /// Lists everybody within `reach` of every member. The grid may be off by `stale`, metres.
    pub(crate) fn rebuild(
        &mut self,
        cells: &Cells,
        grid: &Grid,
        bodies: &Bodies,
        members: Members,
        reach: f32,
        stale: f32,
    ) {
        self.lists.clear();
        self.lists.resize(bodies.len(), (0, 0));
        self.robots.clear();
        let half = Vec2::new(reach + stale, reach + stale);
        let seen = &bodies.published;
        for i in members.iter(bodies.len()) {
            let first = self.robots.len();
            if seen.presence[i] != Presence::Removed {
                let at = seen.at[i];
                let block = cells.around(at, half);
                for row in block.rows.0..=block.rows.1 {
                    let from = cells.index(block.columns.0, row);
                    let to = cells.index(block.columns.1, row);
                    for &j in grid.in_row(from, to) {
                        let apart = seen.at[j as usize].minus(at);
                        if j as usize != i && apart.dot(apart) <= reach * reach {
                            self.robots.push(j);
                        }
                    }
                }
                self.robots[first..].sort_unstable();
            }
            self.lists[i] = (first as u32, self.robots.len() as u32);
        }
    }

    /// Where the neighbours of robot `i` are listed.
    pub(crate) fn of(&self, i: usize) -> core::ops::Range<usize> {
        let (from, to) = self.lists[i];
        from as usize..to as usize
    }

    /// The robot at a place of [`Neighbours::of`].
    pub(crate) fn robot(&self, place: usize) -> usize {
        self.robots[place] as usize
    }
}
