//! The thread that learns.

use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crawler_federation::Broker;
use crawler_learning::RunError;
use crawler_records::Experiment;
use crawler_sim::scenario::Scenario;
use crawler_system::data::make_private;
use crawler_system::process::give_way;

use super::asked::Means;
use super::learning::{Learning, Step};
use super::told::{CurvePoint, NodesView, Outcome, SO_FAR, Score};
use crate::worker::TRAINING_BUILD;

/// Says which program began a training.
const BUILD_FILE: &str = "build";
/// How much of the rate is that of the last round.
const FRESH: f64 = 0.2;

/// A training under way.
#[derive(Debug)]
pub(super) struct Job {
    pub(super) id: i64,
    pub(super) created: i64,
    /// Has it stand after the round.
    pub(super) stop: AtomicBool,
    /// Rounds that are kept.
    pub(super) kept: AtomicU64,
    progress: Mutex<Progress>,
}

#[derive(Debug, Default)]
struct Progress {
    points: Vec<CurvePoint>,
    rate: Option<f64>,
    judging: bool,
    nodes: Option<NodesView>,
}

/// What is to be learned, and where.
#[derive(Debug)]
pub(super) struct Work {
    pub(super) means: Means,
    /// Names the run to nodes.
    pub(super) id: u64,
    /// Where nodes are met.
    pub(super) broker: Option<Broker>,
    pub(super) scenario: Scenario,
    pub(super) folder: PathBuf,
    pub(super) threads: NonZeroUsize,
    /// Whether the records know of a round that is kept.
    pub(super) is_begun: bool,
}

impl Job {
    pub(super) fn new(training: &Experiment) -> Self {
        Self {
            id: training.id,
            created: training.created,
            stop: AtomicBool::new(false),
            kept: AtomicU64::new(0),
            progress: Mutex::default(),
        }
    }

    pub(super) fn is_of(&self, training: &Experiment) -> bool {
        (self.id, self.created) == (training.id, training.created)
    }

    fn progress(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says how far it is.
    pub(super) fn tell(&self, outcome: &mut Outcome) {
        let progress = self.progress();
        if let Some(last) = progress.points.last() {
            outcome.last = Some(*last);
            outcome.rounds = last.round;
        }
        outcome.rate = progress.rate;
        outcome.judging = progress.judging;
        outcome.nodes.clone_from(&progress.nodes);
    }

    pub(super) fn with_points<T>(&self, look: impl FnOnce(&[CurvePoint]) -> T) -> T {
        look(&self.progress().points)
    }

    /// Learns until all is learned and judged, or until it is told to stand: `None` then.
    ///
    /// # Errors
    /// See [`RunError`].
    pub(super) fn learn(&self, work: &Work) -> Result<Option<Score>, RunError> {
        if let Err(error) = give_way() {
            tracing::warn!(%error, "a training does not give way to other threads");
        }
        prepare(work)?;
        let mut run = Learning::open(work)?;
        self.progress().points = CurvePoint::all(run.curve());
        self.kept.store(run.rounds(), Ordering::Relaxed);
        let mut began = Instant::now();
        loop {
            if self.stop.load(Ordering::Relaxed) {
                if run.rounds() > self.kept.load(Ordering::Relaxed) {
                    run.keep()?;
                    self.keep(&run, &work.folder)?;
                }
                run.stand();
                return Ok(None);
            }
            let before = self.steps();
            let line = match run.step()? {
                Step::Waits(nodes) => {
                    self.progress().nodes = Some(nodes);
                    continue;
                }
                Step::Round(line) => line,
                Step::Over => break,
            };
            let fresh = (line.steps - before) as f64 / began.elapsed().as_secs_f64().max(1e-6);
            began = Instant::now();
            {
                let mut progress = self.progress();
                progress.points.push(CurvePoint::of(&line));
                let rate = progress
                    .rate
                    .map_or(fresh, |rate| rate + FRESH * (fresh - rate));
                progress.rate = Some(rate);
                progress.nodes = run.nodes();
            }
            if run.is_kept(&line) {
                self.keep(&run, &work.folder)?;
            }
        }
        self.progress().judging = true;
        let summary = run.finish()?;
        self.kept.store(run.rounds(), Ordering::Relaxed);
        run.end();
        Ok(Some(Score::of(&summary)))
    }

    fn steps(&self) -> u64 {
        self.with_points(|points| points.last().map_or(0, |point| point.steps))
    }

    /// Puts the policy of a checkpoint beside it.
    fn keep(&self, run: &Learning, folder: &Path) -> Result<(), RunError> {
        write(&folder.join(SO_FAR), &run.so_far()?)?;
        self.kept.store(run.rounds(), Ordering::Relaxed);
        Ok(())
    }
}

/// Has the folder hold nothing that another program began.
fn prepare(work: &Work) -> Result<(), RunError> {
    let at = |path: &Path| {
        let path = path.to_owned();
        |error| RunError::File(path, error)
    };
    let (folder, path) = (&work.folder, work.folder.join(BUILD_FILE));
    if !work.is_begun && fs::read(&path).is_ok_and(|build| build != TRAINING_BUILD.as_bytes()) {
        fs::remove_dir_all(folder).map_err(at(folder))?;
    }
    make_private(folder).map_err(at(folder))?;
    write(&path, TRAINING_BUILD.as_bytes())
}

/// Writes a file so that there is the old one or the new one.
fn write(path: &Path, bytes: &[u8]) -> Result<(), RunError> {
    let beside = path.with_extension("new");
    let written = fs::write(&beside, bytes).and_then(|()| fs::rename(&beside, path));
    written.map_err(|error| RunError::File(path.to_owned(), error))
}
