//! The endpoints of the fleet's broker.

use std::net::SocketAddr;
use std::sync::Arc;

use crawler_records::Records;

use super::StartError;
use crate::config::{Broker, BrokerUrl, Settings};
use crawler_accounts::Accounts as People;
use crawler_broker::{Accounts, EmbeddedBroker, Open, RecordAccounts};
use crawler_federation::{LARGEST_PACKET, SessionOptions};
use crawler_fleet::bus::{Target, bracketed};
use crawler_records::audit_log::Notes;
use crawler_server_tls::{Certificates, TlsHandshake, Tunnel, reachable};
use crawler_system::descriptors::Descriptors;

/// The fleet's broker, and where each finds it.
pub(super) struct BrokerEndpoints {
    pub(super) broker: Option<EmbeddedBroker>,
    pub(super) tunnel: Option<Tunnel>,
    /// Our own session.
    pub(super) target: Target,
    /// Where others find the broker.
    pub(super) mqtt: BrokerUrl,
    /// The port of the listener without TLS, where there is one beside that with it.
    pub(super) plain: Option<u16>,
    /// Where this process finds it without TLS.
    pub(super) inside: BrokerUrl,
}

/// Starts the broker of this process, or finds the way to another.
pub(super) async fn open(
    settings: &Settings,
    records: &Records,
    certificates: Option<&Arc<Certificates>>,
    people: &People,
    notes: Notes,
    descriptors: Descriptors,
) -> Result<BrokerEndpoints, StartError> {
    match &settings.broker {
        Broker::Embedded(listen) => {
            let accounts: Arc<dyn Accounts> = if settings.open {
                Arc::new(Open)
            } else {
                let (failures, hashing) = (people.failures(), people.hashing_at_broker());
                Arc::new(RecordAccounts::new(
                    records.clone(),
                    failures,
                    hashing,
                    notes,
                ))
            };
            embedded(settings, *listen, accounts, certificates, descriptors).await
        }
        Broker::Outside(mqtt) => {
            let tunnel = open_tunnel(settings, mqtt).await?;
            let inside = tunnel.as_ref().map_or(mqtt, Tunnel::inside).clone();
            Ok(BrokerEndpoints {
                broker: None,
                target: Target {
                    shared: settings.cache.is_some(),
                    fixes: settings.twins > 0,
                    ..outside(&inside)?
                },
                tunnel,
                mqtt: mqtt.clone(),
                plain: None,
                inside,
            })
        }
    }
}

async fn embedded(
    settings: &Settings,
    listen: SocketAddr,
    accounts: Arc<dyn Accounts>,
    certificates: Option<&Arc<Certificates>>,
    descriptors: Descriptors,
) -> Result<BrokerEndpoints, StartError> {
    let certificates = certificates.filter(|_| settings.tls.covers(listen));
    let broker = EmbeddedBroker::start(&settings.fleet, accounts, descriptors.into())
        .await
        .map_err(|cause| StartError::mqtt(listen, cause))?;
    let (mqtt, plain) = match listen_at(&broker, listen, settings, certificates).await {
        Ok(addresses) => addresses,
        Err(error) => {
            broker.stop().await;
            return Err(error);
        }
    };
    let inside = url(broker.inside(), false);
    let server = broker.server();
    let target = Target {
        host: bracketed(&inside.host),
        port: inside.port,
        client_id: server.user.clone(),
        credentials: Some((server.user.clone(), server.password.to_string())),
        shared: false,
        fixes: settings.twins > 0,
    };
    Ok(BrokerEndpoints {
        broker: Some(broker),
        tunnel: None,
        target,
        mqtt,
        plain,
        inside,
    })
}

/// Lets clients in, and says where: with TLS where there are certificates, and without as the settings say.
async fn listen_at(
    broker: &EmbeddedBroker,
    listen: SocketAddr,
    settings: &Settings,
    certificates: Option<&Arc<Certificates>>,
) -> Result<(BrokerUrl, Option<u16>), StartError> {
    let bind = async |address, tls| {
        let bound = broker.listen(address, tls).await;
        bound.map_err(|cause| StartError::mqtt(address, cause))
    };
    let Some(certificates) = certificates else {
        return Ok((url(bind(listen, None).await?, false), None));
    };
    let tls = &settings.tls;
    let client_ca = tls.client_ca.as_deref();
    let handshake = TlsHandshake::new(certificates.acceptor(crawler_server_tls::MQTT, client_ca)?);
    let mqtt = url(bind(listen, Some(handshake)).await?, true);
    let plain = match tls.mqtt_plain {
        None => None,
        Some(plain) => Some(bind(plain, None).await?.port()),
    };
    Ok((mqtt, plain))
}

/// The way to an outside broker that speaks TLS.
pub(super) async fn open_tunnel(
    settings: &Settings,
    broker: &BrokerUrl,
) -> Result<Option<Tunnel>, StartError> {
    if !broker.tls {
        return Ok(None);
    }
    let tunnel = Tunnel::open(broker, settings.tls.broker_ca.as_deref()).await;
    tunnel
        .map(Some)
        .map_err(|error| StartError::BrokerUnreachable {
            broker: broker.to_string(),
            reason: error.to_string(),
        })
}

/// How a listener of this process is reached from this machine.
fn url(listener: SocketAddr, tls: bool) -> BrokerUrl {
    let listener = reachable(listener);
    BrokerUrl {
        host: listener.ip().to_string(),
        port: listener.port(),
        credentials: None,
        tls,
    }
}

/// The broker as simulated robots of this process reach it.
pub(super) fn for_robots(
    url: &BrokerUrl,
    broker: Option<&EmbeddedBroker>,
    settings: &Settings,
) -> BrokerUrl {
    let mut url = url.clone();
    // Where there are no accounts, a name would be refused.
    if let Some(broker) = broker
        && !settings.open
    {
        let simulator = broker.simulator();
        url.credentials = Some((simulator.user.clone(), simulator.password.to_string()));
    }
    url
}

/// A session of our own with an outside broker.
pub(super) fn outside(url: &BrokerUrl) -> Result<Target, StartError> {
    Target::outside(url).map_err(|_| StartError::Internal("no randomness"))
}

/// A session with an outside broker, for who is no server.
pub(crate) struct BrokerSession {
    target: Target,
    tunnel: Option<Tunnel>,
}

impl BrokerSession {
    /// For a client of this id. With TLS the way there is opened.
    ///
    /// # Errors
    /// [`StartError::BrokerUnreachable`] when the authority cannot be read.
    pub(crate) async fn open(
        settings: &Settings,
        broker: &BrokerUrl,
        client_id: &str,
    ) -> Result<Self, StartError> {
        let tunnel = open_tunnel(settings, broker).await?;
        let inside = tunnel.as_ref().map_or(broker, Tunnel::inside);
        let mut target = outside(inside)?;
        client_id.clone_into(&mut target.client_id);
        Ok(Self { target, tunnel })
    }

    /// Its options; packets are as large as the session allows.
    pub(crate) fn options(&self) -> SessionOptions {
        self.target.options(LARGEST_PACKET)
    }

    /// Closes the way there.
    pub(crate) async fn end(self) {
        if let Some(tunnel) = self.tunnel {
            tunnel.stop().await;
        }
    }
}
