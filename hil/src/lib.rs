//! The bench: one black-box suite for any robot on any broker, and the emulated board as a device.
//!
//! [`suite`] knows a robot by its messages alone: what goes in and what comes out over MQTT. It
//! runs unchanged against a simulated robot, an emulated board and one on a table.
//!
//! [`emulator`] runs a robot's firmware image under QEMU as if it were plugged in: a serial line
//! whose log it decodes, a network cable that can be pulled, flash that outlives a power cut.

mod broker;
pub mod emulator;
pub mod suite;

pub use broker::{BrokerUrl, BrokerUrlError};
