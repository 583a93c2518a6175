//! Rollouts: releases on their way to robots, in phases.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use crawler_protocol::RobotId;
use crawler_records::RecordsError;
use crawler_rollouts::{Action, NewPlan, Robot, RobotDetail, RolloutError, RolloutView, Rollouts};
use crawler_updates::rollout::{CommandError, PlanError, UpdateState};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::{IntoParams, ToSchema};

use super::access::Caller;
use super::audit::Audit;
use super::guard::JsonBody;
use super::problem::{Code, Problem, member, unreadable};
use super::query::{self, ApiQuery, bad_query};

/// Longest plan, in bytes: one whose groups name each robot of a large fleet.
pub(super) const MAX_PLAN: usize = 512 * 1024;
/// Rollouts of a page, and most of them.
const PAGE: u32 = 20;
const LARGEST_PAGE: u32 = 50;
/// Robots of a page, and most of them.
const ROBOTS: u32 = 200;
const MOST_ROBOTS: u32 = 1_000;

/// Which page of rollouts.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ListQuery {
    /// Only rollouts before this one
    #[param(pattern = "^[0-9]{1,18}$")]
    before: Option<String>,
    /// How many at most, 1 to 50; 20 where it is left out
    #[param(minimum = 1, maximum = 50)]
    limit: Option<u32>,
}

/// Which page of robots.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct RobotsQuery {
    /// Only robots behind this one, by name
    #[param(pattern = "^[a-z0-9-]{1,32}$")]
    after: Option<String>,
    /// Only robots in this state
    #[param(
        pattern = "^(not_applicable|waiting|offered|deferred|preparing|receiving|verifying|staged|trial|confirmed|rolled_back|failed|skipped|superseded)$"
    )]
    state: Option<String>,
    /// How many at most, 1 to 1000; 200 where it is left out
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
}

/// Rollouts.
#[derive(Serialize, ToSchema)]
#[schema(as = Rollouts)]
pub(super) struct RolloutList {
    /// Newest first.
    rollouts: Vec<RolloutView>,
    /// What `before` has to be for the next page; null on the last one.
    next: Option<String>,
}

/// Robots of a rollout.
#[derive(Serialize, ToSchema)]
#[schema(as = RolloutRobots)]
pub(super) struct RobotList {
    /// By name.
    robots: Vec<Robot>,
    /// What `after` has to be for the next page; null on the last one.
    next: Option<String>,
}

fn unknown() -> Problem {
    Problem::new(Code::UnknownRollout, "there is no rollout of that id")
}

/// The number that an id stands for.
fn number(id: &str) -> Result<i64, Problem> {
    let digits = !id.is_empty() && id.bytes().all(|byte| byte.is_ascii_digit());
    id.parse().ok().filter(|_| digits).ok_or_else(unknown)
}

fn robot_id(text: &str) -> Result<RobotId, Problem> {
    RobotId::new(text).map_err(|_| Problem::unknown_robot(text))
}

/// The part of a plan that is to blame.
fn part_of_plan(error: &PlanError) -> String {
    let of_phase = |at: &usize| member("/phases", at);
    match error {
        PlanError::Count { what, .. } | PlanError::Range { what, .. } => match *what {
            "releases" | "bytes of a release" | "sequence" => "/releases".to_owned(),
            what => {
                let what = what.rsplit(' ').next().unwrap_or_default();
                match what.split_once('.') {
                    Some((part @ ("limits" | "retries" | "timeouts" | "window"), field)) => {
                        member(&member("", part), field)
                    }
                    // Of one of them.
                    _ => "/phases".to_owned(),
                }
            }
        },
        PlanError::Overlap(..) | PlanError::Mixed(..) | PlanError::Sequence { .. } => {
            "/releases".to_owned()
        }
        PlanError::Repeated(at) | PlanError::Unserved(at) => of_phase(at),
        PlanError::Share(_) | PlanError::Twice(_) => "/phases".to_owned(),
        PlanError::NeverOpen => "/window".to_owned(),
        _ => String::new(),
    }
}

impl From<RolloutError> for Problem {
    fn from(error: RolloutError) -> Self {
        let text = error.to_string();
        let invalid = |pointer: String| Self::new(Code::InvalidRollout, text.clone()).at(pointer);
        match &error {
            RolloutError::Unknown => unknown(),
            RolloutError::NoGate(_) => Self::new(Code::GateMissing, text).at("/override_gate"),
            RolloutError::Override => invalid("/override_gate".to_owned()),
            RolloutError::Release(..) | RolloutError::UnknownRelease(_) => {
                invalid("/releases".to_owned())
            }
            RolloutError::Plan(error) => invalid(part_of_plan(error)),
            // All of it together.
            RolloutError::Start(_) => invalid(String::new()),
            RolloutError::Command(CommandError::UnknownRobot) => {
                Self::new(Code::UnknownRobot, text)
            }
            RolloutError::Command(_) => Self::new(Code::WrongState, text),
            RolloutError::Records(RecordsError::TooMany(_)) => Self::new(
                Code::TooMany,
                "there are as many rollouts at work as may be: abort one first",
            ),
            RolloutError::Records(error) => Self::records(error),
            RolloutError::Contended => Self::new(Code::Busy, text),
            RolloutError::Stopping => Self::new(Code::Stopping, text),
            _ => Self::internal("a rollout in the records cannot be read"),
        }
    }
}

/// Rollouts, newest first
#[utoipa::path(get, path = "/rollouts", tag = "updates",
    params(ListQuery),
    responses(
        (status = 200, description = "A page of them", body = RolloutList),
        (status = 400, description = "The query is not valid")))]
pub(super) async fn list(
    State(rollouts): State<Arc<Rollouts>>,
    ApiQuery(asked): ApiQuery<ListQuery>,
) -> Result<Json<RolloutList>, Problem> {
    let limit = query::page(asked.limit.unwrap_or(PAGE), LARGEST_PAGE)?;
    let before = match &asked.before {
        Some(id) => Some(number(id).map_err(|_| bad_query("before", "must be an id"))?),
        None => None,
    };
    let page = rollouts.list(before, limit).await?;
    Ok(Json(RolloutList {
        rollouts: page.rollouts,
        next: page.next.map(|next| next.to_string()),
    }))
}

/// Begins a rollout
///
/// Releases are named by their ids; what is known of them is filled in. Robots that an earlier rollout has, and that
/// this one is for, go over to it, but for those on trial. Where a release has no gate that has passed, and the server
/// demands one, nothing begins without `override_gate`.
#[utoipa::path(post, path = "/rollouts", tag = "updates",
    request_body = NewPlan,
    responses(
        (status = 201, description = "It has begun", body = RolloutView),
        (status = 400, description = "Not JSON"),
        (status = 409, description = "There are as many at work as may be"),
        (status = 422, description = "The plan cannot be carried out, `detail` says why; or a release has no gate \
                                      that has passed (`gate_missing`)"),
        (status = 503, description = "The records are away")))]
pub(super) async fn start(
    State(rollouts): State<Arc<Rollouts>>,
    State(audit): State<Audit>,
    caller: Caller,
    body: JsonBody,
) -> Result<Response, Problem> {
    begin(&rollouts, &audit, &caller, body.read()?).await
}

/// Begins a rollout with a plan as it was asked for.
pub(super) async fn begin(
    rollouts: &Rollouts,
    audit: &Audit,
    caller: &Caller,
    asked: Value,
) -> Result<Response, Problem> {
    let plan = serde_path_to_error::deserialize(&asked);
    let plan: NewPlan = plan.map_err(|error| {
        // It quotes nothing but names and numbers of a plan.
        let detail = error.inner().to_string();
        let part = unreadable(error.path(), &detail);
        Problem::new(Code::InvalidRollout, detail).with(vec![part])
    })?;
    let begun = rollouts.start(&caller.name(), plan).await;
    let begun = begun.map_err(Problem::from);
    let id = begun
        .as_ref()
        .map_or_else(|_| String::new(), i64::to_string);
    audit
        .write(caller, "rollout.create", &id, asked, &begun)
        .await;
    let view = rollouts.one(begun?).await?;
    Ok((StatusCode::CREATED, Json(view)).into_response())
}

/// One rollout: how far it is, in numbers and with its log
#[utoipa::path(get, path = "/rollouts/{id}", tag = "updates",
    params(("id" = String, Path, description = "Id of the rollout")),
    responses(
        (status = 200, description = "How far it is", body = RolloutView),
        (status = 404, description = "There is none of that id")))]
pub(super) async fn one(
    State(rollouts): State<Arc<Rollouts>>,
    Path(id): Path<String>,
) -> Result<Json<RolloutView>, Problem> {
    Ok(Json(rollouts.one(number(&id)?).await?))
}

/// Where the robots of a rollout stand, by name
#[utoipa::path(get, path = "/rollouts/{id}/robots", tag = "updates",
    params(("id" = String, Path, description = "Id of the rollout"), RobotsQuery),
    responses(
        (status = 200, description = "A page of them", body = RobotList),
        (status = 400, description = "The query is not valid"),
        (status = 404, description = "There is none of that id")))]
pub(super) async fn robots(
    State(rollouts): State<Arc<Rollouts>>,
    Path(id): Path<String>,
    ApiQuery(asked): ApiQuery<RobotsQuery>,
) -> Result<Json<RobotList>, Problem> {
    let limit = query::page(asked.limit.unwrap_or(ROBOTS), MOST_ROBOTS)?;
    let after = asked.after.as_deref().map(RobotId::new).transpose();
    let after = after.map_err(|_| bad_query("after", "must be the id of a robot"))?;
    let named = |name: &str| {
        let mut all = UpdateState::ALL.into_iter();
        let found = all.find(|state| state.name() == name);
        found.ok_or_else(|| bad_query("state", "must be the name of a state of a robot"))
    };
    let state = asked.state.as_deref().map(named).transpose()?;
    let robots = rollouts.robots(number(&id)?, after.as_ref(), state, limit + 1);
    let mut robots = robots.await?;
    let more = robots.len() > limit as usize;
    robots.truncate(limit as usize);
    let next = robots.last().filter(|_| more);
    let next = next.map(|robot| robot.robot.to_string());
    Ok(Json(RobotList { robots, next }))
}

/// Where a robot of a rollout stands, with its log
#[utoipa::path(get, path = "/rollouts/{id}/robots/{robot}", tag = "updates",
    params(("id" = String, Path, description = "Id of the rollout"),
        ("robot" = String, Path, description = "Id of the robot")),
    responses(
        (status = 200, description = "What has happened to it", body = RobotDetail),
        (status = 404, description = "There is no such rollout, or no such robot in it")))]
pub(super) async fn robot(
    State(rollouts): State<Arc<Rollouts>>,
    Path((id, robot)): Path<(String, String)>,
) -> Result<Json<RobotDetail>, Problem> {
    Ok(Json(
        rollouts.robot(number(&id)?, &robot_id(&robot)?).await?,
    ))
}

async fn act(
    rollouts: &Rollouts,
    audit: &Audit,
    caller: &Caller,
    id: &str,
    word: &'static str,
    action: Action,
) -> Result<Json<RolloutView>, Problem> {
    let number = number(id)?;
    let detail = match &action {
        Action::Retry(robot) | Action::Skip(robot) => json!({ "robot": robot }),
        Action::Pause | Action::Resume | Action::Abort => json!({}),
    };
    let done = rollouts.act(number, action).await.map_err(Problem::from);
    audit.write(caller, word, id, detail, &done).await;
    done?;
    Ok(Json(rollouts.one(number).await?))
}

/// Pauses a rollout
///
/// Nothing more is offered. Robots that have not started the new program give it up, and go on later where they
/// were; trials come to their end.
#[utoipa::path(post, path = "/rollouts/{id}/pause", tag = "updates",
    params(("id" = String, Path, description = "Id of the rollout")),
    responses(
        (status = 200, description = "It stands", body = RolloutView),
        (status = 404, description = "There is none of that id"),
        (status = 409, description = "It does not run")))]
pub(super) async fn pause(
    State(rollouts): State<Arc<Rollouts>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<RolloutView>, Problem> {
    act(
        &rollouts,
        &audit,
        &caller,
        &id,
        "rollout.pause",
        Action::Pause,
    )
    .await
}

/// Has a rollout go on that was paused, or has stopped by itself
#[utoipa::path(post, path = "/rollouts/{id}/resume", tag = "updates",
    params(("id" = String, Path, description = "Id of the rollout")),
    responses(
        (status = 200, description = "It runs; failures that stopped it do not count any more",
            body = RolloutView),
        (status = 404, description = "There is none of that id"),
        (status = 409, description = "It is not paused"),
        (status = 422, description = "A release of it was withdrawn")))]
pub(super) async fn resume(
    State(rollouts): State<Arc<Rollouts>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<RolloutView>, Problem> {
    act(
        &rollouts,
        &audit,
        &caller,
        &id,
        "rollout.resume",
        Action::Resume,
    )
    .await
}

/// Ends a rollout before its end; robots on trial come to the end of that
#[utoipa::path(post, path = "/rollouts/{id}/abort", tag = "updates",
    params(("id" = String, Path, description = "Id of the rollout")),
    responses(
        (status = 200, description = "It ends, or has ended", body = RolloutView),
        (status = 404, description = "There is none of that id"),
        (status = 409, description = "It is over")))]
pub(super) async fn abort(
    State(rollouts): State<Arc<Rollouts>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<RolloutView>, Problem> {
    act(
        &rollouts,
        &audit,
        &caller,
        &id,
        "rollout.abort",
        Action::Abort,
    )
    .await
}

/// Offers the release to a robot again that has failed, was rolled back, or left out
#[utoipa::path(post, path = "/rollouts/{id}/robots/{robot}/retry", tag = "updates",
    params(("id" = String, Path, description = "Id of the rollout"),
        ("robot" = String, Path, description = "Id of the robot")),
    responses(
        (status = 200, description = "It waits for its turn", body = RolloutView),
        (status = 404, description = "There is no such rollout, or no such robot in it"),
        (status = 409, description = "There is nothing to try again"),
        (status = 422, description = "A release of it was withdrawn")))]
pub(super) async fn retry(
    State(rollouts): State<Arc<Rollouts>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path((id, robot)): Path<(String, String)>,
) -> Result<Json<RolloutView>, Problem> {
    let action = Action::Retry(robot_id(&robot)?);
    act(&rollouts, &audit, &caller, &id, "rollout.retry", action).await
}

/// Leaves a robot out of a rollout
#[utoipa::path(post, path = "/rollouts/{id}/robots/{robot}/skip", tag = "updates",
    params(("id" = String, Path, description = "Id of the rollout"),
        ("robot" = String, Path, description = "Id of the robot")),
    responses(
        (status = 200, description = "It is left out", body = RolloutView),
        (status = 404, description = "There is no such rollout, or no such robot in it"),
        (status = 409, description = "It has come to its end, or runs the new program on trial")))]
pub(super) async fn skip(
    State(rollouts): State<Arc<Rollouts>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path((id, robot)): Path<(String, String)>,
) -> Result<Json<RolloutView>, Problem> {
    let action = Action::Skip(robot_id(&robot)?);
    act(&rollouts, &audit, &caller, &id, "rollout.skip", action).await
}
