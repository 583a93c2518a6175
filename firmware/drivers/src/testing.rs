//! A clock and a polling loop for the tests: time stands still while a future runs, and jumps to
//! the next thing it waits for when it does not.

use std::cell::Cell;
use std::future::poll_fn;
use std::pin::pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

use crawler_hal::{Clock, Duration, Instant};

/// A clock that only [`TestClock::block_on`] moves.
#[derive(Debug, Clone, Default)]
pub(crate) struct TestClock {
    now: Rc<Cell<Instant>>,
    next: Rc<Cell<Option<Instant>>>,
}

impl TestClock {
    /// A fake device tells when something will happen at it.
    pub(crate) fn wake_at(&self, at: Instant) {
        assert!(at > self.now.get(), "woken in the past: {at:?}");
        let next = self.next.get().map_or(at, |next| next.min(at));
        self.next.set(Some(next));
    }

    /// Time goes by while nobody waits.
    pub(crate) fn pass(&self, span: Duration) {
        self.now.set(self.now.get() + span);
    }

    /// Runs `future` to its end.
    ///
    /// # Panics
    /// When the future waits for nothing that will ever happen: it hangs.
    pub(crate) fn block_on<F: Future>(&self, future: F) -> F::Output {
        let mut future = pin!(future);
        let mut context = Context::from_waker(Waker::noop());
        // Far more than any exchange takes; a driver that spins fails here.
        for _ in 0..10_000 {
            self.next.set(None);
            if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
                return output;
            }
            self.now.set(self.next.get().expect("the future hangs"));
        }
        panic!("the future spins");
    }
}

impl Clock for TestClock {
    fn now(&self) -> Instant {
        self.now.get()
    }

    async fn sleep_until(&self, at: Instant) {
        poll_fn(|_| {
            if self.now.get() >= at {
                return Poll::Ready(());
            }
            self.wake_at(at);
            Poll::Pending
        })
        .await;
    }
}
