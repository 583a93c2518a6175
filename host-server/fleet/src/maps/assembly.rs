//! A map from its segments.

use crawler_protocol::{MapCell, MapSegment};

/// A whole map, and the plan over it.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotMap {
    /// When its first rows were copied, by the clock of the robot, in Unix milliseconds.
    pub timestamp: u64,
    /// Edge of a cell in millimetres.
    pub cell_mm: u16,
    /// Column and row of the lowest left cell, counted from the origin of coordinates.
    pub origin: [i32; 2],
    /// What is known of each cell, row by row, the lowest one first.
    pub rows: Vec<Vec<MapCell>>,
    /// Where the robot is to go, in metres.
    pub goal: Option<[f32; 2]>,
    /// The point that it drives straight to, in metres.
    pub next: Option<[f32; 2]>,
    /// The way ahead, as columns and rows.
    pub way: Vec<[u8; 2]>,
}

/// What has come of a map so far.
#[derive(Debug, Default)]
pub(super) struct Assembly(Option<RobotMap>);

impl Assembly {
    /// Adds a consistent segment; the map, when that was its last one. The first one begins anew, and one that does
    /// not follow the one before it is of no use.
    pub(super) fn add(&mut self, segment: &MapSegment) -> Option<RobotMap> {
        if segment.row == 0 {
            self.0 = Some(RobotMap {
                timestamp: segment.timestamp,
                cell_mm: segment.cell_mm,
                origin: segment.origin,
                rows: Vec::with_capacity(segment.rows.into()),
                goal: segment.goal,
                next: segment.next,
                way: segment.way.to_vec(),
            });
        }
        let map = self.0.as_mut()?;
        let columns = map.rows.first().map(Vec::len);
        let follows = usize::from(segment.row) == map.rows.len()
            && (segment.cell_mm, segment.origin) == (map.cell_mm, map.origin)
            && columns.is_none_or(|columns| columns == usize::from(segment.columns));
        if !follows {
            return None;
        }
        for row in 0..segment.row_count() {
            let cells = (0..segment.columns).filter_map(|column| segment.cell(column, row));
            map.rows.push(cells.collect());
        }
        if segment.is_last() {
            self.0.take()
        } else {
            None
        }
    }
}
