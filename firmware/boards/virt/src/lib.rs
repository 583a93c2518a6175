//! The machine `virt` of QEMU (RISC-V, 32 bits), as a board.
//!
//! | module | what it is |
//! |---|---|
//! | [`machine`] | addresses, power off, reset, what the command line said |
//! | [`log`] | defmt records over the serial line |
//! | [`time`] | time driver over the machine timer, and the watchdog it carries |
//! | [`executor`] | two executors: tasks, and control above them in the software interrupt |
//! | [`ethernet`] | the network card |
//! | [`flash`] | the parallel flash with parameters, settings and programs |
//! | [`update`] | the slots, which of them runs, and the guard in the first lines of `main` |
//! | [`provision`] | the page for a person, in place of the command line |
//! | [`system`] | reset, its cause, the last panic |
//! | [`stack`] | how much stack was ever used |
#![no_std]

pub mod ethernet;
pub mod executor;
pub mod flash;
pub mod log;
pub mod machine;
pub mod provision;
pub mod stack;
pub mod system;
pub mod time;
pub mod update;
