//! What else can be done to a simulation from outside: to its broker, and to bodies.

use crawler_hal::Duration;
use crawler_protocol::Topic;

use super::{Link, Simulation, Way};
use crate::run::SimulationError;
use crate::run::journal::{Input, Payload};
use crate::scenario::Scenario;
use crate::world::{DropError, Dropped};

impl Simulation {
    /// A simulation whose robots reach their broker by `link`.
    ///
    /// # Errors
    /// See [`SimulationError`].
    pub fn linked(link: Link, scenario: Scenario, seed: u64) -> Result<Self, SimulationError> {
        match link {
            Link::Lockstep => Self::lockstep(scenario, seed),
            Link::None => Self::without_network(scenario, seed),
        }
    }

    /// How its robots reach their broker; `None` when that is a real one.
    #[must_use]
    pub fn link(&self) -> Option<Link> {
        match &self.way {
            Way::Lockstep(_) => Some(Link::Lockstep),
            Way::None => Some(Link::None),
            #[cfg(feature = "live")]
            Way::Live(_) => None,
        }
    }

    /// The same scenario from the beginning, with `seed` or with the seed of this one.
    ///
    /// # Errors
    /// [`SimulationError::Live`] for a live one, and what the first time may have failed with.
    pub fn anew(&self, seed: Option<u64>) -> Result<Self, SimulationError> {
        let link = self.link().ok_or(SimulationError::Live)?;
        Self::linked(link, self.scenario.clone(), seed.unwrap_or(self.seed))
    }

    /// Publishes a message from the server's side of a lockstep world's broker; does nothing
    /// otherwise.
    pub fn publish(&mut self, topic: &str, payload: &[u8], at_least_once: bool, retain: bool) {
        let input = Input::Message {
            topic: topic.to_owned(),
            payload: Payload::new(payload),
            at_least_once,
            retain,
        };
        self.journal.note(self.sched.now(), input);
        if let Way::Lockstep(network) = &self.way {
            network.publish(topic, payload, at_least_once, retain);
        }
    }

    /// Has the server of a lockstep world tell another time: `epoch_ms` is Unix time at the
    /// beginning of the world. Does nothing otherwise.
    pub fn serve_time(&mut self, epoch_ms: u64, every: Duration) {
        let input = Input::Time {
            epoch_ms,
            every_us: every.as_micros(),
        };
        self.journal.note(self.sched.now(), input);
        if let Way::Lockstep(network) = &self.way {
            network.serve_time(&Topic::Time.render(&self.fleet), epoch_ms, every);
        }
    }

    /// Has the broker of a lockstep world let in only clients that give this name and password;
    /// `None` lets everyone in. Sessions that are open stay.
    pub fn require_credentials(&mut self, credentials: Option<(&str, &str)>) {
        self.journal.withhold();
        if let Way::Lockstep(network) = &self.way {
            network.require_credentials(credentials);
        }
    }

    /// Puts something solid into the arena, for everybody to meet and to see. Returns its number.
    ///
    /// # Errors
    /// See [`DropError`]; nothing has changed then.
    pub fn drop_in(&mut self, what: Dropped) -> Result<u32, DropError> {
        // The journal is to be read again, number by number.
        what.validate()?;
        self.journal.note(self.sched.now(), Input::Drop { what });
        self.world.drop_in(what)
    }

    /// Takes away what was dropped as number `item`. False when nothing of that number is there.
    pub fn take_away(&mut self, item: u32) -> bool {
        self.journal.note(self.sched.now(), Input::Take { item });
        self.world.take_away(item)
    }

    /// Makes the program of a robot panic with `text`, as a board's handler notes it, and resets
    /// it. Does nothing when there is no such robot.
    pub fn crash(&mut self, robot: usize, text: &str) {
        let input = Input::Crash {
            robot: robot as u32,
            text: text.to_owned(),
        };
        self.journal.note(self.sched.now(), input);
        if let Some(machine) = self.machines.get(robot) {
            self.world.crash(machine.index, text);
        }
    }
}
