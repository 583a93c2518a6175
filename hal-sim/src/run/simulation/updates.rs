//! Robots that take updates.

use std::rc::Rc;

use crawler_app::{UpdateIdentity, Updates};
use crawler_protocol::BuildId;
use crawler_release::PublicKeys;

use super::{BrokerAddress, Simulation};
use crate::devices::Started;
use crate::run::error::SimulationError;
use crate::run::machine::SimUpdates;
use crate::scenario::Scenario;

#[cfg(test)]
mod tests;

/// What the program of the simulator is called.
pub(super) const FACTORY_BUILD: &str = concat!("factory-", env!("CARGO_PKG_VERSION"));

impl Simulation {
    /// A simulation like [`Simulation::lockstep`] whose robots take releases that are signed with one of these
    /// keys.
    ///
    /// # Errors
    /// See [`SimulationError`].
    pub fn updating(
        scenario: Scenario,
        seed: u64,
        keys: PublicKeys,
    ) -> Result<Self, SimulationError> {
        let given = BrokerAddress {
            release_keys: Some(keys),
            ..BrokerAddress::default()
        };
        let mut simulation = Self::lockstep_given(scenario, seed, given, None)?;
        // The keys are no part of what it could be repeated from.
        simulation.journal.withhold();
        Ok(simulation)
    }

    /// By what a program takes updates. A robot that is recorded takes none: its replay knows nothing of slots.
    pub(super) fn updates(&self, started: &Started) -> Option<Rc<SimUpdates>> {
        #[cfg(feature = "recording")]
        if self.broker.event_logs.is_some() {
            return None;
        }
        let keys = self.broker.release_keys?;
        let build = started.bundle.as_ref();
        let build = build.map_or(FACTORY_BUILD, |bundle| &bundle.build);
        Some(Rc::new(Updates::new(UpdateIdentity {
            // A bundle allows no others.
            build: BuildId::new(build).ok()?,
            sequence: 0,
            built_at: 0,
            keys: Some(keys),
        })))
    }
}
