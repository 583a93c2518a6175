//! What an operator should know of, in words, by time.

use std::fmt;
use std::str::FromStr;

use crawler_protocol::RobotId;
use sqlx::AssertSqlSafe;

use crate::RecordsError;
use crate::query::{Connection, query};
use crate::store::Store;
use crate::text::cut;

/// Most events in one answer.
pub const MAX_EVENTS_PAGE: u32 = 1_000;
/// Most bytes of an event's text; what is longer is cut off.
pub const MAX_EVENT_TEXT: usize = 1_024;
/// Rows in one statement.
const AT_ONCE: usize = 100;

/// How much an event matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum EventLevel {
    /// As expected.
    Info,
    /// Worth a look.
    Warn,
    /// Needs somebody.
    Error,
}

impl EventLevel {
    /// How it is stored.
    const fn number(self) -> i64 {
        match self {
            Self::Info => 0,
            Self::Warn => 1,
            Self::Error => 2,
        }
    }

    /// The level of that number; one that a newer program knows needs somebody.
    const fn numbered(number: i64) -> Self {
        match number {
            0 => Self::Info,
            1 => Self::Warn,
            _ => Self::Error,
        }
    }
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Event {
    /// When.
    pub at: i64,
    /// How much it matters.
    pub level: EventLevel,
    /// The robot it is about, if it is about one.
    pub robot: Option<RobotId>,
    /// What, for people.
    pub text: String,
}

/// An event as it is stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredEvent {
    /// Its number. A later one is higher, where one server writes.
    pub id: i64,
    /// What happened.
    pub event: Event,
}

impl StoredEvent {
    /// What was before this one.
    #[must_use]
    pub const fn cursor(&self) -> EventCursor {
        EventCursor {
            at: self.event.at,
            id: self.id,
        }
    }
}

/// A place among the events, which are in order of time: a page goes on with what is before it. Written
/// as `TIME-NUMBER`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct EventCursor {
    at: i64,
    id: i64,
}

impl fmt::Display for EventCursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.at, self.id)
    }
}

/// The text is no place among the events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoCursor;

impl fmt::Display for NoCursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a cursor is what an earlier answer said under `next`")
    }
}

impl std::error::Error for NoCursor {}

impl FromStr for EventCursor {
    type Err = NoCursor;

    fn from_str(text: &str) -> Result<Self, NoCursor> {
        let number = |text: &str| {
            let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
            digits.then(|| text.parse().ok()).flatten().ok_or(NoCursor)
        };
        let (at, id) = text.split_once('-').ok_or(NoCursor)?;
        Ok(Self {
            at: number(at)?,
            id: number(id)?,
        })
    }
}

/// Which events are wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EventQuery {
    /// The earliest time.
    pub from: i64,
    /// Before this time.
    pub to: i64,
    /// Those that matter at least so much.
    pub level: EventLevel,
    /// Only those about this robot.
    pub robot: Option<RobotId>,
    /// Only those before this place.
    pub before: Option<EventCursor>,
    /// At most so many, up to [`MAX_EVENTS_PAGE`].
    pub limit: u32,
}

/// How much is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EventRetention {
    /// Events; 1,000,000.
    pub events: i64,
    /// Arenas; 2,000.
    pub arenas: i64,
    /// Milliseconds that both are kept at most; 400 days, as the minutes of the history.
    pub ms: i64,
}

impl Default for EventRetention {
    fn default() -> Self {
        Self {
            events: 1_000_000,
            arenas: 2_000,
            ms: crawler_history::Retention::default().minutes_ms,
        }
    }
}

type Row = (i64, i64, i64, Option<String>, String);

fn stored((id, at, level, robot, text): Row) -> StoredEvent {
    StoredEvent {
        id,
        event: Event {
            at,
            level: EventLevel::numbered(level),
            // A name that is none was tampered with: the event is shown all the same.
            robot: robot.and_then(|robot| RobotId::new(&robot).ok()),
            text,
        },
    }
}

async fn insert(connection: &mut Connection<'_>, events: &[Event]) -> Result<(), RecordsError> {
    let places: Vec<String> = (0..events.len())
        .map(|row| {
            let first = row * 4 + 1;
            format!("(${first}, ${}, ${}, ${})", first + 1, first + 2, first + 3)
        })
        .collect();
    let mut insert = query(AssertSqlSafe(format!(
        "INSERT INTO event (at, level, robot, text) VALUES {}",
        places.join(", ")
    )));
    for event in events {
        let robot = event.robot.as_ref().map(ToString::to_string);
        insert = insert
            .bind(event.at.max(0))
            .bind(event.level.number())
            .bind(robot)
            .bind(cut(&event.text, MAX_EVENT_TEXT));
    }
    insert.execute(connection).await?;
    Ok(())
}

async fn page(
    connection: &mut Connection<'_>,
    wanted: EventQuery,
) -> Result<Vec<StoredEvent>, RecordsError> {
    let end = EventCursor {
        at: wanted.to,
        id: i64::MIN,
    };
    let end = wanted.before.map_or(end, |before| before.min(end));
    // Spelled out, so that the index of that level is used.
    let level = match wanted.level {
        EventLevel::Info => "",
        EventLevel::Warn => "AND level >= 1",
        EventLevel::Error => "AND level >= 2",
    };
    let robot = wanted.robot.as_ref().map_or("", |_| "AND robot = $5");
    let mut select = query(AssertSqlSafe(format!(
        "SELECT id, at, level, robot, text FROM event
         WHERE (at, id) < ($1, $2) AND at >= $3 {level} {robot}
         ORDER BY at DESC, id DESC LIMIT $4"
    )))
    .bind(end.at)
    .bind(end.id)
    .bind(wanted.from)
    .bind(i64::from(wanted.limit.min(MAX_EVENTS_PAGE)));
    if let Some(robot) = wanted.robot {
        select = select.bind(robot.to_string());
    }
    let rows: Vec<Row> = select.fetch_all(connection).await?;
    Ok(rows.into_iter().map(stored).collect())
}

/// The events among the records.
#[derive(Debug, Clone, Copy)]
pub struct Events<'r>(pub(crate) &'r Store);

impl Events<'_> {
    /// Keeps `events` and returns once they are on disk.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be written; none is then.
    pub async fn add(self, events: Vec<Event>) -> Result<(), RecordsError> {
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    for events in events.chunks(AT_ONCE) {
                        insert(connection, events).await?;
                    }
                    Ok(())
                })
            })
            .await
    }

    /// The events that are wanted, newest first. Whoever asks for what is before the last of them gets
    /// the next page: without a gap or a repeat, whatever comes in meanwhile.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn page(self, wanted: EventQuery) -> Result<Vec<StoredEvent>, RecordsError> {
        self.0
            .read(move |connection| Box::pin(page(connection, wanted)))
            .await
    }

    /// Deletes those from before `before` and all but the newest `most`, and returns how many. What would take
    /// long is left for the next call.
    pub(crate) async fn prune(self, before: i64, most: i64) -> Result<u64, RecordsError> {
        let old = "DELETE FROM event WHERE id IN
                 (SELECT id FROM event WHERE at < $1 ORDER BY at LIMIT $2)";
        let many = "DELETE FROM event WHERE id IN
                 (SELECT id FROM event
                  WHERE id <= (SELECT coalesce(max(id), 0) FROM event) - $1 ORDER BY id LIMIT $2)";
        let deleted = self.0.delete_some(old, before).await?;
        Ok(deleted + self.0.delete_some(many, most).await?)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_cursor_is_read_as_it_was_written(at in 0..=i64::MAX, id in 0..=i64::MAX) {
            let cursor = EventCursor { at, id };
            prop_assert_eq!(cursor.to_string().parse::<EventCursor>(), Ok(cursor));
        }

        #[test]
        fn any_text_is_a_cursor_or_refused(text in "[0-9-]{0,24}|.{0,12}") {
            if let Ok(cursor) = text.parse::<EventCursor>() {
                prop_assert_eq!(cursor.to_string().parse::<EventCursor>(), Ok(cursor));
            }
        }
    }
}
