//! What the robots measured, as it was and in ever longer stretches.
//!
//! [`History::push`] puts a sample into a queue of bounded length and returns at once. Four times a
//! second one task writes what came in as one row, the *tail*. Once a minute, or sooner when much
//! came in, it sorts the tail by robot and replaces it with *blocks*: each a minute or so of one
//! robot, packed, at three levels: every sample, seconds, minutes. A question about an hour of a
//! robot thus reads some sixty rows. After a crash the tail is read again, so nothing that
//! [`History::flush`] confirmed is lost.
//!
//! Reading order: writing in `memory` and `writer`; blocks in `seal`, `fold` and `codec`; `start` and
//! `retention`; reading in `query`, `points`, `frames` and `span`. `store` is this history, or an engine outside
//! in its place.

mod codec;
mod fold;
mod frames;
mod memory;
mod points;
mod query;
mod retention;
mod seal;
mod span;
mod start;
mod store;
mod writer;

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crawler_database::{Db, RecordsError, Schema};
use crawler_protocol::open::Telemetry;
use crawler_protocol::{RobotId, RobotState};
use serde::Serialize;
use tokio::sync::oneshot;

use memory::{Inbox, Shared, Waiting};

pub use fold::{LATEST, numbered_state, state_number, thousandths};
pub use frames::{Frame, MAX_FRAMES, Track};
pub use points::{MAX_POINTS, Points};
pub use retention::{Retention, now};
pub use span::Recorded;
pub use start::{LOCK_FILE, Running};
pub use store::{Answer, EngineFailure, EngineStats, HistoryEngine, HistoryError, HistoryStore};

/// History of the fleet: `TCRh`.
pub const HISTORY: Schema = Schema {
    id: 0x5443_5268,
    steps: &[include_str!("schema/1.sql")],
};
/// File of the history, in the data directory.
pub const HISTORY_FILE: &str = "history.sqlite";
/// Most robots whose history is kept.
pub const MAX_ROBOTS: usize = 10_000;
/// Samples that wait to be written; more are refused.
pub const QUEUE: usize = 131_072;

/// What a robot measured at one time.
///
/// A number that is none counts as 0, one beyond what a robot can be is brought back into range.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The robot.
    pub robot: RobotId,
    /// When, by the server's clock.
    pub at: i64,
    /// Metres along the x axis.
    pub x: f32,
    /// Metres along the y axis.
    pub y: f32,
    /// Heading in radians.
    pub theta: f32,
    /// Distance to what is ahead.
    pub range_mm: Option<u16>,
    /// Voltage of the battery.
    pub battery_mv: u16,
    /// Charge of the battery.
    pub battery_percent: u8,
    /// Strength of the received signal in dBm.
    pub rssi: Option<i8>,
    /// Duty of the left wheel, -1 to 1.
    pub left: f32,
    /// Duty of the right wheel, -1 to 1.
    pub right: f32,
    /// What the robot was doing.
    pub state: RobotState,
}

impl Sample {
    /// What the history keeps of a message that came in at `at`. The server's clock counts: a robot's may
    /// not be set, or be made up. A state that only a newer robot knows is an error to the history, as one that
    /// a newer program has stored is.
    #[must_use]
    pub fn of(telemetry: &Telemetry, at: i64) -> Self {
        Self {
            robot: telemetry.robot.clone(),
            at,
            x: telemetry.pose.x,
            y: telemetry.pose.y,
            theta: telemetry.pose.theta,
            range_mm: telemetry.range_mm,
            battery_mv: telemetry.battery.mv,
            battery_percent: telemetry.battery.percent,
            rssi: telemetry.rssi_dbm,
            left: telemetry.wheels.left,
            right: telemetry.wheels.right,
            state: telemetry.state.known().unwrap_or(RobotState::Error),
        }
    }
}

/// Lowest, mean and highest of what was measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Span {
    /// The lowest.
    pub min: f32,
    /// The mean.
    pub mean: f32,
    /// The highest.
    pub max: f32,
}

/// What a robot measured in a stretch of time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Point {
    /// When the stretch begins; a multiple of the step.
    pub at: i64,
    /// How many samples it stands for.
    pub count: u64,
    /// Mean, in metres along the x axis.
    pub x: f32,
    /// Mean, in metres along the y axis.
    pub y: f32,
    /// Last heading, in radians: a mean of angles would mean nothing.
    pub theta: f32,
    /// Mean duty of the left wheel.
    pub left: f32,
    /// Mean duty of the right wheel.
    pub right: f32,
    /// Voltage of the battery.
    pub battery_mv: Span,
    /// Charge of the battery.
    pub battery_percent: Span,
    /// Distance to what was ahead; none if none of the samples had one.
    pub range_mm: Option<Span>,
    /// Strength of the received signal in dBm; none if none of the samples had one.
    pub rssi: Option<Span>,
    /// The last state.
    pub state: RobotState,
}

/// The sample was not taken: too many wait, the records are closed, or another process keeps the
/// history of this directory. It is counted as dropped; there is nothing else to do about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Full;

impl std::fmt::Display for Full {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the history takes no more samples for now")
    }
}

impl std::error::Error for Full {}

/// How the history is doing, since it was opened.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Stats {
    /// Samples taken into the queue.
    pub accepted: u64,
    /// Samples refused because the queue was full, or nobody writes it.
    pub dropped: u64,
    /// Samples that were of one robot too many, and were left out.
    pub beyond: u64,
    /// Samples on disk.
    pub written: u64,
    /// Samples in the queue.
    pub queued: u64,
    /// Samples on disk that are not in a block yet.
    pub open: u64,
    /// Blocks written.
    pub blocks: u64,
    /// Blocks deleted because they were too old.
    pub expired: u64,
    /// Writes that failed; they are tried again.
    pub failures: u64,
    /// Blocks that could not be read.
    pub damaged: u64,
    /// Whether this process keeps the history.
    pub keeper: bool,
    /// Where a damaged file was put that was found at the start.
    pub set_aside: Option<PathBuf>,
}

/// The history of the fleet. A clone is another handle of the same.
#[derive(Debug, Clone)]
pub struct History {
    shared: Arc<Shared>,
    /// None where the history is elsewhere.
    db: Option<Db>,
}

impl History {
    /// Takes a sample, without waiting. It can be read within half a second.
    ///
    /// # Errors
    /// [`Full`] when it cannot be taken; it is counted as dropped.
    pub fn push(&self, sample: Sample) -> Result<(), Full> {
        let mut inbox = self.shared.inbox();
        if !inbox.open || inbox.samples.len() >= QUEUE {
            drop(inbox);
            self.shared.counts.dropped.fetch_add(1, Ordering::Relaxed);
            return Err(Full);
        }
        inbox.samples.push(sample);
        let many = inbox.samples.len() == writer::BATCH;
        drop(inbox);
        self.shared.counts.accepted.fetch_add(1, Ordering::Relaxed);
        if many {
            self.shared.wake.notify_one();
        }
        Ok(())
    }

    /// Returns when everything that was pushed before is on disk.
    ///
    /// # Errors
    /// [`RecordsError`] when it could not be written. It is kept and tried again.
    pub async fn flush(&self) -> Result<(), RecordsError> {
        self.wait(|inbox| &mut inbox.waiting).await
    }

    /// Like [`History::flush`], and makes blocks of everything, which otherwise happens within a
    /// minute.
    ///
    /// # Errors
    /// As for [`History::flush`].
    pub async fn settle(&self) -> Result<(), RecordsError> {
        self.wait(|inbox| &mut inbox.settling).await
    }

    async fn wait(&self, list: fn(&mut Inbox) -> &mut Vec<Waiting>) -> Result<(), RecordsError> {
        let (sender, done) = oneshot::channel();
        {
            let mut inbox = self.shared.inbox();
            if !inbox.open {
                return Err(RecordsError::Closed);
            }
            let list = list(&mut inbox);
            if list.len() >= writer::MOST_WAITING {
                return Err(RecordsError::TooMany("who wait for the history"));
            }
            list.push(sender);
        }
        self.shared.wake.notify_one();
        done.await.map_err(|_| RecordsError::Closed)?
    }

    /// How it is doing.
    pub fn stats(&self) -> Stats {
        self.shared.stats()
    }

    /// What `robot` measured from `from` until before `to`, in stretches of `step_ms`, oldest first;
    /// stretches without a sample are left out. A step of a minute or more is answered from minutes,
    /// one of a second or more from seconds, a shorter one from the samples themselves; what is too
    /// old for a level comes from the next. The second or minute that `from` is in counts as a whole
    /// then.
    ///
    /// # Errors
    /// [`RecordsError::Invalid`] when the step or the time is none, or for more than [`MAX_POINTS`]
    /// stretches.
    pub async fn query(
        &self,
        robot: &RobotId,
        from: i64,
        to: i64,
        step_ms: i64,
    ) -> Result<Vec<Point>, RecordsError> {
        match &self.db {
            Some(db) => query::query(&self.shared, db, robot, from, to, step_ms).await,
            None => Ok(Vec::new()),
        }
    }

    /// From when to when something is recorded, to about the length of a block.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn recorded(&self) -> Result<Option<Recorded>, RecordsError> {
        match &self.db {
            Some(db) => span::recorded(&self.shared, db).await,
            None => Ok(None),
        }
    }

    /// The robots that something was ever recorded of, in order.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn robots(&self) -> Result<BTreeSet<RobotId>, RecordsError> {
        match &self.db {
            Some(db) => Ok(frames::named(&self.shared, db).await?.into_keys().collect()),
            None => Ok(BTreeSet::new()),
        }
    }

    /// Where `robots` were from `from` until before `to`, every `step_ms`, in the order of their names:
    /// as [`History::query`] has it of each. Robots and stretches without a sample are left out.
    ///
    /// # Errors
    /// As of [`History::query`], and [`RecordsError::Invalid`] for more than [`MAX_FRAMES`].
    pub async fn frames(
        &self,
        robots: &BTreeSet<RobotId>,
        from: i64,
        to: i64,
        step_ms: i64,
    ) -> Result<Vec<Track>, RecordsError> {
        match &self.db {
            Some(db) => frames::frames(&self.shared, db, robots, (from, to, step_ms)).await,
            None => Ok(Vec::new()),
        }
    }

    /// Deletes what is older at `now` than `retention` says, and returns how many blocks that were.
    /// The history does so by itself every minute, with [`Retention::default`].
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written.
    pub async fn retain(&self, retention: Retention, now: i64) -> Result<u64, RecordsError> {
        match &self.db {
            Some(db) => retention::apply(&self.shared, db, retention, now).await,
            None => Ok(0),
        }
    }

    /// Its file; `None` where the history is elsewhere.
    pub fn db(&self) -> Option<&Db> {
        self.db.as_ref()
    }
}

#[cfg(test)]
mod tests;
