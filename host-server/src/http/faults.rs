//! Breaking robots on purpose.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::StatusCode;
use crawler_protocol::{
    Capability, DecodeError, Kind, MAX_MESSAGE, RobotId, SimulatorCommand, Topic,
};
use crawler_sim::live::ControlError;
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::App;
use super::access::Caller;
use super::guard::JsonBody;
use super::problem::Problem;
use crate::bus::PublishError;
use crate::fleet::Presence;

/// A fault and how long it lasts. The schema `simulator-command` says what it may be.
#[derive(ToSchema)]
#[schema(as = FaultRequest)]
#[allow(dead_code)] // describes a body that the protocol's own parser reads
pub(super) struct FaultRequest {
    /// What breaks.
    #[schema(value_type = Object, example = json!({"fault": "ranger-stuck", "mm": 300}))]
    fault: (),
    /// For how long, in milliseconds, up to a day; left out, until it is healed.
    #[schema(value_type = u32, required = false, minimum = 1, maximum = 86_400_000, example = 5000)]
    lasting_ms: Option<u32>,
}

/// Whether faults can be injected into a robot: it is simulated, or stands on a bench.
fn breakable(app: &App, robot: &RobotId) -> Result<(), Problem> {
    let fleet = app.fleet.lock();
    let known = fleet
        .get(robot)
        .ok_or_else(|| Problem::unknown_robot(robot.as_str()))?;
    let status = known.status.as_ref();
    if status.is_some_and(|status| status.kind == Kind::Simulated) {
        // Its world hears what is said about it, whether or not the robot has a link.
        return Ok(());
    }
    if known.presence == Presence::Offline {
        return Err(Problem::new(
            StatusCode::CONFLICT,
            "robot_offline",
            format!("robot `{robot}` is offline"),
        ));
    }
    if !status.is_some_and(|status| status.capabilities.contains(&Capability::Faults)) {
        return Err(Problem::new(
            StatusCode::CONFLICT,
            "takes_no_faults",
            format!("robot `{robot}` is not simulated and does not stand on a bench"),
        ));
    }
    Ok(())
}

/// Has the world of this process do it, or sends it to whoever runs the robot.
async fn pass_on(
    app: &App,
    robot: &RobotId,
    command: SimulatorCommand,
) -> Result<StatusCode, Problem> {
    if let Some(simulation) = app.simulation.get() {
        match simulation.control(command.clone()).await {
            Ok(_) => return Ok(StatusCode::ACCEPTED),
            // It may be in another world, or on a bench.
            Err(ControlError::NoRobot | ControlError::Ended) => {}
            Err(error) => return Err(error.into()),
        }
    }
    breakable(app, robot)?;
    publish(app, &command)
}

fn refused(error: DecodeError) -> Problem {
    let (status, detail) = match error {
        DecodeError::Malformed => (StatusCode::BAD_REQUEST, "the body is not one JSON object"),
        DecodeError::TooLarge => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "the fault is too large for a message",
        ),
        DecodeError::UnknownField => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "the fault does not have one of these fields",
        ),
        DecodeError::DuplicateField => (StatusCode::UNPROCESSABLE_ENTITY, "a field is there twice"),
        DecodeError::MissingField => (StatusCode::UNPROCESSABLE_ENTITY, "a field is missing"),
        DecodeError::WrongType => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "a field holds another type than it must",
        ),
        _ => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "there is no such fault, or a value is out of range",
        ),
    };
    Problem::new(status, error.reason().name(), detail)
}

/// Reads the body as the rest of an `inject` for this robot.
fn read(robot: &RobotId, body: &[u8]) -> Result<SimulatorCommand, DecodeError> {
    let inner = body
        .trim_ascii()
        .strip_prefix(b"{")
        .and_then(|body| body.strip_suffix(b"}"))
        .ok_or(DecodeError::Malformed)?;
    if inner.trim_ascii().is_empty() {
        return Err(DecodeError::MissingField);
    }
    // The strict reader behind this knows no field twice and nothing after the end, so a body
    // cannot reach beyond the place it is put in.
    let mut text = format!(r#"{{"command":"inject","robot":"{robot}","#).into_bytes();
    text.extend_from_slice(inner);
    text.push(b'}');
    SimulatorCommand::from_json(&text)
}

fn publish(app: &App, command: &SimulatorCommand) -> Result<StatusCode, Problem> {
    let mut buffer = [0; MAX_MESSAGE];
    let len = command
        .to_json(&mut buffer)
        .map_err(|_| refused(DecodeError::TooLarge))?;
    match app.bus.publish(&Topic::SimulatorCommand, &buffer[..len]) {
        Ok(()) => Ok(StatusCode::ACCEPTED),
        Err(PublishError::NotConnected) => Err(Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "broker_unavailable",
            "there is no connection to the broker; nothing was sent",
        )),
        Err(PublishError::Full) => Err(Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "overloaded",
            "too many messages are waiting to go out; this one was not sent",
        )),
    }
}

/// Breaks something about a robot
///
/// A robot of the world in this process is broken at once. Otherwise its simulator is told to, or
/// the robot itself where it stands on a bench, and says in its log what became of it.
#[utoipa::path(post, path = "/robots/{id}/faults", tag = "robots",
    params(("id" = String, Path, description = "Robot id")),
    request_body = FaultRequest,
    responses(
        (status = 202, description = "Done, or sent to whoever can"),
        (status = 400, description = "Not JSON", body = Problem,
            content_type = "application/problem+json"),
        (status = 404, description = "Nobody knows the robot", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "It is offline, takes no faults, or not this one",
            body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "Not a fault", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "Too much waits, or no connection to the broker",
            body = Problem, content_type = "application/problem+json")))]
pub(super) async fn inject(
    State(app): State<Arc<App>>,
    caller: Caller,
    Path(id): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<StatusCode, Problem> {
    let robot = RobotId::new(&id).map_err(|_| Problem::unknown_robot(&id))?;
    let command = read(&robot, &body).map_err(refused)?;
    let result = pass_on(&app, &robot, command).await;
    let detail = json!({ "request": serde_json::from_slice::<Value>(&body).unwrap_or_default() });
    app.audit(&caller, "fault.inject", &id, detail, &result)
        .await;
    result
}

/// Mends what was broken about a robot on purpose
#[utoipa::path(delete, path = "/robots/{id}/faults", tag = "robots",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 202, description = "Done, or sent to whoever can"),
        (status = 404, description = "Nobody knows the robot", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "It is offline, takes no faults, or not this one",
            body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "Too much waits, or no connection to the broker",
            body = Problem, content_type = "application/problem+json")))]
pub(super) async fn heal(
    State(app): State<Arc<App>>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let robot = RobotId::new(&id).map_err(|_| Problem::unknown_robot(&id))?;
    let command = SimulatorCommand::Heal {
        robot: robot.clone(),
    };
    let result = pass_on(&app, &robot, command).await;
    app.audit(&caller, "fault.heal", &id, json!({}), &result)
        .await;
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_cannot_reach_beyond_its_place() {
        let robot = RobotId::new("sim-0001").expect("legal");
        let good = br#" {"fault":{"fault":"ranger-dead"},"lasting_ms":5} "#;
        assert!(matches!(
            read(&robot, good),
            Ok(SimulatorCommand::Inject {
                lasting_ms: Some(5),
                ..
            })
        ));
        for (body, error) in [
            ("", DecodeError::Malformed),
            ("[]", DecodeError::Malformed),
            ("{}", DecodeError::MissingField),
            (r#"{"lasting_ms":5}"#, DecodeError::MissingField),
            (r#"{"fault":"ranger-dead"}"#, DecodeError::WrongType),
            (
                r#"{"fault":{"fault":"ranger-dead"},"robot":"ada-1"}"#,
                DecodeError::DuplicateField,
            ),
            (
                r#"{"fault":{"fault":"ranger-dead"},"command":"reset"}"#,
                DecodeError::DuplicateField,
            ),
            (
                r#"{"fault":{"fault":"ranger-dead"}},{"command":"reset"}"#,
                DecodeError::Malformed,
            ),
            (
                r#"{"fault":{"fault":"ranger-dead"},"seed":1}"#,
                DecodeError::UnknownField,
            ),
        ] {
            assert_eq!(read(&robot, body.as_bytes()), Err(error), "{body}");
        }
    }
}
