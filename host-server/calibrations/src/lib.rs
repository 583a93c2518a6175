//! Calibrations of robots where they stand.
//!
//! A person asks for one ([`Calibrations::begin`]). It is permitted, or refused by name; the robot drives under the eyes
//! of the server, which ends it for whatever should not be; and what it told meanwhile becomes a certificate, if a
//! part of the drive that was held out proves it. Evidence is what twins hear, and nothing else.
//!
//! A robot that nobody speaks to stands after half a second. So a server that is killed in the middle leaves no robot
//! driving; when it starts again it says that the calibration was broken off, and sets the robot's rate of telemetry
//! back.
//!
//! Reading order: [`ground`], where a robot may drive; [`permit`], whether it may; `course`, which drives and watches;
//! [`record`], what is kept of a calibration, and `store`, where; [`robots`], what is known of the fleet and told to it;
//! `calibrations`, all of them, and `runner`, which carries one out.

mod calibrations;
mod course;
pub mod ground;
pub mod permit;
pub mod record;
pub mod robots;
mod runner;
mod store;

#[cfg(test)]
mod tests;

pub use calibrations::{
    BeginError, Calibrations, Clock, Free, NewCalibration, Parts, Preview, StopError,
};
