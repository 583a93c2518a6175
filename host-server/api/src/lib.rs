//! The HTTP side of a server: API, live feed, health, metrics, control room.
//!
//! [`router`] has every call, over the [`Parts`] of a server; each handler asks for those that it needs. [`serve`]
//! serves connections with it.
//!
//! Reading order: `state`; what a request passes, in `serve`, `connection`, `peer`, `latency`, `guard`,
//! `compression`, `access` and `rates`; what all answers share, in `problem`, `query` and `audit`. Then a file for
//! each subject: `robots`, `images`, `maps`, `twins`, `calibrations`, `gap`, `commands`, `faults`, `fences`; `telemetry`, `history`, `events`, `counterfactuals`; `live`,
//! `mqtt`; `simulator`, `world`, `experiments`; `releases`, `rollouts`, `policies`, `shadows`; `session`, `sessions`, `users`, `credentials`; `schema`, `health`,
//! `assets`.

mod access;
mod assets;
mod audit;
mod calibrations;
mod commands;
mod compression;
mod connection;
mod counterfactuals;
mod credentials;
mod events;
mod experiments;
mod faults;
mod fences;
mod gap;
mod guard;
mod health;
mod history;
mod images;
mod latency;
mod live;
mod maps;
mod mqtt;
mod peer;
mod policies;
mod problem;
mod query;
mod rates;
mod releases;
mod robots;
mod rollouts;
mod schema;
mod serve;
mod session;
mod sessions;
mod shadows;
mod simulator;
mod state;
mod telemetry;
mod twins;
mod users;
mod world;

use std::net::SocketAddr;
use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::router::UtoipaMethodRouterExt as _;
use utoipa_axum::routes;

use access::Gate;
use crawler_system::address::Networks;
use guard::RequestIds;
use problem::Problem;
pub use serve::serve;
use state::ApiState;
pub use state::Parts;

/// Longest request body. A command is at most 1,024 bytes on the wire.
const MAX_BODY: usize = 4 * 1024;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Terracrawler",
        description = "Watch and steer a fleet of robots. Errors are problem documents (RFC 9457) \
                       with a stable `code`; where a body or a query is wrong, `errors` has a JSON \
                       pointer to each part that is, or the name of the parameter."
    ),
    components(schemas(Problem)),
    tags(
        (name = "robots", description = "The fleet as last known"),
        (name = "commands", description = "Telling robots what to do"),
        (name = "fences", description = "Where robots are to stay in or out of"),
        (name = "simulator", description = "The simulated world of this process"),
        (name = "experiments", description = "Scenarios on many seeds and policies that learn, and what comes of it"),
        (name = "updates", description = "What robots may be updated to"),
        (name = "feed", description = "Everything as it happens"),
        (name = "history", description = "What was, as far back as it is recorded"),
        (name = "session", description = "Logging in and out"),
        (name = "accounts", description = "Who may do what, and who did what"),
        (name = "description", description = "What messages look like")
    )
)]
struct Description;

/// The router of everything, for a server listening at `listen`.
///
/// What `proxies` say of where a request came from is believed.
pub fn router(parts: Parts, listen: SocketAddr, proxies: Networks) -> Router {
    let metrics = Arc::clone(&parts.metrics);
    let state = ApiState::new(parts);
    let (api, document) = OpenApiRouter::with_openapi(Description::openapi())
        .nest(
            "/api/v1",
            OpenApiRouter::new()
                .routes(routes!(robots::list))
                .routes(routes!(robots::one))
                .routes(routes!(robots::logs))
                .routes(routes!(images::newest))
                .routes(routes!(maps::one))
                .routes(routes!(twins::state))
                .routes(routes!(twins::forecast))
                .routes(routes!(twins::certificates))
                .routes(routes!(gap::of_fleet))
                .routes(routes!(counterfactuals::list, counterfactuals::ask))
                .routes(routes!(counterfactuals::one, counterfactuals::forget))
                .routes(routes!(calibrations::permit))
                .routes(routes!(calibrations::list, calibrations::begin))
                .routes(routes!(calibrations::one, calibrations::stop))
                .routes(routes!(robots::parameters, robots::set_parameters))
                .routes(routes!(faults::inject, faults::heal))
                .routes(routes!(commands::to_robot))
                .routes(routes!(commands::to_swarm))
                .routes(routes!(commands::list))
                .routes(routes!(commands::one))
                .routes(routes!(fences::list, fences::add))
                .routes(routes!(fences::change, fences::delete))
                .routes(routes!(simulator::state))
                .routes(routes!(simulator::command))
                .routes(routes!(world::scenarios))
                .routes(routes!(world::scenario))
                .routes(routes!(experiments::list, experiments::create))
                .routes(routes!(experiments::one, experiments::delete))
                .routes(routes!(experiments::start))
                .routes(routes!(experiments::pause))
                .routes(routes!(experiments::resume))
                .routes(routes!(experiments::stop))
                .routes(routes!(experiments::metrics))
                .routes(routes!(experiments::curve))
                .routes(routes!(experiments::file))
                .routes(routes!(releases::list, releases::add))
                .routes(routes!(releases::one))
                .routes(routes!(releases::gate::one, releases::gate::attach))
                .routes(routes!(releases::withdraw))
                .routes(
                    routes!(rollouts::list, rollouts::start)
                        .layer(DefaultBodyLimit::max(rollouts::MAX_PLAN)),
                )
                .routes(routes!(policies::deploy).layer(DefaultBodyLimit::max(rollouts::MAX_PLAN)))
                .routes(routes!(policies::shadow).layer(DefaultBodyLimit::max(rollouts::MAX_PLAN)))
                .routes(routes!(policies::list))
                .routes(routes!(policies::one))
                .routes(routes!(rollouts::one))
                .routes(routes!(rollouts::robots))
                .routes(routes!(rollouts::robot))
                .routes(routes!(rollouts::pause))
                .routes(routes!(rollouts::resume))
                .routes(routes!(rollouts::abort))
                .routes(routes!(rollouts::retry))
                .routes(routes!(rollouts::skip))
                .routes(routes!(schema::one))
                .routes(routes!(live::connect))
                .routes(routes!(telemetry::history))
                .routes(routes!(history::span))
                .routes(routes!(history::frames))
                .routes(routes!(events::page))
                .routes(routes!(session::login, session::logout, session::current))
                .routes(routes!(session::refresh))
                .routes(routes!(session::password))
                .routes(routes!(session::ticket))
                .routes(routes!(sessions::list))
                .routes(routes!(sessions::end))
                .routes(routes!(users::accept))
                .routes(routes!(users::list, users::add))
                .routes(routes!(users::change, users::delete))
                .routes(routes!(credentials::list))
                .routes(routes!(credentials::enrol, credentials::revoke))
                .routes(routes!(audit::page))
                .routes(routes!(audit::verify)),
        )
        .split_for_parts();
    api.merge(schema::document(document))
        .merge(health::routes())
        .merge(mqtt::routes())
        .fallback(assets::serve)
        .layer(middleware::from_fn_with_state(
            Gate::new(&state),
            access::check,
        ))
        .layer(compression::layer())
        .layer(middleware::from_fn(compression::only_where_it_may))
        // Around the check, which reads commands.
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(middleware::from_fn(guard::time_out))
        .layer(middleware::from_fn_with_state(
            guard::Rules::new(listen),
            guard::check,
        ))
        .layer(middleware::from_fn(problem::uniform))
        .layer(middleware::from_fn(guard::catch_panics))
        .layer(middleware::from_fn_with_state(
            (Arc::new(RequestIds::new()), Arc::clone(&metrics)),
            guard::finish,
        ))
        .layer(middleware::from_fn_with_state(metrics, latency::observe))
        .layer(middleware::from_fn_with_state(
            Arc::new(proxies),
            peer::see_through,
        ))
        .with_state(state)
}
