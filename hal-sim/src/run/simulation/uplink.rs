//! How robots reach their broker, and what passes on that way past their programs.

use std::rc::Rc;

#[cfg(feature = "live")]
use crawler_hal::Clock as _;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{Fleet, Pose, RobotId, Topic};
use serde::{Deserialize, Serialize};

use super::EPOCH_MS;
use super::hostile::Packet;
use super::population::Machine;
use crate::net::NoNetwork;
use crate::net::fix::pose_fix;
use crate::net::lockstep::{Cut, VirtualNetwork};
use crate::net::network::SimNetwork;
use crate::run::machine::SimRobot;
#[cfg(feature = "live")]
use crate::run::overhead;
use crate::sched::SimClock;

/// How the robots of a world in virtual time reach their broker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Link {
    /// In the process, in virtual time.
    Lockstep,
    /// Not at all.
    None,
}

/// How robots reach their broker.
pub(crate) enum Way {
    /// Not at all.
    None,
    /// In the process, in virtual time.
    Lockstep(VirtualNetwork),
    /// Over real sockets.
    #[cfg(feature = "live")]
    Live(crate::net::live::Gateway),
}

/// The way of a fleet to its broker. Topics are rendered here alone, and only in lockstep has the simulation the
/// broker in its hand: elsewhere what it would publish comes to nothing.
pub(super) struct Uplink {
    fleet: Fleet,
    way: Way,
}

impl Uplink {
    pub(super) const fn new(fleet: Fleet, way: Way) -> Self {
        Self { fleet, way }
    }

    pub(super) const fn fleet(&self) -> &Fleet {
        &self.fleet
    }

    /// How it is in virtual time; `None` when the broker is a real one.
    pub(super) const fn link(&self) -> Option<Link> {
        match &self.way {
            Way::Lockstep(_) => Some(Link::Lockstep),
            Way::None => Some(Link::None),
            #[cfg(feature = "live")]
            Way::Live(_) => None,
        }
    }

    /// The broker in the process.
    pub(super) const fn network(&self) -> Option<&VirtualNetwork> {
        match &self.way {
            Way::Lockstep(network) => Some(network),
            _ => None,
        }
    }

    #[cfg(feature = "live")]
    pub(super) const fn gateway(&self) -> Option<&crate::net::live::Gateway> {
        match &self.way {
            Way::Live(gateway) => Some(gateway),
            Way::None | Way::Lockstep(_) => None,
        }
    }

    /// When the broker in the process has something to do.
    pub(super) fn next_due(&self) -> Instant {
        self.network().map_or(Instant::FAR_FUTURE, |network| {
            Instant::from_micros(network.next_due())
        })
    }

    /// A link for robot `number`, which stands at these metres. Links are numbered like robots.
    pub(super) fn add_link(&self, number: usize, place: (f32, f32)) -> usize {
        let Some(network) = self.network() else {
            return number;
        };
        let link = network.add_link();
        network.begin(link, place);
        link
    }

    /// What the program of `robot` reaches the broker through, on `link`.
    pub(super) fn join(&self, robot: &Rc<SimRobot>, clock: &SimClock, link: usize) -> SimNetwork {
        #[cfg(not(feature = "live"))]
        let _ = (robot, clock);
        match &self.way {
            Way::None => SimNetwork::None(NoNetwork),
            Way::Lockstep(network) => SimNetwork::Lockstep(network.rejoin(link)),
            #[cfg(feature = "live")]
            Way::Live(gateway) => {
                let (own, clock) = (Rc::clone(robot), clock.clone());
                let unix = move || own.unix_ms(clock.now()).map(|ms| ms / 1_000);
                let network = gateway.network(robot.config().id.as_str());
                SimNetwork::Live(Box::new(gateway.secure(network, Box::new(unix))))
            }
        }
    }

    /// Cuts or heals the link of a robot. False when there is none.
    pub(super) fn cut(&self, machine: &Machine, cut: Cut) -> bool {
        match &self.way {
            Way::None => return false,
            Way::Lockstep(network) => network.cut(machine.link(), cut),
            #[cfg(feature = "live")]
            Way::Live(gateway) => gateway.cut(machine.id().as_str(), cut),
        }
        true
    }

    /// The way of a command, or of what pretends to be one: through the broker where it is in the process, past it
    /// otherwise.
    pub(super) fn command(&self, machine: &Machine, payload: &[u8]) {
        if let Some(network) = self.network() {
            let topic = Topic::CommandRobot(machine.id().clone());
            network.publish(&topic.render(&self.fleet), payload, true, false);
        } else if let Some((robot, program)) = machine.running() {
            program.tell(robot, payload);
        }
    }

    /// One message to the swarm. False when there is no broker for it.
    pub(super) fn command_all(&self, payload: &[u8]) -> bool {
        let topic = Topic::CommandSwarm;
        self.publish(&topic.render(&self.fleet), payload, true, false)
    }

    /// Sends a hostile packet to a robot, and to no other.
    pub(super) fn attack(&self, machine: &Machine, packet: &Packet) {
        match self.network() {
            Some(network) if packet.as_pose => {
                let topic = Topic::Pose(machine.id().clone()).render(&self.fleet);
                network.publish(&topic, &packet.payload, false, false);
            }
            _ => self.command(machine, &packet.payload),
        }
    }

    /// Tells a robot where the camera sees it.
    pub(super) fn fix(&self, id: &RobotId, pose: Pose, now: Instant) {
        match &self.way {
            Way::None => {}
            Way::Lockstep(network) => {
                if let Some(payload) = pose_fix(id, EPOCH_MS + now.as_millis(), pose) {
                    let topic = Topic::Pose(id.clone()).render(&self.fleet);
                    network.publish(&topic, &payload, false, false);
                }
            }
            #[cfg(feature = "live")]
            Way::Live(gateway) => gateway.outlet().push(id, pose, now),
        }
    }

    /// How many of them in a second it carries.
    pub(super) const fn most_fixes_per_s(&self) -> u64 {
        match &self.way {
            Way::None | Way::Lockstep(_) => u64::MAX,
            #[cfg(feature = "live")]
            Way::Live(_) => overhead::LIVE_MOST_PER_S,
        }
    }

    /// Publishes a message from the server's side. False when there is no broker for it.
    pub(super) fn publish(
        &self,
        topic: &str,
        payload: &[u8],
        at_least_once: bool,
        retain: bool,
    ) -> bool {
        let network = self.network();
        network.is_some_and(|network| {
            network.publish(topic, payload, at_least_once, retain);
            true
        })
    }

    /// The server of a world in lockstep tells the time, `epoch_ms` at its beginning, so often.
    pub(super) fn serve_time(&self, epoch_ms: u64, every: Duration) {
        if let Some(network) = self.network() {
            network.serve_time(&Topic::Time.render(&self.fleet), epoch_ms, every);
        }
    }

    /// The broker lets in only clients that give this name and password.
    pub(super) fn require_credentials(&self, credentials: Option<(&str, &str)>) {
        if let Some(network) = self.network() {
            network.require_credentials(credentials);
        }
    }
}
