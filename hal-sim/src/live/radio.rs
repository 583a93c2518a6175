//! The radio of a live world: a proxy in front of the broker, told where robots are.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;

use super::{LiveConfig, LiveError};
use crate::net::proxy::{Proxy, ProxyConfig};
use crate::run::Simulation;

/// Connections beyond those of the simulated robots: boards, and a second one of each robot
/// whose first is not over yet.
const MORE_CONNECTIONS: usize = 256;

/// Starts the radio when the scenario has one or somebody wants to join it.
///
/// # Errors
/// [`LiveError::Radio`].
pub(super) fn start(
    config: &LiveConfig,
    broker: &[SocketAddr],
) -> Result<Option<Arc<Proxy>>, LiveError> {
    let scenario = &config.scenario;
    if !is_wanted(config) {
        return Ok(None);
    }
    let anywhere = SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 0);
    let proxy = Proxy::start(&ProxyConfig {
        listen: config.radio_proxy.unwrap_or(anywhere),
        broker: broker.to_vec(),
        setup: scenario.radio_setup(config.seed),
        most_connections: 2 * scenario.robots as usize + MORE_CONNECTIONS,
    });
    Ok(Some(Arc::new(proxy.map_err(LiveError::Radio)?)))
}

/// Whether a world of this scenario has a radio.
pub(super) const fn is_wanted(config: &LiveConfig) -> bool {
    let scenario = &config.scenario;
    scenario.radio.is_some() || scenario.link.is_some() || config.radio_proxy.is_some()
}

/// Tells the radio where the robots are.
pub(super) fn place(radio: &Proxy, simulation: &Simulation) {
    radio.place((0..simulation.robots()).filter_map(|robot| {
        let truth = simulation.observe(robot)?;
        let id = simulation.id(robot)?;
        let place = (truth.pose.x, truth.pose.y);
        truth.present.then_some((id.as_str(), place))
    }));
}
