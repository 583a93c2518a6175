//! Who may call what: one table of all calls, and the check that every request passes.
//!
//! The check comes before any handler, body or query is looked at. What the table does not name is
//! the administrator's, so a call that somebody forgets to enter here is closed rather than open.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{FromRef, FromRequestParts, MatchedPath, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use crawler_access::Role;
use crawler_protocol::Source;

use super::audit::Audit;
use super::commands::Asked;
use super::peer::Peer;
use super::problem::{Code, Problem};
use super::rates::{Charge, Rates};
use super::state::ApiState;
use crawler_accounts::{Accounts, AuthError, Identity};
use crawler_cluster::ClusterMembership;
use crawler_metrics::{Dropped, Metrics};

/// What a call asks of whoever makes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Need {
    /// Nothing.
    Nothing,
    /// At least this role.
    Role(Role),
    /// A ticket of somebody who is at least a viewer, or what [`Need::Role`] takes.
    Ticket,
    /// That it comes from this machine, or from a viewer.
    LocalOrViewer,
}

const VIEWER: Need = Need::Role(Role::Viewer);
const OPERATOR: Need = Need::Role(Role::Operator);
const ADMIN: Need = Need::Role(Role::Admin);

/// Whoever did not say who they are, and everybody on an open server.
pub(super) const ANONYMOUS: &str = "anonymous";

/// Every call and what it needs. A test holds it to the OpenAPI document.
const TABLE: &[(&str, &str, Need)] = &[
    ("GET", "/healthz", Need::Nothing),
    ("GET", "/readyz", Need::Nothing),
    ("GET", "/metrics", Need::LocalOrViewer),
    // The broker asks for name and password itself.
    ("GET", "/mqtt", Need::Nothing),
    ("GET", "/api/v1/openapi.json", Need::Nothing),
    ("GET", "/api/v1/schema/{message}", Need::Nothing),
    ("POST", "/api/v1/session", Need::Nothing),
    ("POST", "/api/v1/session/refresh", Need::Nothing),
    ("DELETE", "/api/v1/session", Need::Nothing),
    ("POST", "/api/v1/invitations", Need::Nothing),
    ("GET", "/api/v1/session", VIEWER),
    ("PUT", "/api/v1/session/password", VIEWER),
    ("POST", "/api/v1/session/ticket", VIEWER),
    ("GET", "/api/v1/sessions", VIEWER),
    ("DELETE", "/api/v1/sessions/{id}", VIEWER),
    ("GET", "/api/v1/live", Need::Ticket),
    ("GET", "/api/v1/robots", VIEWER),
    ("GET", "/api/v1/robots/{id}", VIEWER),
    ("GET", "/api/v1/robots/{id}/logs", VIEWER),
    ("GET", "/api/v1/robots/{id}/image", VIEWER),
    ("GET", "/api/v1/robots/{id}/map", VIEWER),
    ("GET", "/api/v1/robots/{id}/parameters", VIEWER),
    ("GET", "/api/v1/robots/{id}/telemetry", VIEWER),
    ("GET", "/api/v1/robots/{id}/twin", VIEWER),
    ("GET", "/api/v1/robots/{id}/twin/calibrations", VIEWER),
    (
        "GET",
        "/api/v1/robots/{id}/twin/calibrations/{number}",
        VIEWER,
    ),
    ("GET", "/api/v1/robots/{id}/twin/certificates", VIEWER),
    ("GET", "/api/v1/robots/{id}/twin/forecast", VIEWER),
    ("GET", "/api/v1/robots/{id}/twin/permit", VIEWER),
    ("GET", "/api/v1/fleet/gap", VIEWER),
    ("GET", "/api/v1/history", VIEWER),
    ("GET", "/api/v1/history/frames", VIEWER),
    ("GET", "/api/v1/counterfactuals", VIEWER),
    ("GET", "/api/v1/counterfactuals/{id}", VIEWER),
    ("GET", "/api/v1/events", VIEWER),
    ("GET", "/api/v1/commands", VIEWER),
    ("GET", "/api/v1/commands/{id}", VIEWER),
    ("GET", "/api/v1/fences", VIEWER),
    ("GET", "/api/v1/simulator", VIEWER),
    ("GET", "/api/v1/experiments", VIEWER),
    ("GET", "/api/v1/experiments/{id}", VIEWER),
    ("GET", "/api/v1/experiments/{id}/metrics", VIEWER),
    ("GET", "/api/v1/experiments/{id}/curve", VIEWER),
    ("GET", "/api/v1/experiments/{id}/files/{name}", VIEWER),
    ("GET", "/api/v1/releases", VIEWER),
    ("GET", "/api/v1/releases/{id}", VIEWER),
    ("GET", "/api/v1/releases/{id}/gate", VIEWER),
    ("GET", "/api/v1/policies", VIEWER),
    ("GET", "/api/v1/policies/{name}", VIEWER),
    ("GET", "/api/v1/rollouts", VIEWER),
    ("GET", "/api/v1/rollouts/{id}", VIEWER),
    ("GET", "/api/v1/rollouts/{id}/robots", VIEWER),
    ("GET", "/api/v1/rollouts/{id}/robots/{robot}", VIEWER),
    ("GET", "/api/v1/simulator/scenarios", VIEWER),
    ("GET", "/api/v1/simulator/scenarios/{name}", VIEWER),
    ("POST", "/api/v1/robots/{id}/commands", OPERATOR),
    ("POST", "/api/v1/swarm/commands", OPERATOR),
    ("PUT", "/api/v1/robots/{id}/parameters", OPERATOR),
    ("POST", "/api/v1/robots/{id}/faults", OPERATOR),
    ("DELETE", "/api/v1/robots/{id}/faults", OPERATOR),
    ("POST", "/api/v1/robots/{id}/twin/calibrations", OPERATOR),
    (
        "DELETE",
        "/api/v1/robots/{id}/twin/calibrations/{number}",
        OPERATOR,
    ),
    ("POST", "/api/v1/counterfactuals", OPERATOR),
    ("DELETE", "/api/v1/counterfactuals/{id}", OPERATOR),
    ("POST", "/api/v1/fences", OPERATOR),
    ("PUT", "/api/v1/fences/{id}", OPERATOR),
    ("DELETE", "/api/v1/fences/{id}", OPERATOR),
    ("POST", "/api/v1/policies/{name}/shadow", OPERATOR),
    ("POST", "/api/v1/simulator/commands", OPERATOR),
    ("POST", "/api/v1/experiments", OPERATOR),
    ("DELETE", "/api/v1/experiments/{id}", OPERATOR),
    ("POST", "/api/v1/experiments/{id}/start", OPERATOR),
    ("POST", "/api/v1/experiments/{id}/pause", OPERATOR),
    ("POST", "/api/v1/experiments/{id}/resume", OPERATOR),
    ("POST", "/api/v1/experiments/{id}/stop", OPERATOR),
    ("POST", "/api/v1/releases", ADMIN),
    ("POST", "/api/v1/releases/{id}/gate", ADMIN),
    ("POST", "/api/v1/releases/{id}/withdraw", ADMIN),
    ("POST", "/api/v1/policies/{name}/deploy", ADMIN),
    ("POST", "/api/v1/rollouts", ADMIN),
    ("POST", "/api/v1/rollouts/{id}/pause", ADMIN),
    ("POST", "/api/v1/rollouts/{id}/resume", ADMIN),
    ("POST", "/api/v1/rollouts/{id}/abort", ADMIN),
    ("POST", "/api/v1/rollouts/{id}/robots/{robot}/retry", ADMIN),
    ("POST", "/api/v1/rollouts/{id}/robots/{robot}/skip", ADMIN),
    ("GET", "/api/v1/users", ADMIN),
    ("POST", "/api/v1/users", ADMIN),
    ("PATCH", "/api/v1/users/{name}", ADMIN),
    ("DELETE", "/api/v1/users/{name}", ADMIN),
    ("GET", "/api/v1/credentials", ADMIN),
    ("POST", "/api/v1/robots/{id}/credential", ADMIN),
    ("DELETE", "/api/v1/robots/{id}/credential", ADMIN),
    ("GET", "/api/v1/audit", ADMIN),
    ("GET", "/api/v1/audit/verify", ADMIN),
];

fn need(method: &Method, path: &str) -> Need {
    let method = match method.as_str() {
        // Answered by the handler of GET.
        "HEAD" => "GET",
        other => other,
    };
    let mut rows = TABLE.iter().filter(|row| row.1 == path);
    // Whoever may call all of an address may hear which methods it takes.
    let public = rows.clone().all(|row| row.2 == Need::Nothing) && rows.clone().count() > 0;
    let others = if public { Need::Nothing } else { ADMIN };
    rows.find(|row| row.0 == method).map_or(others, |row| row.2)
}

/// Who makes a request, once it has passed the check.
#[derive(Debug, Clone)]
pub(crate) struct Caller {
    /// The account; `None` on an open server, where nobody has one, and for calls that take
    /// anybody.
    pub(crate) identity: Option<Identity>,
    /// What the request may do.
    pub(crate) role: Role,
    /// Where it came from.
    pub(crate) peer: Peer,
}

impl Caller {
    /// How the audit log names whoever it is.
    pub(crate) fn name(&self) -> String {
        self.identity.as_ref().map_or_else(
            || ANONYMOUS.to_owned(),
            |identity| identity.user.to_string(),
        )
    }

    /// Under whose name robots get a command; `None` stands for the server.
    pub(crate) fn source(&self) -> Option<Source> {
        let identity = self.identity.as_ref()?;
        // Longer than a name may be by no more than a source may be longer.
        Source::new(&format!("operator:{}", identity.user)).ok()
    }

    /// The account. Open servers know none.
    pub(crate) fn identity(&self) -> Result<&Identity, Problem> {
        self.identity.as_ref().ok_or_else(no_accounts)
    }
}

/// What is said of calls about one's own account on a server where nobody has one.
pub(super) fn no_accounts() -> Problem {
    Problem::new(
        Code::OpenServer,
        "this server is open: everybody who reaches it may do everything, and nobody logs in",
    )
}

impl<S: Send + Sync> FromRequestParts<S> for Caller {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        // A handler that runs without the check would be a mistake of ours; it gets nobody.
        parts.extensions.get().cloned().ok_or_else(unauthenticated)
    }
}

fn unauthenticated() -> Problem {
    Problem::new(
        Code::Unauthenticated,
        "log in first: this call needs a token",
    )
}

fn unauthorized(error: AuthError) -> Problem {
    match error {
        AuthError::Expired => Problem::new(
            Code::ExpiredToken,
            "the token has expired; refresh the session",
        ),
        AuthError::Unknown => Problem::new(
            Code::Unauthenticated,
            "the token is not valid, or its session has ended; log in again",
        ),
    }
}

/// The token of `Authorization: Bearer`. `Err` when there is something else in its place.
fn bearer(headers: &HeaderMap) -> Result<Option<&str>, Problem> {
    let Some(value) = headers.get(header::AUTHORIZATION) else {
        return Ok(None);
    };
    value
        .to_str()
        .ok()
        .and_then(|value| value.split_once(' '))
        .filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"))
        .map(|(_, token)| Some(token.trim()))
        .ok_or_else(unauthenticated)
}

/// The ticket in the query, as it was written by us: it needs no decoding.
fn ticket(request: &Request) -> Option<&str> {
    let query = request.uri().query()?;
    query
        .split('&')
        .find_map(|pair| pair.strip_prefix("ticket="))
}

fn known(
    accounts: &Accounts,
    request: &Request,
    tickets: bool,
    redeemed: Option<Identity>,
) -> Result<Identity, Problem> {
    match (bearer(request.headers())?, ticket(request)) {
        (Some(token), _) => accounts.who(token).map_err(unauthorized),
        (None, Some(_)) if tickets && redeemed.is_some() => redeemed.ok_or_else(unauthenticated),
        (None, Some(ticket)) if tickets => accounts.redeem(ticket).ok_or_else(|| {
            Problem::new(
                Code::Unauthenticated,
                "the ticket is not valid, was used already, or is too old; ask for another",
            )
        }),
        (None, _) => Err(unauthenticated()),
    }
}

/// Whether a request changes something that the audit log must have. Commands to robots are told apart by
/// what they are, and people may always log in and out.
fn must_be_audited(request: &Request) -> bool {
    const COMMANDS: [&str; 3] = [
        "/api/v1/robots/{id}/commands",
        "/api/v1/robots/{id}/parameters",
        "/api/v1/swarm/commands",
    ];
    let safe = matches!(*request.method(), Method::GET | Method::HEAD);
    let path = request.extensions().get::<MatchedPath>();
    path.map(MatchedPath::as_str).is_some_and(|path| {
        let need = need(request.method(), path);
        let steers = matches!(need, Need::Role(role) if role >= Role::Operator);
        steers && !safe && !COMMANDS.contains(&path)
    })
}

/// A request for a command, with its body read, and whether that is a halt.
async fn read_command(request: Request) -> Result<(Request, bool), Problem> {
    let (mut parts, body) = request.into_parts();
    let asked = Asked::of(Request::from_parts(parts.clone(), body)).await?;
    let halts = asked.is_halt();
    parts.extensions.insert(asked);
    Ok((Request::from_parts(parts, Body::empty()), halts))
}

/// What the check of a request needs.
#[derive(Clone)]
pub(super) struct Gate {
    accounts: Arc<Accounts>,
    audit: Audit,
    metrics: Arc<Metrics>,
    membership: Option<Arc<ClusterMembership>>,
    /// How much one may ask for.
    rates: Arc<Rates>,
}

impl Gate {
    pub(super) fn new(state: &ApiState) -> Self {
        Self {
            accounts: FromRef::from_ref(state),
            audit: FromRef::from_ref(state),
            metrics: FromRef::from_ref(state),
            membership: FromRef::from_ref(state),
            rates: Arc::new(Rates::new()),
        }
    }

    /// Whose ticket a request shows, where any of several servers may have given it.
    fn shared_ticket(&self, request: &Request) -> Option<(&ClusterMembership, String)> {
        let membership = self.membership.as_deref()?;
        let path = request.extensions().get::<MatchedPath>()?;
        let wanted = need(request.method(), path.as_str()) == Need::Ticket
            && !request.headers().contains_key(header::AUTHORIZATION);
        let ticket = ticket(request).filter(|_| wanted)?;
        Some((membership, ticket.to_owned()))
    }

    /// Who makes a request, where they may.
    fn admit(&self, request: &Request, redeemed: Option<Identity>) -> Result<Caller, Problem> {
        let peer = Peer::of(request);
        let caller = |identity: Option<Identity>, role| Caller {
            identity,
            role,
            peer,
        };
        if self.accounts.is_open() {
            return Ok(caller(None, Role::Admin));
        }
        let need = match request.extensions().get::<MatchedPath>() {
            Some(path) => need(request.method(), path.as_str()),
            // The control room, which must be there to log in with.
            None => Need::Nothing,
        };
        let role = match need {
            Need::Nothing => {
                // Whoever shows a good token all the same, as for logging out, is told apart.
                let token = bearer(request.headers()).ok().flatten();
                let identity = token.and_then(|token| self.accounts.who(token).ok());
                return Ok(caller(identity, Role::Viewer));
            }
            Need::LocalOrViewer if peer.is_local(request.headers()) => {
                return Ok(caller(None, Role::Viewer));
            }
            Need::LocalOrViewer | Need::Ticket => Role::Viewer,
            Need::Role(role) => role,
        };
        let identity = known(&self.accounts, request, need == Need::Ticket, redeemed)?;
        if identity.role < role {
            return Err(Problem::new(
                Code::Forbidden,
                format!(
                    "this call needs the role `{role}`; yours is `{}`",
                    identity.role
                ),
            ));
        }
        let role = identity.role;
        Ok(caller(Some(identity), role))
    }

    /// The request with its caller, charged to what it counts against.
    async fn pass(&self, request: Request) -> Result<Request, Problem> {
        let address = Peer::of(&request).ip();
        let membership = self.membership.as_deref();
        let charge = Charge::of(&request);
        match charge {
            Charge::Probe => self.rates.probe(address)?,
            // Whose command it is comes first: strangers at the same address must not use up a halt.
            Charge::Command => {}
            // Before the token is looked at: guessing tokens is to be no quicker than anything else.
            Charge::Other => self.rates.address(address, membership).await?,
        }
        let shared = self.shared_ticket(&request);
        let redeemed = match shared {
            Some((membership, ticket)) => {
                self.accounts
                    .redeem_shared(&ticket, &membership.cluster)
                    .await
            }
            None => None,
        };
        let caller = match self.admit(&request, redeemed) {
            Ok(caller) => caller,
            Err(problem) => {
                if charge == Charge::Command {
                    self.rates.address(address, membership).await?;
                }
                return Err(problem);
            }
        };
        if must_be_audited(&request) {
            self.audit.has_room()?;
        }
        let read = match charge {
            Charge::Command => read_command(request).await,
            Charge::Probe | Charge::Other => Ok((request, false)),
        };
        let user = caller.identity.as_ref().map(|identity| &identity.user);
        if matches!(read, Ok((_, true))) {
            self.rates.halt(user, address)?;
        } else {
            if charge == Charge::Command {
                self.rates.address(address, membership).await?;
            }
            if let Some(user) = user.filter(|_| charge != Charge::Probe) {
                self.rates.user(user, membership).await?;
            }
        }
        let (mut request, _) = read?;
        tracing::debug!(user = caller.name(), "let in");
        request.extensions_mut().insert(caller);
        Ok(request)
    }
}

/// Lets a request through, or says why not.
pub(super) async fn check(State(gate): State<Gate>, request: Request, next: Next) -> Response {
    match gate.pass(request).await {
        Ok(request) => next.run(request).await,
        Err(problem) => {
            if problem.code() == Code::RateLimited {
                gate.metrics.dropped(Dropped::RateLimited);
            }
            problem.into_response()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_table_does_not_name_is_the_administrators() {
        for (method, path) in [
            (Method::DELETE, "/api/v1/robots"),
            (Method::GET, "/api/v1/secrets"),
            (Method::OPTIONS, "/api/v1/session"),
        ] {
            assert_eq!(need(&method, path), ADMIN, "{method} {path}");
        }
        assert_eq!(need(&Method::HEAD, "/api/v1/robots"), VIEWER);
        for path in ["/healthz", "/readyz", "/mqtt", "/api/v1/invitations"] {
            assert_eq!(need(&Method::DELETE, path), Need::Nothing, "{path}");
        }
    }

    #[test]
    fn no_call_stands_in_the_table_twice() {
        for (index, row) in TABLE.iter().enumerate() {
            let again = TABLE.iter().skip(index + 1);
            let twice = again.filter(|other| (other.0, other.1) == (row.0, row.1));
            assert_eq!(twice.count(), 0, "{} {}", row.0, row.1);
        }
    }

    #[test]
    fn changes_need_an_operator_or_their_own_proof() {
        let own = [
            "/api/v1/session",
            "/api/v1/session/refresh",
            "/api/v1/session/password",
            "/api/v1/session/ticket",
            "/api/v1/sessions/{id}",
            "/api/v1/invitations",
        ];
        for (method, path, need) in TABLE {
            if *method != "GET" && !own.contains(path) {
                assert!(
                    matches!(need, Need::Role(role) if *role >= Role::Operator),
                    "{method} {path}"
                );
            }
        }
    }

    #[test]
    fn only_a_bearer_token_is_one() {
        let mut headers = HeaderMap::new();
        assert!(matches!(bearer(&headers), Ok(None)));
        for (value, token) in [
            ("Bearer abc", Some("abc")),
            ("bearer abc", Some("abc")),
            ("Basic abc", None),
            ("Bearer", None),
            ("", None),
        ] {
            headers.insert(header::AUTHORIZATION, value.parse().expect("value"));
            match bearer(&headers) {
                Ok(found) => assert_eq!(found, token, "{value}"),
                Err(_) => assert_eq!(token, None, "{value}"),
            }
        }
    }
}
