//! What is said of a simulated world, over HTTP and over MQTT.

use crawler_sim::live::{Bookmark, ControlError, LiveDone, LiveState};
use crawler_sim::world::DroppedItem;
// A type called `Object` is any object at all in descriptions.
use crawler_sim_protocol::{Dropped, Object as Thing, Obstacle};
use serde::Serialize;
use utoipa::ToSchema;

use crate::Simulation;

/// The simulated world.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Simulator)]
pub struct SimulatorView {
    /// `running` or `paused`.
    state: &'static str,
    /// How many times as fast as real time it is to run.
    factor: f64,
    /// How many times as fast it ran in the last second; 0 while it is paused.
    real_time_factor: f64,
    /// Seconds since its beginning.
    time: f64,
    /// Its seed.
    seed: u64,
    /// Robots in it.
    robots: u32,
    /// Robots that are connected to the broker.
    connected: u64,
    /// Fingerprint of its history at the end of the last whole second, 16 hexadecimal digits.
    hash: String,
    /// Name of its scenario.
    scenario: String,
    /// What was dropped into it and lies there, in the order in which it came.
    dropped: Vec<ItemView>,
    /// Moments that were kept to go back to, oldest first.
    bookmarks: Vec<BookmarkView>,
}

impl SimulatorView {
    /// What is said of `simulation`, which is in `state`.
    pub fn new(simulation: &Simulation, state: &LiveState) -> Self {
        let numbers = simulation.numbers();
        let scene = simulation.scene();
        Self {
            state: if state.paused { "paused" } else { "running" },
            factor: state.factor,
            real_time_factor: numbers.real_time_factor,
            time: state.time.as_micros() as f64 / 1e6,
            seed: state.seed,
            robots: state.robots,
            connected: numbers.connected,
            hash: format!("{:016x}", state.hash),
            scenario: scene.scenario,
            dropped: scene.dropped.into_iter().map(ItemView::from).collect(),
            bookmarks: scene
                .bookmarks
                .into_iter()
                .map(BookmarkView::from)
                .collect(),
        }
    }
}

/// What came of a command to the simulated world.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = SimulatorAnswer)]
pub struct SimulatorAnswer {
    /// The world after it.
    simulator: SimulatorView,
    /// The robot that was added.
    #[serde(skip_serializing_if = "Option::is_none")]
    robot: Option<String>,
    /// The number of what was dropped.
    #[serde(skip_serializing_if = "Option::is_none")]
    item: Option<u32>,
}

impl SimulatorAnswer {
    /// What is said of `simulation` after a command that came to `done`.
    pub fn new(simulation: &Simulation, done: &LiveDone) -> Self {
        Self {
            simulator: SimulatorView::new(simulation, &done.state),
            robot: done.robot.as_ref().map(|robot| robot.as_str().to_owned()),
            item: done.item,
        }
    }
}

/// The stable code of an error.
pub const fn control_code(error: &ControlError) -> &'static str {
    match error {
        ControlError::Busy => "busy",
        ControlError::Ended => "simulator_ended",
        ControlError::NoRobot => "unknown_robot",
        _ => "refused",
    }
}

/// What was dropped into the running world.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = DroppedItem)]
pub struct ItemView {
    /// Its number, for `take`.
    id: u32,
    /// What it is, when it is an obstacle.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    obstacle: Option<Obstacle>,
    /// What it is, when it is a coloured thing.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    object: Option<Thing>,
}

impl From<DroppedItem> for ItemView {
    fn from(DroppedItem { id, what }: DroppedItem) -> Self {
        let (obstacle, object) = match what {
            Dropped::Obstacle(obstacle) => (Some(obstacle), None),
            Dropped::Object(object) => (None, Some(object)),
        };
        Self {
            id,
            obstacle,
            object,
        }
    }
}

/// A moment of the world that was kept.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Bookmark)]
pub struct BookmarkView {
    /// Its name.
    name: String,
    /// Seconds of the world.
    time: f64,
    /// When it was kept, Unix milliseconds.
    made_at: u64,
    /// Robots in it.
    robots: u32,
    /// Name of its scenario.
    scenario: String,
}

impl From<Bookmark> for BookmarkView {
    fn from(kept: Bookmark) -> Self {
        Self {
            name: kept.name.as_str().to_owned(),
            time: kept.time.as_micros() as f64 / 1e6,
            made_at: kept.made_at,
            robots: kept.robots,
            scenario: kept.scenario,
        }
    }
}
