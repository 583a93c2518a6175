//! The memory of the stack, and the way onto it and back.

use core::arch::asm;
use core::sync::atomic::{AtomicU8, Ordering};

use static_cell::ConstStaticCell;

/// What control takes, and interrupts of higher priority on top of it: [`used`] tells.
const SIZE: usize = 8 * 1024;
/// What was never in use holds it.
const PAINT: u8 = 0xA5;
/// Bytes at the far end that nothing may ever use.
const END: usize = 16;

/// The stack, aligned as the calling convention wants it. Atomic, because others look at it while it is in use.
#[repr(C, align(16))]
struct Memory([AtomicU8; SIZE]);

// All zero, so that it takes no room in the image.
static MEMORY: Memory = Memory([const { AtomicU8::new(0) }; SIZE]);

/// The right to run on the stack.
#[derive(Debug)]
pub(crate) struct Stack(());

/// Places the stack.
///
/// # Panics
/// When called twice.
pub(crate) fn take() -> &'static mut Stack {
    static STACK: ConstStaticCell<Stack> = ConstStaticCell::new(Stack(()));
    let stack = STACK.take();
    for byte in &MEMORY.0 {
        byte.store(PAINT, Ordering::Relaxed);
    }
    stack
}

/// Bytes of the stack that were ever in use: all of it, as long as nobody has taken it.
pub fn used() -> usize {
    SIZE - MEMORY.0.iter().take_while(|byte| is_painted(byte)).count()
}

fn is_painted(byte: &AtomicU8) -> bool {
    byte.load(Ordering::Relaxed) == PAINT
}

impl Stack {
    /// Runs `work` on this stack.
    ///
    /// # Panics
    /// When `work` has run over the end of it: what lies below is no longer to be trusted.
    pub(crate) fn run<T, W: FnOnce() -> T>(&mut self, work: W) -> T {
        let mut call = Call {
            work: Some(work),
            result: None,
        };
        let entry: extern "C" fn(&mut Call<W, T>) = Call::enter;
        let top = MEMORY.0.as_ptr_range().end;
        // SAFETY: `top` is the aligned end of memory that may be written to while it is shared, and that nobody else
        // runs on, because there is one `Stack` and this is its only `&mut`. `entry` keeps s2 as the calling convention
        // asks, so the stack pointer is back when the block ends; everything a call may change is declared. `call`
        // outlives the block.
        unsafe {
            asm!(
                "mv s2, sp",
                "mv sp, {top}",
                "jalr {entry}",
                "mv sp, s2",
                top = in(reg) top,
                entry = in(reg) entry,
                in("a0") &raw mut call,
                out("s2") _,
                clobber_abi("C"),
            );
        }
        assert!(
            MEMORY.0[..END].iter().all(is_painted),
            "the stack of control is too small"
        );
        let Some(result) = call.result else {
            unreachable!("the call has returned")
        };
        result
    }
}

/// A closure on its way to the other stack, and what came of it.
struct Call<W, T> {
    work: Option<W>,
    result: Option<T>,
}

impl<W: FnOnce() -> T, T> Call<W, T> {
    extern "C" fn enter(&mut self) {
        self.result = self.work.take().map(|work| work());
    }
}
