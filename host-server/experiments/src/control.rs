//! Making experiments, and starting, pausing and ending them.

use std::collections::HashMap;
use std::sync::Arc;

use crawler_records::{
    EventLevel, Experiment, ExperimentKind, ExperimentState, NewExperiment, RecordsError,
};
use crawler_system::clock::now_ms;
use serde_json::{Map, Value};
use tokio_util::task::TaskTracker;

use super::keeper::{count, divide, metrics, or_unknown, recount};
use super::recipe::{FieldError, read};
use super::worker::build_of;
use super::{Experiments, Tally, training};

use ExperimentState::{Created, Paused, Running, Stopped};

/// What can be done about an experiment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Has it run for the first time.
    Start,
    /// Has it wait.
    Pause,
    /// Has it run on.
    Resume,
    /// Ends it.
    Stop,
}

impl Action {
    /// Its name in the audit log.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Start => "experiment.start",
            Self::Pause => "experiment.pause",
            Self::Resume => "experiment.resume",
            Self::Stop => "experiment.stop",
        }
    }

    /// What it makes of an experiment, where it can be done.
    const fn of(self, state: ExperimentState) -> Option<ExperimentState> {
        match (self, state) {
            (Self::Start, Created) | (Self::Resume, Paused) => Some(Running),
            (Self::Pause, Running) => Some(Paused),
            (Self::Stop, Created | Running | Paused) => Some(Stopped),
            _ => None,
        }
    }
}

/// Why something is not done.
#[derive(Debug)]
pub enum ControlError {
    /// Fields that are wrong.
    Invalid(Vec<FieldError>),
    /// There is none of that number.
    Unknown,
    /// It is in a state in which this cannot be done.
    WrongState(ExperimentState),
    /// Another build of the program has run a part of it; which.
    OtherBuild(String),
    /// There are as many as may be; of what.
    TooMany(&'static str),
    /// Too many recipes are being tried out.
    Busy,
    /// The records failed.
    Records(RecordsError),
    /// A mistake of ours.
    Internal(&'static str),
}

impl From<RecordsError> for ControlError {
    fn from(error: RecordsError) -> Self {
        match error {
            RecordsError::TooMany(what) => Self::TooMany(what),
            error => Self::Records(error),
        }
    }
}

/// Carries out `work` also when whoever waits for it goes away: it is not to end half-way.
async fn whole<T: Send + 'static>(
    tasks: &TaskTracker,
    work: impl Future<Output = Result<T, ControlError>> + Send + 'static,
) -> Result<T, ControlError> {
    let done = tasks.spawn(work).await;
    done.unwrap_or(Err(ControlError::Internal(
        "a task of experiments ended badly",
    )))
}

/// An experiment of either kind, to be made.
struct Made {
    kind: ExperimentKind,
    name: String,
    recipe: Result<String, serde_json::Error>,
    metrics: String,
    /// Trials, or rounds.
    seeds: u32,
    start: bool,
}

/// Reads a body, and builds the first world of an evaluation.
fn tried(mut body: Map<String, Value>) -> Result<Made, Vec<FieldError>> {
    let kind = match body.remove("kind") {
        None | Some(Value::Null) => ExperimentKind::Evaluation,
        Some(kind) => kind
            .as_str()
            .and_then(|kind| kind.parse().ok())
            .ok_or_else(|| {
                vec![FieldError {
                    pointer: "/kind".to_owned(),
                    detail: "is none of evaluation, training".to_owned(),
                }]
            })?,
    };
    match kind {
        ExperimentKind::Evaluation => {
            let wanted = read(body)?;
            wanted.build()?;
            Ok(Made {
                kind,
                recipe: serde_json::to_string(&wanted.recipe),
                name: wanted.name,
                metrics: metrics(),
                seeds: wanted.recipe.seeds,
                start: wanted.start,
            })
        }
        ExperimentKind::Training => {
            let wanted = training::read(body)?;
            Ok(Made {
                kind,
                recipe: serde_json::to_string(&wanted.asked),
                name: wanted.name,
                metrics: "[]".to_owned(),
                seeds: wanted.rounds,
                start: wanted.start,
            })
        }
    }
}

/// Makes an experiment of a body, once its first world has been built.
///
/// # Errors
/// [`ControlError`]; nothing is stored then.
///
/// # Cancellation safety
/// An experiment is made as a whole, or not at all.
pub async fn create(
    experiments: &Arc<Experiments>,
    by: String,
    body: Map<String, Value>,
) -> Result<Experiment, ControlError> {
    let permit = Arc::clone(&experiments.building).try_acquire_owned();
    let permit = permit.map_err(|_| ControlError::Busy)?;
    let tried = tokio::task::spawn_blocking(move || {
        let _permit = permit;
        tried(body)
    });
    let wanted = match tried.await {
        Ok(wanted) => wanted.map_err(ControlError::Invalid)?,
        Err(_) => return Err(ControlError::Internal("a world could not be built")),
    };
    let (experiments, tasks) = (Arc::clone(experiments), &experiments.tasks);
    whole(tasks, async move {
        let new = NewExperiment {
            kind: wanted.kind,
            owner: experiments.owner.clone(),
            name: wanted.name,
            build: build_of(wanted.kind).to_owned(),
            recipe: wanted
                .recipe
                .map_err(|_| ControlError::Internal("a recipe cannot be written"))?,
            metrics: wanted.metrics,
            seeds: wanted.seeds,
            by,
            created: now_ms(),
            start: wanted.start,
        };
        let _alone = experiments.tallies.lock().await;
        let row = experiments.records.experiments().add(new).await?;
        if row.state == Running {
            take_up(&experiments, row.clone()).await;
        }
        recount(&experiments).await;
        Ok(row)
    })
    .await
}

/// Takes up what runs from now on, and tells of it.
async fn take_up(experiments: &Experiments, row: Experiment) {
    let word = if row.done > 0 { "goes on" } else { "begins" };
    if row.kind == ExperimentKind::Training {
        let text = format!("training “{}” {word}: {} rounds", row.name, row.seeds);
        experiments.tell(EventLevel::Info, text);
        experiments.trainer.wake();
        return;
    }
    let text = format!("experiment “{}” {word}: {} trials", row.name, row.seeds);
    experiments.tell(EventLevel::Info, text);
    let id = row.id;
    // One that this program cannot run, the keeper finds and says so.
    if let Ok(plan) = experiments.worker.take_up(row)
        && let Err(error) = divide(experiments, id, &plan).await
    {
        // The keeper looks for it again.
        tracing::warn!(%error, "an experiment is not divided yet");
    }
}

/// Starts, pauses, resumes or stops an experiment.
///
/// # Errors
/// [`ControlError`]; it goes on as before then.
///
/// # Cancellation safety
/// It is done as a whole, or not at all.
pub async fn act(
    experiments: &Arc<Experiments>,
    id: i64,
    action: Action,
) -> Result<Experiment, ControlError> {
    let (experiments, tasks) = (Arc::clone(experiments), &experiments.tasks);
    whole(tasks, async move {
        let mut tallies = experiments.tallies.lock().await;
        let row = find(&experiments, id).await?;
        let to = action
            .of(row.state)
            .ok_or(ControlError::WrongState(row.state))?;
        if to == Running {
            adopt(&experiments, &row).await?;
        } else if row.kind == ExperimentKind::Evaluation {
            stand(&experiments, &mut tallies, id).await?;
        }
        let moved =
            experiments
                .records
                .experiments()
                .change_state(id, row.state, to, None, now_ms());
        let row = match moved.await {
            Ok(row) => row,
            // It came to its end just now.
            Err(RecordsError::NotFound) => {
                let now = find(&experiments, id).await?;
                return Err(ControlError::WrongState(now.state));
            }
            Err(error) => return Err(error.into()),
        };
        let tally = tallies.remove(&id);
        if to == Running {
            take_up(&experiments, row.clone()).await;
        } else {
            experiments.worker.leave(id);
            if let Err(error) = experiments.worker.release(id).await {
                tracing::warn!(%error, "what is held of an experiment is free when its lease ends");
            }
            experiments.trainer.wake();
            let text = match tally {
                Some(tally) => tally.farewell(to),
                None if row.kind == ExperimentKind::Training => format!(
                    "training “{}” is {to} after {} of {} rounds",
                    row.name, row.done, row.seeds
                ),
                None => format!("experiment “{}” is {to}", row.name),
            };
            experiments.tell(EventLevel::Info, text);
        }
        recount(&experiments).await;
        Ok(row)
    })
    .await
}

/// Has this build run an experiment of which nothing is done, whoever made it.
async fn adopt(experiments: &Experiments, row: &Experiment) -> Result<(), ControlError> {
    let build = build_of(row.kind);
    if row.build == build {
        return Ok(());
    }
    let parts = experiments.records.parts();
    if row.done == 0 && parts.adopt(row.id, build).await? {
        return Ok(());
    }
    Err(ControlError::OtherBuild(or_unknown(&row.build).to_owned()))
}

/// Gives up what this server does of an experiment, and counts all that is done of it, so that it is there before it
/// says that it stands.
async fn stand(
    experiments: &Experiments,
    tallies: &mut HashMap<i64, Tally>,
    id: i64,
) -> Result<(), ControlError> {
    experiments.worker.board.leave(id);
    experiments.worker.store_of(id).await?;
    Ok(count(experiments, tallies, id).await?)
}

/// Deletes an experiment that does not run, whoever ran it.
///
/// # Errors
/// [`ControlError`]; it is as it was then.
pub async fn delete(experiments: &Arc<Experiments>, id: i64) -> Result<(), ControlError> {
    let (experiments, tasks) = (Arc::clone(experiments), &experiments.tasks);
    whole(tasks, async move {
        let _alone = experiments.tallies.lock().await;
        let row = find(&experiments, id).await?;
        match experiments.records.experiments().delete(id).await {
            Ok(()) => {
                experiments.trainer.wake();
                recount(&experiments).await;
                Ok(())
            }
            Err(RecordsError::NotFound) => Err(ControlError::WrongState(row.state)),
            Err(error) => Err(error.into()),
        }
    })
    .await
}

/// The experiment of that number.
async fn find(experiments: &Experiments, id: i64) -> Result<Experiment, ControlError> {
    let row = experiments.records.experiments().get(id).await?;
    row.ok_or(ControlError::Unknown)
}
