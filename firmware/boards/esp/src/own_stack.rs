//! A stack of its own for what runs in an interrupt.
//!
//! An interrupt runs on the stack of whatever it interrupts, and the tasks of the radio have no
//! room to spare: their own code was made for a system whose interrupts have a stack to themselves.
//! Control takes some 4 KB, so on RISC-V it moves to memory of its own for as long as it is polled.
//!
//! The ESP32-S3 passes windows of registers through its stack, which makes moving it a matter of
//! its runtime; there control stays on the stack it finds.

use core::pin::Pin;
use core::task::{Context, Poll};

/// A future that is polled on a stack of its own.
pub(crate) struct OnOwnStack<F> {
    inner: F,
    #[cfg(target_arch = "riscv32")]
    stack: &'static mut memory::Memory,
}

impl<F: Future> OnOwnStack<F> {
    /// Gives `inner` the stack. Called once.
    pub(crate) fn new(inner: F) -> Self {
        Self {
            inner,
            #[cfg(target_arch = "riscv32")]
            stack: memory::take(),
        }
    }
}

impl<F: Future> Future for OnOwnStack<F> {
    type Output = F::Output;

    fn poll(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<F::Output> {
        // SAFETY: `inner` is never moved out of a pinned `OnOwnStack`, and `stack` need not be
        // pinned.
        let this = unsafe { self.get_unchecked_mut() };
        // SAFETY: as above.
        let inner = unsafe { Pin::new_unchecked(&mut this.inner) };
        #[cfg(target_arch = "riscv32")]
        return this.stack.run(|| inner.poll(cx));
        #[cfg(not(target_arch = "riscv32"))]
        inner.poll(cx)
    }
}

#[cfg(target_arch = "riscv32")]
mod memory {
    use core::arch::asm;

    use static_cell::ConstStaticCell;

    /// What control takes (about 4 KB), and interrupts of higher priority on top of it.
    const SIZE: usize = 8 * 1024;
    /// What lies at the far end as long as nothing has run over it.
    const UNTOUCHED: u32 = 0x5AFE_57AC;

    /// The stack, aligned as the calling convention wants it.
    #[repr(C, align(16))]
    pub(super) struct Memory {
        end: [u32; 4],
        room: [u8; SIZE],
    }

    /// Places the stack. Called once.
    pub(super) fn take() -> &'static mut Memory {
        // All zero, so that it takes no room in the image.
        static STACK: ConstStaticCell<Memory> = ConstStaticCell::new(Memory {
            end: [0; 4],
            room: [0; SIZE],
        });
        let stack = STACK.take();
        stack.end = [UNTOUCHED; 4];
        stack
    }

    impl Memory {
        /// Runs `work` on this stack.
        ///
        /// # Panics
        /// When `work` has run over the end of it: what lies below is no longer to be trusted.
        pub(super) fn run<T, W: FnOnce() -> T>(&mut self, work: W) -> T {
            let mut call = Call {
                work: Some(work),
                result: None,
            };
            let entry: extern "C" fn(&mut Call<W, T>) = Call::enter;
            let top = self.room.as_mut_ptr_range().end;
            // SAFETY: `top` is the aligned end of memory that this call alone uses, because it has
            // it by `&mut`. `entry` keeps s2 as the calling convention asks, so the stack pointer
            // is back when the block ends; everything a call may change is declared. `call` outlives
            // the block.
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
                self.end == [UNTOUCHED; 4],
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
}
