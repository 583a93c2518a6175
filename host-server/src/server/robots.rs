//! Simulated robots without a server: they meet theirs at the broker.

use super::{StartError, outside};
use crate::bus;
use crate::config::{Broker, BrokerUrl, Settings};
use crate::simulation::Simulation;

/// A running simulation on somebody's broker.
pub struct Robots {
    simulation: Simulation,
    broker: BrokerUrl,
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
        Ok(Self { simulation, broker })
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
        self.simulation.stop().await;
    }
}
