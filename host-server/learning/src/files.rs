//! The files of a run beside its policy: the curve, the same for `TensorBoard`, and the checkpoint.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use crawler_policy::{Compute, Policy};
use crawler_sim::scenario::Scenario;
use serde_json::Value;

use crate::curve::{COLUMNS, Line};
use crate::error::RunError;
use crate::judge::Summary;
use crate::tensorboard::{Events, NAME as EVENTS};

/// All that a run needs to go on.
const CHECKPOINT: &str = "checkpoint";
/// A line for each round.
const CURVE: &str = "curve.csv";

/// Files that grow while a run learns.
pub(crate) struct Files {
    folder: PathBuf,
    /// The curve so far.
    curve: String,
    /// The same for `TensorBoard`.
    events: Events,
}

impl Files {
    /// The checkpoint in `folder`, where there is one, with its path. The folder is made where there is none.
    pub(crate) fn checkpoint(folder: &Path) -> Result<Option<(PathBuf, Vec<u8>)>, RunError> {
        fs::create_dir_all(folder).map_err(|error| RunError::File(folder.to_owned(), error))?;
        let path = folder.join(CHECKPOINT);
        match fs::read(&path) {
            Ok(bytes) => Ok(Some((path, bytes))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(RunError::File(path, error)),
        }
    }

    /// The files in `folder` of a run whose checkpoint is of so many rounds.
    pub(crate) fn open(folder: &Path, rounds: u64) -> Result<Self, RunError> {
        let curve = if rounds == 0 {
            COLUMNS.to_owned()
        } else {
            recall_curve(&folder.join(CURVE), rounds)?
        };
        let lines: Vec<Line> = curve.lines().filter_map(Line::read).collect();
        let events = Events::open(folder, &lines, now_s())
            .map_err(|error| RunError::File(folder.join(EVENTS), error))?;
        Ok(Self {
            folder: folder.to_owned(),
            curve,
            events,
        })
    }

    /// The curve so far, as in its file.
    pub(crate) fn curve(&self) -> &str {
        &self.curve
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Adds a round of so many decisions, which took so long.
    pub(crate) fn add(&mut self, line: Line, decisions: u64, took_s: f64) -> Result<(), RunError> {
        let text = line.csv();
        self.curve += &text;
        // What the curve has, and not what it was rounded from: who goes on may have nothing else.
        let told = Line::read(&text).unwrap_or(line);
        let added = self.events.add(&told, decisions, took_s, now_s());
        added.map_err(|error| RunError::File(self.path(EVENTS), error))
    }

    /// Writes down the rounds so far, with a checkpoint of the last one.
    pub(crate) fn keep(&self, checkpoint: &[u8]) -> Result<(), RunError> {
        let synced = self.events.sync();
        synced.map_err(|error| RunError::File(self.path(EVENTS), error))?;
        // These first: they may have more than the checkpoint, and never less.
        self.write(CURVE, self.curve.as_bytes())?;
        self.write(CHECKPOINT, checkpoint)
    }

    /// Judges a policy in worlds of `scenario`, and writes it down.
    pub(crate) fn finish(
        &self,
        policy: &Policy,
        scenario: &Arc<Scenario>,
        compute: &Compute,
        options: &Value,
        rounds: u64,
    ) -> Result<Summary, RunError> {
        let summary = Summary::of(policy, scenario, compute)?;
        self.write("policy", &policy.to_bytes())?;
        self.write("policy.tcpo", &summary.blob)?;
        let told = summary.describe(policy, scenario, options, rounds);
        self.write("run.json", told.as_bytes())?;
        Ok(summary)
    }

    /// Writes a file so that there is the old one or the new one, whatever happens.
    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), RunError> {
        let (path, beside) = (self.path(name), self.path(&format!("{name}.new")));
        let write = || {
            let mut file = fs::File::create(&beside)?;
            io::Write::write_all(&mut file, bytes)?;
            file.sync_all()?;
            fs::rename(&beside, &path)
        };
        write().map_err(|error| RunError::File(path.clone(), error))
    }
}

/// The curve in a file up to the last of `rounds`.
fn recall_curve(path: &Path, rounds: u64) -> Result<String, RunError> {
    let text = fs::read_to_string(path).map_err(|error| RunError::File(path.to_owned(), error))?;
    let mut lines = text.split_inclusive('\n');
    let is_head = lines.next() == Some(COLUMNS);
    let kept: Vec<&str> = lines.take(rounds as usize).collect();
    let numbers = kept.iter().map(|line| Some(Line::read(line)?.round));
    if !is_head || !numbers.eq((1..=rounds).map(Some)) {
        let odd = io::Error::new(
            io::ErrorKind::InvalidData,
            "is damaged, or of another version",
        );
        return Err(RunError::File(path.to_owned(), odd));
    }
    let mut curve = COLUMNS.to_owned();
    curve.extend(kept);
    Ok(curve)
}

/// Seconds since 1970; 0 for a clock that is before.
fn now_s() -> f64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0.0, |now| now.as_secs_f64())
}
