//! Telemetry history in an outside time-series engine: whatever takes `InfluxDB`'s line protocol.
//!
//! [`Remote::push`] puts a sample into a queue of bounded length and returns at once. One task writes
//! what came in, a quarter of a second's worth or [`BATCH`] samples at a time. While the engine is
//! away, or refuses the server as such, samples wait in the queue and the task tries again; a batch
//! that the engine understands and refuses is let go and counted. [`Remote::query`] asks the engine
//! and answers as [`crawler_history::History`] does, in `InfluxQL` or `MetricsQL`.
//!
//! Each sample is one line of the measurement [`MEASUREMENT`]; `docs/history.md` has the schema.
//!
//! Reading order: `remote`, which is called; `shared`, `writer` and `line`; `engine`, `address` and `client`;
//! `read`; `error`.

mod address;
mod client;
mod engine;
mod error;
mod line;
mod read;
mod remote;
mod shared;
mod writer;

pub use address::{Address, Dialect, NoAddress, Read};
pub use engine::{Engine, Product, look};
pub use error::EngineError;
pub use line::{MEASUREMENT, push_line};
pub use read::SPARSE_ROWS;
pub use remote::{QUEUE, Remote};
pub use shared::BATCH;
pub use shared::State;
