//! The history of a fleet in an outside engine.

use std::collections::BTreeSet;
use std::fmt;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use crawler_history::{
    Answer, EngineStats, Frame, Full, HistoryEngine, Point, Recorded, Sample, Track,
};
use crawler_protocol::RobotId;
use tokio::sync::{Semaphore, SemaphorePermit, mpsc};
use tokio::task::{JoinHandle, JoinSet};

use crate::address::{Address, Dialect};
use crate::client::{Client, TIME_OUT};
use crate::engine::Engine;
use crate::error::EngineError;
use crate::read::{self, Question, extent};
use crate::shared::{Shared, State};
use crate::writer::Writer;

/// Samples that wait for the engine; more are refused. At about 90 bytes each they are 45 MB, and of
/// 1,000 robots at 5 Hz they are 100 s.
pub const QUEUE: usize = 500_000;
/// Questions at a time; others wait.
const QUESTIONS: usize = 8;
/// Of those, for one answer about many robots.
const TOGETHER: usize = 6;

/// The history of the fleet. A clone is another handle of the same; when the last one is gone, the
/// task that writes ends.
#[derive(Clone)]
pub struct Remote(Arc<Inner>);

struct Inner {
    shared: Arc<Shared>,
    client: Arc<Client>,
    fleet: String,
    questions: Semaphore,
    /// The writer ends when the sender is dropped.
    writer: Mutex<Option<(mpsc::Sender<()>, JoinHandle<()>)>>,
}

impl fmt::Debug for Remote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Remote")
            .field(self.0.client.address())
            .finish()
    }
}

impl Remote {
    /// Begins to keep the history of `fleet` in the engine at `address`, whether it is there or not.
    /// At most `queue` samples wait for it. Must be called within a Tokio runtime.
    ///
    /// # Errors
    /// [`EngineError::Certificates`] when TLS is wanted and cannot be had.
    pub fn start(address: Address, fleet: &str, queue: usize) -> Result<Self, EngineError> {
        let client = Arc::new(Client::new(address)?);
        let shared = Arc::new(Shared::new(queue));
        let writer = Writer::new(shared.clone(), client.clone(), fleet.to_owned());
        // Never sent on: its end is the message.
        let (alive, ends) = mpsc::channel(1);
        let task = tokio::spawn(writer.run(ends));
        Ok(Self(Arc::new(Inner {
            shared,
            client,
            fleet: fleet.to_owned(),
            questions: Semaphore::new(QUESTIONS),
            writer: Mutex::new(Some((alive, task))),
        })))
    }

    /// Takes a sample, without waiting. It is sent within half a second.
    ///
    /// # Errors
    /// [`Full`] when it cannot be taken; it is counted as dropped.
    pub fn push(&self, sample: Sample) -> Result<(), Full> {
        self.0.shared.push(sample)
    }

    /// Returns when the engine has taken or refused everything that was pushed before; as long as it
    /// is away, that is not yet.
    ///
    /// # Errors
    /// [`EngineError::Closed`] when the history was closed before.
    ///
    /// # Cancellation safety
    /// Nothing is lost when this is dropped; the samples are written all the same.
    pub async fn flush(&self) -> Result<(), EngineError> {
        let wanted = self.0.shared.accepted();
        let mut progress = self.0.shared.progress.subscribe();
        let progress = progress
            .wait_for(|progress| progress.closed || progress.settled >= wanted)
            .await
            .map_err(|_| EngineError::Closed)?;
        if progress.settled >= wanted {
            Ok(())
        } else {
            Err(EngineError::Closed)
        }
    }

    /// How it is doing.
    pub fn stats(&self) -> EngineStats {
        self.0.shared.stats()
    }

    /// How it stands with the engine.
    pub fn state(&self) -> State {
        self.0.shared.state()
    }

    /// The engine, once it has been there.
    pub fn engine(&self) -> Option<Engine> {
        self.0.shared.engine()
    }

    /// What `robot` measured from `from` until before `to`, in stretches of `step_ms`, oldest first;
    /// stretches without a sample are left out. By the rules of
    /// [`crawler_history::History::query`].
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for what is no question, [`EngineError::Unreadable`] for an engine
    /// that is only written to, and what is in the way of an answer else.
    pub async fn query(
        &self,
        robot: &RobotId,
        from: i64,
        to: i64,
        step_ms: i64,
    ) -> Result<Vec<Point>, EngineError> {
        let (dialect, _turn) = self.turn().await?;
        let question = Question {
            fleet: &self.0.fleet,
            robot,
            from,
            to,
            step: step_ms,
        };
        read::ask(&self.0.client, dialect, question).await
    }

    /// From when to when the engine has samples of the fleet. `VictoriaMetrics` is asked by the day, and
    /// then some robots of that day.
    ///
    /// # Errors
    /// As of [`Remote::query`].
    pub async fn recorded(&self) -> Result<Option<Recorded>, EngineError> {
        let (dialect, _turn) = self.turn().await?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let now = now.map_or(0, |since| since.as_millis() as i64);
        extent::recorded(&self.0.client, dialect, &self.0.fleet, now).await
    }

    /// The robots of the fleet that the engine has samples of, in order.
    ///
    /// # Errors
    /// As of [`Remote::query`].
    pub async fn robots(&self) -> Result<BTreeSet<RobotId>, EngineError> {
        let (dialect, _turn) = self.turn().await?;
        extent::robots(&self.0.client, dialect, &self.0.fleet).await
    }

    /// Where `robots` were from `from` until before `to`, every `step_ms`, in the order of their names: a
    /// question for each, some at the same time. Robots and stretches without a sample are left out.
    ///
    /// # Errors
    /// As of [`Remote::query`].
    ///
    /// # Cancellation safety
    /// Nothing more is asked once this is dropped.
    pub async fn frames(
        &self,
        robots: &BTreeSet<RobotId>,
        from: i64,
        to: i64,
        step_ms: i64,
    ) -> Result<Vec<Track>, EngineError> {
        let mut waiting = robots.iter();
        let mut asked = JoinSet::new();
        let mut tracks = Vec::new();
        loop {
            while asked.len() < TOGETHER
                && let Some(robot) = waiting.next()
            {
                let (remote, robot) = (self.clone(), robot.clone());
                asked.spawn(async move {
                    let points = remote.query(&robot, from, to, step_ms).await?;
                    let frames = points.iter().map(Frame::from).collect();
                    Ok::<_, EngineError>(Track { robot, frames })
                });
            }
            let Some(answered) = asked.join_next().await else {
                break;
            };
            // Ends only with the runtime, or by a panic, which has been reported.
            let track = answered.map_err(|_| EngineError::Closed)??;
            if !track.frames.is_empty() {
                tracks.push(track);
            }
        }
        tracks.sort_by(|one, other| one.robot.cmp(&other.robot));
        Ok(tracks)
    }

    /// The language of the engine, once it is our turn to ask.
    async fn turn(&self) -> Result<(Dialect, SemaphorePermit<'_>), EngineError> {
        let inner = &self.0;
        match (inner.shared.state(), inner.shared.engine()) {
            // The writer asks again all the time: no need to wait for what it waits for.
            (State::Down(error @ (EngineError::Unreachable(_) | EngineError::Closed)), _)
            | (State::Down(error), None) => Err(error),
            (_, None) => Err(EngineError::Unreachable("it has not answered yet".into())),
            (_, Some(engine)) => {
                let dialect = engine.dialect.ok_or(EngineError::Unreadable)?;
                match tokio::time::timeout(TIME_OUT, inner.questions.acquire()).await {
                    Ok(Ok(turn)) => Ok((dialect, turn)),
                    _ => Err(EngineError::Busy("too many ask at the same time".into())),
                }
            }
        }
    }

    /// Writes what waits, for at most some seconds, and ends. Nothing is taken from then on.
    pub async fn close(&self) {
        let writer = self
            .0
            .writer
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some((alive, task)) = writer {
            drop(alive);
            // An error is a panic of the task, which has been reported.
            let _ = task.await;
        }
    }
}

impl HistoryEngine for Remote {
    fn push(&self, sample: Sample) -> Result<(), Full> {
        Self::push(self, sample)
    }

    fn query<'a>(
        &'a self,
        robot: &'a RobotId,
        from: i64,
        to: i64,
        step: i64,
    ) -> Answer<'a, Vec<Point>> {
        Box::pin(async move { Ok(Self::query(self, robot, from, to, step).await?) })
    }

    fn recorded(&self) -> Answer<'_, Option<Recorded>> {
        Box::pin(async move { Ok(Self::recorded(self).await?) })
    }

    fn robots(&self) -> Answer<'_, BTreeSet<RobotId>> {
        Box::pin(async move { Ok(Self::robots(self).await?) })
    }

    fn frames<'a>(
        &'a self,
        robots: &'a BTreeSet<RobotId>,
        from: i64,
        to: i64,
        step: i64,
    ) -> Answer<'a, Vec<Track>> {
        Box::pin(async move { Ok(Self::frames(self, robots, from, to, step).await?) })
    }

    fn stats(&self) -> EngineStats {
        Self::stats(self)
    }

    fn close(&self) -> Pin<Box<dyn Future<Output = ()> + Send + '_>> {
        Box::pin(Self::close(self))
    }
}
