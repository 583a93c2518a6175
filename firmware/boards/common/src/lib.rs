//! What every board shares and the robot program need not know.
//!
//! Everything here is a value that is handed in: no statics, no unsafe, no heap, so that all of it
//! is tested on the host.
//!
//! | module | what it is |
//! |---|---|
//! | [`clock`] | the clock of a robot, over embassy-time |
//! | [`network`] | its way to the broker, over embassy-net |
//! | [`boot_record`] | why the program started and how it last panicked, in memory that a reset keeps |
//! | [`arguments`] | what a robot is told about itself in one line of text |
//! | [`devicetree`] | that line, in the description of a machine |
//! | [`cfi`] | flash chips with the common flash interface, as regions for parameters and programs |
//! | [`guard`](mod@guard) | the first lines of `main`: run, or go back to the program before |
//! | [`update_identity`] | who the program is to those that update it |
//! | [`settings`] | what a person tells a robot once, and the flash that keeps it |
//! | [`provision`] | the page where a person enters it |
//! | [`model`] | a body in software, for boards that have none |
//! | [`models`] | models of a detector that are changed while it runs |
//! | [`sight`] | frames for a detector, and what it saw in them as text |
#![no_std]
// The futures of a board are polled by the executor that owns their peripherals.
#![allow(async_fn_in_trait)]

#[cfg(test)]
extern crate std;

pub mod arguments;
pub mod boot_record;
pub mod cfi;
pub mod clock;
pub mod devicetree;
pub mod guard;
pub mod model;
pub mod models;
pub mod network;
pub mod provision;
pub mod settings;
pub mod sight;
pub mod update_identity;

pub use clock::EmbassyClock;
pub use network::StackNetwork;
