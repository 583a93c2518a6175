//! Answers what a robot measured in a stretch of time.

use std::sync::atomic::Ordering;

use crawler_protocol::RobotId;

use super::Point;
use super::codec;
use super::fold::{self, Bucket, Fold};
use super::memory::Shared;
use super::retention::{self, Retention};
use super::seal::STEPS;
use crate::RecordsError;
use crate::db::Db;

/// Most stretches in one answer.
pub const MAX_POINTS: i64 = 10_000;
/// Blocks in memory at a time.
const PAGE: i64 = 256;

/// The answer while it is put together: one place for each stretch.
struct Answer {
    /// Where the first stretch begins.
    begin: i64,
    step: i64,
    from: i64,
    to: i64,
    folds: Vec<Fold>,
}

impl Answer {
    fn add(&mut self, bucket: &Bucket) {
        let at = bucket[0];
        if at < self.from || at >= self.to {
            return;
        }
        let place = (at - self.begin) / self.step;
        if let Some(fold) = self.folds.get_mut(place as usize) {
            fold.add(bucket);
        }
    }

    fn points(&self) -> Vec<Point> {
        (0..)
            .zip(&self.folds)
            .filter_map(|(place, fold)| fold.point(self.begin + place * self.step))
            .collect()
    }
}

/// The coarsest level that is fine enough, or the finest that reaches back to `from`.
fn level(step: i64, from: i64, now: i64) -> usize {
    let keeps = Retention::default().levels();
    let enough = STEPS.iter().rposition(|&of| of <= step).unwrap_or(0);
    let reaches = keeps
        .iter()
        .position(|&keep| from >= now.saturating_sub(keep))
        .unwrap_or(STEPS.len() - 1);
    enough.max(reaches)
}

type Row = (i64, i64, i64, Vec<u8>);

pub(super) async fn query(
    shared: &Shared,
    db: &Db,
    robot: &RobotId,
    from: i64,
    to: i64,
    step: i64,
) -> Result<Vec<Point>, RecordsError> {
    if step < 1 || from < 0 || to <= from {
        return Err(RecordsError::Invalid(
            "a question about history has a step, and a beginning before its end",
        ));
    }
    let level = level(step, from, retention::now());
    // The stretch of the level that `from` is in counts as a whole: nobody knows more of it.
    let from = fold::floor(from, STEPS[level]);
    let begin = fold::floor(from, step);
    let places = (to - 1 - begin) / step + 1;
    if places > MAX_POINTS {
        return Err(RecordsError::Invalid(
            "an answer about history has at most 10000 points: ask for a longer step",
        ));
    }
    let mut answer = Answer {
        begin,
        step,
        from,
        to,
        folds: vec![Fold::default(); places as usize],
    };
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
                codec::decode(&row.3, |raw| answer.add(&fold::bucket(raw)))
            } else {
                codec::decode(&row.3, |bucket| answer.add(bucket))
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
        answer.add(minute);
    }
    for raw in &view.rows {
        answer.add(&fold::bucket(raw));
    }
    Ok(answer.points())
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
