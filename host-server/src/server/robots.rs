//! Simulated robots without a server: they meet theirs at the broker.

use std::sync::Arc;

use super::endpoints::{open_tunnel, outside};
use super::parts::Parts;
use super::{StartError, world};
use crate::config::{Broker, BrokerUrl, Settings};
use crawler_fleet::bus;
use crawler_server_tls::Tunnel;
use crawler_simulations::{MAX_PACKET, Simulation};

/// A running simulation on somebody's broker.
pub struct Robots {
    simulation: Arc<Simulation>,
    broker: BrokerUrl,
    parts: Parts,
}

impl Robots {
    /// Starts the robots, once the broker has answered.
    ///
    /// # Errors
    /// [`StartError::BrokerUnreachable`] and [`StartError::Simulation`]. Whatever had been started by then
    /// has ended.
    pub async fn start(settings: &Settings) -> Result<Self, StartError> {
        let mut parts = Parts::default();
        match Self::start_parts(settings, &mut parts).await {
            Ok((simulation, broker)) => Ok(Self {
                simulation,
                broker,
                parts,
            }),
            Err(error) => {
                parts.stop().await;
                Err(error)
            }
        }
    }

    async fn start_parts(
        settings: &Settings,
        parts: &mut Parts,
    ) -> Result<(Arc<Simulation>, BrokerUrl), StartError> {
        let broker = match &settings.broker {
            Broker::Outside(url) => url.clone(),
            Broker::Embedded(_) => return Err(StartError::Internal("robots without a broker")),
        };
        let tunnel = open_tunnel(settings, &broker).await?;
        let inside = tunnel.as_ref().map_or(&broker, Tunnel::inside).clone();
        if let Some(tunnel) = tunnel {
            parts.end_with(tunnel.stop())?;
        }
        // Robots try again for ever, and would do so in silence.
        // As the part of a simulator that is no robot: it may log in wherever the robots may.
        let target = outside(&inside)?.named("simulator");
        bus::probe(&target)
            .await
            .map_err(|error| StartError::BrokerUnreachable {
                broker: broker.to_string(),
                reason: error.to_string(),
            })?;
        let simulation = world::start(settings, &inside).await?;
        let simulation = Arc::new(simulation);
        let ending = Arc::clone(&simulation);
        parts.end_with(async move { ending.stop().await })?;
        let (world, fleet) = (Arc::clone(&simulation), settings.fleet.clone());
        let session = target.options(MAX_PACKET);
        parts.task("the commands to the simulator", |stop| {
            crawler_simulations::listen(world, session, fleet, stop)
        })?;
        Ok((simulation, broker))
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
        self.parts.stop().await;
    }
}
