//! Drivers for the parts of a robot, over the traits of `crawler-hal` and `embedded-hal`.
//!
//! | module | part |
//! |---|---|
//! | [`l298n`] | motor driver: two wheels, dead time on reversal, brake and coast |
//! | [`us100`] | ultrasonic ranger, over its UART or with pulses |
//! | [`battery`] | gauge for a pack of two lithium-ion cells behind a divider |
//! | [`lamp`] | status lamp patterns |
//! | [`median`] | median filter for ranges |
//! | [`ov2640`] | camera sensor: registers, and pictures out of its byte stream |
//!
//! Constructors do no I/O, so an absent part cannot stop the boot; every wait has a deadline; time
//! is an argument. Simulator and boards run the same drivers.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod battery;
pub mod l298n;
pub mod lamp;
pub mod median;
pub mod ov2640;
pub mod us100;

#[cfg(test)]
mod testing;
