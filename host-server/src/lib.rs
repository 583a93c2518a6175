//! The server of a fleet: embedded broker, state of every robot, API, live feed, control room.
//!
//! [`cli`] is the command line, [`config`] resolves the options, [`server::Server`] starts and stops
//! everything, [`run`] is what the binary `terracrawler` does with them. Robots are met in MQTT messages
//! alone, whether the broker is in this process or not; what those messages are is `crawler-protocol`'s to
//! say.
//!
//! Reading order: `run`, `config` and `server`, which starts the parts; `addresses`, where a running server is.
//! The command line: `cli`, `console`, `release`, `replay`, `twin`, `learn_node`, and `rollout`, which speaks to a running server through
//! `client`. `room` has what robots of an arena may touch, `terminal` asks for passwords, `calendar` has moments as people read them.

pub mod cli;
pub mod config;
pub mod console;
mod learn_node;
pub mod release;
pub mod replay;
pub mod rollout;
pub mod run;
pub mod server;
pub mod twin;

mod addresses;
mod calendar;
mod client;
mod room;
mod terminal;

pub use crawler_server_tls::TlsError;
pub use crawler_system::data::DataError;
