//! Logging in and out.
//!
//! The access token goes back in the body and comes in `Authorization`, which no page of another
//! origin can send. The refresh token is in a cookie that scripts cannot read and that goes to these
//! calls alone, from pages of this server alone.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use crawler_access::password::MIN;
use serde::{Deserialize, Serialize};
use serde_json::json;
use utoipa::ToSchema;

use super::access::{ANONYMOUS, Caller, no_accounts};
use super::audit::{Audit, DONE};
use super::guard::JsonBody;
use super::problem::{Code, Problem};
use super::state::Broker;
use crawler_accounts::{Accounts, Entered, LoginError, SESSION_LIFETIME, TICKET_LIFETIME};
use crawler_broker::Kind;
use crawler_cluster::ClusterMembership;

/// Name of the cookie with the refresh token.
const COOKIE: &str = "terracrawler_refresh";
/// Where the browser sends it.
const COOKIE_PATH: &str = "/api/v1/session";

/// Who logs in.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct LoginRequest {
    /// The account.
    #[schema(example = "ada")]
    user: String,
    /// Its password.
    password: String,
}

/// What whoever logged in goes on with.
#[derive(Serialize, ToSchema)]
#[schema(as = Login)]
pub(super) struct LoginView {
    /// For `Authorization: Bearer`.
    token: String,
    /// Seconds until it must be refreshed.
    expires_in: i64,
    /// The account.
    user: String,
    /// `viewer`, `operator` or `admin`.
    role: &'static str,
}

/// An open session: the body, and the cookie beside it.
pub(super) struct LoggedIn {
    entered: Entered,
    tls: bool,
}

impl LoggedIn {
    pub(super) const fn new(entered: Entered, caller: &Caller) -> Self {
        Self {
            entered,
            tls: caller.peer.tls,
        }
    }
}

impl IntoResponse for LoggedIn {
    fn into_response(self) -> Response {
        let Self { entered, tls } = self;
        let view = LoginView {
            token: entered.token,
            expires_in: entered.expires_in,
            user: entered.user.to_string(),
            role: entered.role.as_str(),
        };
        let mut response = Json(view).into_response();
        if let Some(refresh) = entered.refresh {
            set_cookie(
                &mut response,
                &refresh.to_string(),
                SESSION_LIFETIME.as_secs(),
                tls,
            );
        }
        response
    }
}

fn set_cookie(response: &mut Response, value: &str, max_age: u64, tls: bool) {
    let secure = if tls { "; Secure" } else { "" };
    let cookie = format!(
        "{COOKIE}={value}; Path={COOKIE_PATH}; Max-Age={max_age}; HttpOnly; SameSite=Strict{secure}"
    );
    if let Ok(cookie) = HeaderValue::from_str(&cookie) {
        response.headers_mut().insert(header::SET_COOKIE, cookie);
    }
}

fn cookie(headers: &HeaderMap) -> Option<&str> {
    headers
        .get_all(header::COOKIE)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(';'))
        .filter_map(|pair| pair.trim().split_once('='))
        .find(|(name, _)| *name == COOKIE)
        .map(|(_, value)| value)
}

impl From<LoginError> for Problem {
    fn from(error: LoginError) -> Self {
        match error {
            LoginError::Credentials => {
                Self::new(Code::BadCredentials, "name or password are wrong")
            }
            LoginError::Wait(wait) => Self::later(
                Code::TooManyAttempts,
                "too many failed attempts; wait before the next one",
                wait,
            ),
            LoginError::NoSession | LoginError::Reused { .. } => {
                Self::new(Code::NoSession, "there is no session to continue; log in")
            }
            LoginError::Invitation => Self::new(
                Code::BadInvitation,
                "there is no such invitation; it was used, or it is too old",
            ),
            LoginError::Name => Self::new(
                Code::BadName,
                "the invitation needs a name: 1 to 32 of a-z, 0-9, dot, underscore and hyphen, \
                 beginning with a letter; or it is for somebody of another name",
            )
            .at("/name"),
            LoginError::Exists => Self::new(Code::UserExists, "there is an account of that name"),
            LoginError::Weak(weak) => Self::weak(weak, "/password"),
            LoginError::Busy => Self::busy(),
            LoginError::Records(error) => Self::records(&error),
            LoginError::Internal(what) => Self::internal(what),
        }
    }
}

impl Problem {
    /// Of the password that `pointer` points to.
    pub(super) fn weak(weak: crawler_access::password::Weak, pointer: &str) -> Self {
        Self::new(
            Code::WeakPassword,
            format!("{weak}; {MIN} characters are the least"),
        )
        .at(pointer)
    }

    pub(super) fn busy() -> Self {
        Self::later(
            Code::Overloaded,
            "too many passwords are being checked",
            std::time::Duration::from_secs(5),
        )
    }

    pub(super) fn records(error: &crawler_records::RecordsError) -> Self {
        // Paths and the database's words are for the log.
        tracing::error!(%error, "the records cannot be used");
        let code = Code::RecordsUnavailable;
        if error.is_passing() {
            let detail = "the database of the records does not answer";
            return Self::later(code, detail, std::time::Duration::from_secs(2));
        }
        Self::new(code, "the records cannot be read or written")
    }

    pub(super) fn internal(what: &'static str) -> Self {
        tracing::error!(what, "internal error");
        Self::new(
            Code::Internal,
            "internal error: the log of the server says what",
        )
    }
}

/// What is said of somebody in the audit log who may be nobody. People type passwords where their
/// name belongs.
fn told_name(name: &str) -> String {
    name.parse::<crawler_access::UserName>()
        .map_or_else(|_| "(no name)".to_owned(), |name| name.to_string())
}

/// Logs in
///
/// The refresh token comes in the cookie `terracrawler_refresh`. After some failures, attempts have
/// to wait.
#[utoipa::path(post, path = "/session", tag = "session",
    request_body = LoginRequest,
    responses(
        (status = 200, description = "Logged in", body = LoginView),
        (status = 400, description = "Not JSON"),
        (status = 401, description = "Name or password are wrong"),
        (status = 409, description = "The server is open"),
        (status = 422, description = "Not a login"),
        (status = 429, description = "Too many failures")))]
pub(super) async fn login(
    State(accounts): State<Arc<Accounts>>,
    State(audit): State<Audit>,
    caller: Caller,
    body: JsonBody,
) -> Result<LoggedIn, Problem> {
    let request: LoginRequest = body.read()?;
    if accounts.is_open() {
        return Err(no_accounts());
    }
    let result = accounts
        .login(&request.user, request.password, caller.peer.ip())
        .await;
    // Whoever has to wait is not written down each time, or the log would be theirs to fill.
    if !matches!(result, Err(LoginError::Wait(_))) {
        let name = told_name(&request.user);
        let result = result.map_err(Problem::from);
        let detail = match &result {
            Ok(entered) => json!({ "session": entered.session.to_string() }),
            Err(_) => json!({}),
        };
        let who = if result.is_ok() {
            name.as_str()
        } else {
            ANONYMOUS
        };
        audit
            .write_as(who, &caller, "login", &name, detail, &result)
            .await;
        return Ok(LoggedIn::new(result?, &caller));
    }
    Ok(LoggedIn::new(result?, &caller))
}

/// Goes on with a session
///
/// Takes the refresh token out of the cookie and puts another one there. One that was used before
/// ends the session: somebody has a copy of it.
#[utoipa::path(post, path = "/session/refresh", tag = "session",
    responses(
        (status = 200, description = "A new token", body = LoginView),
        (status = 401, description = "There is no session")))]
pub(super) async fn refresh(
    State(accounts): State<Arc<Accounts>>,
    State(audit): State<Audit>,
    caller: Caller,
    headers: HeaderMap,
) -> Response {
    let result = match cookie(&headers) {
        Some(token) => accounts.refresh(token).await,
        None => Err(LoginError::NoSession),
    };
    if let Err(LoginError::Reused { session, user }) = &result {
        let detail = json!({ "session": session.to_string(), "why": "refresh token used twice" });
        audit
            .write_as(
                "server",
                &caller,
                "session.end",
                user.as_ref(),
                detail,
                &DONE,
            )
            .await;
    }
    match result {
        Ok(entered) => LoggedIn::new(entered, &caller).into_response(),
        Err(error) => {
            let gone = matches!(error, LoginError::NoSession | LoginError::Reused { .. });
            let mut response = Problem::from(error).into_response();
            if gone {
                set_cookie(&mut response, "", 0, caller.peer.tls);
            }
            response
        }
    }
}

/// Logs out
///
/// Ends the session of the cookie, or of the token. Without either there is nothing to do.
#[utoipa::path(delete, path = "/session", tag = "session",
    responses((status = 204, description = "Logged out")))]
pub(super) async fn logout(
    State(accounts): State<Arc<Accounts>>,
    State(audit): State<Audit>,
    caller: Caller,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let mut ended = None;
    if let Some(token) = cookie(&headers) {
        ended = accounts.leave(token).await?;
    }
    if let Some(identity) = &caller.identity {
        let alive = accounts.end_session(identity.session).await;
        if alive.map_err(|error| Problem::records(&error))? {
            ended = Some((identity.user.clone(), identity.session));
        }
    }
    if let Some((user, session)) = ended {
        let detail = json!({ "session": session.to_string() });
        let name = user.as_ref();
        audit
            .write_as(name, &caller, "logout", name, detail, &DONE)
            .await;
    }
    let mut response = StatusCode::NO_CONTENT.into_response();
    set_cookie(&mut response, "", 0, caller.peer.tls);
    Ok(response)
}

/// Who makes this request.
#[derive(Serialize, ToSchema)]
#[schema(as = Session)]
pub(super) struct SessionView {
    /// Whether everybody who reaches the server may do everything.
    open: bool,
    /// The account; `null` on an open server.
    user: Option<String>,
    /// `viewer`, `operator` or `admin`.
    role: &'static str,
}

/// Who makes this request
#[utoipa::path(get, path = "/session", tag = "session",
    responses(
        (status = 200, description = "Who it is", body = SessionView),
        (status = 401, description = "Nobody")))]
pub(super) async fn current(
    State(accounts): State<Arc<Accounts>>,
    caller: Caller,
) -> Json<SessionView> {
    Json(SessionView {
        open: accounts.is_open(),
        user: caller.identity.map(|identity| identity.user.to_string()),
        role: caller.role.as_str(),
    })
}

/// A new password.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PasswordRequest {
    /// The one so far.
    old: String,
    /// The one from now on: 10 to 256 characters, and not the name.
    #[schema(min_length = 10, max_length = 256)]
    new: String,
}

/// Changes one's own password
///
/// All other sessions of the account end.
#[utoipa::path(put, path = "/session/password", tag = "session",
    request_body = PasswordRequest,
    responses(
        (status = 204, description = "Changed"),
        (status = 401, description = "The old one is wrong"),
        (status = 422, description = "The new one is not good enough"),
        (status = 429, description = "Too many failures")))]
pub(super) async fn password(
    State(accounts): State<Arc<Accounts>>,
    State(audit): State<Audit>,
    State(broker): State<Broker>,
    caller: Caller,
    body: JsonBody,
) -> Result<StatusCode, Problem> {
    let request: PasswordRequest = body.read()?;
    let identity = caller.identity()?;
    let result = accounts
        .change_password(identity, request.old, request.new, caller.peer.ip())
        .await
        .map_err(|error| match error {
            LoginError::Weak(weak) => Problem::weak(weak, "/new"),
            error => error.into(),
        });
    audit
        .write(
            &caller,
            "password.change",
            identity.user.as_ref(),
            json!({}),
            &result,
        )
        .await;
    result?;
    broker
        .drop_client(Kind::Person, identity.user.as_ref())
        .await;
    Ok(StatusCode::NO_CONTENT)
}

/// A ticket for the live feed.
#[derive(Serialize, ToSchema)]
#[schema(as = Ticket)]
pub(super) struct TicketView {
    /// For `GET /api/v1/live?ticket=…`, once.
    ticket: String,
    /// Seconds until it is worth nothing.
    expires_in: u64,
}

/// Gets a ticket for the live feed
///
/// Browsers send no token with a WebSocket. A ticket is good once and not for long.
#[utoipa::path(post, path = "/session/ticket", tag = "session",
    responses(
        (status = 200, description = "A ticket", body = TicketView),
        (status = 401, description = "Nobody is logged in"),
        (status = 409, description = "The server is open and takes no ticket")))]
pub(super) async fn ticket(
    State(accounts): State<Arc<Accounts>>,
    State(membership): State<Option<Arc<ClusterMembership>>>,
    caller: Caller,
) -> Result<Json<TicketView>, Problem> {
    let identity = caller.identity()?;
    let ticket = match &membership {
        Some(membership) => accounts.shared_ticket(identity, &membership.cluster).await,
        None => accounts.ticket(identity),
    };
    let ticket = ticket.ok_or_else(|| Problem::internal("no randomness"))?;
    Ok(Json(TicketView {
        ticket: ticket.to_string(),
        expires_in: TICKET_LIFETIME.as_secs(),
    }))
}
