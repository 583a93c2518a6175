//! The fleet as last known.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use crawler_protocol::open::{Boot, LogRecord, Open};
use crawler_protocol::{
    Battery, BehaviourName, Capability, Detections, Kind, ParameterValue, Pose, RobotId,
    RobotState, Says, Wheels,
};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::access::Caller;
use super::commands::{Accepted, Asked, CommandSender};
use super::guard::JsonBody;
use super::problem::{Code, Problem};
use super::query::ApiQuery;
use super::shadows::{self, ShadowView};
use super::state::Broker;
use crawler_broker::LinkState;
use crawler_fleet::{FleetState, Presence, Robot, SharedFleet};
use crawler_system::clock;

/// A robot as last known. What it has not told yet is `null`.
#[derive(Serialize, ToSchema)]
#[schema(as = Robot)]
pub(super) struct RobotView {
    /// Its id.
    id: String,
    /// Its number in the live feed.
    index: u16,
    /// Whether it is there.
    presence: Presence,
    /// Whether two robots seem to use this id.
    duplicate: bool,
    /// `throttled` while it sends more than it may, `cut_off` while it is locked out for that; `null`
    /// when all is well, and with an outside broker.
    link: Option<&'static str>,
    /// Unix milliseconds of its last heartbeat or telemetry; `null` when it has not spoken since the
    /// server runs.
    last_seen: Option<u64>,
    /// `simulated`, `emulated` or `physical`.
    #[schema(value_type = Option<String>)]
    kind: Option<Open<Kind>>,
    /// Version of its program.
    firmware: Option<String>,
    /// What names the program that it runs; `null` for robots before updates.
    build: Option<String>,
    /// The models that it has loaded, each with what names its contents.
    models: BTreeMap<String, String>,
    /// Its hardware.
    board: Option<String>,
    /// What it has: `drive`, `range`, `camera`, `vision`.
    #[schema(value_type = Vec<String>)]
    capabilities: Vec<Open<Capability>>,
    /// How often and why it started.
    #[schema(value_type = Option<Object>)]
    boot: Option<Boot>,
    /// Version of the messages it speaks.
    protocol: Option<u8>,
    /// How many fields of its messages this server did not know, and passed over: it is newer.
    unknown_fields: u64,
    /// How many words, such as a state, this server did not know. They are shown as the robot says them.
    unknown_words: u64,
    /// Its state, like `MOVING`.
    #[schema(value_type = Option<String>)]
    state: Option<Open<RobotState>>,
    /// Its behaviour, like `wander`.
    #[schema(value_type = Option<String>)]
    behaviour: Option<Open<BehaviourName>>,
    /// Where it believes to be, in metres and radians; `sigma` is how sure it is.
    #[schema(value_type = Option<Object>)]
    pose: Option<Pose>,
    /// What its ranger sees, in millimetres.
    range_mm: Option<u16>,
    /// Temperature at the ranger.
    temperature_c: Option<f32>,
    /// Duty of the wheels, −1 to 1.
    #[schema(value_type = Option<Object>)]
    wheels: Option<Wheels>,
    /// Its battery, in millivolts and percent.
    #[schema(value_type = Option<Object>)]
    battery: Option<Battery>,
    /// Strength of its radio link.
    rssi_dbm: Option<i8>,
    /// What it says to its neighbours; `null` while its behaviour needs nothing said.
    #[schema(value_type = Option<Vec<i32>>)]
    says: Option<Says>,
    /// How a policy that does not drive compares with the one that does; `null` while nobody has asked for that.
    shadow: Option<ShadowView>,
    /// Milliseconds since it started.
    uptime_ms: Option<u64>,
    /// Unix milliseconds of the telemetry shown here, by the robot's clock.
    timestamp: Option<u64>,
    /// What it saw last; `null` for a robot that has no eyes or told of nothing yet.
    sees: Option<SightView>,
    /// Unix milliseconds at which its newest image arrived; `null` when there is none.
    image: Option<u64>,
    /// Name of the fence that it is on the wrong side of; `null` when there is none.
    fence: Option<String>,
}

/// What a robot saw in one frame, clearest first.
#[derive(Serialize, ToSchema)]
#[schema(as = Sight)]
pub(super) struct SightView {
    /// Unix milliseconds of the frame, by the robot's clock; 0 when it did not know the time.
    timestamp: u64,
    /// Number of the frame.
    frame: u32,
    /// The things in it.
    objects: Vec<SeenView>,
}

/// One thing in a frame.
#[derive(Serialize, ToSchema)]
#[schema(as = Seen)]
pub(super) struct SeenView {
    /// `obstacle`, `object` or `robot`.
    class: String,
    /// From the left edge, as a share of the width.
    x: f32,
    /// From the top edge, as a share of the height.
    y: f32,
    /// From where the robot heads to it, in radians, positive to the left.
    bearing: f32,
    /// How far the class is ahead of the next one, in steps of the detector's output.
    margin: u8,
}

impl SightView {
    fn new(seen: &Detections) -> Self {
        let objects = seen.objects.iter().map(|object| SeenView {
            class: object.class.as_str().to_owned(),
            x: object.x,
            y: object.y,
            bearing: object.bearing,
            margin: object.margin,
        });
        Self {
            timestamp: seen.timestamp,
            frame: seen.frame,
            objects: objects.collect(),
        }
    }
}

impl RobotView {
    fn new(broker: &Broker, fleet: &FleetState, robot: &Robot) -> Self {
        let link = broker.0.as_ref().and_then(|broker| broker.link(&robot.id));
        let status = robot.status.as_ref();
        let telemetry = robot.telemetry.as_ref();
        Self {
            id: robot.id.as_str().to_owned(),
            index: robot.index,
            presence: robot.presence,
            duplicate: robot.has_double(),
            link: link.map(LinkState::name),
            last_seen: robot.last_seen_ms,
            kind: status.map(|status| status.kind),
            firmware: status.map(|status| status.firmware.as_str().to_owned()),
            build: status.and_then(|status| Some(status.build.as_ref()?.as_str().to_owned())),
            models: status.map_or_else(BTreeMap::new, |status| {
                let text = |name: &str| name.to_owned();
                let models = status.models.iter();
                models
                    .map(|(model, build)| (text(model.as_str()), text(build.as_str())))
                    .collect()
            }),
            board: status.map(|status| status.board.as_str().to_owned()),
            capabilities: status.map_or_else(Vec::new, |status| status.capabilities.to_vec()),
            boot: status.map(|status| status.boot.clone()),
            protocol: status.map(|status| status.protocol),
            unknown_fields: robot.unknown.fields,
            unknown_words: robot.unknown.words,
            state: robot.state(),
            behaviour: telemetry.map(|telemetry| telemetry.behaviour),
            pose: telemetry.map(|telemetry| telemetry.pose),
            range_mm: telemetry.and_then(|telemetry| telemetry.range_mm),
            temperature_c: telemetry.and_then(|telemetry| telemetry.temperature_c),
            wheels: telemetry.map(|telemetry| telemetry.wheels),
            battery: telemetry.map(|telemetry| telemetry.battery),
            rssi_dbm: telemetry.and_then(|telemetry| telemetry.rssi_dbm),
            says: telemetry.and_then(|telemetry| telemetry.says),
            shadow: shadows::of_robot(robot),
            uptime_ms: robot.heartbeat.as_ref().map(|beat| beat.uptime_ms),
            timestamp: telemetry.map(|telemetry| telemetry.timestamp),
            sees: robot.sees.as_deref().map(SightView::new),
            image: fleet.image(&robot.id).map(|image| image.received),
            fence: fleet.fence_of(robot).map(|fence| fence.name.clone()),
        }
    }
}

/// The fleet.
#[derive(Serialize, ToSchema)]
#[schema(as = Robots)]
pub(super) struct RobotList {
    /// Unix milliseconds now, by the server's clock.
    time: u64,
    /// Every robot the server knows, by index.
    robots: Vec<RobotView>,
}

/// Every robot as last known
#[utoipa::path(get, path = "/robots", tag = "robots",
    responses((status = 200, description = "The fleet", body = RobotList)))]
pub(super) async fn list(
    State(fleet): State<Arc<SharedFleet>>,
    State(broker): State<Broker>,
) -> Json<RobotList> {
    let robots = {
        let fleet = fleet.lock();
        let views = fleet
            .robots()
            .map(|robot| RobotView::new(&broker, &fleet, robot));
        views.collect()
    };
    Json(RobotList {
        time: clock::unix_ms(),
        robots,
    })
}

/// Looks a robot up and takes from it what is wanted.
fn with_robot<T>(
    fleet: &SharedFleet,
    id: &str,
    take: impl FnOnce(&Robot) -> T,
) -> Result<T, Problem> {
    let unknown = || Problem::unknown_robot(id);
    let id = RobotId::new(id).map_err(|_| unknown())?;
    fleet.lock().get(&id).map(take).ok_or_else(unknown)
}

/// One robot as last known
#[utoipa::path(get, path = "/robots/{id}", tag = "robots",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 200, description = "The robot", body = RobotView),
        (status = 404, description = "Nobody knows it")))]
pub(super) async fn one(
    State(fleet): State<Arc<SharedFleet>>,
    State(broker): State<Broker>,
    Path(id): Path<String>,
) -> Result<Json<RobotView>, Problem> {
    let unknown = || Problem::unknown_robot(&id);
    let robot = RobotId::new(&id).map_err(|_| unknown())?;
    let fleet = fleet.lock();
    let robot = fleet.get(&robot).ok_or_else(unknown)?;
    Ok(Json(RobotView::new(&broker, &fleet, robot)))
}

/// How many records are wanted.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LogQuery {
    /// At most so many; 200 when not given.
    #[param(maximum = 4_294_967_295_u64)]
    limit: Option<u32>,
}

/// What a robot has logged, newest first.
#[derive(Serialize, ToSchema)]
#[schema(as = Logs)]
pub(super) struct LogList {
    /// Newest first. Each is a `log-record` message.
    #[schema(value_type = Vec<Object>)]
    records: Vec<LogRecord>,
}

/// What a robot has logged, newest first
///
/// The server keeps up to 200 records of a robot in memory, fewer when the fleet is large.
#[utoipa::path(get, path = "/robots/{id}/logs", tag = "robots",
    params(("id" = String, Path, description = "Robot id"), LogQuery),
    responses(
        (status = 200, description = "Its log records", body = LogList),
        (status = 400, description = "The query is not valid"),
        (status = 404, description = "Nobody knows it")))]
pub(super) async fn logs(
    State(fleet): State<Arc<SharedFleet>>,
    Path(id): Path<String>,
    ApiQuery(query): ApiQuery<LogQuery>,
) -> Result<Json<LogList>, Problem> {
    let records = with_robot(&fleet, &id, |robot| {
        let newest = robot.logs.iter().rev();
        newest
            .take(query.limit.unwrap_or(200) as usize)
            .cloned()
            .collect()
    })?;
    Ok(Json(LogList { records }))
}

/// A parameter and what it may be.
#[derive(Serialize, ToSchema)]
#[schema(as = Parameter)]
pub(super) struct ParameterView {
    /// Its name.
    name: String,
    /// Its value.
    #[schema(value_type = serde_json::Value)]
    value: ParameterValue,
    /// Its value in a robot as it comes.
    #[schema(value_type = Option<serde_json::Value>)]
    default: Option<ParameterValue>,
    /// Least value.
    min: Option<f32>,
    /// Greatest value.
    max: Option<f32>,
    /// Unit.
    unit: Option<String>,
}

/// The parameters of a robot.
#[derive(Serialize, ToSchema)]
#[schema(as = Parameters)]
pub(super) struct ParameterList {
    /// In the robot's order.
    parameters: Vec<ParameterView>,
}

/// The parameters of a robot
#[utoipa::path(get, path = "/robots/{id}/parameters", tag = "robots",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 200, description = "Its parameters", body = ParameterList),
        (status = 404, description = "Nobody knows it, or its parameters")))]
pub(super) async fn parameters(
    State(fleet): State<Arc<SharedFleet>>,
    Path(id): Path<String>,
) -> Result<Json<ParameterList>, Problem> {
    let message = with_robot(&fleet, &id, |robot| robot.parameters.clone())?.ok_or_else(|| {
        Problem::new(
            Code::NoParameters,
            "the robot has not told its parameters yet",
        )
    })?;
    let parameters = message.values.iter().map(|report| ParameterView {
        name: report.name.as_str().to_owned(),
        value: report.value.clone(),
        default: report.default.clone(),
        min: report.min,
        max: report.max,
        unit: report.unit.as_ref().map(|unit| unit.as_str().to_owned()),
    });
    Ok(Json(ParameterList {
        parameters: parameters.collect(),
    }))
}

/// New values by name. The schema `command-request` says what they may be.
#[derive(ToSchema)]
#[allow(dead_code)] // describes a body that the protocol's own parser reads
pub(super) struct ParameterChanges {}

/// Changes parameters of a robot
///
/// The body is an object of new values, like `{"safe_distance_mm": 600}`. It goes to the robot as a
/// `set` command, which answers for all of them together.
#[utoipa::path(put, path = "/robots/{id}/parameters", tag = "robots",
    params(("id" = String, Path, description = "Robot id")),
    request_body(content = ParameterChanges, description = "New values by name"),
    responses(
        (status = 202, description = "Sent to the robot", body = Accepted),
        (status = 404, description = "Nobody knows it"),
        (status = 409, description = "It is offline"),
        (status = 422, description = "Not an object of values")))]
pub(super) async fn set_parameters(
    State(sender): State<CommandSender>,
    caller: Caller,
    Path(id): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Accepted, Problem> {
    let asked = Asked::read_parameters("set", &body);
    sender.send_to_robot(caller, id, asked).await
}
