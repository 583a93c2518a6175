//! What if: a recorded moment with another command in it.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use crawler_counterfactuals::answer::{self, Answer, RobotAnswer};
use crawler_counterfactuals::{
    self as counterfactuals, Counterfactual, Counterfactuals, Known, MOST_DRAWS, MOST_SECONDS,
    NotAsked, Question, STEP_MS, Unreadable,
};
use crawler_fleet::SharedFleet;
use crawler_fleet::feed::drawn_kind;
use crawler_protocol::{RobotId, RobotState};
use crawler_simulations::arena_json;
use crawler_system::clock;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use utoipa::ToSchema;

use super::access::Caller;
use super::audit::Audit;
use super::commands::{Asked, CommandRequest};
use super::guard::JsonBody;
use super::history::{rounded, state_place};
use super::problem::{Code, FieldError, Problem};
use super::telemetry;

/// For another question to come to its end.
const RETRY: Duration = Duration::from_secs(5);

/// What is asked.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = CounterfactualRequest)]
pub(super) struct QuestionBody {
    /// Unix milliseconds of the moment.
    at: i64,
    /// How long after it, in seconds.
    #[schema(minimum = 1, maximum = 60)]
    seconds: u32,
    /// How often bodies, noise and chance are drawn anew.
    #[schema(minimum = 2, maximum = 200)]
    draws: u32,
    /// Who is told something else; everybody where it is left out.
    robots: Option<Vec<String>>,
    /// What they are told at the moment.
    #[schema(value_type = CommandRequest)]
    command: Map<String, Value>,
}

impl QuestionBody {
    fn read(self) -> Result<Question, Problem> {
        let mut wrong = Vec::new();
        let mut within = |name: &str, value: u32, least: u32, most: u32| {
            if !(least..=most).contains(&value) {
                let rule = format!("must be {least} to {most}");
                wrong.push(FieldError::at(format!("/{name}"), rule));
            }
        };
        within("seconds", self.seconds, 1, MOST_SECONDS);
        within("draws", self.draws, 2, MOST_DRAWS);
        if self.at < 0 {
            wrong.push(FieldError::at("/at", "must be Unix milliseconds"));
        }
        let mut robots = self.robots.as_ref().map(|_| Vec::new());
        for (index, name) in self.robots.iter().flatten().enumerate() {
            match (RobotId::new(name), &mut robots) {
                (Ok(robot), Some(robots)) => robots.push(robot),
                _ => wrong.push(FieldError::at(
                    format!("/robots/{index}"),
                    "must be the name of a robot",
                )),
            }
        }
        if robots.as_ref().is_some_and(Vec::is_empty) {
            wrong.push(FieldError::at(
                "/robots",
                "must name a robot, or be left out",
            ));
        }
        let asked = Asked::read(json!(self.command).to_string().as_bytes());
        let action = match asked.into_action() {
            Ok(action) if counterfactuals::moves(&action) => Some(action),
            Ok(_) => {
                let rule = "must be one that moves robots, or stops them";
                wrong.push(FieldError::at("/command/command", rule));
                None
            }
            Err((reason, parts)) => {
                if parts.is_empty() {
                    wrong.push(FieldError::at("/command", reason.name()));
                }
                wrong.extend(parts.into_iter().map(|part| {
                    let pointer = format!("/command{}", part.pointer.as_deref().unwrap_or(""));
                    FieldError::at(pointer, part.detail)
                }));
                None
            }
        };
        match action {
            Some(action) if wrong.is_empty() => Ok(Question {
                at_ms: self.at,
                seconds: self.seconds,
                draws: self.draws,
                robots,
                action,
            }),
            _ => Err(Problem::invalid(Code::InvalidCounterfactual, wrong)),
        }
    }
}

/// How far the answer is.
#[derive(Serialize, ToSchema)]
#[schema(as = CounterfactualState)]
#[serde(rename_all = "lowercase")]
enum StateView {
    /// It is being worked out.
    Running,
    /// There it is.
    Done,
    /// There is none; `detail` says why.
    Failed,
}

/// What if a recorded moment had had another command in it.
#[derive(Serialize, ToSchema)]
#[schema(as = Counterfactual)]
pub(super) struct CounterfactualView {
    /// Its id.
    id: String,
    /// Unix milliseconds at which it was asked.
    asked: u64,
    /// By whom.
    by: String,
    /// How far it is.
    state: StateView,
    /// Why there is no answer; `null` where there is one, or may be.
    detail: Option<String>,
    /// Draws that are done.
    done: u32,
    /// Unix milliseconds of the moment.
    at: i64,
    /// How long after it, in seconds.
    seconds: u32,
    /// How many draws there are.
    draws: u32,
    /// Who is told something else; `null` for everybody.
    robots: Option<Vec<String>>,
    /// What they are told.
    #[schema(value_type = CommandRequest)]
    command: Value,
    /// The answer; `null` while there is none, and in lists.
    answer: Option<AnswerView>,
}

/// What the draws come to.
#[derive(Serialize, ToSchema)]
#[schema(as = CounterfactualAnswer)]
struct AnswerView {
    /// Milliseconds from one point of a path to the next; the first is at the moment.
    step: u32,
    /// Names of states.
    states: Vec<&'static str>,
    /// The simulated arena of the moment, as the live feed tells it; `null` where there was none.
    #[schema(value_type = Option<Object>)]
    arena: Option<Value>,
    /// Whether what was recorded lies where the draws have it that tell how it was.
    null_test: NullTestView,
    /// Numbers of the whole world.
    measures: Vec<MeasureView>,
    /// The robots, by their names.
    robots: Vec<RobotView>,
}

/// The null test: the unchanged world against what was recorded.
#[derive(Serialize, ToSchema)]
#[schema(as = CounterfactualNullTest)]
struct NullTestView {
    /// Robots of which enough was recorded.
    robots: usize,
    /// Those whose record lies in the region that holds 95 % of the draws.
    inside: usize,
}

/// A number of both worlds.
#[derive(Serialize, ToSchema)]
#[schema(as = CounterfactualMeasure)]
struct MeasureView {
    /// `contacts` and `way_m` of a robot on average, `nearest_m`: how near two robots ever were.
    name: &'static str,
    /// Its unit; empty where it has none.
    unit: &'static str,
    /// As it was, the mean of the draws.
    was: f64,
    /// With the change.
    would: f64,
    /// What the change makes of it.
    difference: DifferenceView,
}

/// A difference, draw by draw.
#[derive(Serialize, ToSchema)]
#[schema(as = CounterfactualDifference)]
struct DifferenceView {
    /// Mean of the draws.
    mean: f64,
    /// Lower end of the interval that holds it with 95 %.
    low: f64,
    /// Its upper end.
    high: f64,
}

/// Where a robot was, as recorded; `null` at points where nobody knows.
#[derive(Serialize, ToSchema)]
#[schema(as = CounterfactualRecord)]
struct RecordView {
    /// Metres.
    x: Vec<Option<f64>>,
    /// Metres.
    y: Vec<Option<f64>>,
    /// Radians.
    theta: Vec<Option<f64>>,
}

/// Where a robot goes in one of both worlds.
#[derive(Serialize, ToSchema)]
#[schema(as = CounterfactualPath)]
struct PathView {
    /// Metres.
    x: Vec<f64>,
    /// Metres.
    y: Vec<f64>,
    /// Radians.
    theta: Vec<f64>,
    /// What it does, by its place in `states`.
    state: Vec<usize>,
    /// Radius around it that holds 95 % of the draws, in metres.
    within: Vec<f64>,
}

/// From what a body is known: a calibration, what the robot did in the 90 seconds before the moment, or its make alone.
#[derive(Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = CounterfactualBody)]
enum BodyView {
    Certificate,
    Record,
    Make,
}

/// A robot in both worlds.
#[derive(Serialize, ToSchema)]
#[schema(as = CounterfactualRobot)]
struct RobotView {
    /// The robot.
    robot: String,
    /// What kind of robot; `null` for one that the server has not heard of since it started.
    kind: Option<&'static str>,
    /// From what its body is known.
    body: BodyView,
    /// Id of the certificate whose body it has; `null` for another one.
    certificate: Option<String>,
    /// What it was told last before the moment; `null` where nobody knows of anything.
    command: Option<String>,
    /// Whether that is supposed only: it moved, and nobody knows who told it to.
    supposed: bool,
    /// Where it was, as recorded.
    recorded: RecordView,
    /// Where it goes as it was.
    was: PathView,
    /// Where it goes with the change.
    would: PathView,
    /// Whether its record lies in the region of the draws as it was; `null` where too little is recorded.
    inside: Option<bool>,
    /// Seconds until it is first more than 5 cm from where it would be; `null` when it never is.
    parted_s: Option<f64>,
    /// How far from where it would be it is in the end, in metres; the mean of the draws.
    apart: f64,
    /// How often it touches something, as it was and with the change; the mean of the draws.
    contacts: [f64; 2],
}

/// Those that are kept.
#[derive(Serialize, ToSchema)]
#[schema(as = CounterfactualList)]
pub(super) struct ListView {
    /// Newest first; without their answers.
    counterfactuals: Vec<CounterfactualView>,
}

/// Kinds of robots, as they are drawn.
type Kinds = BTreeMap<RobotId, &'static str>;

impl CounterfactualView {
    fn new(found: Counterfactual, kinds: Option<&Kinds>) -> Self {
        let (state, detail, told) = match found.state {
            counterfactuals::State::Running => (StateView::Running, None, None),
            counterfactuals::State::Done(answer) => (StateView::Done, None, Some(answer)),
            counterfactuals::State::Failed(why) => (StateView::Failed, Some(why), None),
        };
        let question = found.question;
        let names = |robots: Vec<RobotId>| {
            let names = robots.iter().map(|robot| robot.as_str().to_owned());
            names.collect()
        };
        Self {
            id: found.id.to_string(),
            asked: found.asked_ms,
            by: found.by,
            state,
            detail,
            done: found.done,
            at: question.at_ms,
            seconds: question.seconds,
            draws: question.draws,
            command: json!(question.action),
            robots: question.robots.map(names),
            answer: told
                .zip(kinds)
                .map(|(answer, kinds)| AnswerView::new(&answer, kinds)),
        }
    }
}

impl AnswerView {
    fn new(answer: &Answer, kinds: &Kinds) -> Self {
        let measures = answer.measures.iter().map(|measure| MeasureView {
            name: measure.name,
            unit: measure.unit,
            was: measure.was,
            would: measure.would,
            difference: DifferenceView {
                mean: measure.difference.mean,
                low: measure.difference.low,
                high: measure.difference.high,
            },
        });
        let robots = answer.robots.iter();
        Self {
            step: STEP_MS,
            states: RobotState::ALL.iter().map(|state| state.name()).collect(),
            arena: answer.arena.as_ref().map(arena_json),
            null_test: NullTestView {
                robots: answer.tested,
                inside: answer.inside,
            },
            measures: measures.collect(),
            robots: robots
                .map(|robot| RobotView::new(robot, kinds.get(&robot.robot).copied()))
                .collect(),
        }
    }
}

impl RobotView {
    fn new(robot: &RobotAnswer, kind: Option<&'static str>) -> Self {
        let known = |value: fn(&crawler_sim::world::Pose) -> f32| {
            let points = robot.recorded.iter();
            points
                .map(|place| place.as_ref().map(|place| millimetres(value(place))))
                .collect()
        };
        let (body, certificate) = match &robot.known {
            Known::Certificate(id) => (BodyView::Certificate, Some(id.clone())),
            Known::Record => (BodyView::Record, None),
            Known::Make => (BodyView::Make, None),
        };
        Self {
            robot: robot.robot.as_str().to_owned(),
            kind,
            body,
            certificate,
            command: robot.doing.clone(),
            supposed: robot.supposed,
            recorded: RecordView {
                x: known(|place| place.x),
                y: known(|place| place.y),
                theta: known(|place| place.theta),
            },
            was: PathView::new(&robot.was),
            would: PathView::new(&robot.would),
            inside: robot.inside,
            parted_s: robot.parted_s,
            apart: robot.apart_m,
            contacts: robot.contacts,
        }
    }
}

impl PathView {
    fn new(path: &answer::Path) -> Self {
        let places = |value: fn(&crawler_sim::world::Pose) -> f32| {
            let places = path.places.iter();
            places.map(|place| millimetres(value(place))).collect()
        };
        let states = path.states.iter();
        Self {
            x: places(|place| place.x),
            y: places(|place| place.y),
            theta: places(|place| place.theta),
            state: states.copied().map(state_place).collect(),
            within: path.within.iter().copied().map(millimetres).collect(),
        }
    }
}

/// To a thousandth.
fn millimetres(value: f32) -> f64 {
    rounded(value, 1_000.0)
}

fn unknown() -> Problem {
    Problem::new(
        Code::UnknownCounterfactual,
        "there is no question of that id; the last sixteen are kept",
    )
}

fn failed(error: &NotAsked) -> Problem {
    match error {
        NotAsked::Busy => Problem::later(Code::Busy, error.to_string(), RETRY),
        NotAsked::Past(Unreadable::Nothing { .. }) => {
            Problem::new(Code::NotRecorded, error.to_string())
        }
        NotAsked::Past(Unreadable::TooMuch(_)) => Problem::new(Code::TooMuch, error.to_string()),
        NotAsked::Past(Unreadable::History(error)) => telemetry::problem(error),
        NotAsked::Past(Unreadable::Records(error)) => Problem::records(error),
        error => {
            tracing::error!(%error, "what if is not worked out");
            Problem::internal("it cannot be worked out")
        }
    }
}

fn number(id: &str) -> Result<u64, Problem> {
    id.parse().map_err(|_| unknown())
}

/// What was asked
///
/// The last sixteen questions of this server, newest first; they are forgotten when it ends.
#[utoipa::path(get, path = "/counterfactuals", tag = "history", operation_id = "counterfactuals",
    responses((status = 200, description = "The questions", body = ListView)))]
pub(super) async fn list(State(counterfactuals): State<Arc<Counterfactuals>>) -> Json<ListView> {
    let all = counterfactuals.list().into_iter();
    Json(ListView {
        counterfactuals: all.map(|one| CounterfactualView::new(one, None)).collect(),
    })
}

/// One that is being worked out, and its address.
pub(super) struct Begun(CounterfactualView);

impl IntoResponse for Begun {
    fn into_response(self) -> Response {
        let Self(view) = self;
        let address = format!("/api/v1/counterfactuals/{}", view.id);
        let headers = [(header::LOCATION, address)];
        (StatusCode::ACCEPTED, headers, Json(view)).into_response()
    }
}

/// What if
///
/// The fleet of a recorded moment is simulated from there on, in lockstep: as it was, with what robots were told, and with another
/// command. Each robot, simulated or real, has the body of its certificate, or one that fits what it did before; bodies, noise and
/// chance are drawn anew many times, the same for both worlds. Of a large fleet the robots count that are near those that are asked about. The
/// answer is worked out in the background, one at a time.
#[utoipa::path(post, path = "/counterfactuals", tag = "history", operation_id = "what_if",
    request_body = QuestionBody,
    responses(
        (status = 202, description = "It is being worked out", body = CounterfactualView),
        (status = 400, description = "Not JSON, or it takes too long"),
        (status = 404, description = "Nothing is recorded of that moment, or of a robot at that moment"),
        (status = 422, description = "`errors` names every field that is wrong"),
        (status = 501, description = "The engine that keeps the history cannot be asked here"),
        (status = 503, description = "Another question is being worked out, or the history is away")))]
pub(super) async fn ask(
    State(counterfactuals): State<Arc<Counterfactuals>>,
    State(audit): State<Audit>,
    caller: Caller,
    body: JsonBody,
) -> Result<Begun, Problem> {
    let asked: QuestionBody = body.read()?;
    let detail = json!({
        "at": asked.at,
        "robots": asked.robots.as_ref().map(Vec::len),
        "request": asked.command,
    });
    let question = asked.read()?;
    let begun = counterfactuals
        .ask(&caller.name(), question, clock::unix_ms())
        .await
        .map_err(|error| failed(&error));
    let id = begun
        .as_ref()
        .map_or_else(|_| String::new(), |one| one.id.to_string());
    audit
        .write(&caller, "counterfactual.ask", &id, detail, &begun)
        .await;
    Ok(Begun(CounterfactualView::new(begun?, None)))
}

/// How far an answer is
#[utoipa::path(get, path = "/counterfactuals/{id}", tag = "history", operation_id = "counterfactual",
    params(("id" = String, Path, description = "Id of the question")),
    responses(
        (status = 200, description = "The question, and its answer where there is one", body = CounterfactualView),
        (status = 404, description = "There is none of that id")))]
pub(super) async fn one(
    State(counterfactuals): State<Arc<Counterfactuals>>,
    State(fleet): State<Arc<SharedFleet>>,
    Path(id): Path<String>,
) -> Result<Json<CounterfactualView>, Problem> {
    let found = counterfactuals.get(number(&id)?).ok_or_else(unknown)?;
    let kinds: Kinds = match &found.state {
        counterfactuals::State::Done(answer) => {
            let fleet = fleet.lock();
            let known = answer.robots.iter().filter_map(|told| {
                let status = fleet.get(&told.robot)?.status.as_ref()?;
                Some((told.robot.clone(), drawn_kind(status.kind).name()))
            });
            known.collect()
        }
        _ => Kinds::new(),
    };
    Ok(Json(CounterfactualView::new(found, Some(&kinds))))
}

/// Ends and forgets a question
#[utoipa::path(delete, path = "/counterfactuals/{id}", tag = "history", operation_id = "forget_counterfactual",
    params(("id" = String, Path, description = "Id of the question")),
    responses(
        (status = 204, description = "It is gone"),
        (status = 404, description = "There is none of that id")))]
pub(super) async fn forget(
    State(counterfactuals): State<Arc<Counterfactuals>>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    if counterfactuals.remove(number(&id)?) {
        Ok(StatusCode::NO_CONTENT)
    } else {
        Err(unknown())
    }
}
