//! The guard against a flash whose bits only fall.

use std::vec::Vec;

use crawler_boot::guard::{ATTEMPTS_AFTER_POWER, RESTARTS};
use crawler_boot::otadata::Bootloader;
use crawler_hal::SlotRegion;
use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

use super::*;

const OTADATA: u32 = 0;
const SLOTS: [SlotRegion; 2] = [
    SlotRegion {
        start: 0x2000,
        length: 0x2000,
    },
    SlotRegion {
        start: 0x4000,
        length: 0x2000,
    },
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Refused;

impl NorFlashError for Refused {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

struct Ram {
    bytes: Vec<u8>,
    /// Does nothing any more, or says so.
    worn: bool,
    refuses: bool,
}

impl ErrorType for Ram {
    type Error = Refused;
}

impl ReadNorFlash for Ram {
    const READ_SIZE: usize = 4;

    async fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), Refused> {
        bytes.copy_from_slice(&self.bytes[at as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Ram {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4_096;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Refused> {
        if !self.worn {
            self.bytes[from as usize..to as usize].fill(0xFF);
        }
        if self.refuses { Err(Refused) } else { Ok(()) }
    }

    async fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), Refused> {
        if !self.worn {
            for (kept, byte) in self.bytes[at as usize..].iter_mut().zip(bytes) {
                *kept &= byte;
            }
        }
        if self.refuses { Err(Refused) } else { Ok(()) }
    }
}

impl MultiwriteNorFlash for Ram {}

/// A board that has just received an update into slot 1 and is to try it.
fn activated() -> SlotPort<Ram> {
    let mut port = SlotPort {
        flash: Ram {
            bytes: std::vec![0xFF; 0x6000],
            worn: false,
            refuses: false,
        },
        otadata: OTADATA,
        slots: SLOTS,
        running: 0,
        chip: 0xFFFF,
    };
    block_on(async {
        let flash = &mut port.flash;
        assert_eq!(
            reach(flash, OTADATA, Goal::Keep { running: 0 }).await,
            Ok(true)
        );
        Trailer::begin_async(flash, trailer(1), b"envelope")
            .await
            .expect("begun");
        Trailer::record_async(flash, trailer(1), Record::Activated)
            .await
            .expect("written");
        let goal = Goal::Activate {
            slot: 1,
            running: 0,
        };
        assert_eq!(reach(flash, OTADATA, goal).await, Ok(true));
    });
    port
}

const fn trailer(slot: usize) -> u32 {
    SLOTS[slot].start + SLOTS[slot].length - SECTOR
}

/// A start, as a boot stage makes it that finds both programs whole.
fn start(port: &mut SlotPort<Ram>, cause: ResetCause) -> Result<Next, Option<Refused>> {
    block_on(async {
        let otadata = Otadata::read_async(&mut port.flash, OTADATA, Slots::TWO)
            .await
            .expect("read");
        port.running = otadata.select(Bootloader::Plain).slot.expect("one");
        guard(port, cause).await
    })
}

fn reason_of(port: &mut SlotPort<Ram>, slot: usize) -> Option<RollbackReason> {
    let read = block_on(Trailer::read_async(&mut port.flash, trailer(slot)));
    read.expect("read").rolled_back()
}

#[test]
fn a_program_that_panics_is_started_once_more_at_most() {
    let mut port = activated();
    assert_eq!(start(&mut port, ResetCause::Software), Ok(Next::Try));
    assert_eq!(start(&mut port, ResetCause::Panic), Ok(Next::Try));
    let given_up = Next::Restart(RollbackReason::Panic);
    assert_eq!(start(&mut port, ResetCause::Panic), Ok(given_up));
    assert_eq!(reason_of(&mut port, 1), Some(RollbackReason::Panic));
    assert_eq!(start(&mut port, ResetCause::Software), Ok(Next::Run));
    assert_eq!(port.running, 0);
}

#[test]
fn each_start_is_counted_where_it_belongs() {
    for (cause, allowed, reason) in [
        (
            ResetCause::PowerOn,
            ATTEMPTS_AFTER_POWER,
            RollbackReason::PowerCycles,
        ),
        (
            ResetCause::External,
            ATTEMPTS_AFTER_POWER,
            RollbackReason::PowerCycles,
        ),
        (ResetCause::Software, RESTARTS, RollbackReason::Restarts),
        (ResetCause::Watchdog, 1, RollbackReason::Watchdog),
    ] {
        let mut port = activated();
        for _ in 0..allowed {
            assert_eq!(start(&mut port, cause), Ok(Next::Try), "{cause:?}");
        }
        assert_eq!(
            start(&mut port, cause),
            Ok(Next::Restart(reason)),
            "{cause:?}"
        );
        assert_eq!(
            start(&mut port, ResetCause::Software),
            Ok(Next::Run),
            "{cause:?}"
        );
    }
}

#[test]
fn an_image_that_does_not_start_is_written_down_once() {
    let mut port = activated();
    // The boot stage found no whole program in slot 1.
    let started = |port: &mut SlotPort<Ram>| {
        port.running = 0;
        block_on(guard(port, ResetCause::Software))
    };
    let bad = RollbackReason::BadImage;
    assert_eq!(started(&mut port), Ok(Next::RunAgain(bad)));
    assert_eq!(reason_of(&mut port, 1), Some(bad));
    assert_eq!(started(&mut port), Ok(Next::Run));
}

#[test]
fn a_program_without_a_way_back_runs() {
    let mut port = activated();
    // The entry of the program before is gone.
    port.flash.bytes[..SECTOR as usize].fill(0xFF);
    for _ in 0..5 {
        assert_eq!(start(&mut port, ResetCause::Panic), Ok(Next::Try));
    }
}

#[test]
fn a_trailer_that_is_none_holds_nothing_up() {
    let mut port = activated();
    let at = trailer(1) as usize;
    port.flash.bytes[at..at + SECTOR as usize].fill(0);
    assert_eq!(start(&mut port, ResetCause::Panic), Ok(Next::Try));
    let given_up = Next::Restart(RollbackReason::Panic);
    assert_eq!(start(&mut port, ResetCause::Panic), Ok(given_up));
    assert_eq!(start(&mut port, ResetCause::Software), Ok(Next::Run));
}

#[test]
fn a_flash_that_keeps_nothing_is_told_of() {
    let mut port = activated();
    assert_eq!(start(&mut port, ResetCause::Panic), Ok(Next::Try));
    port.flash.worn = true;
    assert_eq!(start(&mut port, ResetCause::Panic), Err(None));
    port.flash.refuses = true;
    assert_eq!(start(&mut port, ResetCause::Panic), Err(Some(Refused)));
}
