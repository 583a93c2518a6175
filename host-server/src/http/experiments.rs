//! Experiments: scenarios on many seeds, run by this server.

mod view;

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use crawler_records::MAX_SEEDS;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use utoipa::IntoParams;

use super::App;
use super::access::Caller;
use super::guard::JsonBody;
use super::problem::Problem;
use crate::experiments::{self, Action, ControlError};
use view::{ExperimentList, ExperimentView, MetricsView, NewExperiment, TrialView};

/// Experiments of a page, and most of them.
const PAGE: u32 = 50;
const LARGEST_PAGE: u32 = 200;
/// Trials of a page, and most of them.
const TRIALS: u32 = 1_000;
const MOST_TRIALS: u32 = 5_000;

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

fn bad_query(why: impl Into<String>) -> Problem {
    Problem::new(StatusCode::BAD_REQUEST, "bad_query", why)
}

fn within(limit: u32, most: u32) -> Result<u32, Problem> {
    if (1..=most).contains(&limit) {
        Ok(limit)
    } else {
        Err(bad_query(format!("`limit` must be within 1 to {most}")))
    }
}

fn unknown() -> Problem {
    Problem::new(
        StatusCode::NOT_FOUND,
        "unknown_experiment",
        "there is no experiment of that id",
    )
}

/// The number that an id stands for.
fn number(id: &str) -> Result<i64, Problem> {
    let digits = !id.is_empty() && id.bytes().all(|byte| byte.is_ascii_digit());
    id.parse().ok().filter(|_| digits).ok_or_else(unknown)
}

impl From<ControlError> for Problem {
    fn from(error: ControlError) -> Self {
        match error {
            ControlError::Invalid(errors) => Self::invalid("invalid_experiment", errors),
            ControlError::Unknown => unknown(),
            ControlError::WrongState(state) => Self::new(
                StatusCode::CONFLICT,
                "wrong_state",
                format!("the experiment is {state}: this cannot be done now"),
            ),
            ControlError::OtherServer => Self::new(
                StatusCode::CONFLICT,
                "other_server",
                "another server of this fleet runs the experiment: ask that one",
            ),
            ControlError::TooMany(what) => Self::new(
                StatusCode::CONFLICT,
                "too_many",
                format!("there are as many {what} as may be: delete some first"),
            ),
            ControlError::Busy => Self::later(
                StatusCode::SERVICE_UNAVAILABLE,
                "overloaded",
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
        (status = 400, description = "The query is not valid", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn list(
    State(app): State<Arc<App>>,
    query: Result<Query<ListQuery>, QueryRejection>,
) -> Result<Json<ExperimentList>, Problem> {
    let Query(query) = query.map_err(|error| bad_query(error.body_text()))?;
    let limit = within(query.limit.unwrap_or(PAGE), LARGEST_PAGE)?;
    let before = match &query.before {
        Some(id) => Some(number(id).map_err(|_| bad_query("`before` must be an id"))?),
        None => None,
    };
    let rows = app.records.experiments(before, limit).await;
    let rows = rows.map_err(|error| Problem::records(&error))?;
    let full = rows.len() == limit as usize;
    let next = rows.last().filter(|row| full && row.id > 1);
    let next = next.map(|row| row.id.to_string());
    let views = rows.into_iter().map(|row| ExperimentView::new(&app, row));
    Ok(Json(ExperimentList {
        experiments: views.collect::<Result<_, _>>()?,
        next,
    }))
}

/// Makes an experiment
///
/// Its first world is built to see whether it can be: nothing is stored otherwise. The trials run in
/// the background, in the order of their seeds; at most four experiments run at once and others wait.
#[utoipa::path(post, path = "/experiments", tag = "experiments",
    request_body = NewExperiment,
    responses(
        (status = 201, description = "Made", body = ExperimentView),
        (status = 400, description = "Not JSON", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "There are as many as may be", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "`errors` names every field that is wrong", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "Others are being tried out, or the records are away",
            body = Problem, content_type = "application/problem+json")))]
pub(super) async fn create(
    State(app): State<Arc<App>>,
    caller: Caller,
    body: JsonBody,
) -> Result<Response, Problem> {
    let body: Map<String, Value> = body.read()?;
    let asked = Value::Object(body.clone());
    let made = experiments::create(&app.experiments, caller.name(), body).await;
    let made = made.map_err(Problem::from);
    let id = made
        .as_ref()
        .map_or_else(|_| String::new(), |row| row.id.to_string());
    app.audit(&caller, "experiment.create", &id, asked, &made)
        .await;
    let view = ExperimentView::new(&app, made?)?;
    Ok((StatusCode::CREATED, Json(view)).into_response())
}

/// One experiment
#[utoipa::path(get, path = "/experiments/{id}", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 200, description = "How far it is", body = ExperimentView),
        (status = 404, description = "There is none of that id", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn one(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    let row = app.records.experiment(number(&id)?).await;
    let row = row.map_err(|error| Problem::records(&error))?;
    ExperimentView::new(&app, row.ok_or_else(unknown)?).map(Json)
}

/// Deletes an experiment that does not run, with all of its trials
#[utoipa::path(delete, path = "/experiments/{id}", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "There is none of that id", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "It runs", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn delete(
    State(app): State<Arc<App>>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let done = experiments::delete(&app.experiments, number(&id)?).await;
    let done = done.map_err(Problem::from);
    app.audit(&caller, "experiment.delete", &id, json!({}), &done)
        .await;
    done?;
    Ok(StatusCode::NO_CONTENT)
}

async fn act(
    app: &Arc<App>,
    caller: &Caller,
    id: &str,
    action: Action,
) -> Result<Json<ExperimentView>, Problem> {
    let done = experiments::act(&app.experiments, number(id)?, action).await;
    let done = done.map_err(Problem::from);
    app.audit(caller, action.name(), id, json!({}), &done).await;
    ExperimentView::new(app, done?).map(Json)
}

/// What is measured, trial by trial
#[utoipa::path(get, path = "/experiments/{id}/metrics", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment"), MetricsQuery),
    responses(
        (status = 200, description = "A page of trials, oldest first", body = MetricsView),
        (status = 400, description = "The query is not valid", body = Problem,
            content_type = "application/problem+json"),
        (status = 404, description = "There is none of that id", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn metrics(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    query: Result<Query<MetricsQuery>, QueryRejection>,
) -> Result<Json<MetricsView>, Problem> {
    let Query(query) = query.map_err(|error| bad_query(error.body_text()))?;
    let limit = within(query.limit.unwrap_or(TRIALS), MOST_TRIALS)?;
    if query.after.is_some_and(|after| after > MAX_SEEDS) {
        return Err(bad_query(format!("`after` must be 0 to {MAX_SEEDS}")));
    }
    let id = number(&id)?;
    let row = app.records.experiment(id).await;
    let row = row.map_err(|error| Problem::records(&error))?;
    let row = row.ok_or_else(unknown)?;
    let from = query.after.map_or(0, |after| after.saturating_add(1));
    let trials = app.records.trials(id, from, limit).await;
    let trials = trials.map_err(|error| Problem::records(&error))?;
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
        (status = 404, description = "There is none of that id", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "It was started before, or another server runs it", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn start(
    State(app): State<Arc<App>>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    act(&app, &caller, &id, Action::Start).await
}

/// Pauses an experiment
#[utoipa::path(post, path = "/experiments/{id}/pause", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 200, description = "It stands; trials under way are given up, and made anew when it goes on",
            body = ExperimentView),
        (status = 404, description = "There is none of that id", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "It does not run, or another server runs it", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn pause(
    State(app): State<Arc<App>>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    act(&app, &caller, &id, Action::Pause).await
}

/// Has an experiment go on that was paused
#[utoipa::path(post, path = "/experiments/{id}/resume", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 200, description = "It runs, or waits for its turn",
            body = ExperimentView),
        (status = 404, description = "There is none of that id", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "It is not paused, or another server runs it", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn resume(
    State(app): State<Arc<App>>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    act(&app, &caller, &id, Action::Resume).await
}

/// Ends an experiment before its end; what is done stays
#[utoipa::path(post, path = "/experiments/{id}/stop", tag = "experiments",
    params(("id" = String, Path, description = "Id of the experiment")),
    responses(
        (status = 200, description = "It has ended",
            body = ExperimentView),
        (status = 404, description = "There is none of that id", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "It has ended before, or another server runs it", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn stop(
    State(app): State<Arc<App>>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<ExperimentView>, Problem> {
    act(&app, &caller, &id, Action::Stop).await
}
