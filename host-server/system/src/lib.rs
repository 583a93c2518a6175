//! What the server has of the machine it runs on, and what all parts of it need for that.
//!
//! - [`clock`]: the time of day, and the time that robots go by while a clock is set.
//! - [`data`]: the data directory, which one server has at a time, and its disk.
//! - [`descriptors`]: how many connections of each kind the process may have; [`process`]: what it costs.
//! - [`places`] and [`waiting`]: room for connections, of which no single machine takes all;
//!   [`neighbourhood`]: which addresses count as one.
//! - [`address`]: where brokers, engines and proxies are, as people write it.
//! - [`cli_error`]: why a command comes to nothing, for the person who typed it.
//! - [`text`]: what others say of themselves, fit for a log.
//!
//! This is among the lowest of the server's crates: it knows no options, no records and no robots.

pub mod address;
pub mod cli_error;
pub mod clock;
pub mod data;
pub mod descriptors;
pub mod places;
pub mod process;
pub mod text;
pub mod waiting;

mod neighbourhood;

pub use neighbourhood::neighbourhood;
