//! Accounts, as an administrator sees them, and how they come to be.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use crawler_access::{Role, Secret, UserName};
use serde::{Deserialize, Serialize};
use serde_json::json;
use utoipa::ToSchema;
use utoipa::openapi::schema::{Object, ObjectBuilder, Type};

use super::access::{ANONYMOUS, Caller, no_accounts};
use super::audit::Audit;
use super::guard::JsonBody;
use super::peer::Peer;
use super::problem::{Code, Problem};
use super::session::{LoggedIn, LoginView};
use super::state::Broker;
use crawler_accounts::{Accounts, Change, LoginError, PeopleError, UserView};
use crawler_broker::Kind;

impl From<PeopleError> for Problem {
    fn from(error: PeopleError) -> Self {
        match error {
            PeopleError::Unknown => {
                Self::new(Code::UnknownUser, "there is no account of that name")
            }
            PeopleError::Exists => Self::new(Code::UserExists, "there is an account of that name"),
            PeopleError::LastAdmin => Self::new(
                Code::LastAdmin,
                "afterwards nobody could administer the server",
            ),
            PeopleError::TooMany => Self::new(
                Code::TooMany,
                "there are as many accounts or invitations as may be",
            ),
            PeopleError::Weak(weak) => Self::weak(weak, "/password"),
            PeopleError::Busy => Self::busy(),
            PeopleError::Records(error) => Self::records(&error),
            PeopleError::Internal(what) => Self::internal(what),
        }
    }
}

/// The account that an address names.
fn named(name: &str) -> Result<UserName, Problem> {
    // What cannot be a name is nobody's.
    name.parse().map_err(|_| PeopleError::Unknown.into())
}

/// Every account.
#[derive(Serialize, ToSchema)]
#[schema(as = Users)]
pub(super) struct UserList {
    /// By name.
    users: Vec<UserView>,
}

/// Every account
#[utoipa::path(get, path = "/users", tag = "accounts",
    responses((status = 200, description = "The accounts", body = UserList)))]
pub(super) async fn list(State(accounts): State<Arc<Accounts>>) -> Result<Json<UserList>, Problem> {
    let users = accounts.users().await?;
    Ok(Json(UserList { users }))
}

/// The names of roles.
fn roles() -> Object {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .enum_values(Some(["viewer", "operator", "admin"]))
        .examples([json!("operator")])
        .build()
}

/// As [`roles`], where one may be left out.
fn role_or_null() -> Object {
    let mut schema = roles();
    schema.schema_type = [Type::String, Type::Null].into_iter().collect();
    if let Some(values) = &mut schema.enum_values {
        values.push(json!(null));
    }
    schema
}

/// An account that is to be.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct UserRequest {
    /// Its name: 1 to 32 of `a-z`, `0-9`, dot, underscore and hyphen, beginning with a letter.
    #[schema(value_type = String, pattern = "^[a-z][a-z0-9._-]{0,31}$", example = "ada")]
    name: String,
    /// What it may do.
    #[schema(schema_with = roles)]
    role: Role,
    /// Its password; left out, whoever gets the invitation chooses it.
    #[schema(min_length = 10, max_length = 256)]
    password: Option<String>,
}

/// An account that was made.
#[derive(Serialize, ToSchema)]
#[schema(as = NewUser)]
pub(super) struct NewUserView {
    /// The account.
    user: UserView,
    /// The address at which its owner chooses a password, good once and for a day. It is shown here
    /// and nowhere else.
    #[serde(skip_serializing_if = "Option::is_none")]
    invitation: Option<String>,
}

/// The address of an invitation, at this server as the caller knows it. The code is in the part that
/// browsers keep to themselves.
fn link(headers: &HeaderMap, peer: Peer, code: &Secret) -> String {
    let text = |name| {
        let value = headers.get(name)?;
        value.to_str().ok()
    };
    // The check of every request has compared it with the host.
    let origin = text(header::ORIGIN).map_or_else(
        || {
            let scheme = if peer.tls { "https" } else { "http" };
            format!("{scheme}://{}", text(header::HOST).unwrap_or("localhost"))
        },
        str::to_owned,
    );
    format!("{origin}/#invite={code}")
}

/// Makes an account
#[utoipa::path(post, path = "/users", tag = "accounts",
    request_body = UserRequest,
    responses(
        (status = 201, description = "Made", body = NewUserView),
        (status = 400, description = "Not JSON"),
        (status = 409, description = "The name is taken"),
        (status = 422, description = "Not a name, or the password is not good enough")))]
pub(super) async fn add(
    State(accounts): State<Arc<Accounts>>,
    State(audit): State<Audit>,
    caller: Caller,
    headers: HeaderMap,
    body: JsonBody,
) -> Result<Response, Problem> {
    let request: UserRequest = body.read()?;
    let name: UserName = request
        .name
        .parse()
        .map_err(|error| Problem::new(Code::BadName, format!("{error}")).at("/name"))?;
    let detail = json!({ "role": request.role, "invited": request.password.is_none() });
    let result = accounts
        .add(name.clone(), request.role, request.password)
        .await
        .map_err(Problem::from);
    audit
        .write(&caller, "user.add", name.as_ref(), detail, &result)
        .await;
    let (user, code) = result?;
    let invitation = code.map(|code| link(&headers, caller.peer, &code));
    Ok((StatusCode::CREATED, Json(NewUserView { user, invitation })).into_response())
}

/// What changes about an account. What is left out stays.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct UserChange {
    /// What it may do.
    #[schema(schema_with = role_or_null, required = false)]
    role: Option<Role>,
    /// Whether it is locked out.
    disabled: Option<bool>,
    /// Its password.
    #[schema(min_length = 10, max_length = 256)]
    password: Option<String>,
}

/// Changes an account
///
/// Its sessions end with another role or password, and when it is locked out.
#[utoipa::path(patch, path = "/users/{name}", tag = "accounts",
    params(("name" = String, Path, description = "The account")),
    request_body = UserChange,
    responses(
        (status = 200, description = "The account as it is now", body = UserView),
        (status = 400, description = "Not JSON"),
        (status = 404, description = "There is none of that name"),
        (status = 409, description = "It is the last administrator"),
        (status = 422, description = "The password is not good enough")))]
pub(super) async fn change(
    State(accounts): State<Arc<Accounts>>,
    State(audit): State<Audit>,
    State(broker): State<Broker>,
    caller: Caller,
    Path(name): Path<String>,
    body: JsonBody,
) -> Result<Json<UserView>, Problem> {
    let request: UserChange = body.read()?;
    let name = named(&name)?;
    let detail = json!({
        "role": request.role,
        "disabled": request.disabled,
        "password": request.password.is_some(),
    });
    let change = Change {
        role: request.role,
        disabled: request.disabled,
        password: request.password,
    };
    let result = accounts.change(&name, change).await;
    let result = result.map_err(Problem::from);
    if result.is_ok() {
        // At the broker somebody stays what they were when they logged in.
        broker.drop_client(Kind::Person, name.as_ref()).await;
    }
    audit
        .write(&caller, "user.change", name.as_ref(), detail, &result)
        .await;
    result.map(Json)
}

/// Deletes an account
///
/// Its sessions end. What it did stays in the audit log.
#[utoipa::path(delete, path = "/users/{name}", tag = "accounts",
    params(("name" = String, Path, description = "The account")),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "There is none of that name"),
        (status = 409, description = "It is the last administrator")))]
pub(super) async fn delete(
    State(accounts): State<Arc<Accounts>>,
    State(audit): State<Audit>,
    State(broker): State<Broker>,
    caller: Caller,
    Path(name): Path<String>,
) -> Result<StatusCode, Problem> {
    let name = named(&name)?;
    let result = accounts.delete(&name).await.map_err(Problem::from);
    if result.is_ok() {
        broker.drop_client(Kind::Person, name.as_ref()).await;
    }
    audit
        .write(&caller, "user.delete", name.as_ref(), json!({}), &result)
        .await;
    result?;
    Ok(StatusCode::NO_CONTENT)
}

/// Somebody who was invited.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct AcceptRequest {
    /// What the link has after `#invite=`.
    code: String,
    /// The name of the account, where the invitation leaves it open.
    #[schema(pattern = "^[a-z][a-z0-9._-]{0,31}$")]
    name: Option<String>,
    /// Its password: 10 to 256 characters, and not the name.
    #[schema(min_length = 10, max_length = 256)]
    password: String,
}

/// Takes an invitation
///
/// Makes the account, or gives it its password, and logs in.
#[utoipa::path(post, path = "/invitations", tag = "session",
    request_body = AcceptRequest,
    responses(
        (status = 200, description = "Logged in", body = LoginView),
        (status = 400, description = "Not JSON"),
        (status = 401, description = "There is no such invitation"),
        (status = 409, description = "The name is taken, or the server is open"),
        (status = 422, description = "Name or password cannot be used"),
        (status = 429, description = "Too many failures")))]
pub(super) async fn accept(
    State(accounts): State<Arc<Accounts>>,
    State(audit): State<Audit>,
    caller: Caller,
    body: JsonBody,
) -> Result<LoggedIn, Problem> {
    let request: AcceptRequest = body.read()?;
    if accounts.is_open() {
        return Err(no_accounts());
    }
    let result = accounts
        .accept(
            &request.code,
            request.name.as_deref(),
            request.password,
            caller.peer.ip(),
        )
        .await;
    // What the person can put right is between them and the form.
    if matches!(result, Ok(_) | Err(LoginError::Invitation)) {
        let result = result.map_err(Problem::from);
        let (who, detail) = match &result {
            Ok(entered) => (
                entered.user.to_string(),
                json!({ "role": entered.role, "session": entered.session.to_string() }),
            ),
            Err(_) => (ANONYMOUS.to_owned(), json!({})),
        };
        audit
            .write_as(&who, &caller, "invitation.take", &who, detail, &result)
            .await;
        return Ok(LoggedIn::new(result?, &caller));
    }
    Ok(LoggedIn::new(result?, &caller))
}
