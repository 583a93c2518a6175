//! Robots come, go and lose their links.

use std::rc::Rc;

use crawler_app::Config;
use crawler_bundle::DefectKind;
#[cfg(feature = "live")]
use crawler_hal::Clock as _;
use crawler_protocol::{BuildId, Kind};

use super::{Machine, Simulation, Way};
use crate::devices::{BodyParts, Started};
use crate::net::NoNetwork;
use crate::net::lockstep::Cut;
use crate::net::network::SimNetwork;
use crate::run::error::SimulationError;
#[cfg(feature = "recording")]
use crate::run::event_log::life::Life;
use crate::run::eyes;
use crate::run::journal::Input;
use crate::run::machine::{self, Program, SimRobot};
use crate::run::robot_id;
use crate::world::Fingerprint;
use crate::world::Pose;

impl Simulation {
    /// Adds a robot at a free place drawn from the seed, and boots it. Returns its number.
    ///
    /// # Errors
    /// [`SimulationError::NoRoom`] when no free place is found.
    pub fn spawn(&mut self) -> Result<usize, SimulationError> {
        let input = Input::Spawn { pose: None };
        self.journal.note(self.sched.now(), input);
        self.place(None)
    }

    /// Adds a robot at `pose` and boots it. Returns its number.
    ///
    /// # Errors
    /// [`SimulationError::Placement`] when the place is not free.
    pub fn spawn_at(&mut self, pose: Pose) -> Result<usize, SimulationError> {
        let input = Input::Spawn { pose: Some(pose) };
        self.journal.note(self.sched.now(), input);
        self.place(Some(pose))
    }

    /// Adds a robot at `pose`, or at a free place drawn from the seed. What the scenario does is
    /// no input, so this notes nothing.
    pub(super) fn place(&mut self, pose: Option<Pose>) -> Result<usize, SimulationError> {
        match pose {
            Some(pose) => self.boot_at(pose),
            None => self.boot_anywhere(),
        }
    }

    fn boot_anywhere(&mut self) -> Result<usize, SimulationError> {
        let number = self.machines.len();
        let margin = self.world.parameters().chassis.radius_m + self.scenario.spawn.clearance;
        let world = &self.world;
        let all = number as u32 + 1;
        let pose = self
            .spawner
            .place(number, margin, |x, y| world.clearance(x, y, margin))
            .ok_or(SimulationError::NoRoom(all, all))?;
        self.boot_at(pose)
    }

    fn boot_at(&mut self, pose: Pose) -> Result<usize, SimulationError> {
        let number = self.machines.len();
        let wiring = self.scenario.wiring(number);
        let (index, parts) = self.world.place(pose, wiring)?;
        let config = self.config(number, parts.as_ref().map(|parts| &parts.started));
        let id = config.id.clone();
        let robot = parts.is_some().then(|| machine::context(config));
        let link = match &self.way {
            // Also for robots of other shards: links are numbered like robots.
            Way::Lockstep(network) => {
                let link = network.add_link();
                network.begin(link, (pose.x, pose.y));
                link
            }
            _ => number,
        };
        let running = robot.as_ref().zip(parts);
        let program = running.map(|(robot, parts)| self.start_program(robot, parts, number, link));
        self.machines.push(Machine {
            id,
            index,
            robot,
            program,
            link,
            boots: 1,
            history: Fingerprint::new(),
        });
        self.director.add(pose);
        if self.machines[number].robot.is_some() {
            self.initial.wait(number, self.sched.now());
        }
        Ok(number)
    }

    /// Starts the program of robot `number` on what its body hands over.
    pub(super) fn start_program(
        &mut self,
        robot: &Rc<SimRobot>,
        parts: BodyParts,
        number: usize,
        link: usize,
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
        let updates = super::updates::updates(&self.broker, &parts.started);
        let (sched, detector) = (&mut self.sched, self.detector.as_ref());
        let network = match &self.way {
            _ if parts.started.has(DefectKind::NeverLink) => SimNetwork::None(NoNetwork),
            Way::None => SimNetwork::None(NoNetwork),
            Way::Lockstep(network) => SimNetwork::Lockstep(network.rejoin(link)),
            #[cfg(feature = "live")]
            Way::Live(gateway) => {
                let (own, clock) = (Rc::clone(robot), parts.clock.clone());
                let unix = move || own.unix_ms(clock.now()).map(|ms| ms / 1_000);
                let network = gateway.network(robot.config().id.as_str());
                SimNetwork::Live(Box::new(gateway.secure(network, Box::new(unix))))
            }
        };
        machine::start(
            sched,
            robot,
            parts,
            network,
            detector,
            (updates, self.scenario.policy.clone()),
            #[cfg(feature = "recording")]
            event_log,
        )
    }

    /// Takes a robot out of the world, program and all. Its number is not used again.
    pub fn remove(&mut self, robot: usize) {
        let input = Input::Remove {
            robot: robot as u32,
        };
        self.journal.note(self.sched.now(), input);
        self.troubles.forget(robot);
        if let Some(machine) = self.machines.get_mut(robot) {
            if let Some(program) = machine.program.take() {
                program.stop(&mut self.sched);
            }
            self.world.remove_robot(machine.index);
            self.initial.forget(robot);
        }
    }

    /// What a robot is told of itself, when `started` is the program that it runs.
    pub(super) fn config(&mut self, number: usize, started: Option<&Started>) -> Config {
        let bundle = started.and_then(|started| started.bundle.as_deref());
        Config {
            id: robot_id(number),
            fleet: self.fleet.clone(),
            broker_host: self.broker.host.clone(),
            broker_port: self.broker.port,
            kind: Kind::Simulated,
            board: "sim",
            firmware: bundle.map_or(env!("CARGO_PKG_VERSION"), |bundle| {
                self.versions.keep(&bundle.version)
            }),
            build: bundle.map_or_else(|| self.build(), |bundle| BuildId::new(&bundle.build).ok()),
            geometry: machine::geometry(&self.scenario.parameters.chassis),
            credentials: self.broker.credentials.clone(),
            camera: self.scenario.has_camera(number),
            eyes: (self.detector.is_some() && self.scenario.has_camera(number))
                .then(|| eyes::lens(&self.scenario.parameters.camera)),
            // The body is broken by the simulation, not by the program.
            faults: false,
        }
    }

    /// What a program goes by that no update has brought, where somebody outside listens. A world in lockstep has the same
    /// history whatever it was built from.
    fn build(&self) -> Option<BuildId> {
        match self.way {
            Way::None | Way::Lockstep(_) => None,
            #[cfg(feature = "live")]
            Way::Live(_) => BuildId::new(super::updates::FACTORY_BUILD).ok(),
        }
    }

    /// Gives all robots, also those to come, a name and a password for their broker. A robot
    /// takes them up at its next boot.
    ///
    /// # Errors
    /// [`SimulationError::Credentials`] when one of the two is too long.
    pub fn set_credentials(&mut self, name: &str, password: &str) -> Result<(), SimulationError> {
        let credentials = Some(super::credentials(name, password)?);
        self.journal.withhold();
        self.broker.credentials = credentials;
        Ok(())
    }

    /// Cuts or heals the link of a robot, in lockstep and in real time.
    pub fn cut(&mut self, robot: usize, cut: Cut) {
        let input = Input::Cut {
            robot: robot as u32,
            cut,
        };
        self.journal.note(self.sched.now(), input);
        let Some(machine) = self.machines.get(robot) else {
            return;
        };
        match &self.way {
            Way::None => {}
            Way::Lockstep(network) => network.cut(machine.link, cut),
            #[cfg(feature = "live")]
            Way::Live(gateway) => gateway.cut(machine.id.as_str(), cut),
        }
    }
}
