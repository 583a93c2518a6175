//! Whether the server lives, whether it can do its work, and its numbers.

use std::sync::Arc;

use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use crawler_records::Records;
use serde::Serialize;
use tokio::runtime::Handle;

use super::audit::Audit;
use super::state::{ApiState, Broker, World};
use crawler_broker::BrokerHandle;
use crawler_cluster::ClusterMembership;
use crawler_commands::CommandCenter;
use crawler_experiments::Experiments;
use crawler_fleet::bus::Bus;
use crawler_fleet::{RobotCounts, SharedFleet};
use crawler_history::HistoryStore;
use crawler_metrics::Metrics;

pub(super) fn routes() -> Router<ApiState> {
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
    /// Whether the database of the records answers, where they are in one.
    #[serde(skip_serializing_if = "Option::is_none")]
    database: Option<bool>,
    /// Whether what several servers share can be written.
    #[serde(skip_serializing_if = "Option::is_none")]
    cache: Option<bool>,
    /// `false` while commands that are to outlive the server cannot be written down.
    #[serde(skip_serializing_if = "Option::is_none")]
    journal: Option<bool>,
    /// `false` while the audit log cannot be written.
    #[serde(skip_serializing_if = "Option::is_none")]
    audit: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    simulation: Option<bool>,
    /// Whether the engine that keeps the history answers, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    history: Option<bool>,
}

/// 200 when commands are taken and reach robots: the broker is connected, commands and the audit log can be
/// written down, what several servers share can be written where there are several, and the simulation, where there is
/// one, is running. 503 otherwise, with what is missing.
///
/// A database that does not answer is told and does not make it 503: whoever is logged in can still
/// stop robots, and several servers that share it must not all be taken out of service at once. Robots
/// can be steered without their history, so an engine that is away is told of and no more.
async fn ready(
    State(bus): State<Arc<Bus>>,
    State(commands): State<Arc<CommandCenter>>,
    State(audit): State<Audit>,
    State(records): State<Records>,
    State(history): State<HistoryStore>,
    State(world): State<World>,
    State(membership): State<Option<Arc<ClusterMembership>>>,
) -> Response {
    let broker = bus.is_up();
    let simulation = world.get().map(|world| world.is_running());
    let cache = membership.map(|membership| membership.is_member());
    let journal = (!commands.is_written()).then_some(false);
    let audit = (!audit.is_written()).then_some(false);
    let database = records.database().map(|stats| stats.up);
    // With a database it is told of, as that is.
    let written = journal.is_none() && (audit.is_none() || database.is_some());
    let ready = broker && written && cache != Some(false) && simulation != Some(false);
    let body = Json(Readiness {
        ready,
        broker,
        database,
        cache,
        journal,
        audit,
        simulation,
        history: history.engine_up(),
    });
    if ready {
        return body.into_response();
    }
    // A report rather than a problem document: the request itself was all right.
    let mut response = (StatusCode::SERVICE_UNAVAILABLE, body).into_response();
    super::problem::keep(&mut response);
    response
}

async fn metrics(
    State(metrics): State<Arc<Metrics>>,
    State(fleet): State<Arc<SharedFleet>>,
    State(commands): State<Arc<CommandCenter>>,
    State(experiments): State<Arc<Experiments>>,
    State(world): State<World>,
    State(Broker(broker)): State<Broker>,
) -> Response {
    let mut out = metrics.exposition();
    RobotCounts::of(&fleet.lock()).write_metrics(&mut out);
    out.gauge(
        "terracrawler_commands_open",
        "Commands some robot has not answered for good",
        commands.totals().open as f64,
    );
    let own = Handle::current().metrics().num_alive_tasks();
    let of_broker = broker.as_ref().map(BrokerHandle::tasks);
    out.gauges(
        "terracrawler_tasks",
        "Tasks that have not ended, by runtime",
        "runtime",
        std::iter::once(("server", own)).chain(of_broker.map(|count| ("broker", count))),
    );
    if let Some(world) = world.get() {
        world.numbers().write_metrics(&mut out);
    }
    experiments.numbers().write_metrics(&mut out);
    if let Some(broker) = &broker {
        broker.write_metrics(&mut out).await;
    }
    (
        [(
            header::CONTENT_TYPE,
            "application/openmetrics-text; version=1.0.0; charset=utf-8",
        )],
        out.finish(),
    )
        .into_response()
}
