//! What the worlds of scenarios would be.

use axum::Json;
use axum::extract::{Path, State};
use crawler_sim::scenario::{Scenario, ScenarioError};
use crawler_sim::world::{MAX_ROBOTS, Pose};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};

use super::problem::{Code, Problem};
use super::query::{ApiQuery, bad_query};
use super::state::Drawing;
use crawler_experiments::MAX_SEED;
use crawler_simulations::arena_json;

/// Most robots whose places a preview tells.
const MOST_POSES: usize = 1_000;
/// Seed of a preview when nobody says, and of the arenas whose contents are counted.
const SEED: u64 = 1;

/// A scenario that comes with the program.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ScenarioSummary {
    /// Its name.
    name: String,
    /// What it is, in one sentence.
    about: String,
    /// Robots, unless told otherwise.
    robots: u32,
    /// Metres along x.
    width: f32,
    /// Metres along y.
    height: f32,
    /// How many obstacles.
    obstacles: usize,
    /// How many coloured things.
    objects: usize,
    /// How many obstacles that move.
    movers: usize,
}

/// The scenarios that come with the program.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Scenarios {
    /// The first one is the default.
    scenarios: Vec<ScenarioSummary>,
}

/// Where a robot begins.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ScenarioPose {
    /// Metres.
    x: f32,
    /// Metres.
    y: f32,
    /// Radians, anticlockwise from the x axis.
    theta: f32,
}

/// How a scenario begins.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ScenarioPreview {
    /// Its name.
    name: String,
    /// What it is, in one sentence.
    about: String,
    /// Robots in it.
    robots: u32,
    /// The seed of this world.
    seed: u64,
    /// As in the hello frame of the live feed.
    #[schema(value_type = Object)]
    arena: Value,
    /// Where robots begin: the first 1,000.
    poses: Vec<ScenarioPose>,
}

/// Which world of a scenario is wanted.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PreviewQuery {
    /// Its seed; 1 when not given.
    #[param(minimum = 0, maximum = 9_007_199_254_740_991_u64)]
    seed: Option<u64>,
    /// How many robots; as many as the scenario says when not given.
    #[param(minimum = 1, maximum = 65_535)]
    robots: Option<u32>,
}

fn summary(name: &str) -> Result<ScenarioSummary, ScenarioError> {
    let scenario = Scenario::built_in(name)?;
    let arena = scenario.arena(SEED)?;
    Ok(ScenarioSummary {
        robots: scenario.robots,
        name: scenario.name,
        about: scenario.about,
        width: arena.width,
        height: arena.height,
        obstacles: arena.obstacles.len(),
        objects: arena.objects.len(),
        movers: arena.movers.len(),
    })
}

fn preview(name: &str, query: &PreviewQuery) -> Result<ScenarioPreview, ScenarioError> {
    let mut scenario = Scenario::built_in(name)?;
    let seed = query.seed.unwrap_or(SEED);
    scenario.robots = query.robots.unwrap_or(scenario.robots);
    let world = scenario.preview(seed, MOST_POSES)?;
    let place = |Pose { x, y, theta }| ScenarioPose { x, y, theta };
    Ok(ScenarioPreview {
        robots: scenario.robots,
        name: scenario.name,
        about: scenario.about,
        seed,
        arena: arena_json(&world.arena),
        poses: world.poses.into_iter().map(place).collect(),
    })
}

fn problem(error: &ScenarioError) -> Problem {
    let code = match error {
        ScenarioError::Unknown(_) => Code::UnknownScenario,
        _ => Code::Refused,
    };
    Problem::new(code, error.to_string())
}

/// Draws worlds where that holds up nobody: an arena for thousands of robots takes a while. One at a
/// time, so that nobody gets all of the machine by asking for many.
async fn draw<T: Send + 'static>(
    Drawing(drawing): Drawing,
    work: impl FnOnce() -> Result<T, ScenarioError> + Send + 'static,
) -> Result<T, Problem> {
    let turn = drawing.acquire_owned().await;
    let work = move || {
        // Also when whoever asked has left.
        let _turn = turn;
        work()
    };
    match tokio::task::spawn_blocking(work).await {
        Ok(drawn) => drawn.map_err(|error| problem(&error)),
        Err(error) => {
            tracing::error!(%error, "drawing a scenario failed");
            Err(Problem::internal("the scenario cannot be drawn"))
        }
    }
}

/// The scenarios that come with the program
#[utoipa::path(get, path = "/simulator/scenarios", tag = "simulator",
    responses((status = 200, description = "All of them", body = Scenarios)))]
pub(super) async fn scenarios(State(drawing): State<Drawing>) -> Result<Json<Scenarios>, Problem> {
    let all = || Scenario::names().map(summary).collect();
    let scenarios = draw(drawing, all).await?;
    Ok(Json(Scenarios { scenarios }))
}

/// How a scenario begins: its arena, and where its robots stand
#[utoipa::path(get, path = "/simulator/scenarios/{name}", tag = "simulator",
    params(("name" = String, Path, description = "Name of the scenario"), PreviewQuery),
    responses(
        (status = 200, description = "It begins like this", body = ScenarioPreview),
        (status = 400, description = "Not such a query"),
        (status = 404, description = "No scenario has this name"),
        (status = 409, description = "So many robots have no room in it")))]
pub(super) async fn scenario(
    State(drawing): State<Drawing>,
    Path(name): Path<String>,
    ApiQuery(query): ApiQuery<PreviewQuery>,
) -> Result<Json<ScenarioPreview>, Problem> {
    if query.seed.is_some_and(|seed| seed > MAX_SEED) {
        return Err(bad_query("seed", format!("must be 0 to {MAX_SEED}")));
    }
    if query
        .robots
        .is_some_and(|robots| robots == 0 || robots as usize > MAX_ROBOTS)
    {
        return Err(bad_query("robots", format!("must be 1 to {MAX_ROBOTS}")));
    }
    draw(drawing, move || preview(&name, &query))
        .await
        .map(Json)
}
