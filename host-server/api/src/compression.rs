//! Answers in gzip, for readers that take it.
//!
//! Only text that was read, of some length, and whole: a still or a stream gains nothing, and what fits a
//! packet as it is costs one either way.
//!
//! How long a compressed answer is says something about what is in it. Where a secret stood beside what
//! somebody else may choose, that one could find it out by trying (BREACH, CVE-2013-3587). So whatever hands
//! out tokens, tickets, invitations or secrets goes as it is: no answer to a `POST` is compressed, nor
//! what is about sessions, accounts and credentials.

use axum::body::HttpBody;
use axum::extract::Request;
use axum::http::{Method, Response, StatusCode, header};
use axum::middleware::Next;
use tower_http::CompressionLevel;
use tower_http::compression::{CompressionLayer, Predicate};

/// What is shorter goes as it is.
const SHORTEST: u64 = 1_024;
/// What is worth it, beside `text/…`.
const TYPES: [&str; 5] = [
    "application/json",
    "application/manifest+json",
    "application/openmetrics-text",
    "application/schema+json",
    "image/svg+xml",
];
/// Where secrets are handed out, or spoken of.
const SECRETS: [&str; 5] = [
    "/api/v1/credentials",
    "/api/v1/invitations",
    "/api/v1/session",
    "/api/v1/sessions",
    "/api/v1/users",
];

/// Whether an answer is worth it.
#[derive(Debug, Clone, Copy)]
pub(super) struct LongText;

impl Predicate for LongText {
    fn should_compress<B: HttpBody>(&self, response: &Response<B>) -> bool {
        let size = response.body().size_hint().exact();
        let kind = response.headers().get(header::CONTENT_TYPE);
        let kind = kind.and_then(|kind| kind.to_str().ok()).unwrap_or_default();
        let kind = kind.split(';').next().unwrap_or_default().trim();
        response.status() == StatusCode::OK
            && size.is_some_and(|size| size >= SHORTEST)
            && (kind.starts_with("text/") || TYPES.contains(&kind))
    }
}

/// Compresses what is worth it. As fast as can be: the same machine answers to robots.
pub(super) fn layer() -> CompressionLayer<LongText> {
    CompressionLayer::new()
        .quality(CompressionLevel::Fastest)
        .compress_when(LongText)
}

/// Takes the wish for a compressed answer out of requests that are not to have one.
pub(super) async fn only_where_it_may(
    mut request: Request,
    next: Next,
) -> axum::response::Response {
    if request.method() != Method::GET || is_secret(request.uri().path()) {
        request.headers_mut().remove(header::ACCEPT_ENCODING);
    }
    next.run(request).await
}

fn is_secret(path: &str) -> bool {
    SECRETS.iter().any(|secret| {
        let rest = path.strip_prefix(secret);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    })
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn answer(status: u16, kind: &str, length: usize) -> Response<Body> {
        let answer = Response::builder()
            .status(status)
            .header(header::CONTENT_TYPE, kind);
        answer
            .body(Body::from("x".repeat(length)))
            .expect("an answer")
    }

    #[test]
    fn only_long_text_is_worth_it() {
        for kind in [
            "application/json",
            "text/css; charset=utf-8",
            "image/svg+xml",
        ] {
            assert!(
                LongText.should_compress(&answer(200, kind, 1_024)),
                "{kind}"
            );
            assert!(
                !LongText.should_compress(&answer(200, kind, 1_023)),
                "{kind}"
            );
            assert!(
                !LongText.should_compress(&answer(206, kind, 9_000)),
                "{kind}"
            );
            assert!(
                !LongText.should_compress(&answer(422, kind, 9_000)),
                "{kind}"
            );
        }
        for kind in ["image/jpeg", "font/woff2", "application/octet-stream", ""] {
            assert!(
                !LongText.should_compress(&answer(200, kind, 9_000)),
                "{kind}"
            );
        }
        let (parts, _) = answer(200, "text/plain", 9_000).into_parts();
        let stream = futures_util::stream::pending::<Result<Vec<u8>, std::io::Error>>();
        let stream = Response::from_parts(parts, Body::from_stream(stream));
        assert!(
            !LongText.should_compress(&stream),
            "nobody knows how long it is"
        );
    }

    #[test]
    fn secrets_are_known_by_their_paths() {
        for path in [
            "/api/v1/session",
            "/api/v1/session/ticket",
            "/api/v1/users/ada",
        ] {
            assert!(is_secret(path), "{path}");
        }
        for path in [
            "/",
            "/api/v1/robots",
            "/api/v1/sessionsx",
            "/assets/session.js",
        ] {
            assert!(!is_secret(path), "{path}");
        }
    }
}
