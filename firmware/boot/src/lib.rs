//! Which slot to start, and when to give up on a trial.
//!
//! A robot has two slots for its program. An update goes into the one that does not run, is *activated*,
//! and started *on trial*: it is *confirmed* once it has proven itself, or given up, and the program before
//! starts again. This crate takes those decisions and nothing else, for every body: ESP boards, the
//! emulated board and its boot stage, simulated robots.
//!
//! | module | what it decides |
//! |---|---|
//! | [`otadata`] | which slot a bootloader starts, and how to have it start another one |
//! | [`trailer`] | how far an update has come, and how it ended: a journal in the slot's last sector |
//! | [`guard`] | in the first lines of `main`: run, or go back |
//! | [`trial`] | while the program runs: proven, or given up for what reason |
//! | [`model_trial`] | the same for a model that the program runs |
//! | [`flash`] | what the others want done to the flash |
//!
//! Reading order: `flash`, `crc`, `otadata` and its `plan`, then `trailer`, `reason`, `guard`, `trial` and `model_trial`.
//!
//! # Operations instead of a driver
//!
//! A boot stage and the first lines of `main` have no executor; the robot program shares its flash and waits
//! for it; a simulated robot has flash that takes time. So [`otadata`] and [`trailer`] do not touch a
//! flash: they look at bytes, and give the next [`flash::Operation`] on the way to a [`otadata::Goal`].
//! Whoever owns the flash does it, looks again, and asks again. That serves blocking and asynchronous
//! callers alike; a power cut anywhere needs no recovery of its own, since going on is the same as
//! beginning; and tests cut the power within every byte of every operation (`tests/boot/power_cuts.rs`).
//! Functions such as [`otadata::Otadata::reach`] and [`otadata::Otadata::reach_async`] are that loop over the
//! traits of `embedded-storage` and `embedded-storage-async`.
//!
//! # A whole update
//!
//! ```
//! # use embedded_storage::nor_flash::{ErrorType, MultiwriteNorFlash, NorFlash, ReadNorFlash};
//! # use std::convert::Infallible;
//! # struct Ram(Vec<u8>);
//! # impl ErrorType for Ram { type Error = Infallible; }
//! # impl ReadNorFlash for Ram {
//! #     const READ_SIZE: usize = 4;
//! #     fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
//! #         bytes.copy_from_slice(&self.0[at as usize..][..bytes.len()]);
//! #         Ok(())
//! #     }
//! #     fn capacity(&self) -> usize { self.0.len() }
//! # }
//! # impl NorFlash for Ram {
//! #     const WRITE_SIZE: usize = 4;
//! #     const ERASE_SIZE: usize = 4_096;
//! #     fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
//! #         self.0[from as usize..to as usize].fill(0xFF);
//! #         Ok(())
//! #     }
//! #     fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), Infallible> {
//! #         for (kept, byte) in self.0[at as usize..].iter_mut().zip(bytes) { *kept &= byte; }
//! #         Ok(())
//! #     }
//! # }
//! # impl MultiwriteNorFlash for Ram {}
//! use crawler_boot::guard::{Decision, decide};
//! use crawler_boot::otadata::{Bootloader, Goal, Otadata, Slots};
//! use crawler_boot::trailer::{Record, Trailer};
//! use crawler_boot::trial::{Observation, Sensors, Trial, Verdict};
//! use crawler_hal::{Instant, ResetCause};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // Where the partitions are: select entries, and the last sectors of two slots.
//! const OTADATA: u32 = 0x0000;
//! const TRAILERS: [u32; 2] = [0x2000, 0x3000];
//! let mut flash = Ram(vec![0xFF; 0x4000]);
//!
//! // A board fresh from the factory: the boot stage starts slot 0, whose program is proven.
//! let otadata = Otadata::read(&mut flash, OTADATA, Slots::TWO)?;
//! let running = otadata.select(Bootloader::Plain).slot.unwrap_or(0);
//! let decision = decide(ResetCause::PowerOn, otadata.standing(running), None);
//! assert_eq!((running, decision), (0, Decision::Confirmed));
//!
//! // An update arrives. First of all, otadata names the program that is proven.
//! let goal = Goal::Keep { running };
//! Otadata::reach(&mut flash, OTADATA, Slots::TWO, goal).map_err(|e| format!("{e:?}"))?;
//!
//! // Then the trailer of the other slot, and the image, block by block.
//! let spare = 1 - running;
//! let trailer = TRAILERS[usize::from(spare)];
//! Trailer::begin(&mut flash, trailer, b"signed manifest").map_err(|e| format!("{e:?}"))?;
//! for block in 0..10 {
//!     // … receive, write and check the block …
//!     Trailer::record(&mut flash, trailer, Record::Block(block)).map_err(|e| format!("{e:?}"))?;
//! }
//! let works = Sensors::RANGER.with(Sensors::BATTERY);
//! Trailer::record(&mut flash, trailer, Record::Staged(works)).map_err(|e| format!("{e:?}"))?;
//!
//! // It is activated, and the robot restarts.
//! Trailer::record(&mut flash, trailer, Record::Activated).map_err(|e| format!("{e:?}"))?;
//! let goal = Goal::Activate { slot: spare, running };
//! Otadata::reach(&mut flash, OTADATA, Slots::TWO, goal).map_err(|e| format!("{e:?}"))?;
//!
//! // The new program runs, in the other slot, on trial: its first lines count the start.
//! let otadata = Otadata::read(&mut flash, OTADATA, Slots::TWO)?;
//! let running = otadata.select(Bootloader::Plain).slot.unwrap_or(0);
//! assert_eq!(running, spare);
//! let journal = Trailer::read(&mut flash, TRAILERS[usize::from(running)])?;
//! let cause = ResetCause::Software;
//! match decide(cause, otadata.standing(running), journal.rolled_back()) {
//!     Decision::Run(counter) => {
//!         if let Some(operation) = otadata.count(running, counter) {
//!             operation.execute(&mut flash, OTADATA)?;
//!         }
//!     }
//!     other => panic!("{other:?}"),
//! }
//!
//! // It observes itself twice a second, until there is a verdict.
//! let before = journal.staged().unwrap_or_default();
//! let mut trial = Trial::new(Instant::BOOT, before);
//! let seen = Observation { missed: 0, sensors: works, received: true, delivered: true, failed: false };
//! let verdicts = (0..100).map(|half| trial.observe(Instant::from_millis(half * 500), &seen));
//! assert_eq!(verdicts.last(), Some(Verdict::Confirm));
//! let goal = Goal::Confirm { running };
//! let otadata = Otadata::reach(&mut flash, OTADATA, Slots::TWO, goal).map_err(|e| format!("{e:?}"))?;
//! Trailer::record(&mut flash, trailer, Record::Confirmed).map_err(|e| format!("{e:?}"))?;
//!
//! // From now on it is the proven one.
//! assert_eq!(decide(ResetCause::PowerOn, otadata.standing(running), None), Decision::Confirmed);
//! # Ok(())
//! # }
//! ```
#![no_std]

mod crc;
pub mod flash;
pub mod guard;
pub mod model_trial;
pub mod otadata;
mod reason;
pub mod trailer;
pub mod trial;

pub use crc::crc32_le;
pub use model_trial::ModelTrial;
pub use reason::RollbackReason;
pub use trial::Trial;
