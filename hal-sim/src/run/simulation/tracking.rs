//! The camera above the arena, and who takes what it sees to the broker.

#[cfg(feature = "live")]
use std::rc::Rc;

use super::population::Population;
use super::uplink::{Link, Uplink};
#[cfg(feature = "live")]
use crate::net::fix::publisher;
use crate::run::overhead::OverheadCamera;
use crate::scenario::Tracker;
#[cfg(feature = "live")]
use crate::sched::{SimClock, TaskId};
use crate::world::PHYSICS_STEP;

/// See the [module](self). Without a network there is none: nobody would hear of it.
pub(super) struct Tracking {
    camera: Option<OverheadCamera>,
    /// Its client in a live world.
    #[cfg(feature = "live")]
    messenger: Option<TaskId>,
}

impl Tracking {
    pub(super) fn new(tracker: Tracker, seed: u64, uplink: &Uplink) -> Self {
        let reached = uplink.link() != Some(Link::None);
        Self {
            camera: OverheadCamera::new(tracker, seed).filter(|_| reached),
            #[cfg(feature = "live")]
            messenger: None,
        }
    }

    /// Connects the camera of a live world to the broker.
    #[cfg(feature = "live")]
    pub(super) fn connect(
        &mut self,
        population: &mut Population,
        uplink: &Uplink,
        clock: &SimClock,
    ) {
        if let (Some(gateway), Some(_)) = (uplink.gateway(), &self.camera) {
            let outlet = Rc::clone(gateway.outlet());
            let network = gateway.service();
            let fleet = uplink.fleet().clone();
            let broker = population.programs.broker();
            let credentials = broker.credentials.clone();
            let (host, clock) = (broker.host.clone(), clock.world());
            let network = gateway.secure(network, Box::new(|| None));
            let client = publisher::run(fleet, credentials, outlet, network, host, clock);
            self.messenger = Some(population.sched.spawn(client));
        }
    }

    /// Takes the camera down, connection and all.
    #[cfg(feature = "live")]
    pub(super) fn end(&mut self, population: &mut Population) {
        self.camera = None;
        if let Some(messenger) = self.messenger.take() {
            population.sched.remove(messenger);
        }
    }

    /// Tells the robots whose turn it is where they are, after a step of physics. Returns whether there were any.
    pub(super) fn pass(&mut self, population: &Population, uplink: &Uplink) -> bool {
        let Some(camera) = &mut self.camera else {
            return false;
        };
        let robots = population.len();
        let due = camera.pass(PHYSICS_STEP, robots, uplink.most_fixes_per_s());
        for _ in 0..due {
            let number = camera.turn(robots);
            // Robots of other shards have their turn too; theirs tells them.
            let machine = population.get(number);
            let Some(machine) = machine.filter(|machine| machine.robot().is_some()) else {
                continue;
            };
            let Some(truth) = population.world.pose(machine.index()) else {
                continue;
            };
            let pose = camera.see(number, truth);
            uplink.fix(machine.id(), pose, population.sched.now());
        }
        due > 0
    }
}
