//! The way to the fleet's broker, in this process or outside.

use super::StartError;
use super::endpoints::{self, BrokerEndpoints};
use super::entrance::Entrance;
use super::parts::Parts;
use super::storage::Storage;
use crate::config::{BrokerUrl, Settings};
use crawler_broker::{BrokerHandle, EmbeddedBroker};
use crawler_fleet::bus::{self, Connection, Target};

/// The fleet's broker, and our session with it.
pub(super) struct BrokerLink {
    /// The embedded broker, when it is ours.
    pub(super) broker: Option<BrokerHandle>,
    pub(super) session: (Target, Connection),
    /// Where others find the broker.
    pub(super) mqtt: BrokerUrl,
    /// The port without TLS, where there is one beside that with it.
    pub(super) plain: Option<u16>,
    /// Where robots of this process find it.
    pub(super) inside: BrokerUrl,
}

impl BrokerLink {
    pub(super) async fn open(
        settings: &Settings,
        storage: &Storage,
        entrance: &Entrance,
        parts: &mut Parts,
    ) -> Result<Self, StartError> {
        let BrokerEndpoints {
            broker,
            tunnel,
            target,
            mqtt,
            plain,
            inside,
        } = endpoints::open(
            settings,
            &storage.records,
            entrance.certificates.as_ref(),
            &storage.accounts,
            storage.audit.notes(),
            entrance.descriptors,
        )
        .await?;
        let inside = endpoints::for_robots(&inside, broker.as_ref(), settings);
        let handle = broker.as_ref().map(EmbeddedBroker::handle);
        if let Some(broker) = broker {
            broker.note_in(storage.audit.notes());
            parts.end_with(broker.stop())?;
        }
        if let Some(tunnel) = tunnel {
            parts.end_with(tunnel.stop())?;
        }
        let connection = bus::connect(&target, &settings.fleet)
            .await
            .map_err(|error| StartError::BrokerUnreachable {
                broker: mqtt.to_string(),
                reason: error.to_string(),
            })?;
        Ok(Self {
            broker: handle,
            session: (target, connection),
            mqtt,
            plain,
            inside,
        })
    }
}
