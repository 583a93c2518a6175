//! What people want of rollouts.

use std::collections::BTreeSet;
use std::fmt;

use crawler_protocol::RobotId;
use crawler_records::RecordsError;
use crawler_updates::rollout::{
    Command, CommandError, Document, PlanError, ReleaseId, RolloutState, StartError,
};
use tokio::sync::oneshot;

use crate::Rollouts;
use crate::plan::NewPlan;

/// What can be done with a rollout.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(clippy::exhaustive_enums)] // the API has a call for each
pub enum Action {
    /// Offer nothing more for now.
    Pause,
    /// Go on.
    Resume,
    /// End it.
    Abort,
    /// Offer it to a robot again.
    Retry(RobotId),
    /// Leave a robot out.
    Skip(RobotId),
}

impl Action {
    pub(crate) fn command(&self) -> Command {
        match self {
            Self::Pause => Command::Pause,
            Self::Resume => Command::Resume,
            Self::Abort => Command::Abort,
            Self::Retry(robot) => Command::Retry(robot.clone()),
            Self::Skip(robot) => Command::Skip(robot.clone()),
        }
    }
}

/// Why something cannot be done with a rollout.
#[derive(Debug)]
#[non_exhaustive]
pub enum RolloutError {
    /// There is none of that number.
    Unknown,
    /// There is no release of that id.
    UnknownRelease(ReleaseId),
    /// A release cannot be rolled out, and why.
    Release(ReleaseId, &'static str),
    /// The plan cannot be carried out.
    Plan(PlanError),
    /// These releases have no gate that has passed, and nobody says why they go out all the same.
    NoGate(Vec<ReleaseId>),
    /// A reason to go without a gate is none.
    Override,
    /// The plan is for nobody, or for too many.
    Start(StartError),
    /// It makes no sense as things are.
    Command(CommandError),
    /// The records refuse.
    Records(RecordsError),
    /// What is kept of it cannot be read.
    Damaged(String),
    /// Other servers begin rollouts, or are asked to do something with this one, all the time.
    Contended,
    /// The server is about to stop.
    Stopping,
}

impl fmt::Display for RolloutError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown => f.write_str("there is no rollout of that id"),
            Self::UnknownRelease(id) => write!(f, "there is no release {id}"),
            Self::Release(id, why) => write!(f, "release {id} cannot be rolled out: {why}"),
            Self::Plan(error) => error.fmt(f),
            Self::NoGate(releases) => {
                let releases: Vec<_> = releases.iter().map(ReleaseId::as_str).collect();
                write!(
                    f,
                    "no gate that has passed: {} (`release gate` makes one; `override_gate` with a reason goes \
                     without)",
                    releases.join(", ")
                )
            }
            Self::Override => f.write_str("override_gate: a reason of 1 to 512 bytes on one line"),
            Self::Start(error) => error.fmt(f),
            Self::Command(error) => error.fmt(f),
            Self::Records(error) => error.fmt(f),
            Self::Damaged(why) => write!(f, "the rollout cannot be read: {why}"),
            Self::Contended => f.write_str("other servers are faster all the time"),
            Self::Stopping => f.write_str("the server is about to stop"),
        }
    }
}

impl std::error::Error for RolloutError {}

impl From<RecordsError> for RolloutError {
    fn from(error: RecordsError) -> Self {
        Self::Records(error)
    }
}

/// Something that a person waits for.
pub(crate) enum Request {
    Start {
        by: String,
        plan: NewPlan,
        answer: oneshot::Sender<Result<i64, RolloutError>>,
    },
    Act {
        id: i64,
        action: Action,
        answer: oneshot::Sender<Result<(), RolloutError>>,
    },
}

impl Rollouts {
    /// Begins a rollout on this server, and returns its number once it is on disk.
    ///
    /// # Errors
    /// [`RolloutError`].
    ///
    /// # Cancellation safety
    /// It may begin all the same.
    pub async fn start(&self, by: &str, plan: NewPlan) -> Result<i64, RolloutError> {
        let (answer, answered) = oneshot::channel();
        let by = by.to_owned();
        self.ask(Request::Start { by, plan, answer }, answered)
            .await
    }

    /// Does something with a rollout, and returns once that is on disk. Another server that has it loses it to this
    /// one.
    ///
    /// # Errors
    /// [`RolloutError`].
    ///
    /// # Cancellation safety
    /// It may be done all the same.
    pub async fn act(&self, id: i64, action: Action) -> Result<(), RolloutError> {
        let (answer, answered) = oneshot::channel();
        self.ask(Request::Act { id, action, answer }, answered)
            .await
    }

    /// The rollouts that run with `release`, whoever carries them out. One that cannot be read is none.
    ///
    /// # Errors
    /// [`RolloutError::Records`].
    pub async fn running_with(&self, release: &str) -> Result<Vec<i64>, RolloutError> {
        let mut running = Vec::new();
        for lease in self.records.rollouts().leases().await? {
            let Some(kept) = self.records.rollouts().get(lease.id).await? else {
                continue;
            };
            let Ok(document) = serde_json::from_str::<Document>(&kept.document) else {
                continue;
            };
            let mut releases = document.plan.releases.iter();
            if document.state == RolloutState::Running
                && releases.any(|one| one.release.as_str() == release)
            {
                running.push(lease.id);
            }
        }
        Ok(running)
    }

    /// Pauses the rollouts that run with `release`, which was withdrawn: those that did so `before` that, and those
    /// that do so now. Returns the numbers of all that were paused, by this call or meanwhile by the server that
    /// carries them out, and the first error. What is not paused here is paused by that server when it next looks.
    ///
    /// # Cancellation safety
    /// Some may be paused, and others not.
    pub async fn pause_all_of(
        &self,
        release: &str,
        before: Vec<i64>,
    ) -> (Vec<i64>, Result<(), RolloutError>) {
        let mut running: BTreeSet<i64> = before.into_iter().collect();
        let mut first = match self.running_with(release).await {
            Ok(now) => {
                running.extend(now);
                Ok(())
            }
            Err(error) => Err(error),
        };
        let mut paused = Vec::new();
        for id in running {
            match self.act(id, Action::Pause).await {
                Ok(()) | Err(RolloutError::Command(CommandError::Paused)) => paused.push(id),
                // It is over, or about to be.
                Err(RolloutError::Command(_)) => {}
                Err(error) => first = first.and(Err(error)),
            }
        }
        (paused, first)
    }

    async fn ask<T>(
        &self,
        request: Request,
        answered: oneshot::Receiver<Result<T, RolloutError>>,
    ) -> Result<T, RolloutError> {
        let stopping = || RolloutError::Stopping;
        let asked = self.requests.send(request).await;
        asked.map_err(|_| stopping())?;
        answered.await.map_err(|_| stopping())?
    }
}
