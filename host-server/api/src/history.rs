//! What was recorded of all robots: from when to when, and where they were.

use std::collections::BTreeSet;
use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use crawler_history::{Frame, MAX_FRAMES, Track};
use crawler_protocol::{RobotId, RobotState};
use crawler_records::Records;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::sync::Semaphore;
use utoipa::{IntoParams, ToSchema};

use super::problem::{Code, Problem};
use super::query::{ApiQuery, bad_query};
use super::telemetry::{bounds, problem};
use crawler_fleet::SharedFleet;
use crawler_fleet::feed::drawn_kind;
use crawler_history::HistoryStore;
use crawler_system::clock::now_ms;

/// Points of a robot in one answer.
const MOST_POINTS: i64 = 600;
/// Points of a robot when nobody says how far apart they are.
const POINTS: i64 = 300;
/// Shortest step, in milliseconds.
const SHORTEST: i64 = 100;
/// Answers about many robots that are put together at a time, each of up to some 100 MB.
static TOGETHER: Semaphore = Semaphore::const_new(2);

/// From when to when something is recorded.
#[derive(Serialize, ToSchema)]
#[schema(as = HistorySpan)]
pub(super) struct SpanView {
    /// Unix milliseconds of the oldest; `null` where nothing is recorded.
    from: Option<i64>,
    /// Unix milliseconds of the newest; `null` where nothing is recorded.
    to: Option<i64>,
    /// Robots that something was ever recorded of.
    robots: usize,
}

/// From when to when something is recorded
#[utoipa::path(get, path = "/history", tag = "history",
    responses(
        (status = 200, description = "What is recorded at all", body = SpanView),
        (status = 501, description = "The engine that keeps the history cannot be asked here"),
        (status = 503, description = "The history cannot be read for now")))]
pub(super) async fn span(State(history): State<HistoryStore>) -> Result<Json<SpanView>, Problem> {
    let recorded = history.recorded().await;
    let recorded = recorded.map_err(|error| problem(&error))?;
    let robots = history.robots().await.map_err(|error| problem(&error))?;
    Ok(Json(SpanView {
        from: recorded.map(|recorded| recorded.from),
        to: recorded.map(|recorded| recorded.to),
        robots: robots.len(),
    }))
}

/// Which robots and which stretch of time are wanted, and how finely.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct FramesQuery {
    /// Unix milliseconds of its beginning; an hour before the end when not given.
    #[param(minimum = 0)]
    from: Option<i64>,
    /// Unix milliseconds of its end; now when not given.
    #[param(minimum = 1)]
    to: Option<i64>,
    /// Milliseconds from one point to the next, at least 100; a 300th of the whole when not given, or
    /// more where there are many robots.
    #[param(minimum = 100)]
    step: Option<i64>,
    /// Names of robots with commas between them; all when not given.
    #[param(pattern = "^[a-z0-9-]{1,32}(,[a-z0-9-]{1,32})*$")]
    robots: Option<String>,
}

/// Where a robot was over time: columns of equal length, oldest first. A stretch in which nothing was
/// told has no place in them.
#[derive(Serialize, ToSchema)]
#[schema(as = HistoryTrack)]
pub(super) struct TrackView {
    /// The robot.
    robot: String,
    /// What kind of robot; left out for one that the server has not heard of since it started.
    #[serde(skip_serializing_if = "Option::is_none")]
    kind: Option<&'static str>,
    /// Unix milliseconds of the beginning of each stretch.
    at: Vec<i64>,
    /// Metres, the mean.
    x: Vec<f64>,
    /// Metres, the mean.
    y: Vec<f64>,
    /// Radians, the last.
    theta: Vec<f64>,
    /// The last state, by its place in `states`.
    state: Vec<usize>,
    /// Millimetres to what was ahead, the mean; `null` where the ranger saw nothing.
    range_mm: Vec<Option<i64>>,
    /// Percent, the mean.
    battery_percent: Vec<f64>,
}

/// The simulated arena from a time on.
#[derive(Serialize, ToSchema)]
#[schema(as = ArenaChange)]
pub(super) struct ArenaView {
    /// Unix milliseconds.
    at: i64,
    /// The arena, as the live feed tells it; `null` where there was none from then on.
    #[schema(value_type = Option<Object>)]
    arena: Option<Value>,
}

/// Where robots were over time.
#[derive(Serialize, ToSchema)]
#[schema(as = HistoryFrames)]
pub(super) struct FramesView {
    /// Unix milliseconds.
    from: i64,
    /// Unix milliseconds.
    to: i64,
    /// Milliseconds from one point to the next.
    step: i64,
    /// The simulated arena at `from`, as the live feed tells it; `null` where there was none.
    #[schema(value_type = Option<Object>)]
    arena: Option<Value>,
    /// How the arena changed after that, oldest first: of the changes within one step the last.
    arenas: Vec<ArenaView>,
    /// The robots that told something, in the order of their names.
    robots: Vec<TrackView>,
    /// Names of states.
    states: Vec<&'static str>,
}

/// To so many parts of one.
pub(super) fn rounded(value: f32, parts: f64) -> f64 {
    (f64::from(value) * parts).round() / parts
}

/// The place of a state among all, as tracks have it.
pub(super) fn state_place(state: RobotState) -> usize {
    let place = RobotState::ALL.iter().position(|known| *known == state);
    place.unwrap_or_default()
}

fn column<T>(frames: &[Frame], value: impl Fn(&Frame) -> T) -> Vec<T> {
    frames.iter().map(value).collect()
}

impl TrackView {
    fn new(track: &Track, kind: Option<&'static str>) -> Self {
        let frames = &track.frames;
        Self {
            robot: track.robot.as_str().to_owned(),
            kind,
            at: column(frames, |frame| frame.at),
            x: column(frames, |frame| rounded(frame.x, 1_000.0)),
            y: column(frames, |frame| rounded(frame.y, 1_000.0)),
            theta: column(frames, |frame| rounded(frame.theta, 1_000.0)),
            state: column(frames, |frame| state_place(frame.state)),
            range_mm: column(frames, |frame| {
                frame.range_mm.map(|range| range.round() as i64)
            }),
            battery_percent: column(frames, |frame| rounded(frame.battery_percent, 10.0)),
        }
    }
}

/// The robots that are named, with commas between them.
fn named(text: &str) -> Result<BTreeSet<RobotId>, Problem> {
    let names = text.split(',').map(|name| {
        RobotId::new(name)
            .map_err(|_| bad_query("robots", "must be names of robots with commas between them"))
    });
    names.collect()
}

/// The step for so many robots and a stretch of so many milliseconds.
fn step(wanted: Option<i64>, length: i64, robots: usize) -> Result<i64, Problem> {
    let limit = MAX_FRAMES as i64;
    let robots = i64::try_from(robots).unwrap_or(i64::MAX).max(1);
    // How many points of each of them an answer has room for.
    let room = limit / robots;
    let too_much = |detail: String| Problem::new(Code::TooMuch, detail);
    let Some(step) = wanted else {
        if room == 0 {
            return Err(too_much(format!("at most {limit} robots at a time")));
        }
        // Rounded up, so that there are not more.
        let step = (length - 1) / POINTS.min(room) + 1;
        return Ok(step.max(SHORTEST));
    };
    if step < SHORTEST {
        return Err(bad_query("step", format!("must be at least {SHORTEST} ms")));
    }
    let points = length.div_euclid(step);
    if points > MOST_POINTS {
        return Err(too_much(format!(
            "at most {MOST_POINTS} points of a robot: `step` must be a {MOST_POINTS}th of the whole or more"
        )));
    }
    if points > room {
        return Err(too_much(format!(
            "at most {limit} points of all robots together: ask for fewer robots or a longer step"
        )));
    }
    Ok(step)
}

/// An arena as it is stored.
fn arena(text: Option<String>) -> Option<Value> {
    let text = text?;
    let parsed = serde_json::from_str(&text);
    parsed
        .inspect_err(|error| tracing::error!(%error, "a recorded arena cannot be read"))
        .ok()
}

/// Where robots were over time
///
/// At most one point of a robot every `step`: the last heading and state, the mean of all else, as
/// `GET robots/{id}/telemetry` has them. An answer has at most 600 points of a robot, and 600,000 of all
/// of them together.
#[utoipa::path(get, path = "/history/frames", tag = "history",
    params(FramesQuery),
    responses(
        (status = 200, description = "Where they were", body = FramesView),
        (status = 400, description = "The query is not valid, or asks for too much"),
        (status = 501, description = "The engine that keeps the history cannot be asked here"),
        (status = 503, description = "The history cannot be read for now")))]
pub(super) async fn frames(
    State(history): State<HistoryStore>,
    State(records): State<Records>,
    State(fleet): State<Arc<SharedFleet>>,
    ApiQuery(asked): ApiQuery<FramesQuery>,
) -> Result<Json<FramesView>, Problem> {
    let (from, to) = bounds(asked.from, asked.to, now_ms())?;
    let robots = match &asked.robots {
        Some(names) => named(names)?,
        None => history.robots().await.map_err(|error| problem(&error))?,
    };
    let step = step(asked.step, to - from, robots.len())?;
    // Closed never; who waits for too long is told so by the server.
    let _turn = TOGETHER.acquire().await;
    let tracks = history.frames(&robots, from, to, step).await;
    let tracks = tracks.map_err(|error| problem(&error))?;
    let unreadable = |error| Problem::records(&error);
    let begin = records.arenas().at(from).await.map_err(unreadable)?;
    let changes = records.arenas().changes(from, to, step).await;
    let kinds: Vec<_> = {
        let fleet = fleet.lock();
        let status = |track: &Track| fleet.get(&track.robot)?.status.as_ref();
        let kinds = tracks
            .iter()
            .map(|track| Some(drawn_kind(status(track)?.kind).name()));
        kinds.collect()
    };
    Ok(Json(FramesView {
        from,
        to,
        step,
        arena: arena(begin),
        arenas: changes
            .map_err(unreadable)?
            .into_iter()
            .map(|(at, text)| ArenaView {
                at,
                arena: arena(text),
            })
            .collect(),
        robots: tracks
            .iter()
            .zip(kinds)
            .map(|(track, kind)| TrackView::new(track, kind))
            .collect(),
        states: RobotState::ALL.iter().map(|state| state.name()).collect(),
    }))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_step_keeps_to_the_limits() {
        let verdict = |wanted, length, robots| step(wanted, length, robots).ok();
        assert_eq!(verdict(None, 3_600_000, 3), Some(12_000));
        assert_eq!(verdict(None, 3_600_000, 6_000), Some(36_000));
        assert_eq!(verdict(None, 5, 0), Some(100));
        assert_eq!(verdict(Some(99), 1_000, 1), None);
        assert_eq!(verdict(Some(100), 60_000, 1_000), Some(100));
        assert_eq!(verdict(Some(100), 60_100, 1), None);
        assert_eq!(verdict(Some(100), 60_000, 1_001), None);
        let code = |wanted, length, robots| match step(wanted, length, robots) {
            Ok(step) => panic!("{step}"),
            Err(problem) => problem.code(),
        };
        assert_eq!(code(Some(-1), 1_000, 1), Code::BadQuery);
        assert_eq!(code(Some(100), 60_100, 1), Code::TooMuch);
        assert_eq!(code(Some(100), 60_000, 1_001), Code::TooMuch);
    }

    proptest! {
        #[test]
        fn no_step_is_too_short(wanted in any::<Option<i64>>(), length in 1..=i64::MAX, robots in 0..20_000_usize) {
            if let Ok(step) = step(wanted, length, robots) {
                prop_assert!(step >= SHORTEST);
                let points = length / step;
                prop_assert!(points <= MOST_POINTS);
                prop_assert!(points * robots as i64 <= MAX_FRAMES as i64);
            }
        }

        #[test]
        fn columns_are_of_equal_length_and_rounded(
            values in prop::collection::vec((-1e6_f32..1e6, -4.0_f32..4.0, prop::option::of(0.0_f32..4_000.0)), 0..20),
        ) {
            let frames: Vec<Frame> = (0..)
                .zip(&values)
                .map(|(at, &(x, theta, range_mm))| Frame {
                    at,
                    x,
                    y: -x,
                    theta,
                    state: RobotState::ALL[at as usize % RobotState::ALL.len()],
                    range_mm,
                    battery_percent: 50.04,
                })
                .collect();
            let robot = RobotId::new("sim-1").expect("a robot id");
            let view = TrackView::new(&Track { robot, frames: frames.clone() }, None);
            for length in [
                view.x.len(), view.y.len(), view.theta.len(), view.state.len(),
                view.range_mm.len(), view.battery_percent.len(),
            ] {
                prop_assert_eq!(length, view.at.len());
            }
            for (place, frame) in frames.iter().enumerate() {
                prop_assert!((view.x[place] - f64::from(frame.x)).abs() <= 0.000_501);
                prop_assert!((view.theta[place] - f64::from(frame.theta)).abs() <= 0.000_501);
                prop_assert_eq!(RobotState::ALL[view.state[place]], frame.state);
                prop_assert_eq!(view.range_mm[place].is_some(), frame.range_mm.is_some());
                prop_assert!((view.battery_percent[place] - 50.0).abs() < 1e-9);
            }
        }
    }
}
