//! The Terracrawler robot program.
//!
//! Written against [`crawler_hal`] alone: it knows no board, no simulator and no server, keeps
//! no static, allocates nothing, and asks the handed-in clock and random generator for
//! everything that is not a function of its input. Two robots can live in one process.
//!
//! The activities are plain `async fn`s over one shared [`Robot`]; each peripheral has one owner
//! among them, and each sleeps until its next deadline or signal:
//!
//! | activity | owns | period |
//! |---|---|---|
//! | [`control()`] | motors, watchdog | 20 ms |
//! | [`sense()`] | ranger | 60 ms |
//! | [`power()`] | battery input | 1 s |
//! | [`lamp()`] | status lamp | edges of its pattern |
//! | [`store()`] | flash | on demand |
//! | [`link()`] | network | events |
//! | [`update()`] | both slots, where the program can be replaced | on demand |
//! | [`decide()`] | the network of a policy, where there is one | 100 ms while the robot drives by it |
//! | [`camera()`] | camera, where there is one | on demand; `vision_period_ms` while it looks |
//!
//! # Reading order
//!
//! 1. What activities share, and who may write which part of it: `context`.
//! 2. A command: `link`, `intake` with `ledger`, `memory` and `timesync`, `order`, `controller`, called by `control`.
//! 3. What it comes to: `state`, `goal`, `behaviour`, `motion`; `policy`, whose network `decide` runs.
//! 4. What the robot knows: `sense`, `perception`, `power`, `tracking`, `neighbours`, `navigation`, `observe`,
//!    `camera`, `vision`.
//! 5. What it tells: `outbox`, `map_report`, `trouble`, `lamp`.
//! 6. What it keeps: `config`, `parameters`, `store`; what replaces it: `update`; and on the side `hold`, memory of rare steps, and
//!    `injected`, faults that are put in on purpose.
#![no_std]
// Activities are polled by the executor that owns their peripherals; no `Send` bound is wanted.
#![allow(async_fn_in_trait)]

#[cfg(test)]
extern crate std;

pub mod behaviour;
pub mod camera;
mod config;
mod context;
pub mod control;
pub mod controller;
mod decide;
pub mod goal;
mod hold;
mod injected;
pub mod intake;
pub mod lamp;
pub mod ledger;
pub mod link;
mod map_report;
mod memory;
pub mod motion;
pub mod navigation;
pub mod neighbours;
mod observe;
pub mod order;
pub mod outbox;
pub mod parameters;
pub mod perception;
pub mod policy;
pub mod power;
#[cfg(test)]
mod rules;
#[cfg(test)]
mod send_tests;
pub mod sense;
pub mod state;
pub mod store;
#[cfg(test)]
mod testing;
pub mod timesync;
pub mod tracking;
pub mod trouble;
#[cfg(test)]
mod trouble_tests;
mod update;
pub mod vision;

pub use camera::{ImageSlot, camera, camera_with_eyes};
pub use config::{Config, Credentials, Geometry};
pub use context::{BootRecord, Echo, Robot, Routed, Snapshot};
pub use control::control;
pub use decide::{decide, decide_with_shelf};
pub use hold::{Always, Blank, Hold, Inline, Room};
pub use lamp::lamp;
pub use link::{
    link, link_held, link_with_images, link_with_images_and_updates_held, link_with_images_held,
    link_with_updates_held,
};
pub use power::power;
pub use sense::{sense, sense_held};
pub use store::{store, store_held};
pub use update::{
    ASK_AFTER, ASK_AFTER_MOST, LoadError, ModelHost, ModelLooks, NoEyes, PolicyHost, SILENT_AFTER,
    UpdateIdentity, Updates, update, update_held, update_with_policies_held,
};
