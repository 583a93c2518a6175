//! A clock for tests: time passes only when everybody waits.

use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::cell::Cell;
use std::rc::Rc;

use crawler_hal::{Clock, Instant};

/// Virtual time in microseconds.
#[derive(Debug, Clone, Default)]
pub(crate) struct TestClock {
    now: Rc<Cell<u64>>,
    next: Rc<Cell<u64>>,
}

impl TestClock {
    /// Returns when `at` has come.
    pub(crate) async fn wait_for(&self, at: u64) {
        core::future::poll_fn(|_| {
            if self.now.get() >= at {
                Poll::Ready(())
            } else {
                self.next.set(self.next.get().min(at));
                Poll::Pending
            }
        })
        .await;
    }

    pub(crate) fn seconds(&self) -> f64 {
        self.now.get() as f64 / 1e6
    }

    /// Runs `work` to its end, letting time pass whenever it waits.
    pub(crate) fn run<F: Future>(&self, work: F) -> F::Output {
        let mut work = pin!(work);
        let mut context = Context::from_waker(Waker::noop());
        loop {
            self.next.set(u64::MAX);
            if let Poll::Ready(output) = work.as_mut().poll(&mut context) {
                return output;
            }
            assert_ne!(self.next.get(), u64::MAX, "waits for nothing");
            self.now.set(self.next.get());
        }
    }
}

impl Clock for TestClock {
    fn now(&self) -> Instant {
        Instant::from_micros(self.now.get())
    }

    async fn sleep_until(&self, at: Instant) {
        self.wait_for(at.as_micros()).await;
    }
}
