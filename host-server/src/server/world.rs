//! The simulated world that the settings ask for.

use crawler_experiments::BUILD;
use crawler_experiments::scenarios::scenario;
use crawler_sim::live::LiveConfig;
use crawler_sim::tools::recording::RecordTo;
use crawler_simulations::Simulation;
use crawler_system::cli_error::{CliError, OrSay as _};

use super::StartError;
use crate::config::{Broker, BrokerUrl, KeyFiles, Settings};

/// Sets the world up and lets its robots connect to `broker`.
///
/// # Errors
/// [`StartError::Simulation`], with what is wrong with the scenario or the system.
pub(super) async fn start(
    settings: &Settings,
    broker: &BrokerUrl,
) -> Result<Simulation, StartError> {
    let config = config(settings, broker).map_err(StartError::Simulation)?;
    let record = settings.record.as_ref().map(|file| RecordTo {
        file: file.clone(),
        build: BUILD.to_owned(),
    });
    let started = Simulation::start(config, record).await;
    started.map_err(|error| StartError::Simulation(error.into()))
}

fn config(settings: &Settings, broker: &BrokerUrl) -> Result<LiveConfig, CliError> {
    let credentials = match &broker.credentials {
        Some((name, password)) => {
            let usable = crawler_sim::run::credentials(name, password);
            Some(usable.or_say(|error| format!("simulated robots take {error}"))?)
        }
        None => None,
    };
    let mut scenario = scenario(settings.scenario.as_deref())?;
    if let Some(robots) = settings.robots {
        scenario = scenario.with_robots(robots);
    }
    let release_keys = settings
        .release_key
        .as_ref()
        .map(KeyFiles::read)
        .transpose()?;
    Ok(LiveConfig {
        fleet: settings.fleet.clone(),
        broker_host: broker.host.clone(),
        broker_port: broker.port,
        credentials,
        release_keys,
        scenario,
        seed: settings.seed,
        radio_proxy: settings.radio_proxy,
        other_ends: match &settings.broker {
            Broker::Embedded(_) => 1,
            // A tunnel has both of its ends in this process.
            Broker::Outside(url) => 2 * u64::from(url.tls),
        },
        // Connections are carried over TLS on their way, all robots' together.
        authority: None,
    })
}
