//! Every test of the simulator from outside, in one program, so that the robot program is linked
//! once and not for each file. cargo-nextest gives each test a process of its own all the same.

mod camera;
mod chaos;
mod common;
mod determinism;
mod evaluate;
mod eyes;
mod fault_schedules;
mod faults;
mod golden;
mod injection;
#[cfg(feature = "live")]
mod live;
#[cfg(feature = "live")]
mod live_control;
mod lockstep;
mod missions;
mod parallel;
#[cfg(feature = "live")]
mod proxy;
mod radio;
#[cfg(feature = "recording")]
mod recording;
mod safety;
mod swarm;
mod timesync;
mod tracking;
#[cfg(feature = "recording")]
mod what_if;
mod wiring;
