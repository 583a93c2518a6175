//! Has trainings run, stand and end as the records say.

use std::error::Error;
use std::fmt;
use std::fs;
use std::future::pending;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crawler_learning::RunError;
use crawler_records::{EventLevel, Experiment, ExperimentState, RecordsError};
use crawler_system::clock::now_ms;
use tokio::sync::oneshot;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use super::asked::Untrainable;
use super::job::{Job, Work};
use super::told::{CHECKPOINT, Outcome, SO_FAR, Score};
use super::{Asked, folder_in};
use crate::Experiments;
use crate::keeper::{fail, or_unknown, recount};
use crate::worker::TRAINING_BUILD;

/// How often the records are asked for what runs.
const LOOK: Duration = Duration::from_secs(1);
/// For a round to end when the server does.
const PATIENCE: Duration = Duration::from_secs(5);

type Ended = Result<Result<Option<Score>, RunError>, oneshot::error::RecvError>;

/// What is being trained.
struct Current {
    job: Arc<Job>,
    training: Experiment,
    ended: oneshot::Receiver<Result<Option<Score>, RunError>>,
    /// Rounds that the records know of.
    noted: u64,
}

/// Goes on with the trainings that ran when the server stopped, and trains what runs, until `stop`; then keeps what is
/// learned by then.
pub async fn train(experiments: Arc<Experiments>, stop: CancellationToken) {
    let mut keeper = Keeper {
        experiments: &experiments,
        current: None,
        is_tidy: false,
    };
    let mut look = tokio::time::interval(LOOK);
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut away = false;
    loop {
        let ended = tokio::select! {
            () = stop.cancelled() => break,
            () = experiments.trainer.changed.notified() => {
                keeper.is_tidy = false;
                None
            }
            _ = look.tick() => None,
            ended = keeper.ended() => Some(ended),
        };
        let outcome = keeper.step(ended).await;
        match outcome {
            Ok(()) if away => tracing::info!("trainings go on: the records are there again"),
            Err(ref error) if !away => tracing::warn!(%error, "trainings wait for the records"),
            _ => {}
        }
        away = outcome.is_err();
    }
    keeper.leave().await;
}

struct Keeper<'a> {
    experiments: &'a Experiments,
    current: Option<Current>,
    /// Whether nothing is on the disk that nobody needs.
    is_tidy: bool,
}

impl Keeper<'_> {
    /// Waits for the thread that learns.
    async fn ended(&mut self) -> Ended {
        match &mut self.current {
            Some(current) => (&mut current.ended).await,
            None => pending().await,
        }
    }

    async fn step(&mut self, ended: Option<Ended>) -> Result<(), RecordsError> {
        if let Some(ended) = ended
            && let Some(current) = self.current.take()
        {
            self.is_tidy = false;
            let taken = self.take_in(current, ended).await;
            // Until the records have it, the thread knows best.
            *self.experiments.trainer.now() = None;
            taken?;
        }
        if !self.is_tidy {
            self.tidy().await?;
            self.is_tidy = true;
        }
        let running = self
            .experiments
            .records
            .experiments()
            .running_trainings()
            .await?;
        match &mut self.current {
            Some(current) => {
                if !running.iter().any(|row| current.job.is_of(row)) {
                    current.job.stop.store(true, Ordering::Relaxed);
                }
                note(self.experiments, current).await
            }
            None => self.begin(running).await,
        }
    }

    /// Begins the first that can be trained.
    async fn begin(&mut self, running: Vec<Experiment>) -> Result<(), RecordsError> {
        let experiments = self.experiments;
        for training in running {
            if !experiments.is_own(&training.owner) {
                continue;
            }
            let id = training.id;
            match start(experiments, training) {
                Ok(current) => {
                    *experiments.trainer.now() = Some(Arc::clone(&current.job));
                    self.current = Some(current);
                    return Ok(());
                }
                Err(why) => fail(experiments, id, &why.to_string()).await,
            }
        }
        Ok(())
    }

    /// Takes in how the thread ended.
    async fn take_in(&self, mut current: Current, ended: Ended) -> Result<(), RecordsError> {
        let experiments = self.experiments;
        let id = current.training.id;
        match ended {
            Ok(Ok(Some(score))) => complete(experiments, &current, score).await?,
            Ok(Ok(None)) => note(experiments, &mut current).await?,
            // There may be room for it later, and nothing is lost.
            Ok(Err(RunError::File(path, error))) if error.kind() != io::ErrorKind::InvalidData => {
                let why = format!("{}: {error}", called(&path));
                let (from, to) = (ExperimentState::Running, ExperimentState::Paused);
                let moved = experiments.records.experiments().change_state(
                    id,
                    from,
                    to,
                    Some(&why),
                    now_ms(),
                );
                match moved.await {
                    Ok(row) => {
                        let text = format!("training “{}” is paused: {why}", row.name);
                        experiments.tell(EventLevel::Error, text);
                    }
                    Err(RecordsError::NotFound) => {}
                    Err(error) => return Err(error),
                }
                recount(experiments).await;
            }
            Ok(Err(error)) => fail(experiments, id, &because(&error)).await,
            Err(_) => fail(experiments, id, "a mistake of the program ended it").await,
        }
        Ok(())
    }

    /// Has the thread stand, and keeps what it learned.
    async fn leave(&mut self) {
        let Some(mut current) = self.current.take() else {
            return;
        };
        current.job.stop.store(true, Ordering::Relaxed);
        match tokio::time::timeout(PATIENCE, &mut current.ended).await {
            Ok(ended) => {
                if let Err(error) = self.take_in(current, ended).await {
                    tracing::warn!(%error, "what is learned is kept, and the records do not know it");
                }
            }
            Err(_) => {
                tracing::warn!(
                    "a round of a training does not end: it goes on from the checkpoint before"
                );
            }
        }
        *self.experiments.trainer.now() = None;
    }

    /// Deletes the files of trainings that are gone, and of those that are over what nobody needs any more.
    async fn tidy(&self) -> Result<(), RecordsError> {
        let folder = self.experiments.trainer.folder.clone();
        let listing = tokio::task::spawn_blocking(move || folders(&folder)).await;
        for (id, created) in listing.unwrap_or_default() {
            if self
                .current
                .as_ref()
                .is_some_and(|current| (current.job.id, current.job.created) == (id, created))
            {
                continue;
            }
            let row = self.experiments.records.experiments().get(id).await?;
            let row = row.filter(|row| row.created == created);
            let folder = folder_in(&self.experiments.trainer.folder, id, created);
            let state = row.map(|row| row.state);
            let removed = tokio::task::spawn_blocking(move || match state {
                None => fs::remove_dir_all(&folder),
                Some(state) if state.is_over() => {
                    remove(&folder.join(CHECKPOINT))?;
                    if state == ExperimentState::Completed {
                        remove(&folder.join(SO_FAR))?;
                    }
                    Ok(())
                }
                Some(_) => Ok(()),
            });
            if let Ok(Err(error)) = removed.await {
                tracing::warn!(%error, id, "files of a training stay where they are");
            }
        }
        Ok(())
    }
}

/// Why a training cannot go on here.
#[derive(Debug)]
enum TrainingError {
    /// Another build has begun it.
    OtherBuild(String),
    /// What was asked for is of another version.
    Unreadable(serde_json::Error),
    /// It asks for what there is not.
    Asked(Untrainable),
    /// There is no thread for it.
    Thread(io::Error),
}

impl fmt::Display for TrainingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const OTHER: &str = "this version of the program cannot train it";
        match self {
            Self::OtherBuild(build) => write!(
                f,
                "another build of the program has begun it ({}): this one ({TRAINING_BUILD}) would come to other \
                 weights; make it anew",
                or_unknown(build)
            ),
            Self::Unreadable(error) => write!(f, "{OTHER}: {error}"),
            Self::Asked(error) => write!(f, "{OTHER}: {error}"),
            Self::Thread(error) => write!(f, "there is no thread for it: {error}"),
        }
    }
}

impl Error for TrainingError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::OtherBuild(_) => None,
            Self::Unreadable(error) => Some(error),
            Self::Asked(error) => Some(error),
            Self::Thread(error) => Some(error),
        }
    }
}

/// Starts the thread that learns.
fn start(experiments: &Experiments, training: Experiment) -> Result<Current, TrainingError> {
    if training.build != TRAINING_BUILD {
        return Err(TrainingError::OtherBuild(training.build));
    }
    let asked: Asked = serde_json::from_str(&training.recipe).map_err(TrainingError::Unreadable)?;
    let work = Work {
        means: asked.means().map_err(TrainingError::Asked)?,
        // Numbers of experiments begin with 1.
        id: training.id.unsigned_abs(),
        broker: experiments.trainer.broker.clone(),
        scenario: asked.scenario().map_err(TrainingError::Asked)?,
        folder: experiments.trainer.folder_of(&training),
        threads: experiments.trainer.threads,
        is_begun: training.done > 0,
    };
    let job = Arc::new(Job::new(&training));
    let (tell, ended) = oneshot::channel();
    let own = Arc::clone(&job);
    let thread = std::thread::Builder::new().name("training".to_owned());
    let learn = move || {
        // Nobody listens any more when the server ends.
        let _ = tell.send(own.learn(&work));
    };
    thread.spawn(learn).map_err(TrainingError::Thread)?;
    Ok(Current {
        job,
        noted: training.done.into(),
        training,
        ended,
    })
}

/// Notes in the records what is kept.
async fn note(experiments: &Experiments, current: &mut Current) -> Result<(), RecordsError> {
    let kept = current.job.kept.load(Ordering::Relaxed);
    if kept == current.noted {
        return Ok(());
    }
    let mut outcome = Outcome::default();
    current.job.tell(&mut outcome);
    outcome.last = current.job.with_points(|points| {
        let at = points.partition_point(|point| point.round < kept);
        points.get(at).filter(|point| point.round == kept).copied()
    });
    store(experiments, &current.training, kept, &outcome).await?;
    current.noted = kept;
    Ok(())
}

async fn store(
    experiments: &Experiments,
    training: &Experiment,
    kept: u64,
    outcome: &Outcome,
) -> Result<(), RecordsError> {
    // There are no more than the records have room for.
    let done = u32::try_from(kept).unwrap_or(u32::MAX);
    // Numbers and names of ours can be written.
    let results = serde_json::to_string(outcome).unwrap_or_default();
    match experiments
        .records
        .experiments()
        .note_training(training.id, done, results)
        .await
    {
        // Somebody has stopped it.
        Err(RecordsError::NotFound) => Ok(()),
        other => other,
    }
}

/// Notes that all is learned and judged.
async fn complete(
    experiments: &Experiments,
    current: &Current,
    score: Score,
) -> Result<(), RecordsError> {
    let mut outcome = Outcome::default();
    current.job.tell(&mut outcome);
    let share = score.success;
    outcome.score = Some(score);
    let kept = current.job.kept.load(Ordering::Relaxed);
    let training = &current.training;
    store(experiments, training, kept, &outcome).await?;
    let (from, to) = (ExperimentState::Running, ExperimentState::Completed);
    let moved =
        experiments
            .records
            .experiments()
            .change_state(training.id, from, to, None, now_ms());
    match moved.await {
        Ok(row) => {
            let text = format!(
                "training “{}” is completed: {:.1} % of worlds that it never saw",
                row.name,
                share * 100.0
            );
            experiments.tell(EventLevel::Info, text);
        }
        // Paused or stopped just now; who resumes it has it judged once more.
        Err(RecordsError::NotFound) => {}
        Err(error) => return Err(error),
    }
    recount(experiments).await;
    Ok(())
}

/// Folders of trainings, by number and when they were made.
fn folders(folder: &Path) -> Vec<(i64, i64)> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let named = |entry: fs::DirEntry| {
        let name = entry.file_name();
        let (id, created) = name.to_str()?.split_once('-')?;
        let parsed = (id.parse().ok()?, created.parse().ok()?);
        // What is called otherwise is somebody else's.
        let own = folder_in(folder, parsed.0, parsed.1) == entry.path();
        own.then_some(parsed)
    };
    entries.filter_map(named).collect()
}

fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// The name of a file, without where this server has it.
fn called(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// Why it cannot go on, for people.
fn because(error: &RunError) -> String {
    match error {
        RunError::File(path, error) => format!("{}: {error}", called(path)),
        RunError::Checkpoint(_, error) => format!("its checkpoint cannot be used: {error}"),
        error => error.to_string(),
    }
}
