//! Telling robots what to do.

use std::panic::resume_unwind;
use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::rejection::QueryRejection;
use axum::extract::{FromRequest as _, Path, Query, Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use crawler_delivery::Class;
use crawler_protocol::{Action, Reason, RobotId};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio_util::task::TaskTracker;
use tracing::Instrument as _;
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::access::Caller;
use super::guard::JsonBody;
use super::problem::Problem;
use crate::commands::{CommandView, SendError, Target, view_of};
use crate::fleet::Presence;

/// A command on its way: the same document as `GET /api/v1/commands/{id}`, whose address is in
/// `Location`. A command to the swarm leaves out the outcomes of single robots: there are none yet,
/// and a large fleet would make a megabyte of it.
pub(super) struct Accepted(CommandView);

impl utoipa::PartialSchema for Accepted {
    fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::schema::Schema> {
        CommandView::schema()
    }
}

impl ToSchema for Accepted {
    fn name() -> std::borrow::Cow<'static, str> {
        CommandView::name()
    }

    fn schemas(
        schemas: &mut Vec<(
            String,
            utoipa::openapi::RefOr<utoipa::openapi::schema::Schema>,
        )>,
    ) {
        CommandView::schemas(schemas);
    }
}

impl IntoResponse for Accepted {
    fn into_response(self) -> Response {
        let Self(mut view) = self;
        if view.robot.is_none() {
            view.outcomes.clear();
        }
        let location = format!("/api/v1/commands/{}", view.id);
        (
            StatusCode::ACCEPTED,
            [(header::LOCATION, location)],
            Json(view),
        )
            .into_response()
    }
}

/// A command without number, time and sender. The schema `command-request` says what it may be.
#[derive(ToSchema)]
#[schema(as = CommandRequest)]
#[allow(dead_code)] // describes a body that the protocol's own parser reads
pub(super) struct CommandRequest {
    /// Its name, like `move`.
    #[schema(example = "drive")]
    command: String,
    /// What the command needs; left out where it needs nothing.
    #[schema(value_type = Option<Object>, example = json!({"v": 0.2, "w": 0.0}))]
    parameters: Option<()>,
}

fn parse(body: &[u8]) -> Result<Action, Problem> {
    Action::parse(body).map_err(|reason| {
        let status = match reason {
            Reason::Malformed => StatusCode::BAD_REQUEST,
            _ => StatusCode::UNPROCESSABLE_ENTITY,
        };
        let detail = match reason {
            Reason::Malformed => "the body is not one JSON object",
            Reason::TooLarge => "the command is too large for a message",
            Reason::UnknownCommand => "there is no such command",
            Reason::UnknownField => "the command does not have one of these fields",
            Reason::DuplicateField => "a field is there twice",
            Reason::MissingField => "a field is missing",
            Reason::WrongType => "a field holds another type than it must",
            Reason::OutOfRange => "a value is out of range",
            Reason::UnknownBehaviour => "there is no such behaviour",
            _ => "the command is not valid",
        };
        Problem::new(status, reason.name(), detail)
    })
}

/// Whatever happens, these go out: they can only make things safer.
const fn is_halt(action: &Action) -> bool {
    matches!(action, Action::Stop | Action::Estop)
}

/// A request for a command, with its body read, and whether that is a halt.
pub(super) async fn told_apart(request: Request) -> Result<(Request, bool), Problem> {
    let (parts, body) = request.into_parts();
    let unread = Request::from_parts(parts.clone(), body);
    let JsonBody(body) = JsonBody::from_request(unread, &()).await?;
    let halts = Action::parse(&body).is_ok_and(|action| is_halt(&action));
    Ok((Request::from_parts(parts, Body::from(body)), halts))
}

fn failed(error: SendError) -> Problem {
    match error {
        SendError::NotConnected => Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "broker_unavailable",
            "there is no connection to the broker; the command was not sent",
        ),
        SendError::Full => Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "overloaded",
            "too many commands are waiting to go out; this one was not sent",
        ),
        SendError::TooLarge => Problem::new(
            StatusCode::UNPROCESSABLE_ENTITY,
            Reason::TooLarge.name(),
            "the command is too large for a message",
        ),
        SendError::NotWritten { sent: false } => Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "not_written",
            "the disk takes nothing, and this command must outlive the server; it was not sent",
        ),
        SendError::NotWritten { sent: true } => Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "sent_not_written",
            "the command was sent, but the disk takes nothing: should the server end, nobody goes on \
             with it",
        ),
        SendError::NotShared { sent: false } => Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "not_shared",
            "the other servers cannot be told; the command was not sent",
        ),
        SendError::NotShared { sent: true } => Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "sent_not_shared",
            "the command was sent, but the other servers cannot be told: should this one fail, \
             nobody goes on with it",
        ),
    }
}

/// Sends a command under the caller's name.
async fn send(
    app: &App,
    caller: &Caller,
    action: Action,
    target: Target,
    expected: Vec<RobotId>,
) -> Result<Accepted, Problem> {
    let commands = &app.commands;
    let given = commands.give(caller.source(), action, target, expected);
    given.await.map(Accepted).map_err(failed)
}

/// Reads a command and sends it to one robot; writes down that it was given.
///
/// # Cancellation safety
/// What was begun is done, and written down: see [`whole`].
pub(super) async fn send_to_robot(
    app: Arc<App>,
    caller: Caller,
    id: String,
    body: Vec<u8>,
) -> Result<Accepted, Problem> {
    let tasks = app.tasks.clone();
    whole(&tasks, async move {
        let result = try_robot(&app, &caller, &id, &body).await;
        audit(&app, &caller, &id, &body, &result).await;
        result
    })
    .await
}

/// Does `work` whether or not somebody still waits for it: whoever hangs up while a command waits for
/// the disk has given it all the same, and the audit log says so.
async fn whole(
    tasks: &TaskTracker,
    work: impl Future<Output = Result<Accepted, Problem>> + Send + 'static,
) -> Result<Accepted, Problem> {
    match tasks.spawn(work.in_current_span()).await {
        Ok(result) => result,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => resume_unwind(panic),
            Err(_) => Err(Problem::new(
                StatusCode::SERVICE_UNAVAILABLE,
                "stopping",
                "the server is about to end",
            )),
        },
    }
}

/// Whether a command waits for the audit log. Nobody who stops or steers a robot does.
fn must_be_audited(action: &Action) -> bool {
    !matches!(Class::of(action), Class::Halt | Class::Motion)
}

async fn try_robot(app: &App, caller: &Caller, id: &str, body: &[u8]) -> Result<Accepted, Problem> {
    let action = parse(body)?;
    if must_be_audited(&action) {
        app.may_be_audited()?;
    }
    let unknown = || Problem::unknown_robot(id);
    let robot = RobotId::new(id).map_err(|_| unknown())?;
    if app.fleet.lock().get(&robot).is_none() {
        return Err(unknown());
    }
    let target = Target::Robot(robot.clone());
    send(app, caller, action, target, vec![robot]).await
}

async fn try_swarm(app: &App, caller: &Caller, body: &[u8]) -> Result<Accepted, Problem> {
    let action = parse(body)?;
    if must_be_audited(&action) {
        app.may_be_audited()?;
    }
    let expected: Vec<RobotId> = {
        let fleet = app.fleet.lock();
        let online = fleet
            .robots()
            .filter(|robot| robot.presence == Presence::Online);
        online.map(|robot| robot.id.clone()).collect()
    };
    if expected.is_empty() && !is_halt(&action) {
        return Err(Problem::new(
            StatusCode::CONFLICT,
            "no_robots",
            "no robot is online; only stop and estop are sent all the same",
        ));
    }
    send(app, caller, action, Target::Swarm, expected).await
}

/// Writes down a command that was one. It has gone out by then. Nobody who stops or steers a robot
/// waits for a disk: their entry is written when the disk takes it.
async fn audit(
    app: &App,
    caller: &Caller,
    target: &str,
    body: &[u8],
    result: &Result<Accepted, Problem>,
) {
    // The body was parsed, so it is small and says nothing but a command; where it was not, what
    // stands there is anybody's guess.
    let action = Action::parse(body);
    let detail = match &action {
        Ok(_) => serde_json::from_slice(body).unwrap_or(Value::Null),
        Err(_) => Value::Null,
    };
    let detail = match result {
        Ok(Accepted(view)) => json!({ "id": view.id, "request": detail }),
        Err(_) => json!({ "request": detail }),
    };
    if action.is_ok_and(|action| !must_be_audited(&action)) {
        app.audit_later(caller, "command.send", target, detail, result);
        return;
    }
    app.audit(caller, "command.send", target, detail, result)
        .await;
}

/// Sends a command to one robot
///
/// For a robot that is away the command waits: motion for 2 seconds, parameters for 55 minutes,
/// anything else for a minute. Then it is `expired`. `stop` and `estop` are with the broker at once.
#[utoipa::path(post, path = "/robots/{id}/commands", tag = "commands",
    params(("id" = String, Path, description = "Robot id")),
    request_body = CommandRequest,
    responses(
        (status = 202, description = "Sent", body = Accepted),
        (status = 400, description = "Not JSON", body = Problem,
            content_type = "application/problem+json"),
        (status = 404, description = "Nobody knows the robot", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "Not a command", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "No connection to the broker, or no disk to write it to",
            body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn to_robot(
    State(app): State<Arc<App>>,
    caller: Caller,
    Path(id): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Accepted, Problem> {
    send_to_robot(app, caller, id, body.to_vec()).await
}

/// Sends a command to every robot
///
/// Answers are expected of the robots online at this moment. When all have answered, or after a
/// while, what it came to is published on `{fleet}/response/swarm`. With no robot online, `stop`
/// and `estop` go out all the same and anything else is a 409.
#[utoipa::path(post, path = "/swarm/commands", tag = "commands",
    request_body = CommandRequest,
    responses(
        (status = 202, description = "Sent", body = Accepted),
        (status = 400, description = "Not JSON", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "No robot is online", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "Not a command", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "No connection to the broker, or no disk to write it to",
            body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn to_swarm(
    State(app): State<Arc<App>>,
    caller: Caller,
    JsonBody(body): JsonBody,
) -> Result<Accepted, Problem> {
    let tasks = app.tasks.clone();
    whole(&tasks, async move {
        let result = try_swarm(&app, &caller, &body).await;
        audit(&app, &caller, "swarm", &body, &result).await;
        result
    })
    .await
}

/// Commands of one answer.
const MOST_LISTED: usize = 500;

/// Which commands are wanted.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ListQuery {
    /// Those that went to this robot, with its outcome; all, without outcomes, when not given.
    robot: Option<String>,
    /// At most so many, up to 500; 50 when not given.
    #[param(maximum = 4_294_967_295_u64)]
    limit: Option<u32>,
    /// With the `drive` commands, of which steering sends many a second.
    drive: Option<bool>,
}

/// Commands, newest first.
#[derive(Serialize, ToSchema)]
#[schema(as = CommandRecords)]
pub(super) struct CommandList {
    /// Newest first.
    commands: Vec<CommandView>,
}

/// The newest commands and what they came to, newest first
///
/// The server remembers the last 4,096 commands for up to an hour.
#[utoipa::path(get, path = "/commands", tag = "commands",
    params(ListQuery),
    responses(
        (status = 200, description = "The commands", body = CommandList),
        (status = 400, description = "The query is not valid", body = Problem,
            content_type = "application/problem+json"),
        (status = 404, description = "Not a robot's name", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn list(
    State(app): State<Arc<App>>,
    query: Result<Query<ListQuery>, QueryRejection>,
) -> Result<Json<CommandList>, Problem> {
    let Query(query) = query
        .map_err(|error| Problem::new(StatusCode::BAD_REQUEST, "bad_query", error.body_text()))?;
    let robot = query.robot.as_deref().map(|id| {
        let robot = RobotId::new(id);
        robot.map_err(|_| Problem::unknown_robot(id))
    });
    let robot = robot.transpose()?;
    let limit = (query.limit.unwrap_or(50) as usize).min(MOST_LISTED);
    let drive = query.drive.unwrap_or(false);
    let commands = app.commands.newest(robot.as_ref(), drive, limit);
    Ok(Json(CommandList { commands }))
}

/// What a command came to
///
/// The server remembers the last 4,096 commands for up to an hour.
#[utoipa::path(get, path = "/commands/{id}", tag = "commands",
    params(("id" = String, Path, description = "Id from the answer to the command")),
    responses(
        (status = 200, description = "What it came to so far", body = CommandView),
        (status = 404, description = "Not known, or no longer", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "The other servers cannot be asked", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn one(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<Json<CommandView>, Problem> {
    let unknown = || {
        Problem::new(
            StatusCode::NOT_FOUND,
            "unknown_command_id",
            "no such command is remembered",
        )
    };
    let id: u64 = id.parse().map_err(|_| unknown())?;
    if let Some(view) = app.commands.view(id) {
        return Ok(Json(view));
    }
    let membership = app.membership.as_ref().ok_or_else(unknown)?;
    let fields = membership.cluster.read(id).await.map_err(|error| {
        tracing::warn!(%error, "cannot look up a command of another server");
        Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "not_shared",
            "this server does not know the command, and the others cannot be asked",
        )
    })?;
    view_of(id, &fields).map(Json).ok_or_else(unknown)
}
