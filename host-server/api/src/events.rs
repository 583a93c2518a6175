//! What happened, as far back as it is recorded.

use axum::Json;
use axum::extract::State;
use crawler_protocol::RobotId;
use crawler_records::{EventCursor, EventLevel, EventQuery, MAX_EVENTS_PAGE, Records, StoredEvent};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::problem::Problem;
use super::query::{self, ApiQuery, bad_query};

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
fn wanted(asked: EventsQuery) -> Result<EventQuery, Problem> {
    let (from, to) = (asked.from.unwrap_or(0), asked.to.unwrap_or(i64::MAX));
    if to <= from {
        return Err(bad_query("from", "must be before `to`"));
    }
    let limit = query::page(asked.limit.unwrap_or(PAGE), MAX_EVENTS_PAGE)?;
    let robot = asked.robot.map(|robot| RobotId::new(&robot)).transpose();
    let before = asked.before.map(|text| text.parse::<EventCursor>());
    Ok(EventQuery {
        from,
        to,
        level: asked.level.map_or(EventLevel::Info, EventLevel::from),
        robot: robot.map_err(|_| bad_query("robot", "must be the name of a robot"))?,
        before: before
            .transpose()
            .map_err(|_| bad_query("before", "must be what an earlier page said under `next`"))?,
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
        (status = 400, description = "The query is not valid"),
        (status = 503, description = "The records cannot be read for now")))]
pub(super) async fn page(
    State(records): State<Records>,
    ApiQuery(asked): ApiQuery<EventsQuery>,
) -> Result<Json<EventList>, Problem> {
    let wanted = wanted(asked)?;
    let limit = wanted.limit as usize;
    let events = records.events().page(wanted).await;
    let events = events.map_err(|error| Problem::records(&error))?;
    let full = events.len() == limit;
    let next = events.last().filter(|_| full).map(StoredEvent::cursor);
    Ok(Json(EventList {
        events: events.into_iter().map(EventView::from).collect(),
        next: next.map(|cursor| cursor.to_string()),
    }))
}
