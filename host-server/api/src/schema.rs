//! What messages and calls look like.

use std::sync::Arc;

use axum::Router;
use axum::extract::Path;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde_json::{Value, json};
use utoipa::openapi::path::Operation;
use utoipa::openapi::{Content, OpenApi, Ref, RefOr, ResponseBuilder};

use super::problem::{Code, Problem};
use super::state::ApiState;

/// JSON Schema of a message
///
/// Generated from the types that robots and server use.
#[utoipa::path(get, path = "/schema/{message}", tag = "description",
    params(("message" = String, Path, description = "Name of a message, like `telemetry`")),
    responses(
        (status = 200, description = "JSON Schema (2020-12)", body = Object,
            content_type = "application/schema+json"),
        (status = 404, description = "No such message; the names are in `detail`")))]
pub(super) async fn one(Path(message): Path<String>) -> Result<Response, Problem> {
    let schemas = crawler_sim_protocol::schemas();
    let names = || {
        let names: Vec<_> = schemas.iter().map(|(name, _)| *name).collect();
        names.join(", ")
    };
    let schema = schemas
        .iter()
        .find(|(name, _)| *name == message)
        .ok_or_else(|| {
            Problem::new(
                Code::UnknownMessage,
                format!("there are schemas of {}", names()),
            )
        })?;
    let text = serde_json::to_string_pretty(&schema.1).map_err(|error| {
        tracing::error!(%error, message, "a schema cannot be written");
        Problem::new(Code::Internal, "the schema cannot be written")
    })?;
    Ok(([(header::CONTENT_TYPE, "application/schema+json")], text).into_response())
}

/// What is checked before any call, whatever it is.
const ALWAYS: [(&str, &str); 5] = [
    ("400", "Not a request that this call can take"),
    (
        "401",
        "The server is closed, and the token is missing, not valid or expired",
    ),
    (
        "403",
        "Another role is needed, or the request comes from another origin",
    ),
    ("408", "The request did not come to its end in time"),
    (
        "429",
        "Too many requests of this account or address; `Retry-After` says when",
    ),
];
/// And of calls that only read.
const WHEN_READ: [(&str, &str); 1] = [(
    "406",
    "`Accept-Encoding` takes neither gzip nor what is not encoded",
)];
/// And before any body is looked at.
const WITH_BODY: [(&str, &str); 2] = [
    ("413", "The body is too large"),
    ("415", "The body is not `application/json`"),
];

/// Adds the answers that every call can give to those that it tells of itself, and what errors look like.
fn complete(document: &mut OpenApi) {
    for (path, item) in &mut document.paths.paths {
        let operations = [
            ("get", &mut item.get),
            ("put", &mut item.put),
            ("post", &mut item.post),
            ("delete", &mut item.delete),
            ("patch", &mut item.patch),
        ];
        for (method, operation) in operations {
            let Some(operation) = operation else { continue };
            operation.operation_id = Some(operation_id(method, path));
            let with_body = operation.request_body.is_some();
            add(operation, &ALWAYS);
            if method == "get" {
                add(operation, &WHEN_READ);
            }
            if with_body {
                add(operation, &WITH_BODY);
            }
            say_problems(operation);
        }
    }
}

/// `get /api/v1/robots/{id}` to `get_robots_id`: a name must be the only one of its kind, which those
/// of handlers are not.
fn operation_id(method: &str, path: &str) -> String {
    let path = path.strip_prefix("/api/v1").unwrap_or(path);
    let words = path.split(|c: char| !c.is_ascii_alphanumeric());
    words
        .filter(|word| !word.is_empty())
        .fold(method.to_owned(), |name, word| name + "_" + word)
}

fn add(operation: &mut Operation, answers: &[(&str, &str)]) {
    for (status, description) in answers {
        let responses = &mut operation.responses.responses;
        responses
            .entry((*status).to_owned())
            .or_insert_with(|| RefOr::T(ResponseBuilder::new().description(*description).build()));
    }
}

/// What is wrong is said in a problem document, whatever it is.
fn say_problems(operation: &mut Operation) {
    for (status, response) in &mut operation.responses.responses {
        if status.starts_with(['4', '5'])
            && let RefOr::T(response) = response
        {
            let problem = Content::new(Some(Ref::from_schema_name("Problem")));
            let kind = "application/problem+json".to_owned();
            response.content.insert(kind, problem.into());
        }
    }
}

/// Bodies that the protocol's own parser reads, and the message whose schema says what they may be.
const MESSAGES: [(&str, &str); 2] = [
    ("CommandRequest", "command-request"),
    ("SimulatorCommand", "simulator-command"),
];

/// Puts what bodies of commands may be in the place of what the handlers tell of them.
///
/// `None` when the document or a schema has not the shape that it is known to have.
fn describe_commands(document: &mut Value) -> Option<()> {
    let schemas = document.pointer_mut("/components/schemas")?;
    let schemas = schemas.as_object_mut()?;
    for (component, message) in MESSAGES {
        let all = crawler_sim_protocol::schemas();
        let (_, schema) = all.into_iter().find(|(name, _)| *name == message)?;
        let mut schema = serde_json::to_value(schema).ok()?;
        refer_within(&mut schema, component);
        let body = schema.as_object_mut()?;
        body.remove("$schema");
        if let Some(Value::Object(parts)) = body.remove("$defs") {
            for (name, part) in parts {
                schemas.insert(format!("{component}.{name}"), part);
            }
        }
        schemas.insert(component.to_owned(), schema);
    }
    let commands = schemas.get("CommandRequest")?.get("oneOf")?.as_array()?;
    let set = commands.iter().find(|command| command["title"] == "set")?;
    let values = set.pointer("/properties/parameters")?.clone();
    schemas.insert("ParameterChanges".to_owned(), values);
    let fault = schemas.get_mut("FaultRequest")?;
    *fault.pointer_mut("/properties/fault")? =
        json!({ "$ref": "#/components/schemas/SimulatorCommand.FaultSpec" });
    Some(())
}

/// Makes references to parts of a schema into references to parts of `component`.
fn refer_within(schema: &mut Value, component: &str) {
    match schema {
        Value::Object(fields) => {
            for (name, field) in fields {
                match field {
                    Value::String(text) if name == "$ref" => {
                        let part = text.trim_start_matches("#/$defs/");
                        *text = format!("#/components/schemas/{component}.{part}");
                    }
                    field => refer_within(field, component),
                }
            }
        }
        Value::Array(items) => {
            for item in items {
                refer_within(item, component);
            }
        }
        _ => {}
    }
}

/// The OpenAPI document, written out once.
pub(super) fn document(mut document: OpenApi) -> Router<ApiState> {
    complete(&mut document);
    let mut document = serde_json::to_value(document).unwrap_or_else(|error| {
        tracing::error!(%error, "the OpenAPI document cannot be written");
        Value::Null
    });
    if describe_commands(&mut document).is_none() {
        tracing::error!("the OpenAPI document does not say what commands may be");
    }
    let text: Arc<str> = document.to_string().into();
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
