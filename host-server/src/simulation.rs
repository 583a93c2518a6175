//! The simulated robots of this process.

use std::sync::Arc;
use std::time::Duration;

use crawler_experiments::scenarios::scenario;
use crawler_sim::live::{
    ControlError, LiveConfig, LiveDone, LiveHandle, LiveScene, LiveState, start, start_recorded,
};
use crawler_sim::world::Arena;
use crawler_sim_protocol::SimulatorCommand;
use tokio::sync::watch;

use crate::config::{BrokerUrl, Settings};
use crawler_fleet::feed::Feed;
use crawler_fleet::recorder::Recorder;
use crawler_metrics::Exposition;

/// For robots to come to rest. From full speed the ramp takes well under a second.
const PATIENCE: Duration = Duration::from_secs(2);

/// Least time between two arenas that are told.
const ARENA_PAUSE: Duration = Duration::from_millis(100);
/// Bytes of arenas that are told in a millisecond at most: readers who are behind hold them all.
const ARENA_PACE: usize = 4 * 1024;

/// An arena, as the live feed tells it.
pub(crate) fn arena_json(arena: &Arena) -> serde_json::Value {
    serde_json::to_value(arena).unwrap_or_else(|error| {
        tracing::error!(%error, "the arena cannot be written");
        serde_json::Value::Null
    })
}

/// Tells viewers of the arena and keeps it for the record; returns how many bytes each viewer gets.
fn tell(recorder: &Recorder, feed: &Feed, arena: &Arena) -> usize {
    let arena = arena_json(arena);
    recorder.record_arena(&arena);
    feed.set_arena(arena)
}

/// How the simulation in this process is doing.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Simulated {
    /// Simulated seconds per second.
    pub(crate) real_time_factor: f64,
    /// Physics steps so far.
    pub(crate) steps: u64,
    /// Robots in the world.
    pub(crate) robots: u64,
    /// Robots whose connection to the broker is up.
    pub(crate) connected: u64,
}

impl Simulated {
    /// Writes all of it.
    pub(crate) fn write_metrics(&self, out: &mut Exposition) {
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

/// A running world.
pub(crate) struct Simulation {
    world: Arc<LiveHandle>,
}

impl Simulation {
    /// Sets the world up and lets its robots connect to `broker`.
    ///
    /// # Errors
    /// One line saying what is wrong with the scenario or the system.
    pub(crate) async fn start(settings: &Settings, broker: &BrokerUrl) -> Result<Self, String> {
        let credentials = match &broker.credentials {
            Some((name, password)) => {
                let usable = crawler_sim::run::credentials(name, password);
                Some(usable.map_err(|error| format!("simulated robots take {error}"))?)
            }
            None => None,
        };
        let mut scenario = scenario(settings.scenario.as_deref())?;
        if let Some(robots) = settings.robots {
            scenario = scenario.with_robots(robots);
        }
        let config = LiveConfig {
            fleet: settings.fleet.clone(),
            broker_host: broker.host.clone(),
            broker_port: broker.port,
            credentials,
            scenario,
            seed: settings.seed,
            radio_proxy: settings.radio_proxy,
            // Connections are carried over TLS on their way, all robots' together.
            authority: None,
        };
        let record = settings.record.clone();
        let start = move || match record {
            Some(file) => start_recorded(config, file),
            None => start(config),
        };
        let world = tokio::task::spawn_blocking(start)
            .await
            .map_err(|error| error.to_string())?
            .map_err(|error| error.to_string())?;
        if let Some(radio) = world.radio() {
            tracing::info!(address = %radio.address(), "robots reach the broker over a radio");
        }
        Ok(Self {
            world: Arc::new(world),
        })
    }

    /// What the world is made of, for whoever wants to hear of changes.
    pub(crate) fn watch_scene(&self) -> watch::Receiver<LiveScene> {
        self.world.watch_scene()
    }

    /// Tells readers of the live feed what the arena is; what this returns tells of every other one, until
    /// the world ends.
    pub(crate) fn tell_arenas(
        &self,
        recorder: Recorder,
        feed: Arc<Feed>,
    ) -> impl Future<Output = ()> + Send + use<> {
        let mut scene = self.watch_scene();
        let mut told = Arc::clone(&scene.borrow_and_update().arena);
        tell(&recorder, &feed, &told);
        async move {
            // An error says that the world has ended.
            while scene.changed().await.is_ok() {
                let arena = Arc::clone(&scene.borrow_and_update().arena);
                if Arc::ptr_eq(&arena, &told) {
                    continue;
                }
                let bytes = tell(&recorder, &feed, &arena);
                told = arena;
                let pause = Duration::from_millis((bytes / ARENA_PACE) as u64);
                tokio::time::sleep(pause.max(ARENA_PAUSE)).await;
            }
        }
    }

    /// What the world is made of.
    pub(crate) fn scene(&self) -> LiveScene {
        self.world.scene()
    }

    /// How the world is.
    pub(crate) fn state(&self) -> Result<LiveState, ControlError> {
        self.world.state()
    }

    /// Tells the world what to do.
    pub(crate) async fn control(
        &self,
        command: SimulatorCommand,
    ) -> Result<LiveDone, ControlError> {
        self.world.control(command).await
    }

    pub(crate) fn is_running(&self) -> bool {
        self.world.metrics().running
    }

    pub(crate) fn numbers(&self) -> Simulated {
        let metrics = self.world.metrics();
        Simulated {
            real_time_factor: metrics.real_time_factor,
            steps: metrics.steps,
            robots: metrics.robots.into(),
            connected: metrics.connected.into(),
        }
    }

    /// Stops every robot, then takes them off the broker and ends the world.
    pub(crate) async fn stop(&self) {
        let world = Arc::clone(&self.world);
        if let Some(text) = world.recording_error() {
            tracing::warn!(text, "the recording ended before the world");
        }
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
