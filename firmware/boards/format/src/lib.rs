//! What the emulated board's flash holds, in one place for everybody who reads or writes it: the boot stage,
//! the robot program, the launcher, and the command that packs images.
//!
//! | module | what it is |
//! |---|---|
//! | [`layout`] | where slots, select entries and parameters are in the second bank |
//! | [`header`] | what stands before a program in a slot, and whether the program is whole |
//! | [`start`] | which slot the boot stage starts |
//! | [`keys`] | where a program of any board holds the keys that releases must be signed with |
//! | `elf` | from a linked program to an image (feature `std`) |
//! | `pem` | keys as people have them in files (feature `std`) |
//! | `factory` | what a launcher writes into a bank, as a cable does with a board (feature `std`) |
#![no_std]

#[cfg(any(test, feature = "std"))]
extern crate std;

#[cfg(any(test, feature = "std"))]
pub mod elf;
#[cfg(any(test, feature = "std"))]
pub mod factory;
pub mod header;
pub mod keys;
pub mod layout;
#[cfg(any(test, feature = "std"))]
pub mod pem;
pub mod start;
