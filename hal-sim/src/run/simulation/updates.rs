//! Robots that take updates.

use std::rc::Rc;

use crawler_app::{UpdateIdentity, Updates};
use crawler_protocol::BuildId;

use super::programs::BrokerAddress;
use crate::devices::Started;
use crate::run::machine::SimUpdates;

#[cfg(test)]
mod tests;

/// What the program of the simulator is called.
pub(super) const FACTORY_BUILD: &str = concat!("factory-", env!("CARGO_PKG_VERSION"));

/// By what a program takes updates, with what `broker` says. A robot that is recorded takes none: its replay knows
/// nothing of slots.
pub(super) fn updates(broker: &BrokerAddress, started: &Started) -> Option<Rc<SimUpdates>> {
    #[cfg(feature = "recording")]
    if broker.event_logs.is_some() {
        return None;
    }
    let keys = broker.release_keys?;
    let build = started.bundle.as_ref();
    let build = build.map_or(FACTORY_BUILD, |bundle| &bundle.build);
    Some(Rc::new(Updates::new(UpdateIdentity {
        // A bundle allows no others.
        build: BuildId::new(build).ok()?,
        keys: Some(keys),
    })))
}
