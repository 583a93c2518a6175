//! The simulated robots of this process: a world that is started, told what to do, and ended.
//!
//! [`Simulation`] is the world, [`listen`] what takes commands to it from MQTT, [`SimulatorView`] and
//! [`SimulatorAnswer`] what is said of it, over HTTP and over MQTT alike. Who sees its arena is handed in.

mod listener;
mod view;

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use crawler_sim::live::{
    ControlError, LiveConfig, LiveDone, LiveError, LiveHandle, LiveScene, LiveState, start,
    start_recorded,
};
use crawler_sim::tools::recording::RecordTo;
use crawler_sim::world::Arena;
use crawler_sim_protocol::SimulatorCommand;
use tokio::sync::watch;
use tokio::task::JoinError;

use crawler_metrics::Exposition;

pub use listener::{MAX_PACKET, listen, response_topic};
pub use view::{BookmarkView, ItemView, SimulatorAnswer, SimulatorView, control_code};

/// For robots to come to rest. From full speed the ramp takes well under a second of theirs, which is several of real
/// time where the machine has no time for the world. With what else has to end it stays below the half minute after which
/// a service is killed.
const PATIENCE: Duration = Duration::from_secs(20);

/// Least time between two arenas that are told.
const ARENA_PAUSE: Duration = Duration::from_millis(100);
/// Bytes of arenas that are told in a millisecond at most: readers who are behind hold them all.
const ARENA_PACE: usize = 4 * 1024;

/// An arena, as the live feed tells it.
pub fn arena_json(arena: &Arena) -> serde_json::Value {
    serde_json::to_value(arena).unwrap_or_else(|error| {
        tracing::error!(%error, "the arena cannot be written");
        serde_json::Value::Null
    })
}

/// How the simulation in this process is doing.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Simulated {
    /// Simulated seconds per second.
    pub real_time_factor: f64,
    /// Physics steps so far.
    pub steps: u64,
    /// Robots in the world.
    pub robots: u64,
    /// Robots whose connection to the broker is up.
    pub connected: u64,
}

impl Simulated {
    /// Writes all of it.
    pub fn write_metrics(&self, out: &mut Exposition) {
        out.gauge(
            "terracrawler_simulation_real_time_factor",
            "Simulated seconds per second",
            self.real_time_factor,
        );
        out.gauge(
            "terracrawler_simulation_robots",
            "Robots in the simulated world",
            self.robots as f64,
        );
        out.gauge(
            "terracrawler_simulation_connected",
            "Robots of the simulated world that are connected to the broker",
            self.connected as f64,
        );
        out.counter(
            "terracrawler_simulation_steps",
            "Physics steps of the simulated world",
            self.steps as f64,
        );
    }
}

/// Why a world does not start.
#[derive(Debug)]
pub enum SimulationStartError {
    /// What is wrong with the scenario or the system.
    World(LiveError),
    /// What sets it up has failed.
    Task(JoinError),
}

impl fmt::Display for SimulationStartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::World(error) => error.fmt(f),
            Self::Task(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for SimulationStartError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::World(error) => Some(error),
            Self::Task(error) => Some(error),
        }
    }
}

/// A running world.
pub struct Simulation {
    world: Arc<LiveHandle>,
}

impl Simulation {
    /// Sets the world up and lets its robots connect to their broker; what happens is recorded, where `record` says
    /// to what file.
    ///
    /// # Errors
    /// [`SimulationStartError`]
    pub async fn start(
        config: LiveConfig,
        record: Option<RecordTo>,
    ) -> Result<Self, SimulationStartError> {
        let start = move || match record {
            Some(to) => start_recorded(config, to),
            None => start(config),
        };
        let world = tokio::task::spawn_blocking(start)
            .await
            .map_err(SimulationStartError::Task)?
            .map_err(SimulationStartError::World)?;
        if let Some(radio) = world.radio() {
            tracing::info!(address = %radio.address(), "robots reach the broker over a radio");
        }
        Ok(Self {
            world: Arc::new(world),
        })
    }

    /// What the world is made of, for whoever wants to hear of changes.
    pub fn watch_scene(&self) -> watch::Receiver<LiveScene> {
        self.world.watch_scene()
    }

    /// Hands the arena to `tell`, which says how many bytes it told; what this returns hands over every other
    /// one, until the world ends.
    pub fn tell_arenas<T>(&self, tell: T) -> impl Future<Output = ()> + Send + use<T>
    where
        T: Fn(serde_json::Value) -> usize + Send,
    {
        let mut scene = self.watch_scene();
        let mut told = Arc::clone(&scene.borrow_and_update().arena);
        tell(arena_json(&told));
        async move {
            // An error says that the world has ended.
            while scene.changed().await.is_ok() {
                let arena = Arc::clone(&scene.borrow_and_update().arena);
                if Arc::ptr_eq(&arena, &told) {
                    continue;
                }
                let bytes = tell(arena_json(&arena));
                told = arena;
                let pause = Duration::from_millis((bytes / ARENA_PACE) as u64);
                tokio::time::sleep(pause.max(ARENA_PAUSE)).await;
            }
        }
    }

    /// What the world is made of.
    pub fn scene(&self) -> LiveScene {
        self.world.scene()
    }

    /// How the world is.
    ///
    /// # Errors
    /// [`ControlError::Ended`].
    pub fn state(&self) -> Result<LiveState, ControlError> {
        self.world.state()
    }

    /// Tells the world what to do.
    ///
    /// # Errors
    /// [`ControlError`], of a command that was not carried out.
    pub async fn control(&self, command: SimulatorCommand) -> Result<LiveDone, ControlError> {
        self.world.control(command).await
    }

    /// Whether the world goes on.
    pub fn is_running(&self) -> bool {
        self.world.metrics().running
    }

    /// How it is doing.
    pub fn numbers(&self) -> Simulated {
        let metrics = self.world.metrics();
        Simulated {
            real_time_factor: metrics.real_time_factor,
            steps: metrics.steps,
            robots: metrics.robots.into(),
            connected: metrics.connected.into(),
        }
    }

    /// Stops every robot, then takes them off the broker and ends the world.
    pub async fn stop(&self) {
        let world = Arc::clone(&self.world);
        if let Some(text) = world.recording_error() {
            tracing::warn!(text, "the recording ended before the world");
        }
        tracing::info!("simulated robots are told to stop");
        match tokio::task::spawn_blocking(move || world.stop(PATIENCE)).await {
            Ok(Ok(report)) if report.standing == report.robots => {
                tracing::info!(robots = report.robots, "all simulated robots stand");
            }
            Ok(Ok(report)) => tracing::warn!(
                robots = report.robots,
                standing = report.standing,
                "some simulated robots did not come to rest in time"
            ),
            Ok(Err(error)) => tracing::error!(%error, "the simulation did not stop in order"),
            Err(error) => tracing::error!(%error, "the simulation did not stop in order"),
        }
    }
}
