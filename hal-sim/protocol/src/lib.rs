//! What a simulated world is told on `simulator/command`, and over HTTP.
//!
//! A [`SimulatorCommand`] is read as strictly as every message of `crawler-protocol`, with the same
//! reader and the same [errors](crawler_protocol::DecodeError). Whoever runs a world obeys all of them.
//! Robots know none of this: on a bench they obey a [`FaultCommand`](crawler_protocol::FaultCommand) on
//! the same topic, which is a part of it.
//!
//! Feature `schema` adds JSON Schemas, with those of `crawler-protocol`, for whoever serves them all; feature `openapi`
//! describes what is in a world to whoever says over HTTP what is there.
//!
//! Reading order: `command`, what can be told; `names`, `place` and `thing`, what is in it; `read`, how it is read.

mod command;
mod names;
#[cfg(feature = "openapi")]
mod openapi;
mod place;
mod read;
#[cfg(feature = "schema")]
mod schema;
mod thing;

pub use command::{MAX_LOADED, MAX_STEPS, SPEED_RANGE, SimulatorCommand, SimulatorCommandName};
pub use names::{ScenarioName, SnapshotName};
pub use place::Place;
#[cfg(feature = "schema")]
pub use schema::schemas;
pub use thing::{Colour, Dropped, EXTENT_RANGE, Object, ObjectShape, Obstacle};
