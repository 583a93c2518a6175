//! Commands, on the way that the simulation has for them.

use crawler_hal::Clock;
use crawler_protocol::{Action, Command, MAX_MESSAGE, Source, Topic};

use super::{Simulation, Way};

/// Who gives the commands of a simulation.
const SOURCE: &str = "simulator";

impl Simulation {
    /// Gives a robot a command and returns its sequence number. In lockstep it travels through
    /// the broker; otherwise it is handed to the program at once.
    pub fn submit(&mut self, robot: usize, action: Action) -> u64 {
        let (seq, payload) = self.compose(action);
        self.submit_raw(robot, &payload);
        seq
    }

    /// Gives a robot the bytes of a command, whatever they are. The way is that of
    /// [`Simulation::submit`].
    pub fn submit_raw(&mut self, robot: usize, payload: &[u8]) {
        let Some(machine) = self.machines.get(robot) else {
            return;
        };
        match (&self.way, &machine.program) {
            (Way::Lockstep(air), _) => {
                let topic = Topic::CommandRobot(machine.config.id.clone());
                air.publish(&topic.render(&self.fleet), payload, true, false);
            }
            (_, Some(program)) => {
                machine.robot.submit(payload, program.clock.now());
            }
            (_, None) => {}
        }
    }

    /// Gives every robot a command, by one message to the swarm where there is a broker. Returns
    /// its sequence number.
    pub fn submit_all(&mut self, action: Action) -> u64 {
        let (seq, payload) = self.compose(action);
        if let Way::Lockstep(air) = &self.way {
            let topic = Topic::CommandSwarm.render(&self.fleet);
            air.publish(&topic, &payload, true, false);
        } else {
            for robot in 0..self.machines.len() {
                self.submit_raw(robot, &payload);
            }
        }
        seq
    }

    fn compose(&mut self, action: Action) -> (u64, Vec<u8>) {
        self.seq += 1;
        let command = Command {
            action,
            timestamp: self.command_time(),
            seq: self.seq,
            source: Source::new(SOURCE).unwrap_or_else(|_| unreachable!("{SOURCE} is valid")),
        };
        let mut buffer = [0; MAX_MESSAGE];
        // Only a command with numbers that are not finite cannot be written. Robots refuse an
        // empty message, as they would refuse such a command.
        let len = command.to_json(&mut buffer).unwrap_or(0);
        (self.seq, buffer[..len].to_vec())
    }

    /// Unix time for commands: what robots take for the present.
    fn command_time(&self) -> u64 {
        if matches!(self.way, Way::Lockstep(_)) {
            return self.unix_ms();
        }
        self.machines
            .iter()
            .find_map(|machine| {
                let program = machine.program.as_ref()?;
                machine.robot.unix_ms(program.clock.now())
            })
            .unwrap_or_else(|| self.unix_ms())
    }
}
