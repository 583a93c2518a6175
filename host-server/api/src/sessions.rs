//! Sessions: where somebody is logged in, and ending that from elsewhere.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use crawler_access::Role;
use serde::{Deserialize, Serialize};
use serde_json::json;
use utoipa::{IntoParams, ToSchema};

use super::access::Caller;
use super::audit::Audit;
use super::problem::{Code, Problem};
use super::query::ApiQuery;
use crawler_accounts::Accounts;

/// Whose sessions are wanted.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SessionQuery {
    /// `true` for everybody's, which takes an administrator; one's own otherwise.
    all: Option<bool>,
}

/// A session.
#[derive(Serialize, ToSchema)]
#[schema(as = OpenSession)]
pub(super) struct OpenSessionView {
    /// Its number.
    id: String,
    /// The account.
    user: String,
    /// The address it was opened from.
    from: String,
    /// When it was opened, in Unix milliseconds.
    opened: i64,
    /// When it was last refreshed.
    refreshed: i64,
    /// When it ends, unless it is refreshed.
    expires: i64,
    /// Whether it is the one that asks.
    current: bool,
}

/// Sessions.
#[derive(Serialize, ToSchema)]
#[schema(as = Sessions)]
pub(super) struct SessionList {
    /// Newest first.
    sessions: Vec<OpenSessionView>,
}

/// Sessions that are open
#[utoipa::path(get, path = "/sessions", tag = "session",
    params(SessionQuery),
    responses(
        (status = 200, description = "The sessions", body = SessionList),
        (status = 400, description = "The query is not valid"),
        (status = 403, description = "Not an administrator")))]
pub(super) async fn list(
    State(accounts): State<Arc<Accounts>>,
    caller: Caller,
    ApiQuery(asked): ApiQuery<SessionQuery>,
) -> Result<Json<SessionList>, Problem> {
    let all = asked.all == Some(true);
    if all && caller.role < Role::Admin {
        return Err(Problem::new(
            Code::Forbidden,
            "the sessions of others need the role `admin`",
        ));
    }
    let own = match (&caller.identity, all) {
        (_, true) => None,
        (Some(identity), false) => Some(&identity.user),
        // Nobody has one here.
        (None, false) => {
            return Ok(Json(SessionList {
                sessions: Vec::new(),
            }));
        }
    };
    let sessions = accounts.sessions(own).await;
    let sessions = sessions.map_err(|error| Problem::records(&error))?;
    let current = caller.identity.as_ref().map(|identity| identity.session);
    let mut sessions: Vec<_> = sessions
        .into_iter()
        .map(|session| OpenSessionView {
            id: session.id.to_string(),
            user: session.user.to_string(),
            from: session.from,
            opened: session.opened,
            refreshed: session.refreshed,
            expires: session.expires,
            current: current == Some(session.id),
        })
        .collect();
    sessions.sort_by_key(|session| std::cmp::Reverse(session.opened));
    Ok(Json(SessionList { sessions }))
}

/// Ends a session
///
/// One's own, or as an administrator anybody's. Its tokens are worth nothing from here on, and its
/// readers of the live feed are sent away.
#[utoipa::path(delete, path = "/sessions/{id}", tag = "session",
    params(("id" = String, Path, description = "Its number")),
    responses(
        (status = 204, description = "Ended"),
        (status = 404, description = "There is none, or not of this account")))]
pub(super) async fn end(
    State(accounts): State<Arc<Accounts>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let unknown = || Problem::new(Code::UnknownSession, "there is no such session");
    let id: u64 = id.parse().map_err(|_| unknown())?;
    let own = match &caller.identity {
        Some(identity) if caller.role < Role::Admin => Some(&identity.user),
        _ => None,
    };
    let sessions = accounts.sessions(own).await;
    let sessions = sessions.map_err(|error| Problem::records(&error))?;
    let session = sessions
        .into_iter()
        .find(|session| session.id == id)
        .ok_or_else(unknown)?;
    let result = match accounts.end_session(id).await {
        Ok(true) => Ok(()),
        Ok(false) => Err(unknown()),
        Err(error) => Err(Problem::records(&error)),
    };
    let detail = json!({ "session": id.to_string() });
    audit
        .write(
            &caller,
            "session.end",
            session.user.as_ref(),
            detail,
            &result,
        )
        .await;
    result?;
    Ok(StatusCode::NO_CONTENT)
}
