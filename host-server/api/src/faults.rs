//! Breaking robots on purpose.

use std::sync::Arc;

use axum::extract::{FromRef, Path, State};
use axum::http::StatusCode;
use crawler_protocol::{Capability, DecodeError, FaultCommand, Kind, MAX_MESSAGE, RobotId, Topic};
use crawler_sim::live::ControlError;
use crawler_sim_protocol::SimulatorCommand;
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::access::Caller;
use super::audit::Audit;
use super::guard::JsonBody;
use super::problem::{Code, FieldError, Problem, locate};
use super::state::{ApiState, World};
use crawler_commands::PublishError;
use crawler_fleet::bus::Bus;
use crawler_fleet::{Presence, SharedFleet};

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

/// Breaks robots and mends them, wherever they are.
#[derive(Clone)]
pub(super) struct Bench {
    fleet: Arc<SharedFleet>,
    world: World,
    bus: Arc<Bus>,
}

impl FromRef<ApiState> for Bench {
    fn from_ref(state: &ApiState) -> Self {
        Self {
            fleet: FromRef::from_ref(state),
            world: FromRef::from_ref(state),
            bus: FromRef::from_ref(state),
        }
    }
}

impl Bench {
    /// Has the world of this process do it, or sends it to whoever runs the robot.
    async fn pass_on(
        &self,
        robot: &RobotId,
        command: SimulatorCommand,
    ) -> Result<StatusCode, Problem> {
        if let Some(simulation) = self.world.get() {
            match simulation.control(command.clone()).await {
                Ok(_) => return Ok(StatusCode::ACCEPTED),
                // It may be in another world, or on a bench.
                Err(ControlError::NoRobot | ControlError::Ended) => {}
                Err(error) => return Err(error.into()),
            }
        }
        self.check(robot)?;
        self.publish(&command)
    }

    /// Whether faults can be injected into a robot: it is simulated, or stands on a bench.
    fn check(&self, robot: &RobotId) -> Result<(), Problem> {
        let fleet = self.fleet.lock();
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
                Code::RobotOffline,
                format!("robot `{robot}` is offline"),
            ));
        }
        if !status.is_some_and(|status| status.capabilities.contains(&Capability::Faults.into())) {
            return Err(Problem::new(
                Code::TakesNoFaults,
                format!("robot `{robot}` is not simulated and does not stand on a bench"),
            ));
        }
        Ok(())
    }

    fn publish(&self, command: &SimulatorCommand) -> Result<StatusCode, Problem> {
        let mut buffer = [0; MAX_MESSAGE];
        let len = command
            .to_json(&mut buffer)
            .map_err(|_| refused(DecodeError::TooLarge))?;
        match self.bus.publish(&Topic::SimulatorCommand, &buffer[..len]) {
            Ok(()) => Ok(StatusCode::ACCEPTED),
            Err(PublishError::NotConnected) => Err(Problem::new(
                Code::BrokerUnavailable,
                "there is no connection to the broker; nothing was sent",
            )),
            Err(PublishError::Full) => Err(Problem::new(
                Code::Overloaded,
                "too many messages are waiting to go out; this one was not sent",
            )),
        }
    }
}

fn refused(error: DecodeError) -> Problem {
    let detail = match error {
        DecodeError::Malformed => "the body is not one JSON object",
        DecodeError::TooLarge => "the fault is too large for a message",
        DecodeError::UnknownField => "the fault does not have one of these fields",
        DecodeError::DuplicateField => "a field is there twice",
        DecodeError::MissingField => "a field is missing",
        DecodeError::WrongType => "a field holds another type than it must",
        _ => "there is no such fault, or a value is out of range",
    };
    Problem::new(Code::Command(error.reason()), detail)
}

/// The body as the rest of an `inject` for this robot.
fn inject_with(robot: &RobotId, body: &[u8]) -> Option<Vec<u8>> {
    let body = body.trim_ascii().strip_prefix(b"{")?;
    let inner = body.strip_suffix(b"}")?.trim_ascii();
    // The strict reader behind this knows no field twice and nothing after the end, so a body
    // cannot reach beyond the place it is put in.
    let mut text = format!(r#"{{"command":"inject","robot":"{robot}""#).into_bytes();
    if !inner.is_empty() {
        text.push(b',');
        text.extend_from_slice(inner);
    }
    text.push(b'}');
    Some(text)
}

/// Reads the body as that.
///
/// # Errors
/// What is wrong, and where.
fn read(robot: &RobotId, body: &[u8]) -> Result<SimulatorCommand, (DecodeError, Vec<FieldError>)> {
    let Some(text) = inject_with(robot, body) else {
        let error = FieldError::at("", "must be an object");
        return Err((DecodeError::Malformed, vec![error]));
    };
    SimulatorCommand::from_json(&text).map_err(|error| {
        let reader = |body: &[u8]| SimulatorCommand::from_json(body).err();
        let reader = |body: &[u8]| reader(body).map(DecodeError::reason);
        (
            error,
            locate("simulator-command", &text, error.reason(), reader),
        )
    })
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
        (status = 400, description = "Not JSON"),
        (status = 404, description = "Nobody knows the robot"),
        (status = 409, description = "It is offline, takes no faults, or not this one"),
        (status = 422, description = "Not a fault"),
        (status = 503, description = "Too much waits, or no connection to the broker")))]
pub(super) async fn inject(
    State(bench): State<Bench>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<StatusCode, Problem> {
    let robot = RobotId::new(&id).map_err(|_| Problem::unknown_robot(&id))?;
    let command = read(&robot, &body).map_err(|(error, wrong)| refused(error).with(wrong))?;
    let result = bench.pass_on(&robot, command).await;
    let detail = json!({ "request": serde_json::from_slice::<Value>(&body).unwrap_or_default() });
    audit
        .write(&caller, "fault.inject", &id, detail, &result)
        .await;
    result
}

/// Mends what was broken about a robot on purpose
#[utoipa::path(delete, path = "/robots/{id}/faults", tag = "robots",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 202, description = "Done, or sent to whoever can"),
        (status = 404, description = "Nobody knows the robot"),
        (status = 409, description = "It is offline, takes no faults, or not this one"),
        (status = 503, description = "Too much waits, or no connection to the broker")))]
pub(super) async fn heal(
    State(bench): State<Bench>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let robot = RobotId::new(&id).map_err(|_| Problem::unknown_robot(&id))?;
    let command = FaultCommand::Heal {
        robot: robot.clone(),
    };
    let result = bench.pass_on(&robot, command.into()).await;
    audit
        .write(&caller, "fault.heal", &id, json!({}), &result)
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
            Ok(SimulatorCommand::Fault(FaultCommand::Inject {
                lasting_ms: Some(5),
                ..
            }))
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
            let refused = read(&robot, body.as_bytes()).expect_err(body);
            assert_eq!(refused.0, error, "{body}");
        }
    }
}
