//! Simulated robots without a server: they meet theirs at the broker.

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use super::{StartError, outside};
use crate::bus;
use crate::config::{Broker, BrokerUrl, Settings};
use crate::simulation::Simulation;
use crate::simulator;

/// A running simulation on somebody's broker.
pub struct Robots {
    simulation: Arc<Simulation>,
    broker: BrokerUrl,
    stop_listening: CancellationToken,
}

impl Robots {
    /// Starts the robots, once the broker has answered.
    ///
    /// # Errors
    /// [`StartError::BrokerUnreachable`] and [`StartError::Simulation`].
    pub async fn start(settings: &Settings) -> Result<Self, StartError> {
        let broker = match &settings.broker {
            Broker::Outside(url) => url.clone(),
            Broker::Embedded(_) => return Err(StartError::Internal("robots without a broker")),
        };
        // Robots try again for ever, and would do so in silence.
        bus::connect(&outside(&broker)?, &settings.fleet)
            .await
            .map_err(|reason| StartError::BrokerUnreachable {
                broker: broker.to_string(),
                reason,
            })?;
        let simulation = Simulation::start(settings, &broker)
            .await
            .map_err(StartError::Simulation)?;
        let simulation = Arc::new(simulation);
        let stop_listening = CancellationToken::new();
        tokio::spawn(simulator::listen(
            Arc::clone(&simulation),
            outside(&broker)?.named("simulator"),
            settings.fleet.clone(),
            stop_listening.clone(),
        ));
        Ok(Self {
            simulation,
            broker,
            stop_listening,
        })
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.simulation.numbers().robots
    }

    /// Where they go.
    #[must_use]
    pub const fn broker(&self) -> &BrokerUrl {
        &self.broker
    }

    /// Stops the robots, says goodbye for each, and ends their world.
    pub async fn stop(self) {
        self.stop_listening.cancel();
        self.simulation.stop().await;
    }
}
