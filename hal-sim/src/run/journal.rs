//! What reached a simulation from outside, and when.
//!
//! A world in virtual time is a function of its scenario, its seed and what was done to it. The
//! journal keeps the last of the three, so that a [`Snapshot`](crate::tools::snapshot::Snapshot)
//! can make the same world once more.

mod payload;

use crawler_hal::Instant;
use serde::{Deserialize, Serialize};

pub use payload::Payload;

use crate::faults::Fault;
use crate::net::lockstep::Cut;
use crate::world::{Dropped, Pose};

/// Most inputs kept. A hundred robots that each get a command every second fill it in eleven
/// minutes of such use; the table of a test run has a few dozen.
pub const MAX_ENTRIES: usize = 65_536;
/// Most bytes of commands kept.
pub const MAX_BYTES: usize = 16 * 1024 * 1024;

/// One thing done to a simulation from outside.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "input", rename_all = "snake_case", deny_unknown_fields)]
#[non_exhaustive]
pub enum Input {
    /// A command for one robot, or for all.
    Command {
        /// Which robot; without it the swarm.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        robot: Option<u32>,
        /// The message.
        payload: Payload,
        /// Whether the simulation numbered it.
        #[serde(default)]
        numbered: bool,
    },
    /// A message to the broker of a lockstep world.
    Message {
        /// Its topic.
        topic: String,
        /// The message.
        payload: Payload,
        /// Whether it goes at QoS 1.
        at_least_once: bool,
        /// Whether the broker retains it.
        retain: bool,
    },
    /// The server tells another time from now on.
    Time {
        /// Unix time at the beginning of the world, milliseconds.
        epoch_ms: u64,
        /// How often it is told, microseconds.
        every_us: u64,
    },
    /// One more robot, at a given place or one drawn from the seed.
    Spawn {
        /// The place.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pose: Option<Pose>,
    },
    /// A robot was picked up and put down somewhere else.
    Carry {
        /// Which one.
        robot: u32,
        /// Where.
        pose: Pose,
    },
    /// A robot was taken out.
    Remove {
        /// Which one.
        robot: u32,
    },
    /// A link was cut or healed.
    Cut {
        /// Whose.
        robot: u32,
        /// How.
        cut: Cut,
    },
    /// Something broke.
    Fault {
        /// Whose.
        robot: u32,
        /// What.
        fault: Fault,
        /// For how long, microseconds; without it until it is healed.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        lasting_us: Option<u64>,
    },
    /// All that was broken about a robot was mended.
    Heal {
        /// Which one.
        robot: u32,
    },
    /// The program of a robot was made to panic.
    Crash {
        /// Which one.
        robot: u32,
        /// What it says.
        text: String,
    },
    /// Something was put into the arena.
    Drop {
        /// What.
        what: Dropped,
    },
    /// Something that had been put there was taken away.
    Take {
        /// Its number.
        item: u32,
    },
}

/// An [`Input`] and its moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Microseconds since the beginning of the world.
    pub at_us: u64,
    /// Whether the simulation ran between the input before this one and this one, if only to
    /// settle what was due at the same moment.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub settled: bool,
    /// What was done.
    #[serde(flatten)]
    pub input: Input,
}

/// See the [module](self).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Journal {
    entries: Vec<Entry>,
    bytes: usize,
    lost: u64,
    withheld: u64,
    ran: bool,
}

impl Journal {
    /// Everything kept, in order.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Inputs for which there was no room. With any, the journal does not tell the whole story.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// Inputs that are not written down because they are secret: names and passwords.
    #[must_use]
    pub const fn withheld(&self) -> u64 {
        self.withheld
    }

    /// Whether the entries are all there was.
    #[must_use]
    pub const fn is_complete(&self) -> bool {
        self.lost == 0 && self.withheld == 0
    }

    pub(crate) fn note(&mut self, now: Instant, input: Input) {
        let bytes = match &input {
            Input::Command { payload, .. } => payload.len(),
            Input::Message { topic, payload, .. } => topic.len() + payload.len(),
            Input::Crash { text, .. } => text.len(),
            _ => 0,
        };
        // Once an input is lost the later ones are worth nothing.
        if self.lost > 0 || self.entries.len() >= MAX_ENTRIES || self.bytes + bytes > MAX_BYTES {
            self.lost += 1;
            return;
        }
        self.bytes += bytes;
        self.entries.push(Entry {
            at_us: now.as_micros(),
            settled: std::mem::take(&mut self.ran),
            input,
        });
    }

    pub(crate) fn withhold(&mut self) {
        self.withheld += 1;
    }

    /// The simulation runs.
    pub(crate) fn runs(&mut self) {
        self.ran = true;
    }
}

#[cfg(test)]
mod tests;
