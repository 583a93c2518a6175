//! The control room, embedded in the binary.

use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use rust_embed::{EmbeddedFile, RustEmbed};

use super::problem::{Code, Problem};

/// `npm run build` in `ui/` fills the folder; without it the help page below is served.
#[derive(RustEmbed)]
#[folder = "../ui/dist"]
#[allow_missing = true]
struct Files;

/// What to do when the control room was not built.
const HELP: &str = include_str!("help.html");
const HTML: &str = "text/html; charset=utf-8";

/// Serves a file, or says that there is none.
pub(super) async fn serve(request: Request) -> Response {
    let path = request.uri().path();
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        let status = if path == "/" || Files::get(path.trim_start_matches('/')).is_some() {
            StatusCode::METHOD_NOT_ALLOWED
        } else {
            StatusCode::NOT_FOUND
        };
        return status.into_response();
    }
    let name = match path.strip_prefix('/') {
        Some("") => "index.html",
        Some(name) => name,
        None => return not_found(),
    };
    match Files::get(name) {
        Some(file) => send(name, &file, request.headers()),
        None if name == "index.html" => ([(header::CONTENT_TYPE, HTML)], HELP).into_response(),
        None => not_found(),
    }
}

fn not_found() -> Response {
    Problem::new(Code::NotFound, "there is nothing at this address").into_response()
}

fn send(name: &str, file: &EmbeddedFile, request: &HeaderMap) -> Response {
    // Weak: compressed or not, it is the same to a reader, but not byte for byte.
    let tag = format!(
        "\"{}\"",
        crawler_system::text::hex(&file.metadata.sha256_hash())
    );
    let weak = format!("W/{tag}");
    // Vite puts a hash of the content into the names below `assets/`.
    let caching = if name.starts_with("assets/") {
        "public, max-age=31536000, immutable"
    } else {
        "no-cache"
    };
    let known = request
        .get_all(header::IF_NONE_MATCH)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .map(|candidate| candidate.trim().trim_start_matches("W/"))
        .any(|candidate| candidate == tag || candidate == "*");
    let mut response = if known {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        (
            [(header::CONTENT_TYPE, media_type(name))],
            file.data.to_vec(),
        )
            .into_response()
    };
    let headers = response.headers_mut();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(caching));
    headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    if let Ok(tag) = HeaderValue::from_str(&weak) {
        headers.insert(header::ETAG, tag);
    }
    response
}

/// The types that a build of the control room has.
fn media_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, extension)| extension) {
        "html" => HTML,
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" | "map" => "application/json",
        "webmanifest" => "application/manifest+json",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "ico" => "image/x-icon",
        "webp" => "image/webp",
        "woff2" => "font/woff2",
        "wasm" => "application/wasm",
        "txt" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}
