//! What is said of experiments.

use crawler_records::{Experiment, ExperimentKind};
use serde::Serialize;
use utoipa::ToSchema;

use crate::problem::Problem;
use crawler_experiments::{
    AskedNodes, AtWork, CurvePoint, Experiments, Judged, MetricView, NodesView, Recipe, Results,
    Summary, TrainingAsked, TrainingFile, TrainingScore,
};

/// An experiment to be made, of either kind.
#[derive(ToSchema)]
#[allow(dead_code)] // describes a body that is read field by field
#[serde(untagged)]
pub(crate) enum ExperimentRequest {
    Evaluation(NewExperiment),
    Training(NewTraining),
}

/// A training to be made: a policy learns a task, as `terracrawler train` has it do.
#[derive(ToSchema)]
#[allow(dead_code)] // describes a body that is read field by field
pub(crate) struct NewTraining {
    /// `training`.
    #[schema(pattern = "^training$", example = "training")]
    kind: String,
    /// For people, 1 to 64 characters.
    #[schema(min_length = 1, max_length = 64, example = "first policy")]
    name: String,
    /// `ppo`, which it is where it is left out.
    #[schema(pattern = "^ppo$")]
    algorithm: Option<String>,
    /// `spread`, which it is where it is left out.
    #[schema(pattern = "^spread$")]
    task: Option<String>,
    /// Names the run: the same seed and options come to the same bytes. Left out, 1.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_u64)]
    seed: Option<u64>,
    /// Decisions of all robots to learn from; left out, 4,000,000. There are 10,000 rounds at most.
    #[schema(minimum = 1, maximum = 1_000_000_000, example = 400_000)]
    steps: Option<u64>,
    /// Worlds side by side; left out, 64.
    #[schema(minimum = 1, maximum = 256)]
    worlds: Option<u32>,
    /// Units of both hidden layers of the network; left out, 64.
    #[schema(minimum = 4, maximum = 64)]
    units: Option<u32>,
    /// How far the parameters of each world differ from the nominal ones: `none`, `mild` or `wild`; left out, `none`.
    #[schema(pattern = "^(none|mild|wild)$")]
    randomisation: Option<String>,
    /// Whether the critic sees what a robot observes, and no more; left out, it sees the whole world.
    own_critic: Option<bool>,
    /// By how many nodes it is learned, each `terracrawler learn-node` with worlds of its own; left out, by the server. `worlds` is
    /// on each of them then, 8 where left out.
    #[schema(minimum = 1, maximum = 64)]
    nodes: Option<u32>,
    /// How many nodes have to answer a round; left out, more than half.
    #[schema(minimum = 1, maximum = 64)]
    quorum: Option<u32>,
    /// How long the others are waited for, in seconds; left out, 60.
    #[schema(minimum = 1, maximum = 3_600)]
    deadline_s: Option<u32>,
    /// How what nodes learned becomes one: `mean`, `success`, `median`, `trimmed-mean`, `multi-krum` or `norm-clip`; left out, `mean`.
    #[schema(pattern = "^(mean|success|median|trimmed-mean|multi-krum|norm-clip)$")]
    aggregation: Option<String>,
    /// Part of the step before that is taken again; left out, 0.7.
    #[schema(minimum = 0, maximum = 0.99)]
    momentum: Option<f32>,
    /// How strongly each node is pulled back to what all have, the proximal term μ of federated optimisation (Li and others 2020); left out, 0.
    #[schema(minimum = 0, maximum = 10)]
    proximal: Option<f32>,
    /// Whether it starts at once; left out, it does.
    start: Option<bool>,
}

/// An experiment to be made: a scenario that comes along, on many seeds.
#[derive(ToSchema)]
#[allow(dead_code)] // describes a body that is read field by field
pub(crate) struct NewExperiment {
    /// `evaluation`, which it is where it is left out.
    #[schema(pattern = "^evaluation$")]
    kind: Option<String>,
    /// For people, 1 to 64 characters.
    #[schema(min_length = 1, max_length = 64, example = "tight corridor")]
    name: String,
    /// Name of the scenario.
    #[schema(example = "simple-navigation")]
    scenario: String,
    /// Robots in each world; left out, those of the scenario.
    #[schema(minimum = 1, maximum = 10_000)]
    robots: Option<u32>,
    /// How many seeds, each of which makes a trial.
    #[schema(minimum = 1, maximum = 100_000, example = 20)]
    seeds: u32,
    /// The first seed; left out, 1. The last one is 2^53 - 1 at most.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_u64)]
    first_seed: Option<u64>,
    /// From 0 to 1, or the name of one of the scenario's levels.
    #[schema(example = "0.5")]
    difficulty: Option<String>,
    /// How far parameters differ from trial to trial: `none`, `mild` or `wild`.
    #[schema(pattern = "^(none|mild|wild)$")]
    randomisation: Option<String>,
    /// Other values for keys of the scenario, `KEY=VALUE`.
    #[schema(max_items = 32)]
    set: Option<Vec<String>>,
    /// What all trials must come to together, like `success>=0.9`; adds to the scenario's.
    #[schema(max_items = 16)]
    thresholds: Option<Vec<String>>,
    /// Whether it starts at once; left out, it does.
    start: Option<bool>,
}

/// An experiment.
#[derive(Serialize, ToSchema)]
#[schema(as = Experiment)]
pub(crate) struct ExperimentView {
    /// Its id.
    id: String,
    /// `evaluation` or `training`.
    kind: &'static str,
    /// Its name, for people.
    name: String,
    /// Name of the scenario; of a training, of its task.
    scenario: String,
    /// Robots in each world.
    robots: u32,
    /// How many trials it is to have, each of another seed; of a training, how many rounds.
    seeds: u32,
    /// The first seed; of a training, the one that names the run.
    first_seed: u64,
    /// From 0 to 1, or the name of a level; `null` where it is the scenario's.
    difficulty: Option<String>,
    /// `none`, `mild` or `wild`; `null` where it is the scenario's.
    randomisation: Option<String>,
    /// Other values for keys of the scenario.
    set: Vec<String>,
    /// What all trials must come to together, beside what the scenario asks.
    thresholds: Vec<String>,
    /// The account that made it.
    by: String,
    /// When it was made, in Unix milliseconds.
    created_at: i64,
    /// When it was started.
    started_at: Option<i64>,
    /// When it ended.
    ended_at: Option<i64>,
    /// `created`, `running`, `paused`, `stopped`, `completed` or `failed`.
    state: &'static str,
    /// True while it waits until others are done, or for somebody who can work on it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    #[schema(required = false)]
    waiting: bool,
    /// Why it is in that state.
    reason: Option<String>,
    /// How many trials are done: the first ones. Of a training, how many rounds.
    done: u32,
    /// The program that runs it: version, and hashes of robot program and simulator. The same build comes to the
    /// same numbers on any machine.
    build: String,
    /// The servers and workers that are at it now.
    workers: Vec<AtWork>,
    /// What those come to; of a training, what its policy came to in worlds that it did not learn from, once it is over.
    summary: Vec<Summary>,
    /// Every threshold, once all trials are done.
    verdict: Option<Vec<Judged>>,
    /// The command line that comes to the same numbers.
    command: String,
    /// What only trainings have.
    pub(super) training: Option<TrainingView>,
}

/// What only trainings have.
#[derive(Serialize, ToSchema)]
#[schema(as = Training)]
pub(crate) struct TrainingView {
    /// `ppo`.
    algorithm: String,
    /// Decisions of all robots to learn from.
    steps: u64,
    /// Worlds side by side.
    worlds: u32,
    /// Units of both hidden layers of the network.
    units: u32,
    /// Whether the critic sees no more than a robot.
    own_critic: bool,
    /// Decisions per second of late; of one that is over, at its end. `null` for one that stands.
    steps_per_second: Option<f64>,
    /// Seconds to go before it is judged; `null` for one that does not learn.
    left_s: Option<f64>,
    /// Whether all is learned, and the policy is being judged.
    judging: bool,
    /// How nodes learn it; `null` where the server does.
    federated: Option<AskedNodes>,
    /// What nodes are at; `null` where the server learns, and while it stands.
    nodes: Option<NodesView>,
    /// The last round; `null` before the first.
    last: Option<CurvePoint>,
    /// What its policy came to; `null` before it is over.
    score: Option<TrainingScore>,
    /// What can be downloaded; told only where one experiment is asked for.
    pub(super) files: Vec<TrainingFile>,
}

impl TrainingView {
    fn new(experiments: &Experiments, row: &Experiment, asked: &TrainingAsked) -> (Self, u64) {
        let outcome = experiments.trained(row);
        let (steps, rounds) = (asked.steps, outcome.rounds);
        let done = outcome.last.map_or(0, |last| last.steps);
        let learns = !outcome.judging && row.state == crawler_records::ExperimentState::Running;
        // Whole rounds are learned.
        let round = done.checked_div(rounds).unwrap_or_default();
        let left = round.saturating_mul(u64::from(row.seeds).saturating_sub(rounds)) as f64;
        let rate = outcome.rate.filter(|rate| *rate > 0.0);
        let told = Self {
            algorithm: asked.algorithm.clone(),
            steps,
            worlds: asked.worlds,
            units: asked.units,
            own_critic: asked.own_critic,
            steps_per_second: rate,
            left_s: rate
                .filter(|_| learns && rounds > 0)
                .map(|rate| left / rate),
            judging: outcome.judging,
            federated: asked.nodes.clone(),
            nodes: outcome.nodes,
            last: outcome.last,
            score: outcome.score,
            files: Vec::new(),
        };
        (told, rounds)
    }

    /// As a line of a summary.
    fn summary(&self) -> Vec<Summary> {
        let line = |score: &TrainingScore| Summary {
            metric: "success".to_owned(),
            unit: "share".to_owned(),
            mean: score.success,
            low: score.low,
            high: score.high,
            count: score.episodes,
        };
        self.score.iter().map(line).collect()
    }
}

/// The curve of a training.
#[derive(Serialize, ToSchema)]
#[schema(as = TrainingCurve)]
pub(crate) struct CurveView {
    /// What its rounds came to, the oldest first.
    pub(super) points: Vec<CurvePoint>,
    /// `after` of the next page; `null` when there is none yet.
    pub(super) next: Option<u64>,
}

impl ExperimentView {
    pub(super) fn new(experiments: &Experiments, row: Experiment) -> Result<Self, Problem> {
        match row.kind {
            ExperimentKind::Evaluation => Self::of_evaluation(experiments, row),
            ExperimentKind::Training => Ok(Self::of_training(experiments, row)),
        }
    }

    fn of_training(experiments: &Experiments, row: Experiment) -> Self {
        let read: Option<TrainingAsked> = serde_json::from_str(&row.recipe).ok();
        // One that cannot be read is shown, and fails when it is to run.
        let unread = read
            .is_none()
            .then(|| "what it was asked to be cannot be read".to_owned());
        let asked = read.unwrap_or_default();
        let (training, rounds) = TrainingView::new(experiments, &row, &asked);
        let reason = experiments.waits_for(&row).or(unread);
        Self {
            kind: row.kind.name(),
            waiting: experiments.is_waiting(&row),
            workers: Vec::new(),
            build: row.build,
            id: row.id.to_string(),
            name: row.name,
            command: asked.command(),
            robots: asked.robots(),
            scenario: asked.task,
            seeds: row.seeds,
            first_seed: asked.seed,
            difficulty: None,
            randomisation: Some(asked.randomisation),
            set: Vec::new(),
            thresholds: Vec::new(),
            by: row.by,
            created_at: row.created,
            started_at: row.started,
            ended_at: row.ended,
            state: row.state.name(),
            reason: row.reason.or(reason),
            done: u32::try_from(rounds).unwrap_or(row.seeds).min(row.seeds),
            summary: training.summary(),
            verdict: None,
            training: Some(training),
        }
    }

    fn of_evaluation(experiments: &Experiments, row: Experiment) -> Result<Self, Problem> {
        let recipe: Recipe = serde_json::from_str(&row.recipe)
            .map_err(|_| Problem::internal("a recipe in the records cannot be read"))?;
        let results = Results::read(&row.results);
        let reason = experiments.waits_for(&row);
        Ok(Self {
            kind: row.kind.name(),
            training: None,
            waiting: experiments.is_waiting(&row),
            workers: experiments.workers(row.id),
            build: row.build,
            id: row.id.to_string(),
            name: row.name,
            command: recipe.command(),
            scenario: recipe.scenario,
            robots: recipe.in_each,
            seeds: recipe.seeds,
            first_seed: recipe.first_seed,
            difficulty: recipe.difficulty,
            randomisation: recipe.randomisation,
            set: recipe.set,
            thresholds: recipe.thresholds,
            by: row.by,
            created_at: row.created,
            started_at: row.started,
            ended_at: row.ended,
            state: row.state.name(),
            reason: row.reason.or(reason),
            done: row.done,
            summary: results.summary,
            verdict: results.verdict,
        })
    }
}

/// Experiments.
#[derive(Serialize, ToSchema)]
#[schema(as = Experiments)]
pub(crate) struct ExperimentList {
    /// Newest first.
    pub(super) experiments: Vec<ExperimentView>,
    /// `before` of the next page; `null` where there is none.
    pub(super) next: Option<String>,
}

/// A trial: one seed.
#[derive(Serialize, ToSchema)]
#[schema(as = ExperimentTrial)]
pub(crate) struct TrialView {
    /// Its number within the experiment, from 0.
    pub(super) number: u32,
    /// Its seed.
    pub(super) seed: u64,
    /// Whether everything came out as it should.
    pub(super) success: bool,
    /// What did not.
    pub(super) reason: Option<String>,
    /// What was measured, in the order of `metrics`; `null` for what this trial does not have.
    pub(super) values: Vec<Option<f64>>,
}

/// What was measured, trial by trial.
#[derive(Serialize, ToSchema)]
#[schema(as = ExperimentMetrics)]
pub(crate) struct MetricsView {
    /// What is measured of every trial.
    pub(super) metrics: Vec<MetricView>,
    /// The trials that are done, in the order of their seeds.
    pub(super) trials: Vec<TrialView>,
    /// `after` of the next page; `null` when there is none yet.
    pub(super) next: Option<u32>,
}
