//! What every request passes: checks against other web pages, time-out, headers, a number.
//!
//! A web page that somebody has open must not act in their name, nor, on an open server, because it
//! can reach the port: requests from other origins are refused, and so are host names that are not
//! ours while we listen on loopback (a page could point its own name here).

use std::net::{IpAddr, SocketAddr};
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::{FromRequest, Request, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt as _;
use tracing::Instrument as _;

use super::peer::Peer;
use super::problem::{self, Code, Problem};
use crawler_metrics::Metrics;
use crawler_system::text::Shown;

/// The id of a request, in its answer.
const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// No call waits for anything but a lock, the records or the client's own bytes.
const TIME_OUT: Duration = Duration::from_secs(10);
/// But for reading the audit log from its beginning, and for megabytes on their way here.
const LONG_TIME_OUT: Duration = Duration::from_mins(2);

/// Which hosts are ours.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules {
    loopback_only: bool,
}

impl Rules {
    pub(super) fn new(listen: SocketAddr) -> Self {
        Self {
            loopback_only: listen.ip().is_loopback(),
        }
    }

    fn check(self, headers: &HeaderMap) -> Result<(), Problem> {
        let forbidden = |code, detail| Err(Problem::new(code, detail));
        // Of two, a proxy may have looked at the other one.
        let mut hosts = headers.get_all(header::HOST).into_iter();
        let host = hosts
            .next()
            .filter(|_| hosts.next().is_none())
            .and_then(|host| host.to_str().ok())
            .and_then(|host| host.parse::<Authority>().ok());
        let Some(host) = host else {
            return Err(Problem::new(
                Code::BadHost,
                "the Host header is missing, there twice, or not one",
            ));
        };
        if self.loopback_only && !is_loopback_name(host.host()) {
            return forbidden(
                Code::ForeignHost,
                "this server answers on loopback only, to localhost, 127.0.0.1 and [::1]",
            );
        }
        match headers.get(header::ORIGIN) {
            // Browsers say so themselves where they leave the origin out.
            None if headers
                .get("sec-fetch-site")
                .is_some_and(|site| site == "cross-site")
                && headers
                    .get("sec-fetch-mode")
                    .is_none_or(|mode| mode != "navigate") =>
            {
                forbidden(
                    Code::ForeignOrigin,
                    "requests from pages of other origins are refused",
                )
            }
            None => Ok(()),
            Some(origin) if is_origin_of(origin, host.as_str()) => Ok(()),
            Some(_) => forbidden(
                Code::ForeignOrigin,
                "requests from pages of other origins are refused",
            ),
        }
    }
}

fn is_loopback_name(host: &str) -> bool {
    let bare = host
        .strip_prefix('[')
        .and_then(|host| host.strip_suffix(']'))
        .unwrap_or(host);
    bare.eq_ignore_ascii_case("localhost")
        || bare.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

/// Whether a page served at `host` has this origin. `https` counts too: a proxy in front may add it.
fn is_origin_of(origin: &HeaderValue, host: &str) -> bool {
    origin
        .to_str()
        .ok()
        .and_then(|origin| {
            origin
                .strip_prefix("http://")
                .or_else(|| origin.strip_prefix("https://"))
        })
        .is_some_and(|origin| origin.eq_ignore_ascii_case(host))
}

pub(super) async fn check(State(rules): State<Rules>, request: Request, next: Next) -> Response {
    match rules.check(request.headers()) {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    }
}

pub(super) async fn time_out(request: Request, next: Next) -> Response {
    let path = request.uri().path();
    let uploads = path == super::releases::ALL && request.method() == Method::POST;
    let limit = if path == super::audit::VERIFY || uploads {
        LONG_TIME_OUT
    } else {
        TIME_OUT
    };
    match tokio::time::timeout(limit, next.run(request)).await {
        Ok(response) => response,
        Err(_) => Problem::new(
            Code::Timeout,
            format!(
                "the request did not come to its end within {} s",
                limit.as_secs()
            ),
        )
        .into_response(),
    }
}

/// A mistake of ours costs its request and nothing else.
pub(super) async fn catch_panics(request: Request, next: Next) -> Response {
    let call = AssertUnwindSafe(next.run(request)).catch_unwind();
    call.await.unwrap_or_else(|_| {
        // The panic hook has logged what and where.
        Problem::new(
            Code::Internal,
            "internal error: the log of the server says what",
        )
        .into_response()
    })
}

/// Scripts, styles and connections of our own origin only. Vite bundles neither inline scripts nor
/// inline styles; textures and icons may come as data.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
    img-src 'self' data: blob:; font-src 'self'; connect-src 'self'; worker-src 'self'; \
    manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Numbers the request, counts it, and adds the headers that every answer carries.
pub(super) async fn finish(
    State((ids, metrics)): State<(Arc<RequestIds>, Arc<Metrics>)>,
    request: Request,
    next: Next,
) -> Response {
    let peer = Peer::of(&request);
    let id = ids.next();
    let span = tracing::info_span!("request", id = %id, from = %peer.ip());
    let line = format!("{} {}", request.method(), Shown(request.uri().path()));
    let begun = Instant::now();
    let response = next.run(request).instrument(span.clone()).await;
    let mut response = problem::name(response, &id);
    let status = response.status().as_u16();
    let milliseconds = begun.elapsed().as_millis() as u64;
    metrics.http_request(status);
    span.in_scope(|| {
        if status >= 500 {
            tracing::warn!(status, milliseconds, "{line}");
        } else {
            tracing::debug!(status, milliseconds, "{line}");
        }
    });
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        (
            HeaderName::from_static("cross-origin-opener-policy"),
            "same-origin",
        ),
        (
            HeaderName::from_static("cross-origin-resource-policy"),
            "same-origin",
        ),
        (
            HeaderName::from_static("permissions-policy"),
            "camera=(), geolocation=(), microphone=()",
        ),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    if peer.tls {
        // Said over a plain connection, a browser must not believe it.
        let year = HeaderValue::from_static("max-age=31536000");
        headers.insert(header::STRICT_TRANSPORT_SECURITY, year);
    }
    if let Ok(id) = HeaderValue::from_str(&id) {
        headers.insert(REQUEST_ID, id);
    }
    headers
        .entry(header::CACHE_CONTROL)
        .or_insert(HeaderValue::from_static("no-store"));
    response
}

/// Names requests: what stands for this run of the server, and a number.
pub(super) struct RequestIds {
    run: String,
    number: AtomicU64,
}

impl RequestIds {
    /// Ids of a new run.
    pub(super) fn new() -> Self {
        let mut run = [0; 4];
        // Without randomness, two runs may use the same ids: a pity, and no more than that.
        let _ = getrandom::fill(&mut run);
        Self {
            run: crawler_system::text::hex(&run),
            number: AtomicU64::new(0),
        }
    }

    fn next(&self) -> String {
        let number = self.number.fetch_add(1, Ordering::Relaxed);
        format!("{}-{number:06}", self.run)
    }
}

/// A body that says it is JSON. Pages of other origins cannot send that without asking first.
pub(super) struct JsonBody(pub(super) Bytes);

impl JsonBody {
    /// The body as what it should be.
    pub(super) fn read<T: serde::de::DeserializeOwned>(&self) -> Result<T, Problem> {
        problem::read(&self.0).map_err(|error| match error {
            Some(error) => Problem::invalid(Code::InvalidBody, vec![error]),
            None => Problem::new(Code::Malformed, "the body is not one JSON object"),
        })
    }
}

impl<S: Send + Sync> FromRequest<S> for JsonBody {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let is_json = request
            .headers()
            .get(header::CONTENT_TYPE)
            .and_then(|value| value.to_str().ok())
            .and_then(|value| value.split(';').next())
            .is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"));
        if !is_json {
            return Err(Problem::new(
                Code::UnsupportedMediaType,
                "the body must be application/json",
            ));
        }
        match Bytes::from_request(request, state).await {
            Ok(bytes) => Ok(Self(bytes)),
            Err(error) if error.status() == StatusCode::PAYLOAD_TOO_LARGE => Err(Problem::new(
                Code::TooLarge,
                "the body is larger than this call takes",
            )),
            Err(_) => Err(Problem::new(Code::BadRequest, "the body did not arrive")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(listen: &str, host: &str, origin: Option<&str>) -> bool {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, host.parse().expect("host"));
        if let Some(origin) = origin {
            headers.insert(header::ORIGIN, origin.parse().expect("origin"));
        }
        Rules::new(listen.parse().expect("address"))
            .check(&headers)
            .is_ok()
    }

    #[test]
    fn loopback_answers_to_its_own_names() {
        for host in [
            "localhost:8080",
            "127.0.0.1:8080",
            "[::1]:8080",
            "LOCALHOST",
            "127.0.0.2",
        ] {
            assert!(verdict("127.0.0.1:8080", host, None), "{host}");
        }
        for host in [
            "evil.example:8080",
            "localhost.evil.example",
            "10.0.0.1:8080",
        ] {
            assert!(!verdict("127.0.0.1:8080", host, None), "{host}");
        }
        assert!(verdict("0.0.0.0:8080", "robots.local:8080", None));
    }

    #[test]
    fn a_request_is_for_one_host() {
        let rules = Rules::new("0.0.0.0:8080".parse().expect("address"));
        let mut headers = HeaderMap::new();
        assert!(rules.check(&headers).is_err());
        let host = HeaderValue::from_static("robots.local:8080");
        headers.append(header::HOST, host.clone());
        assert!(rules.check(&headers).is_ok());
        headers.append(header::HOST, host);
        assert!(rules.check(&headers).is_err());
    }

    #[test]
    fn only_our_own_pages_may_call() {
        let at = |origin| verdict("127.0.0.1:8080", "localhost:8080", Some(origin));
        assert!(at("http://localhost:8080"));
        for origin in [
            "http://localhost:9090",
            "http://127.0.0.1:8080",
            "https://evil.example",
            "null",
            "file://",
            "http://localhost:8080.evil.example",
        ] {
            assert!(!at(origin), "{origin}");
        }
    }
}
