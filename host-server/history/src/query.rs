//! Answers what a robot measured in a stretch of time.

use std::sync::atomic::Ordering;

use crawler_database::{Boxed, Db, RecordsError};
use crawler_protocol::RobotId;

use super::Point;
use super::codec;
use super::fold;
use super::memory::Shared;
use super::points::{self, Points};
use super::retention::{self, Retention};
use super::seal::STEPS;

/// Blocks in memory at a time.
pub(super) const PAGE: i64 = 256;

/// The coarsest level that is fine enough, or the finest that reaches back to `from`.
pub(super) fn level(step: i64, from: i64, now: i64) -> usize {
    let keeps = Retention::default().levels();
    let enough = points::level(step);
    let reaches = keeps
        .iter()
        .position(|&keep| from >= now.saturating_sub(keep))
        .unwrap_or(STEPS.len() - 1);
    enough.max(reaches)
}

type Row = (i64, i64, i64, Vec<u8>);

pub(super) fn query<'a>(
    shared: &'a Shared,
    db: &'a Db,
    robot: &'a RobotId,
    from: i64,
    to: i64,
    step: i64,
) -> Boxed<'a, Result<Vec<Point>, RecordsError>> {
    Box::pin(async move {
        let level = level(step, from, retention::now());
        let mut answer = Points::at_level(from, to, step, level)?;
        let from = answer.from();
        // One moment: what is in memory then is not in the blocks that may be read, and the reverse.
        let view = shared.memory().view(robot, from, to);
        let number = match view.number {
            Some(number) => Some(number),
            None if view.keeper => None,
            None => look_up(db, robot).await?,
        };
        let Some(number) = number else {
            return Ok(Vec::new());
        };
        let minutes = view.minutes.filter(|_| level == 2);
        let but = minutes.as_ref().map(|minutes| minutes.block);
        let (mut last, mut first, mut id) = (from, i64::MIN, i64::MIN);
        loop {
            let below = view.below;
            let rows: Vec<Row> = db
                .read(move |connection| {
                    Box::pin(async move {
                        // In the order of the index, so that the next page goes on where this one ends.
                        Ok(sqlx::query_as(
                            "SELECT last, first, id, data FROM block
                         WHERE robot = ? AND level = ? AND first < ? AND id < ? AND id IS NOT ?
                         AND (last, first, id) > (?, ?, ?)
                         ORDER BY last, first, id LIMIT ?",
                        )
                        .bind(number)
                        .bind(level as i64)
                        .bind(to)
                        .bind(below)
                        .bind(but)
                        .bind(last)
                        .bind(first)
                        .bind(id)
                        .bind(PAGE)
                        .fetch_all(connection)
                        .await?)
                    })
                })
                .await?;
            let Some(end) = rows.last() else { break };
            (last, first, id) = (end.0, end.1, end.2);
            let full = rows.len() as i64 == PAGE;
            for row in &rows {
                let read = if level == 0 {
                    codec::decode(&row.3, |raw| answer.add_bucket(&fold::bucket(raw)))
                } else {
                    codec::decode(&row.3, |bucket| answer.add_bucket(bucket))
                };
                if read.is_none() {
                    shared.counts.damaged.fetch_add(1, Ordering::Relaxed);
                }
            }
            if !full {
                break;
            }
        }
        for minute in minutes.iter().flat_map(|minutes| &minutes.rows) {
            answer.add_bucket(minute);
        }
        for raw in &view.rows {
            answer.add_bucket(&fold::bucket(raw));
        }
        Ok(answer.finish())
    })
}

async fn look_up(db: &Db, robot: &RobotId) -> Result<Option<i64>, RecordsError> {
    let name = robot.to_string();
    db.read(move |connection| {
        Box::pin(async move {
            let row: Option<(i64,)> = sqlx::query_as("SELECT id FROM robot WHERE name = ?")
                .bind(name)
                .fetch_optional(connection)
                .await?;
            Ok(row.map(|(number,)| number))
        })
    })
    .await
}
