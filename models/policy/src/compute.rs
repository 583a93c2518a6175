//! What computes: threads, and the vectors of the processor. Neither changes a result.
//!
//! Work is cut in pieces whose number and size follow from the work alone, threads take pieces, and what
//! the pieces come to is put together in their order. Within a piece the order of every sum is fixed: a
//! vector holds sums that are independent of each other, never parts of one. A product and the sum that it
//! goes into are rounded one by one, since a processor may lack the instruction that rounds them at once.

use std::num::NonZeroUsize;
use std::thread;

use pulp::{Arch, WithSimd};

/// Who computes: so many threads, with the vectors of this processor or without.
#[derive(Debug, Clone, Copy)]
pub struct Compute {
    threads: NonZeroUsize,
    arch: Arch,
}

impl Compute {
    /// As many threads as told, and the widest vectors of this processor.
    pub fn new(threads: NonZeroUsize) -> Self {
        Self {
            threads,
            arch: Arch::new(),
        }
    }

    /// Without vectors: slow, and the same results to the last bit. For tests of just that.
    pub const fn without_vectors(threads: NonZeroUsize) -> Self {
        Self {
            threads,
            arch: Arch::Scalar,
        }
    }

    /// How many threads work.
    pub const fn threads(&self) -> usize {
        self.threads.get()
    }

    /// Runs a kernel that is written for vectors of any width, or a closure that is marked as inlined, compiled
    /// for this processor.
    #[inline]
    pub(crate) fn run<Op: WithSimd>(&self, kernel: Op) -> Op::Output {
        self.arch.dispatch(kernel)
    }

    /// Divides `items` in as many parts as there are `scratch` values, and hands each to `work` on a thread of
    /// its own. What `work` makes of an item must not depend on the other items of its part, nor on what it finds
    /// in the scratch value.
    pub(crate) fn spread<T: Send, W: Send>(
        items: &mut [T],
        scratch: &mut [W],
        work: impl Fn(&mut W, &mut [T]) + Sync,
    ) {
        let share = items.len().div_ceil(scratch.len().max(1)).max(1);
        let mut parts = items.chunks_mut(share).zip(scratch);
        let own = parts.next();
        let work = &work;
        thread::scope(|scope| {
            for (part, scratch) in parts {
                scope.spawn(move || work(scratch, part));
            }
            if let Some((part, scratch)) = own {
                work(scratch, part);
            }
        });
    }
}
