//! Telling robots what to do.

use std::panic::resume_unwind;
use std::sync::Arc;

use axum::Json;
use axum::extract::{FromRef, FromRequest as _, FromRequestParts, Path, Request, State};
use axum::http::request::Parts;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use crawler_delivery::Class;
use crawler_protocol::{Action, Reason, RobotId};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio_util::task::TaskTracker;
use tracing::Instrument as _;
use utoipa::{IntoParams, ToSchema};

use super::access::Caller;
use super::audit::Audit;
use super::guard::JsonBody;
use super::problem::{self, Code, FieldError, Problem};
use super::query::ApiQuery;
use super::state::ApiState;
use crawler_cluster::ClusterMembership;
use crawler_commands::{CommandCenter, CommandView, SendError, Target, view_of};
use crawler_fleet::{Presence, SharedFleet};

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

/// What is said to whoever sent no command.
fn invalid(reason: Reason) -> Problem {
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
    Problem::new(Code::Command(reason), detail)
}

/// Whatever happens, these go out: they can only make things safer.
const fn is_halt(action: &Action) -> bool {
    matches!(action, Action::Stop | Action::Estop)
}

/// A body that should be a command, read once: for what it is charged to, for the robots and for the audit
/// log.
#[derive(Debug, Clone)]
pub(super) struct Asked {
    action: Result<Action, Reason>,
    /// The parts that are wrong, where it is no command.
    wrong: Vec<FieldError>,
    /// As it was written, for the audit log; `null` where it is no command, and anybody's guess.
    text: Value,
}

impl Asked {
    pub(super) fn read(body: &[u8]) -> Self {
        let action = Action::parse(body);
        // What was parsed is small and says nothing but a command.
        let (text, wrong) = match &action {
            Ok(_) => (serde_json::from_slice(body).unwrap_or_default(), Vec::new()),
            Err(reason) => {
                let reader = |body: &[u8]| Action::parse(body).err();
                let wrong = problem::locate("command-request", body, *reason, reader);
                (Value::Null, wrong)
            }
        };
        Self {
            action,
            wrong,
            text,
        }
    }

    /// A body that holds what is in the command under `parameters`.
    pub(super) fn read_parameters(command: &str, body: &[u8]) -> Self {
        // The strict reader behind this knows no field twice and nothing after the end, so a body
        // cannot reach beyond the place it is put in.
        let mut request = format!(r#"{{"command":"{command}","parameters":"#).into_bytes();
        request.extend_from_slice(body);
        request.push(b'}');
        let mut asked = Self::read(&request);
        for error in &mut asked.wrong {
            let pointer = error.pointer.as_deref();
            let own = pointer.and_then(|pointer| pointer.strip_prefix("/parameters"));
            error.pointer = Some(own.unwrap_or_default().to_owned());
        }
        asked
    }

    /// The body of a request.
    pub(super) async fn of(request: Request) -> Result<Self, Problem> {
        let JsonBody(body) = JsonBody::from_request(request, &()).await?;
        Ok(Self::read(&body))
    }

    /// The command, or why it is none and the parts that are wrong.
    pub(super) fn into_action(self) -> Result<Action, (Reason, Vec<FieldError>)> {
        self.action.map_err(|reason| (reason, self.wrong))
    }

    /// Whether it is a halt.
    pub(super) fn is_halt(&self) -> bool {
        self.action.as_ref().is_ok_and(is_halt)
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Asked {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        // The check of every request has read it.
        let read = parts.extensions.remove();
        read.ok_or_else(|| Problem::internal("a command was not read"))
    }
}

fn failed(error: SendError) -> Problem {
    match error {
        SendError::NotConnected => Problem::new(
            Code::BrokerUnavailable,
            "there is no connection to the broker; the command was not sent",
        ),
        SendError::Full => Problem::new(
            Code::Overloaded,
            "too many commands are waiting to go out; this one was not sent",
        ),
        SendError::TooLarge => invalid(Reason::TooLarge),
        SendError::NotWritten { sent: false } => Problem::new(
            Code::NotWritten,
            "the disk takes nothing, and this command must outlive the server; it was not sent",
        ),
        SendError::NotWritten { sent: true } => Problem::new(
            Code::SentNotWritten,
            "the command was sent, but the disk takes nothing: should the server end, nobody goes on \
             with it",
        ),
        SendError::NotShared { sent: false } => Problem::new(
            Code::NotShared,
            "the other servers cannot be told; the command was not sent",
        ),
        SendError::NotShared { sent: true } => Problem::new(
            Code::SentNotShared,
            "the command was sent, but the other servers cannot be told: should this one fail, \
             nobody goes on with it",
        ),
    }
}

/// Whether a command waits for the audit log. Nobody who stops or steers a robot does.
fn must_be_audited(action: &Action) -> bool {
    !matches!(Class::of(action), Class::Halt | Class::Motion)
}

/// Sends commands, and writes down that they were given.
#[derive(Clone)]
pub(super) struct CommandSender {
    commands: Arc<CommandCenter>,
    fleet: Arc<SharedFleet>,
    audit: Audit,
    tasks: TaskTracker,
}

impl FromRef<ApiState> for CommandSender {
    fn from_ref(state: &ApiState) -> Self {
        Self {
            commands: FromRef::from_ref(state),
            fleet: FromRef::from_ref(state),
            audit: FromRef::from_ref(state),
            tasks: FromRef::from_ref(state),
        }
    }
}

impl CommandSender {
    /// Sends a command to one robot.
    ///
    /// # Errors
    /// What the caller is told; the command was not sent, or the problem says that it was.
    ///
    /// # Cancellation safety
    /// What was begun is done, and written down: see [`whole`].
    pub(super) async fn send_to_robot(
        self,
        caller: Caller,
        id: String,
        asked: Asked,
    ) -> Result<Accepted, Problem> {
        let tasks = self.tasks.clone();
        whole(&tasks, async move {
            let result = self.try_robot(&caller, &id, &asked).await;
            self.write_down(&caller, &id, asked, &result).await;
            result
        })
        .await
    }

    /// Sends a command to every robot.
    ///
    /// # Errors
    /// As [`CommandSender::send_to_robot`].
    ///
    /// # Cancellation safety
    /// As [`CommandSender::send_to_robot`].
    async fn send_to_swarm(self, caller: Caller, asked: Asked) -> Result<Accepted, Problem> {
        let tasks = self.tasks.clone();
        whole(&tasks, async move {
            let result = self.try_swarm(&caller, &asked).await;
            self.write_down(&caller, "swarm", asked, &result).await;
            result
        })
        .await
    }

    /// Sends a command to each of these robots, which the fleet knows, and writes down that `what` was done to `target`.
    /// Their ids, in the order of the robots.
    ///
    /// # Errors
    /// As [`CommandSender::send_to_robot`]; some of them may have been sent then.
    ///
    /// # Cancellation safety
    /// As [`CommandSender::send_to_robot`].
    pub(super) async fn send_to_each(
        self,
        caller: Caller,
        robots: Vec<RobotId>,
        action: Action,
        (what, target, asked): (&'static str, String, Value),
    ) -> Result<Vec<String>, Problem> {
        let tasks = self.tasks.clone();
        whole(&tasks, async move {
            self.audit.has_room()?;
            let each = robots.into_iter().map(|robot| {
                let to = Target::Robot(robot.clone());
                self.send(&caller, action.clone(), to, vec![robot])
            });
            let sent = futures_util::future::join_all(each).await;
            let sent = sent
                .into_iter()
                .map(|sent| sent.map(|Accepted(view)| view.id));
            let result: Result<Vec<String>, Problem> = sent.collect();
            self.audit
                .write(&caller, what, &target, asked, &result)
                .await;
            result
        })
        .await
    }

    async fn try_robot(
        &self,
        caller: &Caller,
        id: &str,
        asked: &Asked,
    ) -> Result<Accepted, Problem> {
        let action = self.allowed(asked)?;
        let unknown = || Problem::unknown_robot(id);
        let robot = RobotId::new(id).map_err(|_| unknown())?;
        if self.fleet.lock().get(&robot).is_none() {
            return Err(unknown());
        }
        let target = Target::Robot(robot.clone());
        self.send(caller, action, target, vec![robot]).await
    }

    async fn try_swarm(&self, caller: &Caller, asked: &Asked) -> Result<Accepted, Problem> {
        let action = self.allowed(asked)?;
        let expected: Vec<RobotId> = {
            let fleet = self.fleet.lock();
            let online = fleet
                .robots()
                .filter(|robot| robot.presence == Presence::Online);
            online.map(|robot| robot.id.clone()).collect()
        };
        if expected.is_empty() && !is_halt(&action) {
            return Err(Problem::new(
                Code::NoRobots,
                "no robot is online; only stop and estop are sent all the same",
            ));
        }
        self.send(caller, action, Target::Swarm, expected).await
    }

    /// The command, where it is one and may be given now.
    fn allowed(&self, asked: &Asked) -> Result<Action, Problem> {
        let action = asked.action.clone();
        let action = action.map_err(|reason| invalid(reason).with(asked.wrong.clone()))?;
        if must_be_audited(&action) {
            self.audit.has_room()?;
        }
        Ok(action)
    }

    /// Sends a command under the caller's name.
    async fn send(
        &self,
        caller: &Caller,
        action: Action,
        target: Target,
        expected: Vec<RobotId>,
    ) -> Result<Accepted, Problem> {
        let given = self
            .commands
            .give(caller.source(), action, target, expected);
        given.await.map(Accepted).map_err(failed)
    }

    /// Writes down a command that was one. It has gone out by then. Nobody who stops or steers a robot
    /// waits for a disk: their entry is written when the disk takes it.
    async fn write_down(
        &self,
        caller: &Caller,
        target: &str,
        asked: Asked,
        result: &Result<Accepted, Problem>,
    ) {
        let Asked { action, text, .. } = asked;
        let detail = match result {
            Ok(Accepted(view)) => json!({ "id": view.id, "request": text }),
            Err(_) => json!({ "request": text }),
        };
        if action.is_ok_and(|action| !must_be_audited(&action)) {
            self.audit
                .note(caller, "command.send", target, detail, result);
            return;
        }
        self.audit
            .write(caller, "command.send", target, detail, result)
            .await;
    }
}

/// Does `work` whether or not somebody still waits for it: whoever hangs up while a command waits for
/// the disk has given it all the same, and the audit log says so.
async fn whole<T: Send + 'static>(
    tasks: &TaskTracker,
    work: impl Future<Output = Result<T, Problem>> + Send + 'static,
) -> Result<T, Problem> {
    match tasks.spawn(work.in_current_span()).await {
        Ok(result) => result,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => resume_unwind(panic),
            Err(_) => Err(Problem::new(Code::Stopping, "the server is about to end")),
        },
    }
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
        (status = 400, description = "Not JSON"),
        (status = 404, description = "Nobody knows the robot"),
        (status = 422, description = "Not a command"),
        (status = 503, description = "No connection to the broker, or no disk to write it to")))]
pub(super) async fn to_robot(
    State(sender): State<CommandSender>,
    caller: Caller,
    Path(id): Path<String>,
    asked: Asked,
) -> Result<Accepted, Problem> {
    sender.send_to_robot(caller, id, asked).await
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
        (status = 400, description = "Not JSON"),
        (status = 409, description = "No robot is online"),
        (status = 422, description = "Not a command"),
        (status = 503, description = "No connection to the broker, or no disk to write it to")))]
pub(super) async fn to_swarm(
    State(sender): State<CommandSender>,
    caller: Caller,
    asked: Asked,
) -> Result<Accepted, Problem> {
    sender.send_to_swarm(caller, asked).await
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
        (status = 400, description = "The query is not valid"),
        (status = 404, description = "Not a robot's name")))]
pub(super) async fn list(
    State(commands): State<Arc<CommandCenter>>,
    ApiQuery(asked): ApiQuery<ListQuery>,
) -> Result<Json<CommandList>, Problem> {
    let robot = asked.robot.as_deref().map(|id| {
        let robot = RobotId::new(id);
        robot.map_err(|_| Problem::unknown_robot(id))
    });
    let robot = robot.transpose()?;
    let limit = (asked.limit.unwrap_or(50) as usize).min(MOST_LISTED);
    let drive = asked.drive.unwrap_or(false);
    let commands = commands.newest(robot.as_ref(), drive, limit);
    Ok(Json(CommandList { commands }))
}

/// What a command came to
///
/// The server remembers the last 4,096 commands for up to an hour.
#[utoipa::path(get, path = "/commands/{id}", tag = "commands",
    params(("id" = String, Path, description = "Id from the answer to the command")),
    responses(
        (status = 200, description = "What it came to so far", body = CommandView),
        (status = 404, description = "Not known, or no longer"),
        (status = 503, description = "The other servers cannot be asked")))]
pub(super) async fn one(
    State(commands): State<Arc<CommandCenter>>,
    State(membership): State<Option<Arc<ClusterMembership>>>,
    Path(id): Path<String>,
) -> Result<Json<CommandView>, Problem> {
    let unknown = || Problem::new(Code::UnknownCommandId, "no such command is remembered");
    let id: u64 = id.parse().map_err(|_| unknown())?;
    if let Some(view) = commands.view(id) {
        return Ok(Json(view));
    }
    let membership = membership.ok_or_else(unknown)?;
    let fields = membership.cluster.read(id).await.map_err(|error| {
        tracing::warn!(%error, "cannot look up a command of another server");
        Problem::new(
            Code::NotShared,
            "this server does not know the command, and the others cannot be asked",
        )
    })?;
    view_of(id, &fields).map(Json).ok_or_else(unknown)
}
