//! Which slot the boot stage starts.

use crawler_boot::otadata::{Bootloader, Otadata, Slots};
use embedded_storage::nor_flash::ReadNorFlash;

use crate::header::Header;
use crate::layout::{OTADATA, SLOTS};

/// What the boot stage tells the program, in the third register, beside the number of the slot: to a program that
/// was started without it the emulator tells something else there.
const TOLD: u32 = 0x5443_4200;

/// Puts the first intact program into `memory`, from the slot that the select entries name on, and says which slot
/// it is from; `None` when no slot holds one.
///
/// What cannot be read counts as not intact. The program is checked in the place where it runs. Nothing is written:
/// that is left to the program.
pub fn load<F: ReadNorFlash>(flash: &mut F, memory: &mut [u8]) -> Option<u8> {
    let selection = match Otadata::read(flash, OTADATA, Slots::TWO) {
        Ok(otadata) => otadata.select(Bootloader::Plain),
        Err(_) => return None,
    };
    selection
        .tries(Slots::TWO)
        .find(|slot| load_slot(flash, *slot, memory))
}

fn load_slot<F: ReadNorFlash>(flash: &mut F, slot: u8, memory: &mut [u8]) -> bool {
    let Some(start) = SLOTS.get(usize::from(slot)) else {
        return false;
    };
    let mut head = [0; Header::BYTES];
    if flash.read(*start, &mut head).is_err() {
        return false;
    }
    let header = Header::parse(&head);
    let Some((header, program)) =
        header.and_then(|header| Some((header, memory.get_mut(..header.length() as usize)?)))
    else {
        return false;
    };
    let at = start + Header::BYTES as u32;
    flash.read(at, program).is_ok() && header.matches(program)
}

/// What the program is told of the slot that it is from.
#[must_use]
pub const fn tell(slot: u8) -> usize {
    (TOLD | slot as u32) as usize
}

/// The slot that the program was told that it is from; `None` when it was started without the boot stage.
#[must_use]
pub const fn told(word: usize) -> Option<u8> {
    match (word as u32) ^ TOLD {
        slot @ 0..=1 => Some(slot as u8),
        _ => None,
    }
}
