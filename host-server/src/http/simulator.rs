//! The simulated world of this process: how it is, and telling it what to do.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use crawler_protocol::SimulatorCommand;
use crawler_sim::live::ControlError;
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::App;
use super::access::Caller;
use super::guard::JsonBody;
use super::problem::Problem;
use crate::simulation::Simulation;
use crate::simulator::{SimulatorAnswer, SimulatorView, control_code};

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
        let status = match error {
            ControlError::Busy | ControlError::Ended => StatusCode::SERVICE_UNAVAILABLE,
            ControlError::NoRobot => StatusCode::NOT_FOUND,
            _ => StatusCode::CONFLICT,
        };
        Self::new(status, control_code(&error), error.to_string())
    }
}

fn simulation(app: &App) -> Result<&Arc<Simulation>, Problem> {
    app.simulation.get().ok_or_else(|| {
        Problem::new(
            StatusCode::NOT_FOUND,
            "no_simulator",
            "no world is simulated in this process",
        )
    })
}

/// The simulated world of this process
#[utoipa::path(get, path = "/simulator", tag = "simulator",
    responses(
        (status = 200, description = "The world", body = SimulatorView),
        (status = 404, description = "There is none", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "It has ended", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn state(State(app): State<Arc<App>>) -> Result<Json<SimulatorView>, Problem> {
    let simulation = simulation(&app)?;
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
        (status = 400, description = "The body is not JSON", body = Problem,
            content_type = "application/problem+json"),
        (status = 404, description = "There is no world, or no such robot", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "It cannot be done", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "Not a command", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "The world has ended, or too much waits", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn command(
    State(app): State<Arc<App>>,
    caller: Caller,
    JsonBody(body): JsonBody,
) -> Result<Json<SimulatorAnswer>, Problem> {
    let simulation = simulation(&app)?;
    if serde_json::from_slice::<serde::de::IgnoredAny>(&body).is_err() {
        return Err(Problem::new(
            StatusCode::BAD_REQUEST,
            "malformed",
            "the body is not JSON",
        ));
    }
    let command = SimulatorCommand::from_json(&body).map_err(|error| {
        Problem::new(
            StatusCode::UNPROCESSABLE_ENTITY,
            "invalid_command",
            format!("the body is no command to the simulator: {error}"),
        )
    })?;
    let done = simulation.control(command).await.map_err(Problem::from);
    let detail = json!({ "request": serde_json::from_slice::<Value>(&body).unwrap_or_default() });
    app.audit(&caller, "simulator.command", "simulator", detail, &done)
        .await;
    Ok(Json(SimulatorAnswer::new(simulation, &done?)))
}
