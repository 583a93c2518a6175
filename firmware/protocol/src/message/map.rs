//! The map of a robot and the way over it, some rows at a time.

mod cells;

use heapless::Vec;
use serde::de::{Deserialize, Deserializer, Error, Unexpected};
use serde::{Deserialize as DeriveDeserialize, Serialize};

use super::wire;
use crate::RobotId;

/// Most bytes of cells in one segment: sixteen rows of the widest map.
pub const MAX_MAP_BYTES: usize = 384;
/// Most columns of a map, and most rows.
pub const MAX_MAP_EDGE: u8 = 96;
/// Most points of a way. As many of any map fit a message.
pub const MAX_WAY: usize = 16;
/// The number of columns is a multiple of this, so that a row is whole bytes in both of its halves, and whole
/// groups of base64.
const COLUMNS_STEP: u8 = 24;

/// What is known of one cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapCell {
    /// Nothing was ever noticed here: free as far as the robot knows, or never looked at.
    Unmarked,
    /// Something was noticed here, and the ranger has looked through it since.
    Cleared,
    /// Something is here.
    Blocked,
    /// Something is here, and stays on the map whatever the ranger sees past it.
    Fixed,
}

/// Some rows of the map of a robot, the lowest first; the first of them also have the plan.
///
/// A map is told in as many segments as its rows need, in the order of their rows. Each says where it lies by itself,
/// since the map moves along with the robot. Where a segment begins again with row 0, the map has moved meanwhile,
/// and what came before is void.
#[derive(Debug, Clone, PartialEq, Serialize, DeriveDeserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct MapSegment {
    /// The robot.
    pub robot: RobotId,
    /// The number of the command that asked for the map.
    pub seq: u64,
    /// When these rows were copied from the map, in Unix milliseconds; 0 while the clock is not synchronised.
    pub timestamp: u64,
    /// Edge of a cell in millimetres.
    #[serde(deserialize_with = "positive")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub cell_mm: u16,
    /// Column and row of the lowest left cell of the map, counted from the origin of coordinates.
    pub origin: [i32; 2],
    /// Columns of the map: 24, 48, 72 or 96.
    #[serde(deserialize_with = "columns")]
    #[cfg_attr(feature = "schema", schemars(range(min = 24, max = 96)))]
    pub columns: u8,
    /// Rows of the map.
    #[serde(deserialize_with = "rows")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 96)))]
    pub rows: u8,
    /// The first row of this segment, counted from the lowest one of the map.
    pub row: u8,
    /// The rows of this segment in base64, without padding: of each row a bit for each cell, whether something is
    /// there, and then once more a bit for each cell, which tells the levels of both apart. The leftmost cell is the
    /// lowest bit of the first byte.
    #[serde(with = "cells")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::string::String", length(min = 4, max = 512))
    )]
    pub cells: Vec<u8, MAX_MAP_BYTES>,
    /// Where the robot is to go, in metres; `null` while it is to go nowhere, and in segments beyond the first.
    #[serde(with = "point")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<[f32; 2]>"))]
    pub goal: Option<[f32; 2]>,
    /// The point that it drives straight to now, in metres; `null` without a plan, and in segments beyond the first.
    #[serde(with = "point")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<[f32; 2]>"))]
    pub next: Option<[f32; 2]>,
    /// The way ahead as planned: columns and rows of cells of the map, from the robot on. It may end before the goal.
    /// Empty in segments beyond the first.
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::vec::Vec<[u8; 2]>", length(max = 16))
    )]
    pub way: Vec<[u8; 2], MAX_WAY>,
}
wire!(MapSegment);

impl MapSegment {
    /// Bytes of a row.
    #[must_use]
    pub const fn row_bytes(columns: u8) -> usize {
        columns as usize / 4
    }

    /// How many rows of the map are in this segment.
    #[must_use]
    pub fn row_count(&self) -> usize {
        self.cells.len() / Self::row_bytes(self.columns).max(1)
    }

    /// Whether this is the last segment of the map.
    #[must_use]
    pub fn is_last(&self) -> bool {
        usize::from(self.row) + self.row_count() == usize::from(self.rows)
    }

    /// Whether the parts fit each other: whole rows, at least one, none beyond the last, and a way on the map. What
    /// was read need not.
    #[must_use]
    pub fn is_consistent(&self) -> bool {
        let row = Self::row_bytes(self.columns);
        let whole = row > 0 && !self.cells.is_empty() && self.cells.len().is_multiple_of(row);
        let within = |[column, row]: &[u8; 2]| *column < self.columns && *row < self.rows;
        whole
            && usize::from(self.row) + self.row_count() <= usize::from(self.rows)
            && self.way.iter().all(within)
    }

    /// What is known of the cell in this column, `row` rows above the first of this segment; `None` outside of it.
    #[must_use]
    pub fn cell(&self, column: u8, row: usize) -> Option<MapCell> {
        if column >= self.columns {
            return None;
        }
        let half = Self::row_bytes(self.columns) / 2;
        let at = row * 2 * half + usize::from(column) / 8;
        let bit = |at: usize| Some(self.cells.get(at)? >> (column % 8) & 1 != 0);
        Some(match (bit(at)?, bit(at + half)?) {
            (false, false) => MapCell::Unmarked,
            (false, true) => MapCell::Cleared,
            (true, false) => MapCell::Blocked,
            (true, true) => MapCell::Fixed,
        })
    }
}

fn positive<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u16, D::Error> {
    let value = u16::deserialize(deserializer)?;
    if value > 0 {
        Ok(value)
    } else {
        Err(D::Error::invalid_value(
            Unexpected::Unsigned(0),
            &"1 or more",
        ))
    }
}

fn columns<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u8, D::Error> {
    let value = rows(deserializer)?;
    if value.is_multiple_of(COLUMNS_STEP) {
        Ok(value)
    } else {
        let number = Unexpected::Unsigned(value.into());
        Err(D::Error::invalid_value(number, &"24, 48, 72 or 96"))
    }
}

fn rows<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u8, D::Error> {
    let value = u8::deserialize(deserializer)?;
    if (1..=MAX_MAP_EDGE).contains(&value) {
        Ok(value)
    } else {
        let number = Unexpected::Unsigned(value.into());
        Err(D::Error::invalid_value(number, &"1 to 96"))
    }
}

/// A point that may be missing. What is not finite leaves as no point, and does not enter.
mod point {
    use serde::de::{Deserialize, Deserializer, Error, Unexpected};
    use serde::{Serialize, Serializer};

    // The signature is that of `serde(with)`.
    #[allow(clippy::ref_option, clippy::trivially_copy_pass_by_ref)]
    pub(super) fn serialize<S: Serializer>(
        point: &Option<[f32; 2]>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        let is_finite = |point: &[f32; 2]| point.iter().all(|along| along.is_finite());
        point.filter(is_finite).serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<[f32; 2]>, D::Error> {
        let point = Option::<[f32; 2]>::deserialize(deserializer)?;
        match point.into_iter().flatten().find(|along| !along.is_finite()) {
            Some(along) => {
                let number = Unexpected::Float(along.into());
                Err(D::Error::invalid_value(number, &"finite numbers or null"))
            }
            None => Ok(point),
        }
    }
}
