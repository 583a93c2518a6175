//! What the programs of robots are started with.

use std::rc::Rc;

use crawler_app::{Config, Credentials};
use crawler_bundle::DefectKind;
use crawler_protocol::{BuildId, Kind};
use crawler_release::PublicKeys;

use super::updates::{self, FACTORY_BUILD};
use super::uplink::Uplink;
use super::versions::Versions;
use crate::devices::{BodyParts, Started};
use crate::net::NoNetwork;
use crate::net::network::SimNetwork;
use crate::run::error::SimulationError;
#[cfg(feature = "recording")]
use crate::run::event_log::{EventLogs, life::Life};
use crate::run::eyes::{self, DetectorInstance, Looks};
use crate::run::machine::{self, Program, SimRobot};
use crate::run::robot_id;
use crate::scenario::Scenario;
use crate::sched::Scheduler;

/// Name and password for a broker, as robots hold them.
///
/// # Errors
/// [`SimulationError::Credentials`] when the name is longer than 32 bytes or the password longer
/// than 64.
pub fn credentials(name: &str, password: &str) -> Result<Credentials, SimulationError> {
    Ok(Credentials {
        username: name.try_into().map_err(|_| SimulationError::Credentials)?,
        password: password
            .try_into()
            .map_err(|_| SimulationError::Credentials)?,
    })
}

/// What robots are told of the world outside: where their broker is and what it wants to know of its clients, and
/// whose releases they believe.
#[derive(Debug, Clone, Default)]
pub(crate) struct BrokerAddress {
    pub(crate) host: heapless::String<64>,
    pub(crate) port: u16,
    pub(crate) credentials: Option<Credentials>,
    /// By which keys robots believe releases; without one they take no updates.
    pub(crate) release_keys: Option<PublicKeys>,
    /// Where their devices are recorded.
    #[cfg(feature = "recording")]
    pub(crate) event_logs: Option<EventLogs>,
}

/// See the [module](self). Nothing of it changes while the world runs but the credentials, which a robot takes up at
/// its next boot.
pub(super) struct Programs {
    scenario: Rc<Scenario>,
    /// Whom robots are to connect to.
    broker: BrokerAddress,
    /// What their cameras are seen through with.
    detector: Option<Rc<DetectorInstance>>,
    /// Versions of programs from bundles.
    versions: Versions,
}

impl Programs {
    /// # Errors
    /// When the detector of the scenario cannot be used.
    pub(super) fn new(
        scenario: &Rc<Scenario>,
        broker: BrokerAddress,
    ) -> Result<Self, SimulationError> {
        Ok(Self {
            scenario: Rc::clone(scenario),
            broker,
            detector: scenario.detector.map(DetectorInstance::new).transpose()?,
            versions: Versions::default(),
        })
    }

    pub(super) fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    #[cfg(feature = "live")]
    pub(super) const fn broker(&self) -> &BrokerAddress {
        &self.broker
    }

    pub(super) fn set_credentials(&mut self, credentials: Credentials) {
        self.broker.credentials = Some(credentials);
    }

    /// What looking has come to. Nothing where the scenario has no detector.
    pub(super) fn looks(&self) -> Looks {
        self.detector
            .as_ref()
            .map_or_else(Looks::default, |detector| detector.looks())
    }

    /// What a robot is told of itself, when `started` is the program that it runs.
    pub(super) fn config(
        &mut self,
        number: usize,
        started: Option<&Started>,
        uplink: &Uplink,
    ) -> Config {
        let bundle = started.and_then(|started| started.bundle.as_deref());
        Config {
            id: robot_id(number),
            fleet: uplink.fleet().clone(),
            broker_host: self.broker.host.clone(),
            broker_port: self.broker.port,
            kind: Kind::Simulated,
            board: "sim",
            firmware: bundle.map_or(env!("CARGO_PKG_VERSION"), |bundle| {
                self.versions.keep(&bundle.version)
            }),
            build: bundle.map_or_else(
                || factory_build(uplink),
                |bundle| BuildId::new(&bundle.build).ok(),
            ),
            geometry: machine::geometry(&self.scenario.parameters.chassis),
            credentials: self.broker.credentials.clone(),
            camera: self.scenario.has_camera(number),
            eyes: (self.detector.is_some() && self.scenario.has_camera(number))
                .then(|| eyes::lens(&self.scenario.parameters.camera)),
            // The body is broken by the simulation, not by the program.
            faults: false,
        }
    }

    /// Starts the program of a robot on what its body hands over. `numbers` are its own and that of its link.
    pub(super) fn start(
        &self,
        sched: &mut Scheduler,
        robot: &Rc<SimRobot>,
        parts: BodyParts,
        (number, link): (usize, usize),
        uplink: &Uplink,
    ) -> Program {
        #[cfg(feature = "recording")]
        let event_log = self.broker.event_logs.as_ref().map(|event_logs| {
            let life = Life::of(robot.config(), &parts);
            let event_log = event_logs.insert(number, life, &parts.clock);
            event_log.watch(robot);
            event_log
        });
        #[cfg(not(feature = "recording"))]
        let _ = number;
        let updates = updates::updates(&self.broker, &parts.started);
        let network = if parts.started.has(DefectKind::NeverLink) {
            SimNetwork::None(NoNetwork)
        } else {
            uplink.join(robot, &parts.clock, link)
        };
        machine::start(
            sched,
            robot,
            parts,
            network,
            self.detector.as_ref(),
            (updates, self.scenario.policy.clone()),
            #[cfg(feature = "recording")]
            event_log,
        )
    }
}

/// What a program goes by that no update has brought, where somebody outside listens. A world in virtual time has the
/// same history whatever it was built from.
fn factory_build(uplink: &Uplink) -> Option<BuildId> {
    match uplink.link() {
        Some(_) => None,
        None => BuildId::new(FACTORY_BUILD).ok(),
    }
}
