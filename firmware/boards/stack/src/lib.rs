//! A stack of its own for what a board runs in an interrupt.
//!
//! An interrupt runs on the stack of whatever it interrupts. How deep that gets is a matter of luck: seldom does one
//! come where the stack is deepest. And the tasks of a radio have no room to spare: their own code was made for a system
//! whose interrupts have a stack to themselves. So on RISC-V control moves to memory of its own for as long as it is
//! polled, and what it takes is known apart.
//!
//! The ESP32-S3 passes windows of registers through its stack, which makes moving it a matter of its runtime; there
//! control stays on the stack it finds, as it does on the host.
#![no_std]

use core::pin::Pin;
use core::task::{Context, Poll};

#[cfg(target_arch = "riscv32")]
mod memory;

#[cfg(target_arch = "riscv32")]
pub use memory::used;

/// A future that is polled on a stack of its own.
///
/// Dropping it is as safe as dropping what is in it.
#[derive(Debug)]
pub struct OnOwnStack<F> {
    inner: F,
    #[cfg(target_arch = "riscv32")]
    stack: &'static mut memory::Stack,
}

impl<F: Future> OnOwnStack<F> {
    /// Gives `inner` the stack.
    ///
    /// # Panics
    /// On RISC-V when called twice: there is one such stack.
    pub fn new(inner: F) -> Self {
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
        // SAFETY: `inner` is never moved out of a pinned `OnOwnStack`, and `stack` need not be pinned.
        let this = unsafe { self.get_unchecked_mut() };
        // SAFETY: as above.
        let inner = unsafe { Pin::new_unchecked(&mut this.inner) };
        #[cfg(target_arch = "riscv32")]
        return this.stack.run(|| inner.poll(cx));
        #[cfg(not(target_arch = "riscv32"))]
        inner.poll(cx)
    }
}
