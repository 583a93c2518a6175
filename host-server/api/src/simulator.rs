//! The simulated world of this process: how it is, and telling it what to do.

use axum::Json;
use axum::extract::State;
use crawler_protocol::DecodeError;
use crawler_sim::live::ControlError;
use crawler_sim_protocol::SimulatorCommand;
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::access::Caller;
use super::audit::Audit;
use super::guard::JsonBody;
use super::problem::{Code, Problem, locate};
use super::state::World;
use crawler_simulations::{SimulatorAnswer, SimulatorView};

/// A command to the simulated world; the schema `simulator-command` says what it may be.
#[derive(ToSchema)]
#[schema(as = SimulatorCommand)]
#[allow(dead_code)] // describes a body that the protocol's own parser reads
pub(super) struct CommandBody {
    /// Its name, like `pause`; what it needs stands beside it.
    #[schema(example = "pause")]
    command: String,
}

impl From<ControlError> for Problem {
    fn from(error: ControlError) -> Self {
        // Named as in answers over MQTT: see `control_code`.
        let code = match error {
            ControlError::Busy => Code::Busy,
            ControlError::Ended => Code::SimulatorEnded,
            ControlError::NoRobot => Code::UnknownRobot,
            _ => Code::Refused,
        };
        Self::new(code, error.to_string())
    }
}

/// The simulated world of this process
#[utoipa::path(get, path = "/simulator", tag = "simulator",
    responses(
        (status = 200, description = "The world", body = SimulatorView),
        (status = 404, description = "There is none"),
        (status = 503, description = "It has ended")))]
pub(super) async fn state(State(world): State<World>) -> Result<Json<SimulatorView>, Problem> {
    let simulation = world.expected()?;
    Ok(Json(SimulatorView::new(simulation, &simulation.state()?)))
}

/// Tells the simulated world what to do
///
/// Answers when it is done: a `step` when the last of its steps is. Steps that take longer than a
/// request may go on all the same.
#[utoipa::path(post, path = "/simulator/commands", tag = "simulator",
    request_body = CommandBody,
    responses(
        (status = 200, description = "It is done", body = SimulatorAnswer),
        (status = 400, description = "The body is not JSON"),
        (status = 404, description = "There is no world, or no such robot"),
        (status = 409, description = "It cannot be done"),
        (status = 422, description = "Not a command"),
        (status = 503, description = "The world has ended, or too much waits")))]
pub(super) async fn command(
    State(world): State<World>,
    State(audit): State<Audit>,
    caller: Caller,
    JsonBody(body): JsonBody,
) -> Result<Json<SimulatorAnswer>, Problem> {
    let simulation = world.expected()?;
    if serde_json::from_slice::<serde::de::IgnoredAny>(&body).is_err() {
        return Err(Problem::new(Code::Malformed, "the body is not JSON"));
    }
    let command = SimulatorCommand::from_json(&body).map_err(|error| {
        let reader = |body: &[u8]| SimulatorCommand::from_json(body).err();
        let reader = |body: &[u8]| reader(body).map(DecodeError::reason);
        Problem::new(
            Code::InvalidCommand,
            format!("the body is no command to the simulator: {error}"),
        )
        .with(locate("simulator-command", &body, error.reason(), reader))
    })?;
    let done = simulation.control(command).await.map_err(Problem::from);
    let detail = json!({ "request": serde_json::from_slice::<Value>(&body).unwrap_or_default() });
    audit
        .write(&caller, "simulator.command", "simulator", detail, &done)
        .await;
    Ok(Json(SimulatorAnswer::new(simulation, &done?)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crawler_simulations::control_code;

    #[test]
    fn errors_have_one_code_over_http_and_over_mqtt() {
        for error in [
            ControlError::Busy,
            ControlError::Ended,
            ControlError::NoRobot,
            ControlError::Refused("so".to_owned()),
        ] {
            let code = control_code(&error);
            assert_eq!(Problem::from(error).code().name(), code);
        }
    }
}
