//! Whether the server lives, whether it can do its work, and its numbers.

use std::sync::Arc;

use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde::Serialize;

use super::App;
use crate::broker::BrokerHandle;
use crate::metrics::{Observed, Robots};

pub(super) fn routes() -> Router<Arc<App>> {
    Router::new()
        .route("/healthz", get(alive))
        .route("/readyz", get(ready))
        .route("/metrics", get(metrics))
}

/// 200 as long as requests are answered at all.
async fn alive() -> &'static str {
    "ok\n"
}

#[derive(Serialize)]
struct Readiness {
    ready: bool,
    broker: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    simulation: Option<bool>,
}

/// 200 when commands reach robots: the broker is connected, and the simulation, where there is one,
/// is running. 503 otherwise, with what is missing.
async fn ready(State(app): State<Arc<App>>) -> Response {
    let broker = app.bus.is_up();
    let simulation = app.simulation.get().map(|world| world.is_running());
    let ready = broker && simulation != Some(false);
    let body = Json(Readiness {
        ready,
        broker,
        simulation,
    });
    if ready {
        return body.into_response();
    }
    // A report rather than a problem document: the request itself was all right.
    let mut response = (StatusCode::SERVICE_UNAVAILABLE, body).into_response();
    super::problem::keep(&mut response);
    response
}

async fn metrics(State(app): State<Arc<App>>) -> Response {
    let observed = Observed {
        robots: Robots::count(&app.fleet.lock()),
        open_commands: app.commands.totals().open,
        simulation: app.simulation.get().map(|world| world.numbers()),
    };
    let text = app
        .metrics
        .encode(&observed, app.broker.as_ref().map(BrokerHandle::counters));
    (
        [(
            header::CONTENT_TYPE,
            "application/openmetrics-text; version=1.0.0; charset=utf-8",
        )],
        text,
    )
        .into_response()
}
