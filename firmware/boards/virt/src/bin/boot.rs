//! The boot stage of the emulated board: puts the program of a slot into memory, checks it there, and jumps.
//!
//! It runs in place from the first bank of flash, which is read-only, so nothing can break it; it writes nothing but
//! the memory of the program. Which slot starts is decided in `crawler-image-format`, with `crawler-boot`. The
//! machine's own words in the first two registers, hart and device tree, go through to the program; the third tells
//! it which slot it is from.
#![no_std]
#![no_main]

use core::arch::{asm, global_asm};
use core::panic::PanicInfo;
use core::{ptr, slice};

use crawler_image_format::layout::{BANK_ADDRESS, END, Group, PROGRAM, PROGRAM_MAX};
use crawler_image_format::start;
use embedded_storage::nor_flash::{ErrorType, ReadNorFlash};

/// Powers the machine off, or resets it (the "test finisher").
const FINISHER: *mut u32 = 0x0010_0000 as *mut u32;
/// Ends the emulator with code 5: `ExitCode::NoProgram` of the program.
const NO_PROGRAM: u32 = 5 << 16 | 0x3333;
/// Ends it with code 6: a mistake in here.
const PANIC: u32 = 6 << 16 | 0x3333;

// Hart and device tree wait in registers that the call preserves.
global_asm!(
    ".section .init, \"ax\"",
    ".globl _start",
    "_start:",
    "csrw mie, zero",
    "la sp, _stack_end",
    "mv s0, a0",
    "mv s1, a1",
    "call {load}",
    "mv a2, a0",
    "mv a0, s0",
    "mv a1, s1",
    "li t0, {program}",
    "fence.i",
    "jr t0",
    load = sym load,
    program = const PROGRAM,
);

/// The second bank, in the address space of the slots.
struct Bank;

impl ErrorType for Bank {
    type Error = Absent;
}

/// There is no flash at such an address.
#[derive(Debug)]
struct Absent;

impl embedded_storage::nor_flash::NorFlashError for Absent {
    fn kind(&self) -> embedded_storage::nor_flash::NorFlashErrorKind {
        embedded_storage::nor_flash::NorFlashErrorKind::OutOfBounds
    }
}

impl ReadNorFlash for Bank {
    const READ_SIZE: usize = 1;

    fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), Absent> {
        for piece in Group::pieces(at, bytes.len()).ok_or(Absent)? {
            let part = bytes.get_mut(piece.from..piece.to).ok_or(Absent)?;
            let from = (BANK_ADDRESS + piece.offset) as *const u8;
            // SAFETY: the layout keeps the piece within the bank, which the machine has and which shows its content
            // after a reset; memory and bank do not overlap.
            unsafe { ptr::copy_nonoverlapping(from, part.as_mut_ptr(), part.len()) };
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        END as usize
    }
}

/// Loads a program; what it is to be told.
extern "C" fn load() -> usize {
    // SAFETY: the memory of the program, of which nothing runs yet, and which nothing here lies in.
    let memory = unsafe { slice::from_raw_parts_mut(PROGRAM as *mut u8, PROGRAM_MAX as usize) };
    match start::load(&mut Bank, memory) {
        Some(slot) => start::tell(slot),
        None => end(NO_PROGRAM),
    }
}

fn end(word: u32) -> ! {
    // SAFETY: a register of this machine; writing it ends the emulator.
    unsafe { FINISHER.write_volatile(word) };
    loop {
        // SAFETY: waits for an interrupt, of which none is enabled.
        unsafe { asm!("wfi") };
    }
}

#[panic_handler]
fn panic(_info: &PanicInfo<'_>) -> ! {
    end(PANIC)
}
