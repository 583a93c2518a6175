//! What is said of experiments.

use serde::Serialize;
use utoipa::ToSchema;

use crate::problem::Problem;
use crawler_experiments::{AtWork, Experiments, Judged, MetricView, Recipe, Results, Summary};

/// An experiment to be made: a scenario that comes along, on many seeds.
#[derive(ToSchema)]
#[allow(dead_code)] // describes a body that is read field by field
pub(crate) struct NewExperiment {
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
    /// Its name, for people.
    name: String,
    /// Name of the scenario.
    scenario: String,
    /// Robots in each world.
    robots: u32,
    /// How many trials it is to have, each of another seed.
    seeds: u32,
    /// The first seed.
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
    /// How many trials are done: the first ones.
    done: u32,
    /// The program that runs it: version, and hashes of robot program and simulator. The same build comes to the
    /// same numbers on any machine.
    build: String,
    /// The servers and workers that are at it now.
    workers: Vec<AtWork>,
    /// What those come to.
    summary: Vec<Summary>,
    /// Every threshold, once all trials are done.
    verdict: Option<Vec<Judged>>,
    /// The command line that comes to the same numbers.
    command: String,
}

impl ExperimentView {
    pub(super) fn new(
        experiments: &Experiments,
        row: crawler_records::Experiment,
    ) -> Result<Self, Problem> {
        let recipe: Recipe = serde_json::from_str(&row.recipe)
            .map_err(|_| Problem::internal("a recipe in the records cannot be read"))?;
        let results = Results::read(&row.results);
        let reason = experiments.waits_for(&row);
        Ok(Self {
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
