//! What robots know of their surroundings.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use crawler_protocol::{Capability, MapCell, RobotId};
use serde::Serialize;
use utoipa::ToSchema;

use super::problem::{Code, Problem};
use crawler_commands::SendError;
use crawler_fleet::maps::{FRESH, MapError, Maps, RobotMap};
use crawler_fleet::{Presence, SharedFleet};

/// The map of a robot, and its plan.
#[derive(Serialize, ToSchema)]
#[schema(as = RobotMap)]
pub(super) struct MapView {
    /// Unix milliseconds when the robot copied it, by its own clock; 0 when it did not know the time.
    timestamp: u64,
    /// Edge of a cell in metres.
    resolution: f32,
    /// The lowest left corner of the map, in metres.
    origin: [f32; 2],
    /// Cells from left to right.
    columns: usize,
    /// The cells, row by row, the lowest row first, a character for each: `.` nothing was ever noticed, `o` looked
    /// through since something was noticed, `#` something is there.
    #[schema(example = json!(["....", ".o##", "...#"]))]
    rows: Vec<String>,
    /// Where the robot is to go, in metres; `null` while it is to go nowhere.
    goal: Option<[f32; 2]>,
    /// The point that it drives straight to now, in metres; `null` without a plan.
    next: Option<[f32; 2]>,
    /// The way ahead as planned, in metres, from the robot on; it may end before the goal, which is then beyond what
    /// the robot looks ahead.
    way: Vec<[f32; 2]>,
}

impl MapView {
    fn new(map: &RobotMap) -> Self {
        let resolution = f32::from(map.cell_mm) / 1_000.0;
        // In whole millimetres as long as that goes: a way of whole cells has coordinates that look so.
        let metres = |cell: i64, half: i64| {
            let mm = cell * i64::from(map.cell_mm) + half * i64::from(map.cell_mm) / 2;
            (mm as f64 / 1_000.0) as f32
        };
        let middle =
            |axis: usize, cell: u8| metres(i64::from(map.origin[axis]) + i64::from(cell), 1);
        let row = |row: &Vec<MapCell>| row.iter().copied().map(character).collect();
        Self {
            timestamp: map.timestamp,
            resolution,
            origin: map.origin.map(|cell| metres(i64::from(cell), 0)),
            columns: map.rows.first().map_or(0, Vec::len),
            rows: map.rows.iter().map(row).collect(),
            goal: map.goal,
            next: map.next,
            way: map
                .way
                .iter()
                .map(|[column, row]| [middle(0, *column), middle(1, *row)])
                .collect(),
        }
    }
}

const fn character(cell: MapCell) -> char {
    match cell {
        MapCell::Unmarked => '.',
        MapCell::Cleared => 'o',
        MapCell::Blocked | MapCell::Fixed => '#',
    }
}

fn problem(robot: &RobotId, error: MapError) -> Problem {
    let code = match error {
        MapError::None => {
            return Problem::new(
                Code::NoMap,
                format!(
                    "robot `{robot}` has no map: it keeps one while it goes to a place, and for half a minute after"
                ),
            );
        }
        MapError::NoAnswer => Code::NoAnswer,
        MapError::Refused(_) => Code::Refused,
        MapError::Busy => return Problem::later(Code::Busy, error.to_string(), FRESH),
        MapError::NotSent(SendError::NotConnected) => {
            return Problem::new(
                Code::BrokerUnavailable,
                "there is no connection to the broker; the robot was not asked",
            );
        }
        MapError::NotSent(_) => {
            return Problem::new(
                Code::Overloaded,
                "too many messages are waiting to go out; the robot was not asked",
            );
        }
    };
    Problem::new(code, error.to_string())
}

/// The map of a robot, and its plan
///
/// What the robot has noticed around itself, and the way that it has planned over it. The robot is asked for it: that
/// takes half a second, and a map may be a second old by the time of the call, however many ask. A robot
/// keeps a map while it goes to a place (`goto`), and for half a minute after. The server keeps none.
#[utoipa::path(get, path = "/robots/{id}/map", tag = "robots",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 200, description = "The map", body = MapView),
        (status = 404, description = "Nobody knows the robot, or it has no map"),
        (status = 409, description = "It is offline, refuses, or is of a kind that tells no map"),
        (status = 503, description = "Too many robots are asked, or no connection to the broker"),
        (status = 504, description = "It did not tell its map in time")))]
pub(super) async fn one(
    State(fleet): State<Arc<SharedFleet>>,
    State(maps): State<Arc<Maps>>,
    Path(id): Path<String>,
) -> Result<Json<MapView>, Problem> {
    let robot = RobotId::new(&id).map_err(|_| Problem::unknown_robot(&id))?;
    check(&fleet, &robot)?;
    let map = maps.read(&robot).await;
    let map = map.map_err(|error| problem(&robot, error))?;
    Ok(Json(MapView::new(&map)))
}

/// Whether the robot can be asked.
fn check(fleet: &SharedFleet, robot: &RobotId) -> Result<(), Problem> {
    let fleet = fleet.lock();
    let known = fleet
        .get(robot)
        .ok_or_else(|| Problem::unknown_robot(robot.as_str()))?;
    if known.presence == Presence::Offline {
        return Err(Problem::new(
            Code::RobotOffline,
            format!("robot `{robot}` is offline"),
        ));
    }
    let can = Capability::Map.into();
    let status = known.status.as_ref();
    if !status.is_some_and(|status| status.capabilities.contains(&can)) {
        return Err(Problem::new(
            Code::TellsNoMap,
            format!("robot `{robot}` runs a program that tells no map"),
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_become_characters_and_metres() {
        let map = RobotMap {
            timestamp: 7,
            cell_mm: 100,
            origin: [-2, 3],
            rows: vec![
                vec![MapCell::Unmarked, MapCell::Cleared],
                vec![MapCell::Blocked, MapCell::Fixed],
            ],
            goal: Some([1.5, 0.25]),
            next: None,
            way: vec![[1, 0], [1, 1]],
        };
        let view = serde_json::to_value(MapView::new(&map)).expect("JSON");
        let expected = serde_json::json!({
            "timestamp": 7, "resolution": 0.1_f32, "origin": [-0.2_f32, 0.3_f32], "columns": 2,
            "rows": [".o", "##"], "goal": [1.5, 0.25], "next": null,
            "way": [[-0.05_f32, 0.35_f32], [-0.05_f32, 0.45_f32]],
        });
        assert_eq!(view, expected);
    }
}
