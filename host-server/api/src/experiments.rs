//! Experiments: scenarios on many seeds, run by this server and by all that share its records, and policies that learn.

mod view;

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use crawler_records::{Experiment, ExperimentKind, MAX_SEEDS, Records};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use utoipa::IntoParams;

use super::access::Caller;
use super::audit::Audit;
use super::guard::JsonBody;
use super::problem::{Code, Problem};
use super::query::{self, ApiQuery, bad_query};
use crawler_experiments::{self as experiments, Action, ControlError, Experiments};
use view::{CurveView, ExperimentList, ExperimentRequest, ExperimentView, MetricsView, TrialView};

/// Experiments of a page, and most of them.
const PAGE: u32 = 50;
const LARGEST_PAGE: u32 = 200;
/// Trials of a page, and most of them.
const TRIALS: u32 = 1_000;
const MOST_TRIALS: u32 = 5_000;
/// Rounds of a page of a curve, and most of them.
const ROUNDS: u32 = 1_000;
const MOST_ROUNDS: u32 = 10_000;

/// Which page of experiments.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ListQuery {
    /// Only experiments before this one
    #[param(pattern = "^[0-9]{1,18}$")]
    before: Option<String>,
    /// How many at most, 1 to 200; 50 where it is left out
    #[param(minimum = 1, maximum = 200)]
    limit: Option<u32>,
}

/// Which page of trials.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct MetricsQuery {
    /// Only trials after the one of this number
    #[param(minimum = 0, maximum = 100_000)]
    after: Option<u32>,
    /// How many at most, 1 to 5000; 1000 where it is left out
    #[param(minimum = 1, maximum = 5000)]
    limit: Option<u32>,
}

/// Which page of a curve.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CurveQuery {
    /// Only rounds after the one of this number
    #[param(minimum = 0, maximum = 100_000)]
    after: Option<u32>,
    /// How many at most, 1 to 10000; 1000 where it is left out
    #[param(minimum = 1, maximum = 10_000)]
    limit: Option<u32>,
}

fn unknown() -> Problem {
    Problem::new(Code::UnknownExperiment, "there is no experiment of that id")
}

/// The number that an id stands for.
fn number(id: &str) -> Result<i64, Problem> {
    let digits = !id.is_empty() && id.bytes().all(|byte| byte.is_ascii_digit());
    id.parse().ok().filter(|_| digits).ok_or_else(unknown)
}

impl From<ControlError> for Problem {
    fn from(error: ControlError) -> Self {
        match error {
            ControlError::Invalid(errors) => {
                let errors = errors.into_iter().map(Into::into);
                Self::invalid(Code::InvalidExperiment, errors.collect())
            }
            ControlError::Unknown => unknown(),
            ControlError::WrongState(state) => Self::new(
                Code::WrongState,
                format!("the experiment is {state}: this cannot be done now"),
            ),
            ControlError::OtherBuild(build) => Self::new(
                Code::OtherBuild,
                format!(
                    "another build of the program has run a part of it, {build}: this one may come to other numbers; \
                     make it anew"
                ),
            ),
            ControlError::TooMany(what) => Self::new(
                Code::TooMany,
                format!("there are as many {what} as may be: delete some first"),
            ),
            ControlError::Busy => Self::later(
                Code::Overloaded,
                "other experiments are being tried out",
                std::time::Duration::from_secs(2),
            ),
            ControlError::Records(error) => Self::records(&error),
            ControlError::Internal(what) => Self::internal(what),
        }
    }
}

/// Experiments, newest first
#[utoipa::path(get, path = "/experiments", tag = "experiments",
    params(ListQuery),
    responses(
        (status = 200, description = "A page of them", body = ExperimentList),
        (status = 400, description = "The query is not valid")))]
pub(super) async fn list(
    State(records): State<Records>,
    State(experiments): State<Arc<Experiments>>,
    ApiQuery(asked): ApiQuery<ListQuery>,
) -> Result<Json<ExperimentList>, Problem> {
    let limit = query::page(asked.limit.unwrap_or(PAGE), LARGEST_PAGE)?;
    let before = match &asked.before {
        Some(id) => Some(number(id).map_err(|_| bad_query("before", "must be an id"))?),
        None => None,
    };
    let rows = records.experiments().page(before, limit).await;
    let rows = rows.map_err(|error| Problem::records(&error))?;
    let full = rows.len() == limit as usize;
    let next = rows.last().filter(|row| full && row.id > 1);
    let next = next.map(|row| row.id.to_string());
    let views = rows
        .into_iter()
        .map(|row| ExperimentView::new(&experiments, row));
    Ok(Json(ExperimentList {
        experiments: views.collect::<Result<_, _>>()?,
        next,
    }))
}

/// Makes an experiment
///
/// The first world of an evaluation is built to see whether it can be: nothing is stored otherwise. The trials run in
/// the background, in the order of their seeds; at most four experiments run at once and others wait. A training learns
/// in a thread that gives way to everything else; one learns at a time, and others wait.
#[utoipa::path(post, path = "/experiments", tag = "experiments",
    request_body = ExperimentRequest,
    responses(
        (status = 201, description = "Made", body = ExperimentView),
        (status = 400, description = "Not JSON"),
        (status = 409, description = "There are as many as may be"),
        (status = 422, description = "`errors` names every field that is wrong"),
        (status = 503, description = "Others are being tried out, or the records are away")))]
pub(super) async fn create(
    State(experiments): State<Arc<Experiments>>,
    State(audit): State<Audit>,
    caller: Caller,
    body: JsonBody,
) -> Result<Response, Problem> {
    let body: Map<String, Value> = body.read()?;
    let asked = Value::Object(body.clone());
    let made = experiments::create(&experiments, caller.name(), body).await;
    let made = made.map_err(Problem::from);
    let id = made
        .as_ref()
        .map_or_else(|_| String::new(), |row| row.id.to_string());
    audit
        .write(&caller, "experiment.create", &id, asked, &made)
        .await;
    let view = ExperimentView::new(&experiments, made?)?;
    Ok((StatusCode::CREATED, Json(view)).into_response())
}

/// One experiment
#[utoipa::path(get, path = "/experiments/{id}", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 200, description = "How far it is", body = ExperimentView),
        (status = 404, description = "There is none of that id")))]
pub(super) async fn one(
    State(records): State<Records>,
    State(experiments): State<Arc<Experiments>>,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    let row = find(&records, &id).await?;
    let files = experiments.training_files(&row).await;
    let mut view = ExperimentView::new(&experiments, row)?;
    if let Some(training) = &mut view.training {
        training.files = files;
    }
    Ok(Json(view))
}

async fn find(records: &Records, id: &str) -> Result<Experiment, Problem> {
    let row = records.experiments().get(number(id)?).await;
    let row = row.map_err(|error| Problem::records(&error))?;
    row.ok_or_else(unknown)
}

/// The same for what only trainings have.
async fn find_training(records: &Records, id: &str) -> Result<Experiment, Problem> {
    let row = find(records, id).await?;
    if row.kind == ExperimentKind::Training {
        return Ok(row);
    }
    Err(Problem::new(
        Code::NotFound,
        "the experiment is no training, and has neither curve nor files",
    ))
}

/// How a training has gone, round by round
#[utoipa::path(get, path = "/experiments/{id}/curve", tag = "experiments",
    params(("id" = String, Path, description = "Id of the training"), CurveQuery),
    responses(
        (status = 200, description = "A page of rounds, oldest first", body = CurveView),
        (status = 400, description = "The query is not valid"),
        (status = 404, description = "There is none of that id, or it is no training")))]
pub(super) async fn curve(
    State(records): State<Records>,
    State(experiments): State<Arc<Experiments>>,
    Path(id): Path<String>,
    ApiQuery(asked): ApiQuery<CurveQuery>,
) -> Result<Json<CurveView>, Problem> {
    let limit = query::page(asked.limit.unwrap_or(ROUNDS), MOST_ROUNDS)? as usize;
    if asked.after.is_some_and(|after| after > MAX_SEEDS) {
        return Err(bad_query("after", format!("must be 0 to {MAX_SEEDS}")));
    }
    let row = find_training(&records, &id).await?;
    let after = u64::from(asked.after.unwrap_or(0));
    let mut points = experiments.curve(&row, after, limit + 1).await;
    let more = points.len() > limit;
    points.truncate(limit);
    let next = points.last().filter(|_| more).map(|point| point.round);
    Ok(Json(CurveView { points, next }))
}

/// A file that came of a training
///
/// `policy.tcpo` is the policy for robots, `policy` the same in floats, `curve.csv` has a line for each round,
/// `events.out.tfevents.terracrawler` the same for `TensorBoard`, and `run.json` options, results and hashes: the files of
/// `terracrawler train`. Before the end there is `so-far.tcpo`, what was learned by the last checkpoint.
#[utoipa::path(get, path = "/experiments/{id}/files/{name}", tag = "experiments",
    params(("id" = String, Path, description = "Id of the training"),
        ("name" = String, Path, description = "Name of the file")),
    responses(
        (status = 200, description = "The file", body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 404, description = "There is none of that id or name, or another server has it")))]
pub(super) async fn file(
    State(records): State<Records>,
    State(experiments): State<Arc<Experiments>>,
    Path((id, name)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let row = find_training(&records, &id).await?;
    let file = experiments.training_file(&row, &name).await;
    let file = file.map_err(|error| {
        tracing::warn!(%error, id, name, "a file of a training cannot be read");
        Problem::internal("the file cannot be read")
    })?;
    let (media, bytes) =
        file.ok_or_else(|| Problem::new(Code::NotFound, "the training has no such file here"))?;
    let headers = [
        (header::CONTENT_TYPE, media),
        (header::CACHE_CONTROL, "no-cache"),
        (header::CONTENT_DISPOSITION, "attachment"),
    ];
    Ok((headers, bytes).into_response())
}

/// Deletes an experiment that does not run, with all of its trials
#[utoipa::path(delete, path = "/experiments/{id}", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "There is none of that id"),
        (status = 409, description = "It runs")))]
pub(super) async fn delete(
    State(experiments): State<Arc<Experiments>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let done = experiments::delete(&experiments, number(&id)?).await;
    let done = done.map_err(Problem::from);
    audit
        .write(&caller, "experiment.delete", &id, json!({}), &done)
        .await;
    done?;
    Ok(StatusCode::NO_CONTENT)
}

async fn act(
    experiments: &Arc<Experiments>,
    audit: &Audit,
    caller: &Caller,
    id: &str,
    action: Action,
) -> Result<Json<ExperimentView>, Problem> {
    let done = experiments::act(experiments, number(id)?, action).await;
    let done = done.map_err(Problem::from);
    audit
        .write(caller, action.name(), id, json!({}), &done)
        .await;
    ExperimentView::new(experiments, done?).map(Json)
}

/// What is measured, trial by trial
#[utoipa::path(get, path = "/experiments/{id}/metrics", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment"), MetricsQuery),
    responses(
        (status = 200, description = "A page of trials, oldest first", body = MetricsView),
        (status = 400, description = "The query is not valid"),
        (status = 404, description = "There is none of that id")))]
pub(super) async fn metrics(
    State(records): State<Records>,
    Path(id): Path<String>,
    ApiQuery(asked): ApiQuery<MetricsQuery>,
) -> Result<Json<MetricsView>, Problem> {
    let limit = query::page(asked.limit.unwrap_or(TRIALS), MOST_TRIALS)?;
    if asked.after.is_some_and(|after| after > MAX_SEEDS) {
        return Err(bad_query("after", format!("must be 0 to {MAX_SEEDS}")));
    }
    let row = find(&records, &id).await?;
    let id = row.id;
    let from = asked.after.map_or(0, |after| after.saturating_add(1));
    let trials = records.trials().page(id, from, limit).await;
    let mut trials = trials.map_err(|error| Problem::records(&error))?;
    // Others may be done that are not counted yet.
    trials.retain(|trial| trial.number < row.done);
    let last = trials.last().map(|trial| trial.number);
    Ok(Json(MetricsView {
        metrics: serde_json::from_str(&row.metrics)
            .map_err(|_| Problem::internal("a list of metrics in the records cannot be read"))?,
        next: last.filter(|last| last + 1 < row.done),
        trials: trials
            .into_iter()
            .map(|trial| TrialView {
                number: trial.number,
                seed: trial.seed,
                success: trial.success,
                reason: trial.reason,
                values: trial.measured,
            })
            .collect(),
    }))
}

/// Starts an experiment that was made and not started
#[utoipa::path(post, path = "/experiments/{id}/start", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 200, description = "It runs, or waits for its turn",
            body = ExperimentView),
        (status = 404, description = "There is none of that id"),
        (status = 409, description = "It was started before")))]
pub(super) async fn start(
    State(experiments): State<Arc<Experiments>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    act(&experiments, &audit, &caller, &id, Action::Start).await
}

/// Pauses an experiment
#[utoipa::path(post, path = "/experiments/{id}/pause", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 200, description = "It stands; trials under way are given up, and made anew when it goes on",
            body = ExperimentView),
        (status = 404, description = "There is none of that id"),
        (status = 409, description = "It does not run")))]
pub(super) async fn pause(
    State(experiments): State<Arc<Experiments>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    act(&experiments, &audit, &caller, &id, Action::Pause).await
}

/// Has an experiment go on that was paused
#[utoipa::path(post, path = "/experiments/{id}/resume", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 200, description = "It runs, or waits for its turn",
            body = ExperimentView),
        (status = 404, description = "There is none of that id"),
        (status = 409, description = "It is not paused, or another build has begun it")))]
pub(super) async fn resume(
    State(experiments): State<Arc<Experiments>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    act(&experiments, &audit, &caller, &id, Action::Resume).await
}

/// Ends an experiment before its end; what is done stays
#[utoipa::path(post, path = "/experiments/{id}/stop", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 200, description = "It has ended",
            body = ExperimentView),
        (status = 404, description = "There is none of that id"),
        (status = 409, description = "It has ended before")))]
pub(super) async fn stop(
    State(experiments): State<Arc<Experiments>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    act(&experiments, &audit, &caller, &id, Action::Stop).await
}
