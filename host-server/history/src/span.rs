//! From when to when something is recorded.

use super::memory::Shared;
use crawler_database::{Boxed, Db, RecordsError};

/// How long a block of each level is, about: a minute or so, and an hour of minutes.
const LENGTHS: [i64; 3] = [120_000, 120_000, 3_600_000];

/// What is recorded at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Recorded {
    /// Time of the oldest.
    pub from: i64,
    /// Time of the newest.
    pub to: i64,
}

pub(super) fn recorded<'a>(
    shared: &'a Shared,
    db: &'a Db,
) -> Boxed<'a, Result<Option<Recorded>, RecordsError>> {
    Box::pin(async move {
        let open = {
            let memory = shared.memory();
            let sealing = memory.sealing.iter().flat_map(|lots| lots.values());
            let lots = sealing.chain(memory.open.values());
            // About in order of time; what is late by a moment is not worth looking at all of them.
            let ends = lots.filter_map(|lot| Some((lot.first()?[0], lot.last()?[0])));
            ends.reduce(|one, other| (one.0.min(other.0), one.1.max(other.1)))
        };
        let mut found = open;
        for (level, length) in (0_i64..).zip(LENGTHS) {
            let stored: (Option<i64>, Option<i64>) = db
                .read(move |connection| {
                    Box::pin(async move {
                        // Blocks are found by their end; one that ends later may have begun sooner.
                        Ok(sqlx::query_as(
                            "SELECT (SELECT min(first) FROM block WHERE level = ?1 AND last <=
                                    (SELECT min(last) FROM block WHERE level = ?1) + ?2),
                                (SELECT max(last) FROM block WHERE level = ?1)",
                        )
                        .bind(level)
                        .bind(length)
                        .fetch_one(connection)
                        .await?)
                    })
                })
                .await?;
            if let (Some(from), Some(to)) = stored {
                let (begin, end) = found.unwrap_or((from, to));
                found = Some((begin.min(from), end.max(to)));
            }
        }
        Ok(found.map(|(from, to)| Recorded { from, to }))
    })
}
