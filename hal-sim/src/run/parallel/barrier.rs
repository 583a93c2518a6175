//! A barrier that can be left for good.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};

/// Looks at the barrier before a thread lies down, some twenty microseconds: the others are usually
/// there by then, and waking a thread takes longer.
const SPINS: u32 = 1_000;

/// Somebody has left: nobody will come any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Left;

/// Where a fixed number of threads wait for each other, again and again.
#[derive(Debug)]
pub(super) struct Barrier {
    threads: usize,
    spins: u32,
    arrived: AtomicUsize,
    /// How often all have met.
    met: AtomicU64,
    left: AtomicBool,
    /// Guards nothing: it makes lying down and waking up exclude each other.
    bed: Mutex<()>,
    bell: Condvar,
}

impl Barrier {
    /// For so many threads. With fewer `cores` than threads nobody spins: that would keep the one
    /// who is waited for from running.
    pub(super) const fn new(threads: usize, cores: usize) -> Self {
        Self {
            threads,
            spins: if cores < threads { 0 } else { SPINS },
            arrived: AtomicUsize::new(0),
            met: AtomicU64::new(0),
            left: AtomicBool::new(false),
            bed: Mutex::new(()),
            bell: Condvar::new(),
        }
    }

    /// Waits for all.
    ///
    /// # Errors
    /// When one of them has left.
    pub(super) fn wait(&self) -> Result<(), Left> {
        if self.left.load(Ordering::Acquire) {
            return Err(Left);
        }
        let round = self.met.load(Ordering::Acquire);
        if self.arrived.fetch_add(1, Ordering::AcqRel) + 1 == self.threads {
            // Nobody arrives for the next round before `met` says that there is one.
            self.arrived.store(0, Ordering::Release);
            self.met.store(round + 1, Ordering::Release);
            self.ring();
            return Ok(());
        }
        let is_over = || {
            let met = self.met.load(Ordering::Acquire) != round;
            met || self.left.load(Ordering::Acquire)
        };
        for _ in 0..self.spins {
            if is_over() {
                return self.outcome(round);
            }
            std::hint::spin_loop();
        }
        let mut bed = self.bed.lock().unwrap_or_else(PoisonError::into_inner);
        while !is_over() {
            bed = self.bell.wait(bed).unwrap_or_else(PoisonError::into_inner);
        }
        drop(bed);
        self.outcome(round)
    }

    /// Leaves for good: whoever waits now or later is told.
    pub(super) fn leave(&self) {
        self.left.store(true, Ordering::Release);
        self.ring();
    }

    fn outcome(&self, round: u64) -> Result<(), Left> {
        // All met before one of them left: that round still counts.
        if self.met.load(Ordering::Acquire) == round {
            Err(Left)
        } else {
            Ok(())
        }
    }

    fn ring(&self) {
        // With the lock: otherwise one who is about to lie down would not hear it.
        drop(self.bed.lock().unwrap_or_else(PoisonError::into_inner));
        self.bell.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicU32;

    use super::*;

    #[test]
    fn all_meet_in_every_round_whether_they_spin_or_sleep() {
        for (threads, cores) in [(1, 1), (2, 8), (3, 8), (4, 1)] {
            let barrier = Barrier::new(threads, cores);
            let rounds: Vec<AtomicU32> = (0..300).map(|_| AtomicU32::new(0)).collect();
            std::thread::scope(|scope| {
                for _ in 0..threads {
                    scope.spawn(|| {
                        for round in &rounds {
                            round.fetch_add(1, Ordering::Relaxed);
                            barrier.wait().unwrap();
                            let here = round.load(Ordering::Relaxed);
                            assert_eq!(here as usize, threads, "nobody passes alone");
                        }
                    });
                }
            });
        }
    }

    #[test]
    fn one_who_leaves_frees_all_others() {
        for cores in [1, 8] {
            let barrier = Barrier::new(3, cores);
            std::thread::scope(|scope| {
                let waiting = [(); 2].map(|()| {
                    scope.spawn(|| {
                        let mut rounds = 0;
                        while barrier.wait().is_ok() {
                            rounds += 1;
                        }
                        rounds
                    })
                });
                for _ in 0..10 {
                    barrier.wait().unwrap();
                }
                barrier.leave();
                for thread in waiting {
                    assert_eq!(thread.join().unwrap(), 10);
                }
            });
            assert_eq!(barrier.wait(), Err(Left));
        }
    }
}
