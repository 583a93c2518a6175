//! What robots, simulators and learners log in to the broker with.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use crawler_access::Secret;
use crawler_protocol::RobotId;
use crawler_records::{Records, RecordsError};
use serde::Serialize;
use serde_json::json;
use utoipa::ToSchema;

use super::access::Caller;
use super::audit::Audit;
use super::problem::{Code, FieldError, Problem};
use super::state::Broker;
use crawler_broker::Kind;
use crawler_system::address::BrokerUrl;
use crawler_system::clock::now_ms;

/// A credential, without its secret, which nobody keeps.
#[derive(Serialize, ToSchema)]
#[schema(as = Credential)]
pub(super) struct CredentialView {
    /// The robot, `simulator-…`, or `learner-…`.
    robot: String,
    /// When it was made, in Unix milliseconds.
    created: i64,
    /// The account that made it.
    by: String,
    /// When it was revoked; `null` while it is good.
    revoked: Option<i64>,
}

/// Credentials.
#[derive(Serialize, ToSchema)]
#[schema(as = Credentials)]
pub(super) struct CredentialList {
    /// By name.
    credentials: Vec<CredentialView>,
}

/// Every credential, also those that were revoked
#[utoipa::path(get, path = "/credentials", tag = "accounts",
    responses((status = 200, description = "The credentials", body = CredentialList)))]
pub(super) async fn list(State(records): State<Records>) -> Result<Json<CredentialList>, Problem> {
    let credentials = records.credentials().all().await;
    let credentials = credentials.map_err(|error| Problem::records(&error))?;
    let credentials = credentials.into_iter().map(|credential| CredentialView {
        robot: credential.name,
        created: credential.created,
        by: credential.by,
        revoked: credential.revoked,
    });
    Ok(Json(CredentialList {
        credentials: credentials.collect(),
    }))
}

/// A credential that was made.
#[derive(Serialize, ToSchema)]
#[schema(as = NewCredential)]
pub(super) struct NewCredentialView {
    /// The robot, `simulator-…`, or `learner-…`.
    robot: String,
    /// Its password at the broker. It is shown here and nowhere else.
    secret: String,
    /// The broker with name and password in it, for the robot's settings.
    url: String,
}

/// The broker as the robot is likely to reach it: an embedded one is where the caller found this
/// server.
fn address(
    mqtt: &BrokerUrl,
    broker: &Broker,
    headers: &HeaderMap,
    name: &str,
    secret: &Secret,
) -> String {
    let mut url = mqtt.clone();
    url.credentials = None;
    if broker.0.is_some()
        && let Some(host) = headers
            .get(header::HOST)
            .and_then(|host| host.to_str().ok())
            .and_then(|host| host.parse::<Authority>().ok())
    {
        let host = host.host();
        let bare = host
            .strip_prefix('[')
            .and_then(|host| host.strip_suffix(']'));
        bare.unwrap_or(host).clone_into(&mut url.host);
    }
    let bare = url.to_string();
    // A name and a secret have no character that means something in an address.
    bare.split_once("://").map_or_else(
        || bare.clone(),
        |(scheme, rest)| format!("{scheme}://{name}:{secret}@{rest}"),
    )
}

/// Who may have a credential: a robot, a simulator or a learner, whose names are robots' names too.
fn named(name: &str) -> Result<RobotId, Problem> {
    RobotId::new(name).map_err(|_| {
        let error = FieldError::of_parameter("id", "must be 1 to 32 of a-z, 0-9 and hyphen");
        Problem::new(
            Code::BadName,
            "a robot's name is 1 to 32 of a-z, 0-9 and hyphen",
        )
        .with(vec![error])
    })
}

/// Gives a robot its secret
///
/// `simulator-NAME` enrols a simulator, whose one secret is good for all robots in it, and
/// `learner-NAME` a machine of federated learning. One that had a secret gets another, and its
/// connection to an embedded broker ends.
#[utoipa::path(post, path = "/robots/{id}/credential", tag = "accounts",
    params(("id" = String, Path, pattern = "^[a-z0-9-]{1,32}$",
        description = "Robot id, `simulator-…`, or `learner-…`")),
    responses(
        (status = 201, description = "Enrolled; the secret is shown this once",
            body = NewCredentialView),
        (status = 409, description = "There are as many as may be"),
        (status = 422, description = "Not a robot's name")))]
pub(super) async fn enrol(
    State(records): State<Records>,
    State(audit): State<Audit>,
    State(broker): State<Broker>,
    State(mqtt): State<BrokerUrl>,
    caller: Caller,
    headers: HeaderMap,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let robot = named(&id)?;
    let secret = Secret::generate().map_err(|_| Problem::internal("no randomness"))?;
    let result = records
        .credentials()
        .enroll(robot.as_str(), secret.digest(), now_ms(), &caller.name())
        .await
        .map_err(|error| match error {
            RecordsError::TooMany(_) => {
                Problem::new(Code::TooMany, "there are as many credentials as may be")
            }
            error => Problem::records(&error),
        });
    audit
        .write(
            &caller,
            "credential.enrol",
            robot.as_str(),
            json!({}),
            &result,
        )
        .await;
    result?;
    broker.drop_client(Kind::Machine, robot.as_str()).await;
    let view = NewCredentialView {
        url: address(&mqtt, &broker, &headers, robot.as_str(), &secret),
        robot: robot.as_str().to_owned(),
        secret: secret.to_string(),
    };
    Ok((StatusCode::CREATED, Json(view)).into_response())
}

/// Takes a robot's secret away
///
/// Its connection to an embedded broker ends at once.
#[utoipa::path(delete, path = "/robots/{id}/credential", tag = "accounts",
    params(("id" = String, Path, description = "Robot id, `simulator-…`, or `learner-…`")),
    responses(
        (status = 204, description = "Revoked"),
        (status = 404, description = "It has none")))]
pub(super) async fn revoke(
    State(records): State<Records>,
    State(audit): State<Audit>,
    State(broker): State<Broker>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let unknown = || {
        Problem::new(
            Code::UnknownCredential,
            "there is no credential of that name that is good",
        )
    };
    let robot = named(&id).map_err(|_| unknown())?;
    let result = records
        .credentials()
        .revoke(robot.as_str(), now_ms())
        .await
        .map_err(|error| match error {
            RecordsError::NotFound => unknown(),
            error => Problem::records(&error),
        });
    // Whoever would not hear of it in the records is not to stay at the broker either.
    if result.is_ok() {
        broker.drop_client(Kind::Machine, robot.as_str()).await;
    }
    audit
        .write(
            &caller,
            "credential.revoke",
            robot.as_str(),
            json!({}),
            &result,
        )
        .await;
    result?;
    Ok(StatusCode::NO_CONTENT)
}
