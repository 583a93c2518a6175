//! What happened, as far back as it is recorded.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use crawler_protocol::RobotId;
use crawler_records::{EventCursor, EventLevel, EventQuery, MAX_EVENTS_PAGE, StoredEvent};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::problem::Problem;

/// Events of a page.
const PAGE: u32 = 200;

/// How much an event matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = EventLevel)]
pub(super) enum LevelView {
    /// As expected.
    Info,
    /// Worth a look.
    Warn,
    /// Needs somebody.
    Error,
}

impl From<EventLevel> for LevelView {
    fn from(level: EventLevel) -> Self {
        match level {
            EventLevel::Info => Self::Info,
            EventLevel::Warn => Self::Warn,
            EventLevel::Error => Self::Error,
        }
    }
}

impl From<LevelView> for EventLevel {
    fn from(level: LevelView) -> Self {
        match level {
            LevelView::Info => Self::Info,
            LevelView::Warn => Self::Warn,
            LevelView::Error => Self::Error,
        }
    }
}

/// Which events are wanted.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct EventsQuery {
    /// Unix milliseconds of the earliest; all that are recorded when not given.
    from: Option<i64>,
    /// Only those before this time, in Unix milliseconds.
    to: Option<i64>,
    /// Only those that matter at least so much.
    level: Option<LevelView>,
    /// Only those about this robot.
    #[param(pattern = "^[a-z0-9-]{1,32}$")]
    robot: Option<String>,
    /// At most so many, up to 1,000; 200 when not given.
    #[param(minimum = 1, maximum = 1_000)]
    limit: Option<u32>,
    /// Only those before this place: `next` of the page before.
    #[param(pattern = "^[0-9]{1,18}-[0-9]{1,18}$")]
    before: Option<String>,
}

/// Something that happened.
#[derive(Serialize, ToSchema)]
#[schema(as = Event)]
pub(super) struct EventView {
    /// Its number.
    id: String,
    /// Unix milliseconds.
    time: i64,
    /// How much it matters.
    level: LevelView,
    /// The robot it is about; `null` where it is about none.
    robot: Option<String>,
    /// What, for people.
    text: String,
}

impl From<StoredEvent> for EventView {
    fn from(stored: StoredEvent) -> Self {
        let event = stored.event;
        Self {
            id: stored.id.to_string(),
            time: event.at,
            level: event.level.into(),
            robot: event.robot.map(|robot| robot.as_str().to_owned()),
            text: event.text,
        }
    }
}

/// A page of events.
#[derive(Serialize, ToSchema)]
#[schema(as = Events)]
pub(super) struct EventList {
    /// Newest first.
    events: Vec<EventView>,
    /// `before` of the next page; `null` where there is none.
    next: Option<String>,
}

/// What a query asks for.
fn wanted(query: EventsQuery) -> Result<EventQuery, Problem> {
    let bad = |detail: String| Problem::new(StatusCode::BAD_REQUEST, "bad_query", detail);
    let (from, to) = (query.from.unwrap_or(0), query.to.unwrap_or(i64::MAX));
    if to <= from {
        return Err(bad("`from` must be before `to`".into()));
    }
    let limit = query.limit.unwrap_or(PAGE);
    if !(1..=MAX_EVENTS_PAGE).contains(&limit) {
        return Err(bad(format!(
            "`limit` must be within 1 to {MAX_EVENTS_PAGE}"
        )));
    }
    let robot = query.robot.map(|robot| RobotId::new(&robot)).transpose();
    let before = query.before.map(|text| text.parse::<EventCursor>());
    Ok(EventQuery {
        from,
        to,
        level: query.level.map_or(EventLevel::Info, EventLevel::from),
        robot: robot.map_err(|_| bad("`robot` must be the name of a robot".into()))?,
        before: before
            .transpose()
            .map_err(|_| bad("`before` must be what an earlier page said under `next`".into()))?,
        limit,
    })
}

/// What happened, newest first
///
/// Up to 1,000,000 events are kept, for up to 400 days. One that has just happened is here within a
/// second; the live feed tells it at once.
#[utoipa::path(get, path = "/events", tag = "history",
    params(EventsQuery),
    responses(
        (status = 200, description = "A page of events", body = EventList),
        (status = 400, description = "The query is not valid", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "The records cannot be read for now", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn page(
    State(app): State<Arc<App>>,
    query: Result<Query<EventsQuery>, axum::extract::rejection::QueryRejection>,
) -> Result<Json<EventList>, Problem> {
    let Query(query) = query
        .map_err(|error| Problem::new(StatusCode::BAD_REQUEST, "bad_query", error.body_text()))?;
    let wanted = wanted(query)?;
    let limit = wanted.limit as usize;
    let events = app.records.events(wanted).await;
    let events = events.map_err(|error| Problem::records(&error))?;
    let full = events.len() == limit;
    let next = events.last().filter(|_| full).map(StoredEvent::cursor);
    Ok(Json(EventList {
        events: events.into_iter().map(EventView::from).collect(),
        next: next.map(|cursor| cursor.to_string()),
    }))
}
