//! What is said of a training.

use std::fs;
use std::io::{self, Read as _};
use std::path::Path;

use crawler_federated::Coordinator;
use crawler_federated::coordinator::{Part, Round};
use crawler_learning::{EVENTS, JUDGED, Judged, Line, Summary};
use crawler_records::{Experiment, ExperimentKind, ExperimentState};
use crawler_sim::evaluate::of_share;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use utoipa::ToSchema;

use crate::Experiments;

/// Files that are given away, with their media types.
const FILES: [(&str, &str); 6] = [
    ("policy.tcpo", "application/octet-stream"),
    (SO_FAR, "application/octet-stream"),
    ("policy", "application/octet-stream"),
    (CURVE, "text/csv; charset=utf-8"),
    (EVENTS, "application/octet-stream"),
    ("run.json", "application/json"),
];
/// What was learned by the last round that is kept, as robots have it.
pub(super) const SO_FAR: &str = "so-far.tcpo";
/// A line for each round.
pub(super) const CURVE: &str = "curve.csv";
/// All that goes on with it.
pub(super) const CHECKPOINT: &str = "checkpoint";
/// Largest file, in bytes: far more than any has.
const MAX_FILE: u64 = 8 * 1024 * 1024;
/// Seconds of a decision.
const DECISION_S: f32 = 0.1;

/// What a round of learning came to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = TrainingPoint)]
pub struct CurvePoint {
    /// The round, from 1.
    pub round: u64,
    /// Decisions of all robots so far.
    pub steps: u64,
    /// Episodes that ended in the round.
    pub episodes: usize,
    /// Mean of what robots were rewarded with in an episode; `null` where none ended.
    pub reward: Option<f32>,
    /// Share of the episodes; `null` where none ended.
    pub success: Option<f32>,
    /// Mean length of the episodes in seconds; `null` where none ended.
    pub length_s: Option<f32>,
    /// How undecided the policy is, in nats.
    pub entropy: f64,
    /// How far the policy has moved in the round, an estimate of the Kullback-Leibler divergence.
    pub divergence: f64,
    /// Share of the samples at which the policy was held back.
    pub clipped: f64,
    /// Loss of the critic: half of its squared error.
    pub critic: f64,
    /// Loss of the policy: the clipped objective, negative.
    pub loss: f64,
    /// Share of the decisions from which the shield took something; `null` where nobody has counted.
    pub vetoes: Option<f32>,
}

impl CurvePoint {
    pub(super) fn of(line: &Line) -> Self {
        let told = |number: f32| Some(number).filter(|number| number.is_finite());
        Self {
            round: line.round,
            steps: line.steps,
            episodes: line.episodes,
            reward: told(line.reward),
            success: told(line.success),
            length_s: told(line.length * DECISION_S),
            entropy: line.entropy,
            divergence: line.divergence,
            clipped: line.clipped,
            critic: line.critic,
            loss: line.loss,
            vetoes: told(line.vetoes),
        }
    }

    pub(super) fn all(curve: &str) -> Vec<Self> {
        let lines = curve.lines().filter_map(Line::read);
        lines.map(|line| Self::of(&line)).collect()
    }
}

/// What a policy came to in worlds that it did not learn from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = TrainingScore)]
pub struct Score {
    /// Episodes that it was judged on.
    pub episodes: u32,
    /// Share of them that succeeded, as robots have the policy.
    pub success: f64,
    /// Lower end of the 95 % interval, Wilson's.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Their mean length, in seconds.
    pub length_s: f32,
    /// Share of them that succeeded by the policy in floats.
    pub floats: f64,
    /// Bytes of the policy for robots.
    pub bytes: u64,
    /// SHA-256 of the policy for robots.
    pub sha256: String,
}

impl Score {
    pub(super) fn of(summary: &Summary) -> Self {
        let share = |judged: &Judged| f64::from(judged.success);
        let successes = (share(&summary.whole) * f64::from(JUDGED)).round() as usize;
        let estimate = of_share(successes, JUDGED as usize);
        let sha256 = Sha256::digest(&summary.blob);
        Self {
            episodes: JUDGED,
            success: estimate.map_or(0.0, |estimate| estimate.mean),
            low: estimate.map_or(0.0, |estimate| estimate.low),
            high: estimate.map_or(1.0, |estimate| estimate.high),
            length_s: summary.whole.length * DECISION_S,
            floats: share(&summary.floats),
            bytes: summary.blob.len() as u64,
            sha256: crawler_system::text::hex(&sha256),
        }
    }
}

/// What the records have of how far a training is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The last round that is kept.
    pub last: Option<CurvePoint>,
    /// Once it is over.
    pub score: Option<Score>,
    /// Decisions per second of late.
    pub rate: Option<f64>,
    /// Whether all is learned and the policy is being judged.
    #[serde(skip)]
    pub judging: bool,
    /// What nodes are at, where nodes learn and it runs.
    #[serde(skip)]
    pub nodes: Option<NodesView>,
    /// How many rounds there are.
    #[serde(skip)]
    pub rounds: u64,
}

/// What the nodes of a training are at.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = TrainingNodes)]
pub struct NodesView {
    /// How many are expected.
    pub expected: usize,
    /// How many have to answer a round.
    pub quorum: usize,
    /// Who has answered the round under way.
    pub answered: Vec<String>,
    /// Those of the last round; empty before there was one since the server started.
    pub last: Vec<NodeView>,
    /// Updates that were taken, in the whole training.
    pub taken: u64,
    /// Updates that came twice.
    pub doubled: u64,
    /// Updates that came after their round.
    pub late: u64,
    /// Messages that were no updates, or of none that was asked for.
    pub refused: u64,
}

/// What a node said of a round.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = TrainingNode)]
pub struct NodeView {
    /// Its name.
    pub node: String,
    /// Decisions that it learned from.
    pub decisions: u32,
    /// Episodes that came to an end there.
    pub episodes: u32,
    /// Share of them that succeeded; `null` where none ended.
    pub success: Option<f32>,
    /// Their mean reward; `null` where none ended.
    pub reward: Option<f32>,
    /// How far it would move the weights: the length of its update.
    pub step: f64,
}

impl NodesView {
    pub(super) fn of(coordinator: &Coordinator, last: Option<&Round>) -> Self {
        let (settings, counts) = (coordinator.settings(), coordinator.counts());
        let node = |part: &Part| {
            let ended = |number: f32| (part.report.episodes > 0).then_some(number);
            NodeView {
                node: part.node.clone(),
                decisions: part.report.samples,
                episodes: part.report.episodes,
                success: ended(part.report.success),
                reward: ended(part.report.reward),
                step: part.step,
            }
        };
        Self {
            expected: settings.nodes,
            quorum: settings.quorum,
            answered: coordinator.answered().map(str::to_owned).collect(),
            last: last.map_or_else(Vec::new, |round| round.nodes.iter().map(node).collect()),
            taken: counts.taken,
            doubled: counts.doubled,
            late: counts.late,
            refused: counts.refused,
        }
    }
}

/// A file that came of a training.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = TrainingFile)]
pub struct TrainingFile {
    /// Its name.
    pub name: &'static str,
    /// How long it is.
    pub bytes: u64,
}

impl Experiments {
    /// How far a training is: by the thread that is at it, or by the records.
    #[must_use]
    pub fn trained(&self, training: &Experiment) -> Outcome {
        // There are none before the first round.
        let mut outcome: Outcome = serde_json::from_str(&training.results).unwrap_or_default();
        outcome.rounds = training.done.into();
        match self.trainer.job(training) {
            Some(job) => job.tell(&mut outcome),
            // How fast one was that stands is of no use.
            None if training.state != ExperimentState::Completed => outcome.rate = None,
            None => {}
        }
        outcome
    }

    /// The rounds of a training after number `after`, at most `limit` of them.
    pub async fn curve(&self, training: &Experiment, after: u64, limit: usize) -> Vec<CurvePoint> {
        let those = move |points: &[CurvePoint]| -> Vec<CurvePoint> {
            let points = points.iter().filter(|point| point.round > after);
            points.take(limit).copied().collect()
        };
        if let Some(job) = self.trainer.job(training) {
            return job.with_points(those);
        }
        let path = self.trainer.folder_of(training).join(CURVE);
        // One that cannot be read has no lines; whoever goes on with it says why.
        let read =
            move || whole(&path).map(|bytes| CurvePoint::all(&String::from_utf8_lossy(&bytes)));
        match tokio::task::spawn_blocking(read).await {
            Ok(Ok(points)) => those(&points),
            _ => Vec::new(),
        }
    }

    /// The files of a training that this server has.
    pub async fn training_files(&self, training: &Experiment) -> Vec<TrainingFile> {
        let folder = self.trainer.folder_of(training);
        let names = self.given(training);
        let look = move || {
            let file = |(name, _): (&'static str, _)| {
                let about = fs::symlink_metadata(folder.join(name)).ok()?;
                about.is_file().then_some(TrainingFile {
                    name,
                    bytes: about.len(),
                })
            };
            names.into_iter().filter_map(file).collect()
        };
        tokio::task::spawn_blocking(look).await.unwrap_or_default()
    }

    /// A file of a training and its media type; `None` where there is none of that name.
    ///
    /// # Errors
    /// When it cannot be read.
    pub async fn training_file(
        &self,
        training: &Experiment,
        name: &str,
    ) -> io::Result<Option<(&'static str, Vec<u8>)>> {
        let mut names = self.given(training).into_iter();
        let Some((name, media)) = names.find(|(known, _)| *known == name) else {
            return Ok(None);
        };
        let path = self.trainer.folder_of(training).join(name);
        let read = tokio::task::spawn_blocking(move || whole(&path)).await;
        match read.map_err(io::Error::other)? {
            Ok(bytes) => Ok(Some((media, bytes))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// What may be there of a training.
    fn given(&self, training: &Experiment) -> Vec<(&'static str, &'static str)> {
        let over = training.state == ExperimentState::Completed;
        let is_own = training.kind == ExperimentKind::Training && self.is_own(&training.owner);
        let names = FILES.into_iter().filter(|(name, _)| match *name {
            CURVE | EVENTS => true,
            SO_FAR => !over,
            _ => over,
        });
        if is_own { names.collect() } else { Vec::new() }
    }
}

/// The bytes of a file that is no larger than any of ours.
fn whole(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    fs::File::open(path)?
        .take(MAX_FILE + 1)
        .read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_FILE {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "is too long"));
    }
    Ok(bytes)
}
