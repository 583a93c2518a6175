//! The ways to the fleet's broker.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;

use crawler_records::Records;

use super::StartError;
use crate::accounts::Failures;
use crate::broker::{Accounts, EmbeddedBroker, Open, RecordAccounts};
use crate::bus::Target;
use crate::config::{Broker, BrokerUrl, Settings};
use crate::tls::{Certificates, Door, Tunnel, reachable};

/// The fleet's broker, and the ways to it.
pub(super) struct Ways {
    pub(super) broker: Option<EmbeddedBroker>,
    pub(super) tunnel: Option<Tunnel>,
    /// Our own session.
    pub(super) target: Target,
    /// Where others find the broker.
    pub(super) mqtt: BrokerUrl,
    /// Where this process finds it without TLS.
    pub(super) inside: BrokerUrl,
}

/// Starts the broker of this process, or finds the way to another.
pub(super) async fn open(
    settings: &Settings,
    records: &Records,
    certificates: Option<&Arc<Certificates>>,
    failures: Arc<Failures>,
) -> Result<Ways, StartError> {
    match &settings.broker {
        Broker::Embedded(listen) => {
            embedded(settings, *listen, records, certificates, failures).await
        }
        Broker::Outside(mqtt) => {
            let tunnel = open_tunnel(settings, mqtt).await?;
            let inside = tunnel.as_ref().map_or(mqtt, Tunnel::inside).clone();
            Ok(Ways {
                broker: None,
                target: Target {
                    shared: settings.cache.is_some(),
                    ..outside(&inside)?
                },
                tunnel,
                mqtt: mqtt.clone(),
                inside,
            })
        }
    }
}

async fn embedded(
    settings: &Settings,
    listen: SocketAddr,
    records: &Records,
    certificates: Option<&Arc<Certificates>>,
    failures: Arc<Failures>,
) -> Result<Ways, StartError> {
    let tls = &settings.tls;
    let certificates = certificates.filter(|_| tls.covers(listen));
    let plain = if certificates.is_some() {
        let nobody_else = SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 0);
        tls.mqtt_plain.unwrap_or(nobody_else)
    } else {
        listen
    };
    let accounts: Arc<dyn Accounts> = if settings.open {
        Arc::new(Open)
    } else {
        Arc::new(RecordAccounts::new(records.clone(), failures))
    };
    let broker = EmbeddedBroker::start(plain, &settings.fleet, accounts)
        .await
        .map_err(|cause| StartError::mqtt(plain, cause))?;
    let inside = url(broker.address(), false);
    let mqtt = match certificates {
        None => inside.clone(),
        Some(certificates) => {
            let client_ca = tls.client_ca.as_deref();
            let door = Door::new(certificates.acceptor(crate::tls::MQTT, client_ca)?);
            let front = broker.front(listen, door).await;
            let front = front.map_err(|cause| StartError::mqtt(listen, cause))?;
            url(front.address(), true)
        }
    };
    let server = broker.server();
    let target = Target {
        host: bracketed(&inside.host),
        port: inside.port,
        client_id: server.user.clone(),
        credentials: Some((server.user.clone(), server.password.to_string())),
        shared: false,
    };
    Ok(Ways {
        broker: Some(broker),
        tunnel: None,
        target,
        mqtt,
        inside,
    })
}

/// The way to an outside broker that speaks TLS.
pub(crate) async fn open_tunnel(
    settings: &Settings,
    broker: &BrokerUrl,
) -> Result<Option<Tunnel>, StartError> {
    if !broker.tls {
        return Ok(None);
    }
    let tunnel = Tunnel::open(broker, settings.tls.broker_ca.as_deref()).await;
    tunnel
        .map(Some)
        .map_err(|reason| StartError::BrokerUnreachable {
            broker: broker.to_string(),
            reason,
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
pub(crate) fn outside(url: &BrokerUrl) -> Result<Target, StartError> {
    let mut id = [0_u8; 8];
    getrandom::fill(&mut id).map_err(|_| StartError::Internal("no randomness"))?;
    Ok(Target {
        host: bracketed(&url.host),
        port: url.port,
        client_id: format!("server-{}", crate::hex(&id)),
        credentials: url.credentials.clone(),
        shared: false,
    })
}

/// The client joins host and port with a colon, so an IPv6 address needs its brackets.
fn bracketed(host: &str) -> String {
    if host.contains(':') {
        format!("[{host}]")
    } else {
        host.to_owned()
    }
}
