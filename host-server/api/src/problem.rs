//! Errors as RFC 9457 problem documents.

mod code;
mod fields;
mod schema;

use std::time::Duration;

use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

pub(crate) use code::Code;
use crawler_updates::release::Fault;
pub(crate) use fields::{FieldError, member, read, unreadable};
pub(crate) use schema::locate;

const CONTENT_TYPE: HeaderValue = HeaderValue::from_static("application/problem+json");

/// An error, as RFC 9457 wants it.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub(crate) struct Problem {
    /// Always `about:blank`: `code` says more.
    #[serde(rename = "type")]
    kind: &'static str,
    /// The status in words.
    title: &'static str,
    /// The HTTP status.
    status: u16,
    /// What is wrong with this request, for people.
    detail: String,
    /// What is wrong, for programs. Stable.
    #[schema(value_type = String)]
    code: Code,
    /// The request's id, which the server's log names as well.
    #[serde(skip_serializing_if = "Option::is_none")]
    request: Option<String>,
    /// Seconds after which another try may do better; also in `Retry-After`.
    #[serde(skip_serializing_if = "Option::is_none")]
    retry_after: Option<u32>,
    /// The parts of the request that are wrong: what the statuses 400 and 422 are about.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Vec<FieldError>>)]
    errors: Option<Box<Fields>>,
    /// Every reason against a release, or against its gate, with the codes of `terracrawler release verify`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Vec<ReleaseFault>>)]
    faults: Option<Box<Faults>>,
}

/// A reason against a release, or against its gate.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub(crate) struct ReleaseFault {
    /// A stable name.
    code: &'static str,
    /// The same for people.
    text: String,
}

/// Reasons against a release, in a place of their own, as fields are.
#[derive(Debug, Clone, Serialize)]
#[serde(transparent)]
struct Faults(Vec<ReleaseFault>);

/// Fields that are wrong, in a place of their own: few problems have some, and all are passed on.
#[derive(Debug, Clone, Serialize)]
#[serde(transparent)]
struct Fields(Vec<FieldError>);

impl Problem {
    pub(crate) fn new(code: Code, detail: impl Into<String>) -> Self {
        Self::of(code.status(), code, detail)
    }

    fn of(status: StatusCode, code: Code, detail: impl Into<String>) -> Self {
        Self {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or("Error"),
            status: status.as_u16(),
            detail: detail.into(),
            code,
            request: None,
            retry_after: None,
            errors: None,
            faults: None,
        }
    }

    /// A file that is no release, or not a genuine one.
    pub(crate) fn of_release(faults: Vec<Fault>) -> Self {
        Self::of_file(Code::InvalidRelease, faults)
    }

    /// A file that is not what it should be, for these reasons.
    pub(crate) fn of_file(code: Code, faults: Vec<Fault>) -> Self {
        let told: Vec<_> = faults
            .iter()
            .map(|fault| format!("{}: {}", fault.code, fault.text))
            .collect();
        let faults = faults.into_iter().map(|fault| ReleaseFault {
            code: fault.code,
            text: fault.text,
        });
        Self {
            faults: Some(Box::new(Faults(faults.collect()))),
            ..Self::new(code, told.join("; "))
        }
    }

    /// What is wrong, for people.
    pub(crate) fn detail(&self) -> &str {
        &self.detail
    }

    /// A request with parts that are wrong; people are told of each.
    pub(crate) fn invalid(code: Code, errors: Vec<FieldError>) -> Self {
        let told: Vec<_> = errors.iter().map(FieldError::line).collect();
        Self::new(code, told.join("; ")).with(errors)
    }

    /// Names the parts of the request that are wrong.
    pub(crate) fn with(self, errors: Vec<FieldError>) -> Self {
        Self {
            errors: (!errors.is_empty()).then(|| Box::new(Fields(errors))),
            ..self
        }
    }

    /// Names the part of the body that is wrong, as `detail` says.
    pub(crate) fn at(self, pointer: impl Into<String>) -> Self {
        let error = FieldError::at(pointer, self.detail.clone());
        self.with(vec![error])
    }

    /// A problem that another try after `wait` may not have.
    pub(crate) fn later(code: Code, detail: impl Into<String>, wait: Duration) -> Self {
        Self {
            // Rounded up: who comes a moment too early is refused again.
            retry_after: Some(wait.as_millis().div_ceil(1_000).max(1) as u32),
            ..Self::new(code, detail)
        }
    }

    /// What is wrong, for programs.
    pub(crate) const fn code(&self) -> Code {
        self.code
    }

    pub(crate) fn unknown_robot(id: &str) -> Self {
        Self::new(
            Code::UnknownRobot,
            format!("no robot `{}` is known", id.escape_default()),
        )
    }

    fn from_status(status: StatusCode) -> Self {
        let (code, detail) = match status {
            StatusCode::NOT_FOUND => (Code::NotFound, "there is nothing at this address"),
            StatusCode::METHOD_NOT_ALLOWED => (
                Code::MethodNotAllowed,
                "this address does not take this method",
            ),
            StatusCode::NOT_ACCEPTABLE => (
                Code::NotAcceptable,
                "the answer would be in gzip or as it is, and `Accept-Encoding` takes neither",
            ),
            StatusCode::PAYLOAD_TOO_LARGE => {
                (Code::TooLarge, "the body is larger than this call takes")
            }
            StatusCode::UNSUPPORTED_MEDIA_TYPE => (
                Code::UnsupportedMediaType,
                "the body must be application/json",
            ),
            StatusCode::UPGRADE_REQUIRED | StatusCode::BAD_REQUEST => {
                (Code::BadRequest, "the request cannot be understood")
            }
            status if status.is_server_error() => (Code::Internal, "the server failed"),
            _ => (Code::Refused, "the request is refused"),
        };
        // Others have their own opinion of what is refused.
        Self::of(status, code, detail)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let mut response = (status, axum::Json(&self)).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, CONTENT_TYPE);
        if let Some(seconds) = self.retry_after {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        if status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        response.extensions_mut().insert(self);
        response
    }
}

/// Puts the request's id into the problem document, where the answer is one.
pub(super) fn name(response: Response, request: &str) -> Response {
    let (mut parts, body) = response.into_parts();
    let Some(mut problem) = parts.extensions.remove::<Problem>() else {
        return Response::from_parts(parts, body);
    };
    problem.request = Some(request.to_owned());
    let (named, body) = axum::Json(problem).into_response().into_parts();
    parts.headers.remove(header::CONTENT_LENGTH);
    if let Some(length) = named.headers.get(header::CONTENT_LENGTH) {
        parts.headers.insert(header::CONTENT_LENGTH, length.clone());
    }
    Response::from_parts(parts, body)
}

/// Marks an answer whose body is meant as it is, although its status is that of an error.
#[derive(Debug, Clone, Copy)]
struct AsItIs;

/// Keeps [`uniform`] from replacing the body.
pub(super) fn keep(response: &mut Response) {
    response.extensions_mut().insert(AsItIs);
}

/// Turns errors that others have worded into problem documents.
pub(super) async fn uniform(request: Request, next: Next) -> Response {
    let response = next.run(request).await;
    let status = response.status();
    if !(status.is_client_error() || status.is_server_error())
        || response.headers().get(header::CONTENT_TYPE) == Some(&CONTENT_TYPE)
        || response.extensions().get::<AsItIs>().is_some()
    {
        return response;
    }
    let (mut parts, _) = response.into_parts();
    let problem = Problem::from_status(status).into_response();
    let (problem_parts, body) = problem.into_parts();
    // What belongs to the error stays, such as the methods that are allowed.
    parts.headers.remove(header::CONTENT_LENGTH);
    parts.headers.extend(problem_parts.headers);
    parts.extensions.extend(problem_parts.extensions);
    Response::from_parts(parts, Body::new(body))
}
