//! Commands, on the way that the simulation has for them.

#[cfg(feature = "live")]
use crawler_hal::Clock as _;
use crawler_protocol::{Action, Command, MAX_MESSAGE, Source, Topic};

use super::{Simulation, Way};
use crate::run::journal::{Input, Payload};

/// Who gives the commands of a simulation.
const SOURCE: &str = "simulator";
/// Who gives the commands of the scenario. Each robot gets them when it is ready; numbers shared
/// among robots would depend on when the others are.
const SCENARIO: &str = "scenario";
/// Number of the initial command; those of others follow it.
pub(super) const FIRST_SEQ: u64 = 1;
/// Later commands of the scenario are numbered from here, for each robot apart, and far from the
/// commands of others.
const LATER_SEQ: u64 = 1 << 40;

impl Simulation {
    /// Gives a robot a command and returns its sequence number. In lockstep it travels through
    /// the broker; otherwise it is handed to the program at once.
    pub fn submit(&mut self, robot: usize, action: Action) -> u64 {
        let (seq, payload) = self.compose(action);
        self.note_command(Some(robot), &payload, true);
        self.hand(robot, &payload);
        seq
    }

    /// Gives a robot a command of the scenario, and returns its number: what that does is no input.
    pub(super) fn start(&mut self, robot: usize, action: Action) -> u64 {
        let seq = match self.director.count(robot) {
            0 => FIRST_SEQ,
            later => LATER_SEQ + later,
        };
        let payload = self.write(SCENARIO, seq, action);
        self.hand(robot, &payload);
        seq
    }

    /// Does what the journal says that one of the methods here did.
    pub(crate) fn submit_again(&mut self, robot: Option<usize>, payload: &Payload, numbered: bool) {
        self.seq += u64::from(numbered);
        self.note_command(robot, payload.bytes(), numbered);
        match robot {
            Some(robot) => self.hand(robot, payload.bytes()),
            None => self.hand_all(payload.bytes()),
        }
    }

    fn note_command(&mut self, robot: Option<usize>, payload: &[u8], numbered: bool) {
        let input = Input::Command {
            robot: robot.map(|robot| robot as u32),
            payload: Payload::new(payload),
            numbered,
        };
        self.journal.note(self.sched.now(), input);
    }

    /// Gives a robot the bytes of a command, whatever they are. The way is that of
    /// [`Simulation::submit`].
    pub fn submit_raw(&mut self, robot: usize, payload: &[u8]) {
        self.note_command(Some(robot), payload, false);
        self.hand(robot, payload);
    }

    fn hand(&mut self, robot: usize, payload: &[u8]) {
        self.troubles.overhear(robot, payload);
        self.deliver(robot, payload);
    }

    /// The way of a command, or of what pretends to be one.
    pub(super) fn deliver(&self, robot: usize, payload: &[u8]) {
        let Some(machine) = self.machines.get(robot) else {
            return;
        };
        match &self.way {
            Way::Lockstep(network) => {
                let topic = Topic::CommandRobot(machine.id.clone());
                network.publish(&topic.render(&self.fleet), payload, true, false);
            }
            _ => {
                if let Some((robot, program)) = machine.running() {
                    program.tell(robot, payload);
                }
            }
        }
    }

    /// Gives every robot a command, by one message to the swarm where there is a broker. Returns
    /// its sequence number.
    pub fn submit_all(&mut self, action: Action) -> u64 {
        let (seq, payload) = self.compose(action);
        self.note_command(None, &payload, true);
        self.hand_all(&payload);
        seq
    }

    fn hand_all(&mut self, payload: &[u8]) {
        if let Way::Lockstep(network) = &self.way {
            let topic = Topic::CommandSwarm.render(&self.fleet);
            network.publish(&topic, payload, true, false);
        } else {
            for robot in 0..self.machines.len() {
                self.hand(robot, payload);
            }
        }
    }

    fn compose(&mut self, action: Action) -> (u64, Vec<u8>) {
        self.seq += 1;
        (self.seq, self.write(SOURCE, self.seq, action))
    }

    fn write(&self, source: &str, seq: u64, action: Action) -> Vec<u8> {
        let command = Command {
            action,
            timestamp: self.command_time(),
            seq,
            source: Source::new(source).unwrap_or_else(|_| unreachable!("{source} is valid")),
        };
        let mut buffer = [0; MAX_MESSAGE];
        // Only a command with numbers that are not finite cannot be written. Robots refuse an
        // empty message, as they would refuse such a command.
        let len = command.to_json(&mut buffer).unwrap_or(0);
        buffer[..len].to_vec()
    }

    /// Unix time for commands: what robots take for the present.
    fn command_time(&self) -> u64 {
        #[cfg(feature = "live")]
        if matches!(self.way, Way::Live(_)) {
            let told = self.machines.iter().find_map(|machine| {
                let (robot, program) = machine.running()?;
                robot.unix_ms(program.clock.now())
            });
            return told.unwrap_or_else(|| self.unix_ms());
        }
        self.unix_ms()
    }
}
