//! The server as a whole: started from settings, stopped in order.

mod broker_link;
mod calibrations;
mod cells;
mod clockwork;
mod cluster;
mod cluster_metrics;
mod endpoints;
mod entrance;
mod history;
mod hub;
mod ingest;
mod outcome_log;
mod parts;
mod robots;
mod rollouts;
#[cfg(test)]
mod slow_disk_tests;
mod start;
mod start_error;
#[cfg(test)]
mod start_tests;
mod storage;
mod stores;
mod twins;
mod watch;
mod worker;
mod world;
mod writable;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crawler_access::Secret;

use crate::config::{BrokerUrl, Settings};
use crawler_simulations::Simulation;
use crawler_system::data::Disk;
use parts::Parts;

pub(crate) use endpoints::BrokerSession;
pub use robots::Robots;
pub use start_error::StartError;
pub use worker::WorkerProcess;

/// A running server. Dropped without [`Server::stop`] it stops in the background, as long as there is a
/// runtime.
pub struct Server {
    simulation: Option<Arc<Simulation>>,
    #[cfg(test)]
    fleet: Arc<crawler_fleet::SharedFleet>,
    #[cfg(test)]
    records: crawler_records::Records,
    http: SocketAddr,
    https: bool,
    authority: Option<PathBuf>,
    mqtt: BrokerUrl,
    invitation: Option<String>,
    parts: Parts,
}

impl Server {
    /// Starts everything `settings` ask for and returns when it is ready: data directory, broker,
    /// connection to it, simulated robots, API.
    ///
    /// # Errors
    /// [`StartError`] names what cannot be had. Whatever had been started by then has ended: its tasks
    /// and threads, its listeners, its hold of the data directory.
    ///
    /// # Cancellation safety
    /// As for dropping a server.
    pub async fn start(settings: &Settings) -> Result<Self, StartError> {
        Self::start_on(settings, Disk::default(), Parts::default()).await
    }

    /// The same on a disk that may be a test's, with parts that may be one's.
    async fn start_on(
        settings: &Settings,
        disk: Disk,
        mut parts: Parts,
    ) -> Result<Self, StartError> {
        match Box::pin(start::start(settings, disk, &mut parts)).await {
            Ok(started) => Ok(Self {
                simulation: started.simulation,
                #[cfg(test)]
                fleet: started.fleet,
                #[cfg(test)]
                records: started.records,
                http: started.http,
                https: started.https,
                authority: started.authority,
                mqtt: started.mqtt,
                invitation: started
                    .invitation
                    .map(|code| link(started.http, started.https, &code)),
                parts,
            }),
            Err(error) => {
                parts.stop().await;
                Err(error)
            }
        }
    }

    /// Where API and control room are.
    #[must_use]
    pub const fn http(&self) -> SocketAddr {
        self.http
    }

    /// Whether API and control room are reached over TLS alone.
    #[must_use]
    pub const fn https(&self) -> bool {
        self.https
    }

    /// The certificate that clients pin, when the server has an authority of its own.
    #[must_use]
    pub fn authority(&self) -> Option<&Path> {
        self.authority.as_deref()
    }

    /// How many robots are simulated in this process.
    #[must_use]
    pub fn simulated(&self) -> u64 {
        let world = self.simulation.as_ref();
        world.map_or(0, |world| world.numbers().robots)
    }

    /// Where the fleet's broker is.
    #[must_use]
    pub const fn mqtt(&self) -> &BrokerUrl {
        &self.mqtt
    }

    /// Where the first administrator makes an account: an address that is good once, and for a day.
    /// `None` on an open server, and where there is an administrator.
    #[must_use]
    pub fn invitation(&self) -> Option<&str> {
        self.invitation.as_deref()
    }

    /// Stops in order, what was started last first: readers and requests, experiments, robots of this
    /// process, connection to the broker, broker, what is written down. Takes at most a few times five
    /// seconds.
    ///
    /// # Cancellation safety
    /// As for dropping a server.
    pub async fn stop(self) {
        self.parts.stop().await;
    }
}

/// The address at which the invitation `code` is taken, on this machine.
fn link(http: SocketAddr, https: bool, code: &Secret) -> String {
    let host = if http.ip().is_unspecified() {
        format!("localhost:{}", http.port())
    } else {
        http.to_string()
    };
    let scheme = if https { "https" } else { "http" };
    format!("{scheme}://{host}/#invite={code}")
}
