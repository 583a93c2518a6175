//! What reaches a simulation from outside: commands, messages, robots, faults, things.
//!
//! Every method here notes in the [journal](crate::run::journal) what it does, and nothing else does, so that a world
//! can be made once more from its recipe and its journal.

use crawler_hal::{Duration, Instant};
use crawler_protocol::Action;

use super::Simulation;
use super::programs::credentials;
use crate::faults::{Fault, FaultError};
use crate::net::lockstep::Cut;
use crate::run::error::SimulationError;
use crate::run::journal::{Entry, Input, Journal, Payload};
use crate::world::{DropError, Dropped, PlacementError, Pose, validate_dropped};

impl Simulation {
    /// What was done to this simulation from outside.
    #[must_use]
    pub fn journal(&self) -> &Journal {
        &self.journal
    }

    fn note(&mut self, input: Input) {
        self.journal.note(self.runtime.now(), input);
    }

    fn note_command(&mut self, robot: Option<usize>, payload: &[u8], numbered: bool) {
        self.note(Input::Command {
            robot: robot.map(|robot| robot as u32),
            payload: Payload::new(payload),
            numbered,
        });
    }

    /// Gives a robot a command and returns its sequence number. In lockstep it travels through
    /// the broker; otherwise it is handed to the program at once.
    pub fn submit(&mut self, robot: usize, action: Action) -> u64 {
        let (seq, payload) = self.runtime.compose(action);
        self.note_command(Some(robot), &payload, true);
        self.runtime.hand(robot, &payload);
        seq
    }

    /// Gives a robot these bytes for a command, whatever they are. The way is that of
    /// [`Simulation::submit`].
    pub fn submit_raw(&mut self, robot: usize, payload: &[u8]) {
        self.note_command(Some(robot), payload, false);
        self.runtime.hand(robot, payload);
    }

    /// Gives every robot a command, by one message to the swarm where there is a broker. Returns
    /// its sequence number.
    pub fn submit_all(&mut self, action: Action) -> u64 {
        let (seq, payload) = self.runtime.compose(action);
        self.note_command(None, &payload, true);
        self.runtime.hand_all(&payload);
        seq
    }

    /// Lets nothing of the scenario happen any more: no command, no fault, no goal. A journal does not know of it: it is the
    /// end of a world.
    #[cfg(feature = "live")]
    pub(crate) fn end_scenario(&mut self) {
        self.runtime.end_scenario();
    }

    /// Does what the journal says that one of the three did.
    fn submit_again(&mut self, robot: Option<usize>, payload: &Payload, numbered: bool) {
        if numbered {
            self.runtime.commands.next();
        }
        self.note_command(robot, payload.bytes(), numbered);
        match robot {
            Some(robot) => self.runtime.hand(robot, payload.bytes()),
            None => self.runtime.hand_all(payload.bytes()),
        }
    }

    /// Publishes a message from the server's side of a lockstep world's broker; does nothing
    /// otherwise.
    pub fn publish(&mut self, topic: &str, payload: &[u8], at_least_once: bool, retain: bool) {
        self.note(Input::Message {
            topic: topic.to_owned(),
            payload: Payload::new(payload),
            at_least_once,
            retain,
        });
        let uplink = &self.runtime.uplink;
        uplink.publish(topic, payload, at_least_once, retain);
    }

    /// Has the server of a lockstep world tell another time: `epoch_ms` is Unix time at the
    /// beginning of the world. Does nothing otherwise.
    pub fn serve_time(&mut self, epoch_ms: u64, every: Duration) {
        self.note(Input::Time {
            epoch_ms,
            every_us: every.as_micros(),
        });
        self.runtime.uplink.serve_time(epoch_ms, every);
    }

    /// Has the broker of a lockstep world let in only clients that give this name and password;
    /// `None` lets everyone in. Sessions that are open stay.
    pub fn require_credentials(&mut self, credentials: Option<(&str, &str)>) {
        self.journal.withhold();
        self.runtime.uplink.require_credentials(credentials);
    }

    /// Gives all robots, also those to come, a name and a password for their broker. A robot
    /// takes them up at its next boot.
    ///
    /// # Errors
    /// [`SimulationError::Credentials`] when one of the two is too long.
    pub fn set_credentials(&mut self, name: &str, password: &str) -> Result<(), SimulationError> {
        let credentials = credentials(name, password)?;
        self.journal.withhold();
        self.runtime
            .population
            .programs
            .set_credentials(credentials);
        Ok(())
    }

    /// Adds a robot at a free place drawn from the seed, and boots it. Returns its number.
    ///
    /// # Errors
    /// [`SimulationError::NoRoom`] when no free place is found.
    pub fn spawn(&mut self) -> Result<usize, SimulationError> {
        self.note(Input::Spawn { pose: None });
        self.runtime.place(None)
    }

    /// Adds a robot at `pose` and boots it. Returns its number.
    ///
    /// # Errors
    /// [`SimulationError::Placement`] when the place is not free.
    pub fn spawn_at(&mut self, pose: Pose) -> Result<usize, SimulationError> {
        self.note(Input::Spawn { pose: Some(pose) });
        self.runtime.place(Some(pose))
    }

    /// Picks a robot up and puts it down at `pose`. Its wheels turn as they did, and its program is not told.
    ///
    /// # Errors
    /// See [`PlacementError`]; it is where it was then.
    pub fn carry(&mut self, robot: usize, pose: Pose) -> Result<(), PlacementError> {
        self.note(Input::Carry {
            robot: robot as u32,
            pose,
        });
        match self.index(robot) {
            Some(index) => self.runtime.population.world.carry(index, pose),
            None => Ok(()),
        }
    }

    /// Takes a robot out of the world, program and all. Its number is not used again.
    pub fn remove(&mut self, robot: usize) {
        self.note(Input::Remove {
            robot: robot as u32,
        });
        self.runtime.remove(robot);
    }

    /// Cuts or heals the link of a robot, in lockstep and in real time.
    pub fn cut(&mut self, robot: usize, cut: Cut) {
        self.note(Input::Cut {
            robot: robot as u32,
            cut,
        });
        if let Some(machine) = self.runtime.population.get(robot) {
            self.runtime.uplink.cut(machine, cut);
        }
    }

    /// Breaks something about a robot: for so long, or until [`Simulation::heal`]. A fault takes
    /// the place of an earlier one of the same part of the same robot, time and all. What is over
    /// at once, such as [`Fault::ClockStep`] or [`Fault::FlashNoise`], has nothing to last.
    ///
    /// # Errors
    /// See [`FaultError`]; nothing is broken then.
    pub fn inject(
        &mut self,
        robot: usize,
        fault: Fault,
        lasting: Option<Duration>,
    ) -> Result<(), FaultError> {
        fault.validate()?;
        self.note(Input::Fault {
            robot: robot as u32,
            fault,
            lasting_us: lasting.map(Duration::as_micros),
        });
        self.runtime.break_part(robot, fault, lasting)
    }

    /// Mends all that was broken about a robot by [`Simulation::inject`]. Charge that is gone
    /// stays gone, and so does what noise has overwritten; a clock is set right by its server.
    pub fn heal(&mut self, robot: usize) {
        self.note(Input::Heal {
            robot: robot as u32,
        });
        self.runtime.heal(robot);
    }

    /// Makes the program of a robot panic with `text`, as a board's handler notes it, and resets
    /// it. Does nothing when there is no such robot.
    pub fn crash(&mut self, robot: usize, text: &str) {
        self.note(Input::Crash {
            robot: robot as u32,
            text: text.to_owned(),
        });
        if let Some(index) = self.index(robot) {
            self.runtime.population.world.crash(index, text);
        }
    }

    /// Puts something solid into the arena, for everybody to meet and to see. Returns its number.
    ///
    /// # Errors
    /// See [`DropError`]; nothing has changed then.
    pub fn drop_in(&mut self, what: Dropped) -> Result<u32, DropError> {
        // The journal is to be read again, number by number.
        validate_dropped(&what)?;
        self.note(Input::Drop { what });
        self.runtime.population.world.drop_in(what)
    }

    /// Takes away what was dropped as number `item`. False when nothing of that number is there.
    pub fn take_away(&mut self, item: u32) -> bool {
        self.note(Input::Take { item });
        self.runtime.population.world.take_away(item)
    }

    /// Lets `span` pass.
    pub fn run_for(&mut self, span: Duration) {
        self.run_until(self.now() + span);
    }

    /// Lets time pass until `end`.
    pub fn run_until(&mut self, end: Instant) {
        self.journal.runs();
        self.runtime.run_until(end);
    }

    /// Does once more what a journal says, up to and including `until`, and lets time pass up to
    /// there.
    ///
    /// # Errors
    /// None that the first time did not have: what failed then fails the same way again, and is
    /// passed over.
    pub fn follow(&mut self, entries: &[Entry], until: Instant) {
        for entry in entries {
            let at = Instant::from_micros(entry.at_us);
            if at > until {
                break;
            }
            if entry.settled || at > self.now() {
                self.run_until(at);
            }
            self.apply(&entry.input);
        }
        self.run_until(until);
    }

    /// Does to the simulation what `input` says.
    pub fn apply(&mut self, input: &Input) {
        match input {
            Input::Command {
                robot,
                payload,
                numbered,
            } => self.submit_again(robot.map(|robot| robot as usize), payload, *numbered),
            Input::Message {
                topic,
                payload,
                at_least_once,
                retain,
            } => self.publish(topic, payload.bytes(), *at_least_once, *retain),
            Input::Time { epoch_ms, every_us } => {
                self.serve_time(*epoch_ms, Duration::from_micros(*every_us));
            }
            Input::Spawn { pose } => {
                let _: Result<usize, SimulationError> = match pose {
                    Some(pose) => self.spawn_at(*pose),
                    None => self.spawn(),
                };
            }
            Input::Carry { robot, pose } => {
                let _ = self.carry(*robot as usize, *pose);
            }
            Input::Remove { robot } => self.remove(*robot as usize),
            Input::Cut { robot, cut } => self.cut(*robot as usize, *cut),
            Input::Fault {
                robot,
                fault,
                lasting_us,
            } => {
                let lasting = lasting_us.map(Duration::from_micros);
                let _ = self.inject(*robot as usize, *fault, lasting);
            }
            Input::Heal { robot } => self.heal(*robot as usize),
            Input::Crash { robot, text } => self.crash(*robot as usize, text),
            Input::Drop { what } => {
                let _ = self.drop_in(*what);
            }
            Input::Take { item } => {
                self.take_away(*item);
            }
        }
    }
}
