//! The link against a scripted broker, in virtual time.

mod cells;
mod harness;
mod images;
mod loss;
mod maps;
mod peer;
mod telemetry;
mod traffic;
mod trouble;
mod updates;
mod wire;
