//! Simulated robots without a server: they meet theirs at the broker.

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use super::StartError;
use super::ways::{open_tunnel, outside};
use crate::bus;
use crate::config::{Broker, BrokerUrl, Settings};
use crate::simulation::Simulation;
use crate::simulator;
use crate::tls::Tunnel;

/// A running simulation on somebody's broker.
pub struct Robots {
    simulation: Arc<Simulation>,
    broker: BrokerUrl,
    stop_listening: CancellationToken,
    _tunnel: Option<Tunnel>,
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
        let tunnel = open_tunnel(settings, &broker).await?;
        let inside = tunnel.as_ref().map_or(&broker, Tunnel::inside).clone();
        // Robots try again for ever, and would do so in silence.
        // As the part of a simulator that is no robot: it may log in wherever the robots may.
        let target = outside(&inside)?.named("simulator");
        bus::probe(&target)
            .await
            .map_err(|reason| StartError::BrokerUnreachable {
                broker: broker.to_string(),
                reason,
            })?;
        let simulation = Simulation::start(settings, &inside)
            .await
            .map_err(StartError::Simulation)?;
        let simulation = Arc::new(simulation);
        let stop_listening = CancellationToken::new();
        tokio::spawn(simulator::listen(
            Arc::clone(&simulation),
            target,
            settings.fleet.clone(),
            stop_listening.clone(),
        ));
        Ok(Self {
            simulation,
            broker,
            stop_listening,
            _tunnel: tunnel,
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
