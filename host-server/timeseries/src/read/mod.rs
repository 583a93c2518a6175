//! Questions about history, in the languages of the engines.

pub(crate) mod extent;
pub(crate) mod influxql;
pub(crate) mod metricsql;

use crawler_history::{Point, Points, Span, numbered_state};
use crawler_protocol::RobotId;

use crate::address::Dialect;
use crate::client::Client;
use crate::error::EngineError;

pub use influxql::SPARSE_ROWS;

/// Names of the fields, in the order in which they are asked for.
pub(crate) const FIELDS: [&str; 10] = [
    "x",
    "y",
    "theta",
    "left",
    "right",
    "battery_mv",
    "battery_percent",
    "range_mm",
    "rssi_dbm",
    "state",
];

/// How samples of a field become one number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fold {
    Count,
    Mean,
    Min,
    Max,
    Last,
}

/// What a [`Point`] is made of.
pub(crate) const PARTS: [(Fold, &str); 19] = [
    (Fold::Count, "x"),
    (Fold::Mean, "x"),
    (Fold::Mean, "y"),
    (Fold::Mean, "left"),
    (Fold::Mean, "right"),
    (Fold::Last, "theta"),
    (Fold::Last, "state"),
    (Fold::Min, "battery_mv"),
    (Fold::Mean, "battery_mv"),
    (Fold::Max, "battery_mv"),
    (Fold::Min, "battery_percent"),
    (Fold::Mean, "battery_percent"),
    (Fold::Max, "battery_percent"),
    (Fold::Min, "range_mm"),
    (Fold::Mean, "range_mm"),
    (Fold::Max, "range_mm"),
    (Fold::Min, "rssi_dbm"),
    (Fold::Mean, "rssi_dbm"),
    (Fold::Max, "rssi_dbm"),
];

/// The values of [`PARTS`] in a stretch of time.
pub(crate) type Parts = [Option<f64>; PARTS.len()];

/// The point that begins at `at`. `None` where no sample was, or not a whole one.
pub(crate) fn point(at: i64, parts: &Parts) -> Option<Point> {
    let number = |place: usize| parts[place].map(|value| value as f32);
    let span = |place: usize| {
        Some(Span {
            min: number(place)?,
            mean: number(place + 1)?,
            max: number(place + 2)?,
        })
    };
    Some(Point {
        at,
        count: parts[0].filter(|&count| count >= 1.0)? as u64,
        x: number(1)?,
        y: number(2)?,
        left: number(3)?,
        right: number(4)?,
        theta: number(5)?,
        state: numbered_state(parts[6]? as i64),
        battery_mv: span(7)?,
        battery_percent: span(10)?,
        range_mm: span(13),
        rssi: span(16),
    })
}

/// No history is of later, in Unix milliseconds: the year 2255. `InfluxDB` counts nanoseconds in 64 bits.
const LAST: i64 = 9_000_000_000_000;

/// Whose history, and of when: `from` until before `to`, in stretches of `step` milliseconds.
#[derive(Debug, Clone)]
pub(crate) struct Question<'a> {
    pub(crate) fleet: &'a str,
    pub(crate) robot: &'a RobotId,
    pub(crate) from: i64,
    pub(crate) to: i64,
    pub(crate) step: i64,
}

/// Asks the engine in its language.
pub(crate) async fn ask(
    client: &Client,
    dialect: Dialect,
    mut question: Question<'_>,
) -> Result<Vec<Point>, EngineError> {
    let points = Points::new(question.from, question.to, question.step)
        .map_err(|error| EngineError::Invalid(error.to_string()))?;
    (question.from, question.to) = (points.from(), points.to().min(LAST));
    question.step = question.step.min(LAST);
    if question.from >= question.to {
        return Ok(Vec::new());
    }
    match dialect {
        Dialect::InfluxQl => influxql::points(client, &question, points).await,
        Dialect::MetricsQl => metricsql::points(client, &question).await,
    }
}
