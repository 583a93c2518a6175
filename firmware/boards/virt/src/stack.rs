//! How much stack was ever used.
//!
//! At start the memory below the stack pointer is painted; what is no longer painted was used.
//! Interrupt handlers run on the same stack, so the figure covers them, but for control: that has a stack of its own.

use core::ptr;

unsafe extern "C" {
    /// Lowest address of the stack, from riscv-rt's linker script.
    static mut __estack: u32;
    /// The address above it.
    static mut __sstack: u32;
}

const PAINT: u32 = 0x5AFE_C0DE;
/// Left alone below the frame that paints, in words.
const MARGIN: usize = 64;

/// Paints the unused part of the stack.
#[inline(never)]
pub fn paint() {
    let here = 0_u32;
    let mut place = &raw mut __estack;
    let end = ptr::from_ref(&here).cast_mut().wrapping_sub(MARGIN);
    while place < end {
        // SAFETY: between the end of static memory and this frame nothing lives.
        unsafe {
            place.write_volatile(PAINT);
            place = place.add(1);
        }
    }
}

/// Bytes of stack that were ever in use.
pub fn used() -> usize {
    let end = &raw const __sstack;
    let mut place = &raw const __estack;
    // SAFETY: within the stack; a word in use is read, which harms nobody.
    while place < end && unsafe { place.read_volatile() } == PAINT {
        place = place.wrapping_add(1);
    }
    end.addr() - place.addr()
}
