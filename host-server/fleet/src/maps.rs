//! Maps of robots, as long as somebody looks: asked for, put together from their segments, and kept for a second.
//!
//! However many people look, a robot is asked once a second at most, and no more than [`MOST`] robots at a
//! time. What a robot tells that nobody asked it for here changes nothing.

mod assembly;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crawler_commands::SendError;
use crawler_protocol::open::{Open, Response};
use crawler_protocol::{MapSegment, Reason, ResponseStatus, RobotId};
use tokio::sync::watch;
use tokio::time::Instant;

use assembly::Assembly;
pub use assembly::RobotMap;

/// How old a map may be that is given to whoever asks next.
pub const FRESH: Duration = Duration::from_secs(1);
/// A robot tells all of its map within half a second, and its link may be slow.
pub const PATIENCE: Duration = Duration::from_secs(4);
/// Robots that may be asked at a time.
pub const MOST: usize = 32;

/// Why there is no map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MapError {
    /// The robot has none.
    None,
    /// It did not tell all of it in time.
    NoAnswer,
    /// It refused.
    Refused(Option<Open<Reason>>),
    /// Too many robots are asked already.
    Busy,
    /// It could not be asked.
    NotSent(SendError),
}

impl fmt::Display for MapError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("the robot has no map"),
            Self::NoAnswer => f.write_str("the robot did not tell its map in time"),
            Self::Refused(Some(reason)) => write!(f, "the robot refused: {reason}"),
            Self::Refused(None) => f.write_str("the robot refused"),
            Self::Busy => f.write_str("too many robots are asked for their maps"),
            Self::NotSent(error) => write!(f, "the robot could not be asked: {error:?}"),
        }
    }
}

impl std::error::Error for MapError {}

type Outcome = Result<Arc<RobotMap>, MapError>;

/// A robot that was asked.
struct Request {
    /// Number of the command.
    seq: u64,
    asked: Instant,
    assembly: Assembly,
    /// What came of it; `None` until then.
    outcome: watch::Sender<Option<Outcome>>,
}

impl Request {
    /// Whether whoever asks at `now` may have what comes of it.
    fn serves(&self, now: Instant) -> bool {
        let settled = self.outcome.borrow().is_some();
        let age = now.saturating_duration_since(self.asked);
        age < if settled { FRESH } else { PATIENCE }
    }
}

/// Sends a robot the command, and tells its number.
type Ask = Box<dyn Fn(&RobotId) -> Result<u64, SendError> + Send + Sync>;

/// See the [module](self).
pub struct Maps {
    ask: Ask,
    requests: Mutex<HashMap<RobotId, Request>>,
}

impl Maps {
    /// Maps that robots are asked for with `ask`, which tells the number of the command.
    pub fn new(ask: impl Fn(&RobotId) -> Result<u64, SendError> + Send + Sync + 'static) -> Self {
        Self {
            ask: Box::new(ask),
            requests: Mutex::default(),
        }
    }

    fn requests(&self) -> MutexGuard<'_, HashMap<RobotId, Request>> {
        self.requests.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The map of a robot, no older than [`FRESH`] when it was asked for.
    ///
    /// # Errors
    /// [`MapError`].
    ///
    /// # Cancellation safety
    /// Dropped, nobody waits for the answer any more; others may.
    pub async fn read(&self, robot: &RobotId) -> Outcome {
        let now = Instant::now();
        let (mut outcome, asked) = self.ask(robot, now)?;
        let told = outcome.wait_for(Option::is_some);
        match tokio::time::timeout_at(asked + PATIENCE, told).await {
            Ok(Ok(told)) => told.clone().unwrap_or(Err(MapError::NoAnswer)),
            Ok(Err(_)) | Err(_) => Err(MapError::NoAnswer),
        }
    }

    /// Asks the robot, unless somebody has just done so; where the outcome comes, and since when it is waited for.
    fn ask(
        &self,
        robot: &RobotId,
        now: Instant,
    ) -> Result<(watch::Receiver<Option<Outcome>>, Instant), MapError> {
        let mut requests = self.requests();
        requests.retain(|_, request| request.serves(now));
        if let Some(request) = requests.get(robot) {
            return Ok((request.outcome.subscribe(), request.asked));
        }
        if requests.len() >= MOST {
            return Err(MapError::Busy);
        }
        // Under the lock: the answer waits for it, and finds the request.
        let seq = (self.ask)(robot).map_err(MapError::NotSent)?;
        let (outcome, receiver) = watch::channel(None);
        let request = Request {
            seq,
            asked: now,
            assembly: Assembly::default(),
            outcome,
        };
        requests.insert(robot.clone(), request);
        Ok((receiver, now))
    }

    /// Takes in a part of a map.
    pub fn segment(&self, segment: &MapSegment) {
        let mut requests = self.requests();
        if let Some(request) = requests.get_mut(&segment.robot)
            && request.seq == segment.seq
            && let Some(map) = request.assembly.add(segment)
        {
            request.settle(Ok(Arc::new(map)));
        }
    }

    /// Takes in an answer: a robot may have no map, or not want to tell it. That it has told all of it shows when the
    /// last part comes.
    pub fn answer(&self, response: &Response) {
        let error = match (response.status, response.reason) {
            (
                Open::Known(ResponseStatus::Accepted | ResponseStatus::Completed)
                | Open::Unknown(_),
                _,
            ) => return,
            (_, Some(Open::Known(Reason::NoMap))) => MapError::None,
            (_, reason) => MapError::Refused(reason),
        };
        let requests = self.requests();
        if let Some(request) = requests.get(&response.robot)
            && request.seq == response.seq
        {
            request.settle(Err(error));
        }
    }
}

impl Request {
    /// The first outcome stays.
    fn settle(&self, outcome: Outcome) {
        self.outcome.send_if_modified(|known| {
            let is_first = known.is_none();
            if is_first {
                *known = Some(outcome);
            }
            is_first
        });
    }
}
