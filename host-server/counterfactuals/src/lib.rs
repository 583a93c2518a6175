//! What if: the fleet of a recorded moment, simulated from there on, as it was and with another command.
//!
//! What is recorded of robots, simulated or real, is where they were and what they were told. So a world is made of it: the
//! arena of that moment, each robot where it was, with the body of its certificate, or the one that fits what it did before,
//! and with the command that was in force. From there on the whole program runs in lockstep, twice: as it was, and with another
//! command. That is done many times with bodies, noise and chance drawn anew, and the same in both worlds, so that what
//! comes of the command is told with an interval.
//!
//! Before it is believed there is a null test: what was recorded after the moment has to lie where the draws have it that
//! tell how it was.
//!
//! Reading order: [`Question`]; `past`, what was recorded; `bodies` and `world`, one draw; [`answer`], all of them;
//! `keeper`, who asks when.

pub mod answer;
mod bodies;
mod keeper;
mod past;
mod question;
mod world;

pub use bodies::Known;
pub use keeper::{Counterfactual, Counterfactuals, NotAsked, Parts, State};
pub use past::{Certificates, Unreadable};
pub use question::{MOST_DRAWS, MOST_ROBOTS, MOST_SECONDS, Question, STEP_MS, TooMuch, moves};
