//! Robots come, go and lose their links.

use crawler_app::{Config, Geometry};
use crawler_protocol::{Kind, RobotId};

use super::{Machine, START_PERIOD, Simulation, Way};
use crate::net::NoNetwork;
use crate::net::lockstep::Cut;
use crate::run::error::SimulationError;
use crate::run::machine;
use crate::world::Pose;

/// Voltage for which odometry is calibrated: a 2S pack in the middle of its charge.
const NOMINAL_V: f32 = 7.4;

impl Simulation {
    /// Adds a robot at a free place drawn from the seed, and boots it. Returns its number.
    ///
    /// # Errors
    /// [`SimulationError::NoRoom`] when no free place is found.
    pub fn spawn(&mut self) -> Result<usize, SimulationError> {
        let margin = self.scenario.parameters.chassis.radius_m + self.scenario.spawn.clearance;
        let world = &self.world;
        let all = self.machines.len() as u32 + 1;
        let pose = self
            .spawner
            .find(|pose| world.clearance(pose.x, pose.y, margin) >= margin)
            .ok_or(SimulationError::NoRoom(all, all))?;
        self.spawn_at(pose)
    }

    /// Adds a robot at `pose` and boots it. Returns its number.
    ///
    /// # Errors
    /// [`SimulationError::Placement`] when the place is not free.
    pub fn spawn_at(&mut self, pose: Pose) -> Result<usize, SimulationError> {
        let number = self.machines.len();
        let wiring = self.scenario.wiring(number);
        let (index, parts) = self.world.add_wired(pose, wiring)?;
        let config = self.config(number);
        let robot = machine::context(&config);
        let (program, link) = match &self.way {
            Way::None => (
                machine::start(&mut self.sched, &robot, parts, NoNetwork),
                number,
            ),
            Way::Lockstep(air) => {
                let network = air.add_link();
                let link = network.link();
                (
                    machine::start(&mut self.sched, &robot, parts, network),
                    link,
                )
            }
            #[cfg(feature = "live")]
            Way::Live(gateway) => (
                machine::start(&mut self.sched, &robot, parts, gateway.network()),
                number,
            ),
        };
        self.machines.push(Machine {
            config,
            index,
            robot,
            program: Some(program),
            link,
            boots: 1,
        });
        if self.action.is_some() {
            self.waiting.push(number as u32);
            self.next_start = self.next_start.min(self.sched.now() + START_PERIOD);
        }
        Ok(number)
    }

    /// Takes a robot out of the world, program and all. Its number is not used again.
    pub fn remove(&mut self, robot: usize) {
        if let Some(machine) = self.machines.get_mut(robot) {
            if let Some(program) = machine.program.take() {
                program.stop(&mut self.sched);
            }
            self.world.remove_robot(machine.index);
            self.waiting.retain(|&waiting| waiting as usize != robot);
        }
    }

    fn config(&self, number: usize) -> Config {
        let chassis = &self.scenario.parameters.chassis;
        let name = format!("sim-{:04}", number + 1);
        Config {
            // Letters, digits and a hyphen: always a valid id.
            id: RobotId::new(&name).unwrap_or_else(|_| unreachable!("{name} is a valid id")),
            fleet: self.fleet.clone(),
            broker_host: self.broker.host.clone(),
            broker_port: self.broker.port,
            kind: Kind::Simulated,
            board: "sim",
            firmware: env!("CARGO_PKG_VERSION"),
            geometry: Geometry {
                wheel_base_m: chassis.track_m,
                top_speed_mps: chassis.speed_at(NOMINAL_V),
                time_constant_s: chassis.driven_tau_s,
                // What a turning wheel settles by. A standing one starts a little later; that is
                // over within a step or two of the ramp.
                stiction_duty: chassis.dead_band(NOMINAL_V),
                nominal_v: NOMINAL_V,
                bridge_drop_v: chassis.bridge_drop_v,
            },
            credentials: self.broker.credentials.clone(),
            camera: self.scenario.has_camera(number),
        }
    }

    /// Gives all robots, also those to come, a name and a password for their broker. A robot
    /// takes them up at its next boot.
    ///
    /// # Errors
    /// [`SimulationError::Credentials`] when one of the two is too long.
    pub fn set_credentials(&mut self, name: &str, password: &str) -> Result<(), SimulationError> {
        let credentials = Some(super::credentials(name, password)?);
        for machine in &mut self.machines {
            machine.config.credentials.clone_from(&credentials);
        }
        self.broker.credentials = credentials;
        Ok(())
    }

    /// Cuts or heals the link of a robot in lockstep; does nothing otherwise.
    pub fn cut(&mut self, robot: usize, cut: Cut) {
        if let (Way::Lockstep(air), Some(machine)) = (&self.way, self.machines.get(robot)) {
            air.cut(machine.link, cut);
        }
    }
}
