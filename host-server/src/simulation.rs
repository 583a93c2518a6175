//! The simulated robots of this process.

use std::sync::Arc;
use std::time::Duration;

use crawler_sim::run::live::{LiveConfig, LiveHandle, start};
use crawler_sim::scenario::Scenario;

use crate::config::{BrokerUrl, Settings};
use crate::metrics::Simulated;

/// For robots to come to rest. From full speed the ramp takes well under a second.
const PATIENCE: Duration = Duration::from_secs(2);

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
        };
        let world = tokio::task::spawn_blocking(move || start(config))
            .await
            .map_err(|error| error.to_string())?
            .map_err(|error| error.to_string())?;
        Ok(Self {
            world: Arc::new(world),
        })
    }

    /// The arena, as the live feed tells it.
    pub(crate) fn arena(&self) -> serde_json::Value {
        serde_json::to_value(self.world.arena()).unwrap_or_else(|error| {
            tracing::error!(%error, "the arena cannot be written");
            serde_json::Value::Null
        })
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

/// A scenario by name, or from a file.
fn scenario(name: Option<&str>) -> Result<Scenario, String> {
    let Some(name) = name else {
        let default = Scenario::names().next().unwrap_or("arena");
        return Scenario::built_in(default).map_err(|error| error.to_string());
    };
    if Scenario::names().any(|known| known == name) {
        return Scenario::built_in(name).map_err(|error| error.to_string());
    }
    let text = std::fs::read_to_string(name).map_err(|error| {
        let known: Vec<_> = Scenario::names().collect();
        format!(
            "`{name}` is neither a scenario ({}) nor a file that can be read: {error}",
            known.join(", ")
        )
    })?;
    Scenario::parse(&text).map_err(|error| format!("{name}: {}", error.to_string().trim_end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scenario_that_comes_along_is_found_by_name() {
        for name in Scenario::names() {
            assert_eq!(scenario(Some(name)).expect(name).name, name);
        }
        assert!(scenario(None).is_ok());
    }

    #[test]
    fn a_scenario_that_is_not_there_is_named_with_those_that_are() {
        let error = scenario(Some("nowhere.toml")).expect_err("no such file");
        assert!(error.contains("nowhere.toml"), "{error}");
        assert!(error.contains("arena"), "{error}");
    }
}
