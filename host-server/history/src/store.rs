//! The history of telemetry, wherever it is: in the data directory, or in an engine outside.

use std::collections::BTreeSet;
use std::fmt;
use std::pin::Pin;
use std::sync::Arc;

use crawler_database::RecordsError;
use crawler_protocol::RobotId;

use crate::{Full, History as Local, Point, Recorded, Sample, Track};

/// An engine outside that keeps the history.
///
/// What is asked is answered by the rules of [`History`](Local), and once it is dropped nothing more is asked.
pub trait HistoryEngine: fmt::Debug + Send + Sync {
    /// Takes a sample, without waiting.
    ///
    /// # Errors
    /// [`Full`] when it cannot be taken; it is counted as dropped.
    fn push(&self, sample: Sample) -> Result<(), Full>;

    /// As [`HistoryStore::query`].
    fn query<'a>(
        &'a self,
        robot: &'a RobotId,
        from: i64,
        to: i64,
        step: i64,
    ) -> Answer<'a, Vec<Point>>;

    /// As [`HistoryStore::recorded`].
    fn recorded(&self) -> Answer<'_, Option<Recorded>>;

    /// As [`HistoryStore::robots`].
    fn robots(&self) -> Answer<'_, BTreeSet<RobotId>>;

    /// As [`HistoryStore::frames`].
    fn frames<'a>(
        &'a self,
        robots: &'a BTreeSet<RobotId>,
        from: i64,
        to: i64,
        step: i64,
    ) -> Answer<'a, Vec<Track>>;

    /// How it is doing.
    fn stats(&self) -> EngineStats;

    /// Writes what waits, for at most some seconds, and ends. Nothing is taken from then on.
    fn close(&self) -> Pin<Box<dyn Future<Output = ()> + Send + '_>>;
}

/// What an engine answers, in its time.
pub type Answer<'a, T> = Pin<Box<dyn Future<Output = Result<T, EngineFailure>> + Send + 'a>>;

/// Why an engine has no answer, by what to do about it.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum EngineFailure {
    /// The question is none; the text says why. Ask another.
    Invalid(String),
    /// It is only written to. Ask it with its own tools.
    Unreadable,
    /// It cannot be asked for now. Ask again later.
    Unavailable {
        /// What came instead of an answer.
        reason: String,
        /// What a person can do about it.
        advice: &'static str,
    },
}

/// How the history in an engine is doing, since it was started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EngineStats {
    /// Samples taken into the queue.
    pub accepted: u64,
    /// Samples refused because the queue was full, or let go when the server stopped.
    pub dropped: u64,
    /// Samples that the engine took.
    pub written: u64,
    /// Samples that the engine understood and refused.
    pub refused: u64,
    /// Samples that wait.
    pub queued: u64,
    /// Requests of the writer that failed and are tried again.
    pub failures: u64,
    /// Whether the engine takes samples.
    pub up: bool,
}

/// The history of the fleet. A clone is another handle of the same.
#[derive(Debug, Clone)]
pub enum HistoryStore {
    /// In a file of the data directory.
    Local(Local),
    /// In an engine.
    Engine(Arc<dyn HistoryEngine>),
}

/// Why a question about history has no answer.
#[derive(Debug)]
pub enum HistoryError {
    /// The file failed.
    Local(RecordsError),
    /// The engine failed.
    Engine(EngineFailure),
}

impl HistoryStore {
    /// Takes a sample, without waiting.
    ///
    /// # Errors
    /// [`Full`] when it cannot be taken; it is counted as dropped.
    pub fn push(&self, sample: Sample) -> Result<(), Full> {
        match self {
            Self::Local(local) => local.push(sample),
            Self::Engine(engine) => engine.push(sample),
        }
    }

    /// What `robot` measured from `from` until before `to`, in stretches of `step` milliseconds.
    ///
    /// # Errors
    /// [`HistoryError`] of where the history is.
    pub async fn query(
        &self,
        robot: &RobotId,
        from: i64,
        to: i64,
        step: i64,
    ) -> Result<Vec<Point>, HistoryError> {
        match self {
            Self::Local(local) => local
                .query(robot, from, to, step)
                .await
                .map_err(HistoryError::Local),
            Self::Engine(engine) => engine
                .query(robot, from, to, step)
                .await
                .map_err(HistoryError::Engine),
        }
    }

    /// From when to when something is recorded.
    ///
    /// # Errors
    /// [`HistoryError`] of where the history is.
    pub async fn recorded(&self) -> Result<Option<Recorded>, HistoryError> {
        match self {
            Self::Local(local) => local.recorded().await.map_err(HistoryError::Local),
            Self::Engine(engine) => engine.recorded().await.map_err(HistoryError::Engine),
        }
    }

    /// The robots that something was ever recorded of, in order.
    ///
    /// # Errors
    /// [`HistoryError`] of where the history is.
    pub async fn robots(&self) -> Result<BTreeSet<RobotId>, HistoryError> {
        match self {
            Self::Local(local) => local.robots().await.map_err(HistoryError::Local),
            Self::Engine(engine) => engine.robots().await.map_err(HistoryError::Engine),
        }
    }

    /// Where `robots` were from `from` until before `to`, every `step` milliseconds.
    ///
    /// # Errors
    /// [`HistoryError`] of where the history is.
    pub async fn frames(
        &self,
        robots: &BTreeSet<RobotId>,
        from: i64,
        to: i64,
        step: i64,
    ) -> Result<Vec<Track>, HistoryError> {
        match self {
            Self::Local(local) => local
                .frames(robots, from, to, step)
                .await
                .map_err(HistoryError::Local),
            Self::Engine(engine) => engine
                .frames(robots, from, to, step)
                .await
                .map_err(HistoryError::Engine),
        }
    }

    /// Whether the engine takes samples; `None` where there is none.
    pub fn engine_up(&self) -> Option<bool> {
        match self {
            Self::Local(_) => None,
            Self::Engine(engine) => Some(engine.stats().up),
        }
    }

    /// Finishes what waits for an engine. A local history ends with the records.
    pub async fn close(&self) {
        if let Self::Engine(engine) = self {
            engine.close().await;
        }
    }
}
