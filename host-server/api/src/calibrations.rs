//! Calibrations of robots where they stand.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::json;
use utoipa::openapi::schema::{Array, ArrayBuilder, Object, ObjectBuilder, Type};
use utoipa::{IntoParams, ToSchema};

use super::access::Caller;
use super::audit::Audit;
use super::guard::JsonBody;
use super::problem::{Code, FieldError, Problem, member};
use super::query::ApiQuery;
use super::twins::known;
use crawler_calibrations::ground::Region;
use crawler_calibrations::permit::Refusal;
use crawler_calibrations::record::{Calibration, Errors};
use crawler_calibrations::{
    BeginError, Calibrations, Free, NewCalibration as Asked, Preview, StopError,
};
use crawler_fleet::{Shape, SharedFleet};

/// Longest description of a floor, in characters.
const MAX_FLOOR: usize = 64;
/// Sides of a square that is said to be free around a robot are so far away, metres.
const AROUND_M: std::ops::RangeInclusive<f64> = 0.1..=100.0;

/// Half and nine in ten of some predictions were off by less, in metres.
#[derive(Serialize, ToSchema)]
#[schema(as = CalibrationError)]
pub(super) struct ErrorView {
    /// Half of them.
    median: f64,
    /// Nine in ten.
    p90: f64,
}

impl ErrorView {
    const fn new([median, p90]: [f64; 2]) -> Self {
        Self { median, p90 }
    }
}

/// How a drive that was held out is predicted: by the new body, and by those before.
#[derive(Serialize, ToSchema)]
#[schema(as = CalibrationErrors)]
pub(super) struct ErrorsView {
    /// How far ahead, in seconds.
    ahead_s: f64,
    /// By what was found.
    own: ErrorView,
    /// By the nominal body.
    nominal: ErrorView,
    /// By the certificate before; `null` where there was none.
    previous: Option<ErrorView>,
}

impl ErrorsView {
    fn new(errors: &Errors) -> Self {
        Self {
            ahead_s: errors.ahead_s,
            own: ErrorView::new(errors.own),
            nominal: ErrorView::new(errors.nominal),
            previous: errors.previous.map(ErrorView::new),
        }
    }
}

/// Why there is no certificate.
#[derive(Serialize, ToSchema)]
#[schema(as = CalibrationReason)]
pub(super) struct ReasonView {
    /// Of one that was broken off: `stopped`, `other_command`, `left_area`, `robot_near`, `tracker_lost`, `jumped`, `link_lost`,
    /// `halted`, `restarted`, `robot_refused`, `too_little`, `failed` or `server_ended`. Of one that drove: `unidentified`,
    /// `clock_jumped`, `unsound`, `tracker_doubted`, `nothing_held_out`, `not_better_than_nominal` or
    /// `not_better_than_previous`.
    code: String,
    /// For people.
    detail: String,
}

/// A calibration of a robot.
#[derive(Serialize, ToSchema)]
#[schema(as = Calibration)]
pub(super) struct CalibrationView {
    /// Its number.
    number: u64,
    /// The robot.
    robot: String,
    /// Who asked for it.
    by: String,
    /// What the robot drives on, in words; empty where nobody said.
    floor: String,
    /// Unix milliseconds.
    begun: u64,
    /// Unix milliseconds; `null` while it goes on.
    ended: Option<u64>,
    /// `preparing`, `baseline`, `held_out`, `identifying`; at the end `certified`, `refused` or `broken_off`.
    state: &'static str,
    /// How long the drive takes, in seconds.
    seconds: f64,
    /// Legs of the drive that were begun.
    begun_legs: usize,
    /// All of them.
    legs: usize,
    /// Corners of the floor that the robot may take, in metres.
    #[schema(schema_with = corners)]
    area: Vec<[f64; 2]>,
    /// Why there is no certificate; `null` where there is one, and while it goes on.
    reason: Option<ReasonView>,
    /// Id of the certificate; `null` where there is none.
    certificate: Option<String>,
    /// How the part of the drive is predicted that was held out; empty where it did not get so far.
    errors: Vec<ErrorsView>,
    /// How long identification and validation took, in seconds.
    took_s: Option<f64>,
}

impl CalibrationView {
    fn new(one: Calibration) -> Self {
        let [begun_legs, legs] = one.legs;
        Self {
            number: one.id,
            robot: one.robot.as_str().to_owned(),
            by: one.by,
            floor: one.floor,
            begun: one.begun,
            ended: one.ended,
            state: one.state.name(),
            seconds: one.seconds,
            begun_legs,
            legs,
            area: one.area,
            reason: one.reason.map(|reason| ReasonView {
                code: reason.code,
                detail: reason.detail,
            }),
            certificate: one.certificate,
            errors: one.errors.iter().map(ErrorsView::new).collect(),
            took_s: one.took_s,
        }
    }
}

/// Calibrations of a robot.
#[derive(Serialize, ToSchema)]
#[schema(as = Calibrations)]
pub(super) struct CalibrationList {
    /// The newest first.
    calibrations: Vec<CalibrationView>,
}

/// What is against a calibration.
#[derive(Serialize, ToSchema)]
#[schema(as = PermitRefusal)]
pub(super) struct RefusalView {
    /// `offline`, `doubled`, `cannot_drive`, `halted`, `not_idle`, `too_slow`, `no_twin`, `unsure`, `no_area`, `leaves`,
    /// `near_robot`, `busy`, `near_calibration` or `too_many`.
    code: &'static str,
    /// For people.
    detail: String,
    /// Where, x and y in metres, of what is about a place.
    at: Option<[f64; 2]>,
}

impl RefusalView {
    fn new(refusal: &Refusal) -> Self {
        Self {
            code: refusal.name(),
            detail: refusal.to_string(),
            at: refusal.at(),
        }
    }
}

/// Whether a robot may be calibrated where it stands, and what it would be.
#[derive(Serialize, ToSchema)]
#[schema(as = CalibrationPermit)]
pub(super) struct PermitView {
    /// The robot.
    robot: String,
    /// What is against it; `null` where it may begin.
    refused: Option<RefusalView>,
    /// How long the drive takes, in seconds.
    seconds: f64,
    /// Length and width of the floor that it takes, in metres; `null` where that is not known.
    size: Option<[f64; 2]>,
    /// Corners of that floor, in metres; empty where nobody knows where the robot is.
    #[schema(schema_with = corners)]
    area: Vec<[f64; 2]>,
}

impl PermitView {
    fn new(robot: String, preview: Preview) -> Self {
        Self {
            robot,
            refused: preview.refusal.as_ref().map(RefusalView::new),
            seconds: preview.seconds,
            size: preview.size,
            area: preview.area,
        }
    }
}

/// `true` alone.
fn yes() -> Object {
    ObjectBuilder::new()
        .description(Some("Must be `true`: somebody has seen that the floor is free and nobody is within a metre of it."))
        .schema_type(Type::Boolean)
        .enum_values(Some([true]))
        .build()
}

/// Pairs of numbers.
fn corners() -> Array {
    let number = ObjectBuilder::new().schema_type(Type::Number);
    let corner = ArrayBuilder::new().items(number);
    ArrayBuilder::new()
        .items(corner.min_items(Some(2)).max_items(Some(2)))
        .build()
}

/// What a person asks for.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct NewCalibration {
    #[schema(schema_with = yes)]
    confirmed: bool,
    /// What the robot drives on, in words: up to 64 characters.
    #[schema(max_length = 64)]
    floor: Option<String>,
    /// Corners of what is free, x and y in metres: 3 to 32. Fences, and the walls of a simulated arena, hold beside it.
    #[schema(schema_with = corners)]
    #[serde(default)]
    area: Vec<Vec<f64>>,
    /// In its place: so many metres are free around the robot, from its middle to each side of a square; 0.1 to 100.
    #[schema(minimum = 0.1, maximum = 100.0)]
    around: Option<f64>,
}

fn invalid(pointer: &str, detail: impl Into<String>) -> Problem {
    let error = FieldError::at(pointer, detail);
    Problem::invalid(Code::InvalidCalibration, vec![error])
}

impl NewCalibration {
    fn check(self, by: String) -> Result<Asked, Problem> {
        if !self.confirmed {
            let rule = "must be true: look first whether the floor is free and nobody is near";
            return Err(invalid("/confirmed", rule));
        }
        let floor = self.floor.unwrap_or_default();
        if floor.chars().count() > MAX_FLOOR || floor.chars().any(char::is_control) {
            let rule = format!("must have up to {MAX_FLOOR} characters that can be seen");
            return Err(invalid("/floor", rule));
        }
        let free = match (self.area.is_empty(), self.around) {
            (true, None) => None,
            (true, Some(around)) => Some(Free::Around(
                check_around(around).map_err(|rule| invalid("/around", rule))?,
            )),
            (false, None) => Some(Free::Area(Arc::new(shape(self.area)?))),
            (false, Some(_)) => {
                return Err(invalid("/around", "must not be there beside `area`"));
            }
        };
        Ok(Asked { by, floor, free })
    }
}

fn check_around(around: f64) -> Result<f64, String> {
    if AROUND_M.contains(&around) {
        return Ok(around);
    }
    Err(format!(
        "must be {} to {}",
        AROUND_M.start(),
        AROUND_M.end()
    ))
}

/// What somebody says to be free.
#[derive(Debug)]
struct Stated(Shape);

impl Region for Stated {
    fn holds(&self, at: [f64; 2]) -> bool {
        self.0.holds(at)
    }

    fn to_edge(&self, at: [f64; 2]) -> f64 {
        self.0.to_edge(at)
    }
}

fn shape(area: Vec<Vec<f64>>) -> Result<Stated, Problem> {
    let mut corners = Vec::with_capacity(area.len());
    for (number, corner) in area.into_iter().enumerate() {
        let Ok(corner) = <[f64; 2]>::try_from(corner) else {
            let pointer = member("/area", number);
            return Err(invalid(&pointer, "must be two numbers, x and y"));
        };
        corners.push(corner);
    }
    let refused = |error: crawler_fleet::ShapeError| invalid("/area", error.to_string());
    Shape::new(corners).map(Stated).map_err(refused)
}

fn failed(id: &str, error: BeginError) -> Problem {
    match error {
        BeginError::UnknownRobot => Problem::unknown_robot(id),
        BeginError::Refused(refusal) => {
            let detail = format!("{}: {refusal}", refusal.name());
            let problem = Problem::new(Code::NotPermitted, detail);
            match refusal {
                Refusal::NoArea | Refusal::Leaves { .. } => problem.at("/area"),
                _ => problem,
            }
        }
        BeginError::NotWritten(error) => {
            tracing::error!(%error, "a calibration cannot be written down");
            Problem::new(
                Code::NotWritten,
                "the disk takes nothing, and a calibration must be told of after a restart; it has not begun",
            )
        }
        _ => Problem::new(Code::Stopping, "the server is about to end"),
    }
}

fn unknown(number: &str) -> Problem {
    let detail = format!(
        "this robot has no calibration `{}` on this server",
        number.escape_default()
    );
    Problem::new(Code::UnknownCalibration, detail)
}

/// What is said to be free.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PermitQuery {
    /// So many metres are free around the robot, from its middle to each side of a square.
    #[param(minimum = 0.1, maximum = 100.0)]
    around: Option<f64>,
}

/// Whether a robot may be calibrated where it stands
///
/// With what is against it, and which floor the drive takes: that which bodies as different as robots can be swept when
/// they rehearsed it.
#[utoipa::path(get, path = "/robots/{id}/twin/permit", tag = "robots", operation_id = "twin_permit",
    params(("id" = String, Path, description = "Robot id"), PermitQuery),
    responses(
        (status = 200, description = "Whether it may, and what it would be", body = PermitView),
        (status = 400, description = "The query is not valid"),
        (status = 404, description = "Nobody knows the robot")))]
pub(super) async fn permit(
    State(fleet): State<Arc<SharedFleet>>,
    State(calibrations): State<Arc<Calibrations>>,
    Path(id): Path<String>,
    ApiQuery(asked): ApiQuery<PermitQuery>,
) -> Result<Json<PermitView>, Problem> {
    let robot = known(&fleet, &id)?;
    let around = asked.around.map(check_around).transpose();
    let around = around.map_err(|rule| super::query::bad_query("around", rule))?;
    let free = around.map(Free::Around);
    let preview = calibrations.preview(&robot, free.as_ref()).await;
    let preview = preview.map_err(|error| failed(&id, error))?;
    Ok(Json(PermitView::new(id, preview)))
}

/// Calibrations of a robot
///
/// Those that this server has carried out, the newest first; the last 500 of all robots are kept.
#[utoipa::path(get, path = "/robots/{id}/twin/calibrations", tag = "robots", operation_id = "calibrations",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 200, description = "The calibrations", body = CalibrationList),
        (status = 404, description = "Nobody knows the robot")))]
pub(super) async fn list(
    State(fleet): State<Arc<SharedFleet>>,
    State(calibrations): State<Arc<Calibrations>>,
    Path(id): Path<String>,
) -> Result<Json<CalibrationList>, Problem> {
    let robot = known(&fleet, &id)?;
    let all = calibrations.list(&robot).into_iter();
    Ok(Json(CalibrationList {
        calibrations: all.map(CalibrationView::new).collect(),
    }))
}

/// One that has begun, and its address.
pub(super) struct Begun(CalibrationView);

impl IntoResponse for Begun {
    fn into_response(self) -> Response {
        let Self(view) = self;
        let address = format!(
            "/api/v1/robots/{}/twin/calibrations/{}",
            view.robot, view.number
        );
        (
            StatusCode::ACCEPTED,
            [(header::LOCATION, address)],
            Json(view),
        )
            .into_response()
    }
}

/// Calibrates a robot where it stands
///
/// The robot drives for a minute and a half under the eyes of the server, which ends it for whatever should not be:
/// somebody stops it or tells the robot something else, it leaves the floor that it may take, somebody comes near, its link or the
/// tracker is lost. A certificate comes of it if a part of the drive that was held out is predicted better than by
/// the nominal body, and than by the certificate before.
#[utoipa::path(post, path = "/robots/{id}/twin/calibrations", tag = "robots", operation_id = "calibrate",
    params(("id" = String, Path, description = "Robot id")),
    request_body = NewCalibration,
    responses(
        (status = 202, description = "It has begun", body = CalibrationView),
        (status = 400, description = "Not JSON"),
        (status = 404, description = "Nobody knows the robot"),
        (status = 409, description = "It may not be calibrated now, or here; `detail` says why"),
        (status = 422, description = "Not confirmed, or no area"),
        (status = 503, description = "No disk to write it to")))]
pub(super) async fn begin(
    State(fleet): State<Arc<SharedFleet>>,
    State(calibrations): State<Arc<Calibrations>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
    body: JsonBody,
) -> Result<Begun, Problem> {
    let robot = known(&fleet, &id)?;
    let asked: NewCalibration = body.read()?;
    let asked = asked.check(caller.name())?;
    audit.has_room()?;
    let detail = json!({ "floor": asked.floor });
    let begun = calibrations.begin(&robot, asked).await;
    let begun = begun.map_err(|error| failed(&id, error));
    audit
        .write(&caller, "calibration.begin", &id, detail, &begun)
        .await;
    Ok(Begun(CalibrationView::new(begun?)))
}

/// How far a calibration is
#[utoipa::path(get, path = "/robots/{id}/twin/calibrations/{number}", tag = "robots", operation_id = "calibration",
    params(("id" = String, Path, description = "Robot id"),
        ("number" = String, Path, description = "Number of the calibration")),
    responses(
        (status = 200, description = "The calibration", body = CalibrationView),
        (status = 404, description = "Nobody knows the robot, or it has no such calibration on this server")))]
pub(super) async fn one(
    State(fleet): State<Arc<SharedFleet>>,
    State(calibrations): State<Arc<Calibrations>>,
    Path((id, number)): Path<(String, String)>,
) -> Result<Json<CalibrationView>, Problem> {
    let robot = known(&fleet, &id)?;
    let found = number.parse().ok();
    let found = found.and_then(|number| calibrations.get(&robot, number));
    let found = found.ok_or_else(|| unknown(&number))?;
    Ok(Json(CalibrationView::new(found)))
}

/// Stops a calibration
///
/// The robot is told to stop at once. It stays in the list, as broken off.
#[utoipa::path(delete, path = "/robots/{id}/twin/calibrations/{number}", tag = "robots", operation_id = "stop_calibration",
    params(("id" = String, Path, description = "Robot id"),
        ("number" = String, Path, description = "Number of the calibration")),
    responses(
        (status = 204, description = "The robot was told to stop"),
        (status = 404, description = "Nobody knows the robot, or it has no such calibration on this server"),
        (status = 409, description = "It is over")))]
pub(super) async fn stop(
    State(fleet): State<Arc<SharedFleet>>,
    State(calibrations): State<Arc<Calibrations>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path((id, number)): Path<(String, String)>,
) -> Result<StatusCode, Problem> {
    let robot = known(&fleet, &id)?;
    let found: u64 = number.parse().map_err(|_| unknown(&number))?;
    let stopped = calibrations.stop(&robot, found, &caller.name());
    let stopped = stopped.map_err(|error| match error {
        StopError::Unknown => unknown(&number),
        StopError::Over => Problem::new(Code::WrongState, "this calibration is over"),
    });
    let detail = json!({ "number": found });
    // Nobody who stops a robot waits for a disk.
    audit.note(&caller, "calibration.stop", &id, detail, &stopped);
    stopped?;
    Ok(StatusCode::NO_CONTENT)
}
