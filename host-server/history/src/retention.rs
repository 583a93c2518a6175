//! How long history is kept.

use std::sync::atomic::Ordering;
use std::time::{SystemTime, UNIX_EPOCH};

use super::memory::Shared;
use crawler_database::{Boxed, Db, RecordsError};

/// Blocks deleted in one transaction, and so how long others wait for it.
const AT_ONCE: i64 = 500;
/// Transactions in one go; the rest waits for the next.
const ROUNDS: usize = 100;
const HOUR: i64 = 3_600_000;

/// How long each level is kept, in milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Retention {
    /// The samples themselves; 24 hours.
    pub raw_ms: i64,
    /// Seconds; 7 days.
    pub seconds_ms: i64,
    /// Minutes; 400 days.
    pub minutes_ms: i64,
}

impl Default for Retention {
    fn default() -> Self {
        Self {
            raw_ms: 24 * HOUR,
            seconds_ms: 7 * 24 * HOUR,
            minutes_ms: 400 * 24 * HOUR,
        }
    }
}

impl Retention {
    pub(super) fn levels(&self) -> [i64; 3] {
        [self.raw_ms, self.seconds_ms, self.minutes_ms]
    }
}

/// The time, for what happens by itself.
pub fn now() -> i64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_millis() as i64)
}

pub(super) fn apply<'a>(
    shared: &'a Shared,
    db: &'a Db,
    retention: Retention,
    now: i64,
) -> Boxed<'a, Result<u64, RecordsError>> {
    Box::pin(async move {
        let mut total = 0;
        for (level, keep) in (0_i64..).zip(retention.levels()) {
            let before = now.saturating_sub(keep);
            for _ in 0..ROUNDS {
                let deleted = db
                    .write(move |connection| {
                        Box::pin(async move {
                            let done = sqlx::query(
                                "DELETE FROM block WHERE id IN
                             (SELECT id FROM block WHERE level = ? AND last < ? LIMIT ?)",
                            )
                            .bind(level)
                            .bind(before)
                            .bind(AT_ONCE)
                            .execute(connection)
                            .await?;
                            Ok(done.rows_affected())
                        })
                    })
                    .await?;
                total += deleted;
                if deleted < AT_ONCE as u64 {
                    break;
                }
            }
        }
        shared.counts.expired.fetch_add(total, Ordering::Relaxed);
        Ok(total)
    })
}
