//! What a robot program needs of its body.
//!
//! This crate holds traits and units and no logic. The robot program (`crawler-app`) and the
//! drivers (`crawler-drivers`) are written against it; a board or the simulator implements it.
//!
//! The cut is at the wire: a body offers PWM channels, pins, a UART, an ADC and a flash, and the
//! shipped drivers run on top of them everywhere. Whatever the wider ecosystem already names
//! keeps its name ([`embedded_hal`], [`embedded_hal_async`], [`embedded_io_async`],
//! [`embedded_storage_async`], [`rand_core`]); own traits exist only for what those lack:
//!
//! | trait | what it is |
//! |---|---|
//! | [`Clock`] | monotonic time, and sleeping until a moment of it |
//! | [`Adc`] | one calibrated voltage reading |
//! | [`Camera`] | one frame or still into a caller's buffer |
//! | [`Network`] | joining a network and opening a byte stream |
//! | [`System`] | reset, reset cause, watchdog |
//! | [`SlotPort`] | the flash with the two places for the program, for updates |
//! | [`Body`] | all of them as associated types, handed over once at boot |
//!
//! Reading order: `units`, `time` and `clock`; then the parts, `adc`, `camera`, `network`, `slots` and
//! `system`; `body` bundles them.
#![no_std]
// The futures of these traits are polled by the executor that owns the peripheral, so no `Send`
// bound is wanted; the lint exists for public traits of thread pools.
#![allow(async_fn_in_trait)]

mod adc;
mod body;
mod camera;
mod clock;
mod network;
mod slots;
mod system;
mod time;
mod units;

pub use adc::Adc;
pub use body::{Body, MotorPort, Parts, RangerPort};
pub use camera::{Camera, CameraError, CameraErrorKind, FrameFormat, NoCamera, NoCameraError};
pub use clock::{Clock, Elapsed, Ticker, with_deadline};
pub use network::{LinkMonitor, LinkState, NetError, Network};
pub use slots::{ModelRegion, NoSlots, NoSlotsError, SlotPort, SlotRegion};
pub use system::{PANIC_TEXT, ResetCause, System};
pub use time::{Duration, Instant};
pub use units::{Celsius, Millimeters, Millivolts, Percent};
