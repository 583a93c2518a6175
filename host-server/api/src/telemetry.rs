//! What a robot has told of itself over time.

use std::time::Duration;

use axum::Json;
use axum::extract::{Path, State};
use crawler_history::{Point, Span};
use crawler_protocol::RobotId;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::problem::{Code, Problem};
use super::query::{ApiQuery, bad_query};
use crawler_history::{EngineFailure, HistoryError, HistoryStore};
use crawler_system::clock::now_ms;

/// When another try may find the engine back.
const RETRY: Duration = Duration::from_secs(5);
/// How far back an answer goes when nobody says.
const HOUR: i64 = 3_600_000;
/// Points of one answer.
const MOST_POINTS: i64 = 2_000;
/// Points of an answer when nobody says how far apart they are.
const POINTS: i64 = 360;

/// Which stretch of time is wanted, and how finely.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct TelemetryQuery {
    /// Unix milliseconds of its beginning; an hour before the end when not given.
    #[param(minimum = 0)]
    from: Option<i64>,
    /// Unix milliseconds of its end; now when not given.
    #[param(minimum = 1)]
    to: Option<i64>,
    /// Milliseconds from one point to the next; a 360th of the whole when not given.
    #[param(minimum = 1)]
    step: Option<i64>,
}

/// A stretch of time: the mean of what was told in it, its extremes, and the last heading and state.
#[derive(Serialize, ToSchema)]
#[schema(as = TelemetryPoint)]
pub(super) struct PointView {
    /// Unix milliseconds of its beginning.
    at: i64,
    /// Messages in it.
    count: u64,
    /// Metres.
    x: f32,
    /// Metres.
    y: f32,
    /// Radians.
    theta: f32,
    /// Millimetres to what is ahead; `null` when the ranger saw nothing.
    range_mm: Option<f32>,
    /// Millivolts.
    battery_mv: f32,
    /// Percent.
    battery_percent: f32,
    /// Strength of the radio link.
    rssi_dbm: Option<f32>,
    /// Duty of the left wheel, −1 to 1.
    left: f32,
    /// Duty of the right wheel, −1 to 1.
    right: f32,
    /// The state, like `MOVING`.
    state: &'static str,
    /// The lowest of what is a mean above: what was near for a moment only is seen here.
    least: ExtremeView,
    /// The highest.
    most: ExtremeView,
}

/// The lowest or the highest of what was told in a stretch of time.
#[derive(Serialize, ToSchema)]
#[schema(as = TelemetryExtreme)]
pub(super) struct ExtremeView {
    /// Millimetres to what is ahead; `null` when the ranger saw nothing.
    range_mm: Option<f32>,
    /// Millivolts.
    battery_mv: f32,
    /// Percent.
    battery_percent: f32,
    /// Strength of the radio link.
    rssi_dbm: Option<f32>,
}

impl ExtremeView {
    fn of(point: &Point, which: fn(Span) -> f32) -> Self {
        Self {
            range_mm: point.range_mm.map(which),
            battery_mv: which(point.battery_mv),
            battery_percent: which(point.battery_percent),
            rssi_dbm: point.rssi.map(which),
        }
    }
}

impl From<Point> for PointView {
    fn from(point: Point) -> Self {
        Self {
            least: ExtremeView::of(&point, |span| span.min),
            most: ExtremeView::of(&point, |span| span.max),
            at: point.at,
            count: point.count,
            x: point.x,
            y: point.y,
            theta: point.theta,
            range_mm: point.range_mm.map(|span| span.mean),
            battery_mv: point.battery_mv.mean,
            battery_percent: point.battery_percent.mean,
            rssi_dbm: point.rssi.map(|span| span.mean),
            left: point.left,
            right: point.right,
            state: point.state.name(),
        }
    }
}

/// What a robot has told over time.
#[derive(Serialize, ToSchema)]
#[schema(as = TelemetryHistory)]
pub(super) struct HistoryView {
    /// The robot.
    robot: String,
    /// Unix milliseconds.
    from: i64,
    /// Unix milliseconds.
    to: i64,
    /// Milliseconds from one point to the next.
    step: i64,
    /// Oldest first. A stretch in which nothing was told has no point.
    points: Vec<PointView>,
}

/// A stretch of time, with what a query leaves out of it.
pub(super) fn bounds(from: Option<i64>, to: Option<i64>, now: i64) -> Result<(i64, i64), Problem> {
    // Whoever asks from this very moment on, or has a clock that is ahead, gets nothing yet.
    let soonest = from.map_or(now, |from| now.max(from.saturating_add(1)));
    let to = to.unwrap_or(soonest);
    let from = from.unwrap_or_else(|| to.saturating_sub(HOUR).max(0));
    if from < 0 || to <= from {
        return Err(bad_query(
            "from",
            "must be before `to`, and neither before 1970",
        ));
    }
    Ok((from, to))
}

/// The query, with what it leaves out: from, to and step.
fn stretch(query: &TelemetryQuery, now: i64) -> Result<(i64, i64, i64), Problem> {
    let (from, to) = bounds(query.from, query.to, now)?;
    let length = to - from;
    let step = query
        .step
        .unwrap_or_else(|| length.div_euclid(POINTS).max(1));
    if step < 1 || length.div_euclid(step) >= MOST_POINTS {
        return Err(bad_query(
            "step",
            format!("must be at least a {MOST_POINTS}th of the whole"),
        ));
    }
    Ok((from, to, step))
}

pub(super) fn problem(error: &HistoryError) -> Problem {
    let failure = match error {
        HistoryError::Local(error) => return Problem::records(error),
        HistoryError::Engine(failure) => failure,
    };
    match failure {
        EngineFailure::Invalid(why) => Problem::new(Code::BadQuery, why),
        EngineFailure::Unreadable => Problem::new(
            Code::HistoryNotReadable,
            "the engine that keeps the history cannot be asked here: use its own tools",
        ),
        failure => {
            // Addresses and the engine's words are for the log.
            if let EngineFailure::Unavailable { reason, advice } = failure {
                tracing::warn!(error = %reason, "the history cannot be read: {advice}");
            }
            Problem::later(
                Code::HistoryUnavailable,
                "the engine that keeps the history cannot be asked for now",
                RETRY,
            )
        }
    }
}

/// What a robot has told over time
///
/// Kept as it came for a day, by the second for a week and by the minute for 400 days. Where a
/// time-series engine keeps the history, it keeps every sample for as long as it is told to.
#[utoipa::path(get, path = "/robots/{id}/telemetry", tag = "robots",
    params(("id" = String, Path, description = "Robot id"), TelemetryQuery),
    responses(
        (status = 200, description = "Its history; empty for a robot that nobody knows",
            body = HistoryView),
        (status = 400, description = "The query is not valid"),
        (status = 404, description = "Not a robot's name"),
        (status = 501, description = "The engine that keeps the history cannot be asked here"),
        (status = 503, description = "The history cannot be read for now")))]
pub(super) async fn history(
    State(history): State<HistoryStore>,
    Path(id): Path<String>,
    ApiQuery(query): ApiQuery<TelemetryQuery>,
) -> Result<Json<HistoryView>, Problem> {
    let robot = RobotId::new(&id).map_err(|_| Problem::unknown_robot(&id))?;
    let (from, to, step) = stretch(&query, now_ms())?;
    let points = history.query(&robot, from, to, step).await;
    let points = points.map_err(|error| problem(&error))?;
    Ok(Json(HistoryView {
        robot: robot.as_str().to_owned(),
        from,
        to,
        step,
        points: points.into_iter().map(PointView::from).collect(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(from: Option<i64>, to: Option<i64>, step: Option<i64>) -> Option<(i64, i64, i64)> {
        stretch(&TelemetryQuery { from, to, step }, 10 * HOUR).ok()
    }

    #[test]
    fn what_is_left_out_is_the_last_hour() {
        assert_eq!(
            verdict(None, None, None),
            Some((9 * HOUR, 10 * HOUR, 10_000))
        );
        assert_eq!(verdict(None, Some(500), None), Some((0, 500, 1)));
        let now = 10 * HOUR;
        assert_eq!(verdict(Some(now), None, None), Some((now, now + 1, 1)));
    }

    #[test]
    fn no_question_is_too_large_to_answer() {
        for (from, to, step) in [
            (Some(-1), None, None),
            (Some(5), Some(5), None),
            (Some(i64::MAX), Some(i64::MIN), None),
            (Some(0), Some(i64::MAX), Some(1)),
            (None, None, Some(0)),
            (None, None, Some(-5)),
            (None, None, Some(i64::MIN)),
            (None, None, Some(1_000)),
        ] {
            assert_eq!(verdict(from, to, step), None, "{from:?} {to:?} {step:?}");
        }
        assert!(verdict(Some(0), Some(i64::MAX), None).is_some());
    }
}
