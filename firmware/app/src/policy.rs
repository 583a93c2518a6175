//! Driving by a policy that was learned: a small network in int8 that chooses one of a few motions ten times a second.
//!
//! | | |
//! |---|---|
//! | what it sees | an [`Observation`]: [`WIDTH`] numbers of 8 bits, from what the robot remembers of its surroundings and knows of others |
//! | what it chooses | an [`Action`], which is a twist |
//! | what it may do | what the [`shield()`] leaves of it: no twist drives into what is known |
//! | what it is | a [`Policy`]: a blob with the network and what it was trained for |
//!
//! All of it is in whole numbers, so that host, board and browser decide alike, bit for bit. A [`Pilot`] has the memory,
//! makes the observations and holds the shield in every control step; whoever runs the network is elsewhere: the activity
//! [`decide()`](crate::decide()) on a robot, a learner in training. A decision that was made for the observation of one
//! control step counts from the next one on. Without one for [`DECIDED_WITHIN`] the robot stands.
//!
//! Reading order: `action` and `shield`; `memory`, what is remembered of the surroundings, with `sector`; `observation`,
//! what a network sees of that; `blob`, `network` and `table`, which choose; `pilot`, which puts it together for
//! the controller; `decisions`, what is handed over to the activity and back; `shelf`, where a policy lies that a release
//! has brought; `shadow`, how one that does not drive compares.

mod action;
mod blob;
pub(crate) mod decisions;
mod memory;
mod network;
mod observation;
mod pilot;
mod sector;
pub(crate) mod shadow;
mod shelf;
mod shield;
mod table;

use crawler_hal::Duration;

pub use action::Action;
pub use blob::{
    FORMAT_VERSION, HEADER, LAYERS, MAGIC, MAX_BYTES, Mode, NO_SCORE, Policy, PolicyError,
};
pub use decisions::{Installed, Policies};
pub use network::{LOGIT_STEPS, Scratch, choose};
pub use observation::{Observation, WIDTH};
pub use pilot::{Asked, Decision, Known, Pilot};
pub use shelf::Shelf;
pub(crate) use shelf::{Also, NoShelf, Open, Unread};
pub use shield::{Around, shield};
pub use table::{PRE_STEPS, squeezed};

/// Counts changes of what the numbers of an observation mean.
pub const OBSERVATION_VERSION: u8 = 1;
/// Counts changes of the actions.
pub const ACTIONS_VERSION: u8 = 1;
/// Counts changes of what the shield takes away.
pub const SHIELD_VERSION: u8 = 1;
/// Control steps from one decision to the next.
pub const STEPS: u8 = 5;
/// How long a decision counts.
pub const DECIDED_WITHIN: Duration = Duration::from_millis(300);

/// A policy by what it is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Named<'a> {
    /// Its name, as `behave` gives it.
    pub name: &'a str,
    /// Bytes that [`Policy::new`] reads.
    pub blob: &'a [u8],
}

/// The policy that comes with the program: it gets apart from others and touches nothing. `docs/learning.md` says how it
/// was trained, `policies/spread.json` what came of that.
pub const SPREAD: Named<'static> = Named {
    name: "spread",
    blob: include_bytes!("../policies/spread.tcpo"),
};

#[cfg(test)]
mod driving_tests;
#[cfg(test)]
mod tests;
