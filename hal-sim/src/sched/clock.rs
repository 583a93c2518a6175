//! The world's clock.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::num::NonZero;
use std::pin::Pin;
use std::rc::Rc;
use std::task::{Context, Poll, RawWakerVTable, Waker};

use crawler_hal::{Clock, Instant};

/// No deadline.
pub(super) const NEVER: u64 = u64::MAX;

/// Which waker belongs to the task being polled.
#[derive(Clone, Copy)]
pub(super) struct Polled {
    data: *const (),
    vtable: &'static RawWakerVTable,
}

impl Polled {
    pub(super) fn of(waker: &Waker) -> Self {
        Self {
            data: waker.data(),
            vtable: waker.vtable(),
        }
    }

    fn is(self, waker: &Waker) -> bool {
        self.data == waker.data() && std::ptr::eq(self.vtable, waker.vtable())
    }
}

/// What the scheduler and all handles of its clock share.
pub(super) struct Shared {
    /// Microseconds of world time.
    pub(super) now: Cell<u64>,
    /// The task being polled.
    pub(super) polled: Cell<Option<Polled>>,
    /// Earliest moment the task being polled wants to wake at.
    pub(super) deadline: Cell<u64>,
    /// Sleeps polled with a waker that is not the task's own, by moment and arrival.
    foreign: RefCell<BTreeMap<(u64, u64), Waker>>,
    arrivals: Cell<NonZero<u64>>,
}

impl Shared {
    /// Earliest moment of a sleep that has a waker of its own.
    pub(super) fn foreign_deadline(&self) -> u64 {
        self.foreign
            .borrow()
            .first_key_value()
            .map_or(NEVER, |(&(at, _), _)| at)
    }

    /// Takes the first waker whose moment has come.
    pub(super) fn pop_foreign(&self) -> Option<Waker> {
        let mut foreign = self.foreign.borrow_mut();
        let first = foreign.first_entry()?;
        (first.key().0 <= self.now.get()).then(|| first.remove())
    }
}

/// Virtual time of one world: a handle that is cheap to clone.
///
/// Every handle tells the moments of one body: [`Instant::BOOT`] is when [`SimClock::boot_now`]
/// made the handle, or the beginning of the world. Time moves only when the scheduler of the
/// world moves it.
#[derive(Clone)]
pub struct SimClock {
    shared: Rc<Shared>,
    boot: u64,
}

impl SimClock {
    /// A clock of a new world, at its beginning.
    #[must_use]
    pub fn new() -> Self {
        Self {
            shared: Rc::new(Shared {
                now: Cell::new(0),
                polled: Cell::new(None),
                deadline: Cell::new(NEVER),
                foreign: RefCell::new(BTreeMap::new()),
                arrivals: Cell::new(NonZero::<u64>::MIN),
            }),
            boot: 0,
        }
    }

    /// The clock of a body that boots at this moment of the same world.
    #[must_use]
    pub fn boot_now(&self) -> Self {
        Self {
            shared: Rc::clone(&self.shared),
            boot: self.shared.now.get(),
        }
    }

    /// The same world's clock, counting from the beginning of the world.
    #[must_use]
    pub fn world(&self) -> Self {
        Self {
            shared: Rc::clone(&self.shared),
            boot: 0,
        }
    }

    pub(super) fn shared(&self) -> &Rc<Shared> {
        &self.shared
    }
}

impl Default for SimClock {
    fn default() -> Self {
        Self::new()
    }
}

impl std::fmt::Debug for SimClock {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("SimClock").field(&self.now()).finish()
    }
}

impl Clock for SimClock {
    fn now(&self) -> Instant {
        Instant::from_micros(self.shared.now.get() - self.boot)
    }

    fn sleep_until(&self, at: Instant) -> impl Future<Output = ()> {
        Sleep {
            shared: &self.shared,
            at: at.as_micros().saturating_add(self.boot),
            arrival: None,
        }
    }
}

/// The future of [`SimClock::sleep_until`].
///
/// A task under poll only notes its earliest deadline: whatever it waits for, it polls again on
/// every poll, so nothing needs to be queued, allocated or cancelled for each sleep. A sleep that
/// is polled with another waker (a combinator that tells its children apart, another executor)
/// keeps that waker in a map until its moment, or until it is dropped.
struct Sleep<'a> {
    shared: &'a Rc<Shared>,
    at: u64,
    /// Its place among the sleeps of that moment, while it is in the map.
    arrival: Option<NonZero<u64>>,
}

impl Sleep<'_> {
    fn forget(&mut self) {
        if let Some(arrival) = self.arrival.take() {
            let key = (self.at, arrival.get());
            self.shared.foreign.borrow_mut().remove(&key);
        }
    }
}

impl Future for Sleep<'_> {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<()> {
        let shared = self.shared;
        if self.at <= shared.now.get() {
            self.forget();
            return Poll::Ready(());
        }
        if shared.polled.get().is_some_and(|p| p.is(cx.waker())) {
            self.forget();
            shared.deadline.set(shared.deadline.get().min(self.at));
        } else if let Some(arrival) = self.arrival {
            let key = (self.at, arrival.get());
            if let Some(waker) = shared.foreign.borrow_mut().get_mut(&key) {
                waker.clone_from(cx.waker());
            }
        } else {
            let arrival = shared.arrivals.get();
            shared.arrivals.set(arrival.saturating_add(1));
            let key = (self.at, arrival.get());
            shared.foreign.borrow_mut().insert(key, cx.waker().clone());
            self.arrival = Some(arrival);
        }
        Poll::Pending
    }
}

impl Drop for Sleep<'_> {
    fn drop(&mut self) {
        self.forget();
    }
}
