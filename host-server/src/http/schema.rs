//! What messages and calls look like.

use std::sync::Arc;

use axum::Router;
use axum::extract::Path;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use utoipa::openapi::OpenApi;

use super::App;
use super::problem::Problem;

/// JSON Schema of a message
///
/// Generated from the types that robots and server use.
#[utoipa::path(get, path = "/schema/{message}", tag = "description",
    params(("message" = String, Path, description = "Name of a message, like `telemetry`")),
    responses(
        (status = 200, description = "JSON Schema (2020-12)", body = Object,
            content_type = "application/schema+json"),
        (status = 404, description = "No such message; the names are in `detail`", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn one(Path(message): Path<String>) -> Result<Response, Problem> {
    let schemas = crawler_protocol::schemas();
    let names = || {
        let names: Vec<_> = schemas.iter().map(|(name, _)| *name).collect();
        names.join(", ")
    };
    let schema = schemas
        .iter()
        .find(|(name, _)| *name == message)
        .ok_or_else(|| {
            Problem::new(
                StatusCode::NOT_FOUND,
                "unknown_message",
                format!("there are schemas of {}", names()),
            )
        })?;
    let text = serde_json::to_string_pretty(&schema.1).map_err(|error| {
        tracing::error!(%error, message, "a schema cannot be written");
        Problem::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "internal",
            "the schema cannot be written",
        )
    })?;
    Ok(([(header::CONTENT_TYPE, "application/schema+json")], text).into_response())
}

/// The OpenAPI document, written out once.
pub(super) fn document(document: &OpenApi) -> Router<Arc<App>> {
    let text: Arc<str> = document
        .to_json()
        .unwrap_or_else(|error| {
            tracing::error!(%error, "the OpenAPI document cannot be written");
            "{}".into()
        })
        .into();
    Router::new().route(
        "/api/v1/openapi.json",
        get(move || {
            let text = Arc::clone(&text);
            async move {
                (
                    [(header::CONTENT_TYPE, "application/json")],
                    text.to_string(),
                )
            }
        }),
    )
}
