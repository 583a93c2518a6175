//! Telling robots who is near, cell by cell of the floor: which cells anybody listens to, and what is
//! said about each.
//!
//! The server tells it from telemetry, the server of a simulation in lockstep from where bodies are.

use std::collections::{BTreeMap, BTreeSet};

pub use crawler_app::neighbours::needed_for;
use crawler_app::neighbours::{Cell, cell_at};
use crawler_hal::Duration;
use crawler_protocol::{CellDigest, MAX_NEIGHBOURS, Neighbour};

/// Time between two messages about a cell: at most two a second.
pub const PERIOD: Duration = Duration::from_millis(500);

/// Robots of a cell that fit a message in any case: those of more take turns.
const SURE: usize = 8;

/// A message for each of the `wanted` cells, empty ones too: whoever was there has left. Robots
/// beyond what a message holds are counted and left out; from one period to the next these are others.
#[must_use]
pub fn digests(
    robots: impl IntoIterator<Item = Neighbour>,
    wanted: &BTreeSet<Cell>,
    timestamp: u64,
) -> Vec<CellDigest> {
    let empty = |&(x, y): &Cell| CellDigest {
        x,
        y,
        timestamp,
        count: 0,
        robots: heapless::Vec::new(),
    };
    let mut cells: BTreeMap<Cell, Vec<Neighbour>> =
        wanted.iter().map(|cell| (*cell, Vec::new())).collect();
    for robot in robots {
        let cell = cell_at(robot.x, robot.y).and_then(|cell| cells.get_mut(&cell));
        if let Some(cell) = cell {
            cell.push(robot);
        }
    }
    let turn = timestamp / PERIOD.as_millis();
    let full = |(cell, mut robots): (Cell, Vec<Neighbour>)| {
        if robots.len() > SURE {
            let first = turn.wrapping_mul(SURE as u64) % robots.len() as u64;
            robots.rotate_left(first as usize);
        }
        CellDigest {
            count: u16::try_from(robots.len()).unwrap_or(u16::MAX),
            robots: robots.into_iter().take(MAX_NEIGHBOURS).collect(),
            ..empty(&cell)
        }
    };
    cells.into_iter().map(full).collect()
}

/// The cells that robots at `places`, in metres, listen to when they move by where others are, or
/// are about to.
#[must_use]
pub fn wanted(places: impl IntoIterator<Item = [f32; 2]>) -> BTreeSet<Cell> {
    // Near a border a robot may still listen around the cell it came from.
    let reach = 1.5 * CellDigest::EDGE_M;
    let steps = [-reach, -0.5 * reach, 0.0, 0.5 * reach, reach];
    places
        .into_iter()
        .flat_map(|[x, y]| steps.map(move |dx| (x + dx, y)))
        .flat_map(|(x, y)| steps.map(move |dy| cell_at(x, y + dy)))
        .flatten()
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crawler_app::neighbours::around;
    use crawler_protocol::{MAX_MESSAGE, RobotId};

    fn robot(number: usize, x: f32, y: f32) -> Neighbour {
        Neighbour {
            id: RobotId::new(&format!("r-{number}")).expect("legal"),
            x,
            y,
            theta: 0.0,
            v: 0.0,
            w: 0.0,
            says: None,
        }
    }

    #[test]
    fn cells_tell_their_robots_and_how_many_did_not_fit() {
        let many = (0..20).map(|n| robot(n, 0.1, 0.1));
        let robots = many.chain([robot(99, -0.1, 0.1), robot(98, f32::NAN, 0.0)]);
        let cells = BTreeSet::from([(0, 0), (-1, 0), (5, 5)]);
        let told = digests(robots, &cells, 7);
        assert_eq!(told.len(), 3);
        let of = |cell| told.iter().find(|d| (d.x, d.y) == cell).expect("told");
        assert_eq!(of((0, 0)).count, 20);
        assert_eq!(of((0, 0)).robots.len(), MAX_NEIGHBOURS);
        assert_eq!(of((-1, 0)).robots[0].id.as_str(), "r-99");
        assert_eq!(of((5, 5)).count, 0, "empty, and said so");
        let mut buffer = [0; MAX_MESSAGE];
        for digest in &told {
            assert!(digest.to_json(&mut buffer).is_ok());
        }
    }

    #[test]
    fn robots_of_a_crowded_cell_take_turns() {
        let mut named = BTreeSet::new();
        let cells = BTreeSet::from([(0, 0)]);
        // Three messages, as long as a robot remembers, of which each holds no more than it must.
        for turn in 0..3 {
            let robots = (0..24).map(|n| robot(n, 0.1, 0.1));
            let told = digests(robots, &cells, 500 * (1_000_003 + turn));
            named.extend(
                told[0]
                    .robots
                    .iter()
                    .take(SURE)
                    .map(|robot| robot.id.clone()),
            );
        }
        assert_eq!(named.len(), 24);
    }

    #[test]
    fn whatever_a_robot_listens_to_is_wanted() {
        for place in [[0.1, 0.1], [1.9, -0.1], [-3.0, 2.0]] {
            let wanted = wanted([place]);
            let [x, y] = place;
            for (dx, dy) in [(0.0, 0.0), (0.25, 0.0), (-0.25, 0.25)] {
                let centre = cell_at(x + dx, y + dy).expect("a cell");
                for cell in around(centre) {
                    assert!(wanted.contains(&cell), "{place:?} {cell:?}");
                }
            }
        }
        assert!(wanted([[f32::NAN, 0.0]]).is_empty());
    }
}
