//! The scheduler of a world: virtual time, and the tasks that live in it.
//!
//! A [`Scheduler`] is a value on one thread. It polls a task only when the task was woken or its
//! deadline has come, deadlines in order of (time, task), wake-ups in order of arrival, so that
//! the same program takes the same steps on every run. Time stands still while tasks run and
//! jumps when [`Scheduler::advance_to`] says so.
//!
//! Wakers are ordinary [`Waker`]s and may be called from any thread; the live runner hands them
//! to sockets.

use std::pin::{Pin, pin};
use std::ptr::from_ref;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};

use branches::prefetch_read_data;
use crawler_hal::Instant;

mod clock;
mod ready;
#[cfg(test)]
mod tests;
mod timers;

pub use clock::SimClock;
use clock::{NEVER, Polled};
use ready::{Ready, TaskWaker};
use timers::{Entry, TimerQueue};

/// Stale entries the timer queue may hold before it is rebuilt, beyond one for each task.
const STALE_ENTRIES: usize = 1024;

/// Polls a task may take on average within one moment. A robot's link, the busiest of all, stays
/// a hundred times below.
const POLLS_PER_MOMENT: u64 = 10_000;

/// So many polls ahead a task's place in the list is fetched, which tells where its future is,
const FAR_AHEAD: usize = 8;
/// and so many the future itself,
const AHEAD: usize = 4;
/// of which no more than this: the rest of a large one is for what seldom happens.
const MOST_AHEAD: usize = 512;
/// Bytes that come into a cache at once.
const CACHE_LINE: usize = 64;

/// A task of a [`Scheduler`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TaskId(u32);

/// Nothing is left that could make progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stalled;

impl std::fmt::Display for Stalled {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("no task is ready and no deadline lies ahead within the limit")
    }
}

impl std::error::Error for Stalled {}

/// A future, whatever it comes to.
trait Work {
    /// Polls it; true when it is done.
    fn go_on(self: Pin<&mut Self>, context: &mut Context<'_>) -> bool;
}

impl<F: Future> Work for F {
    fn go_on(self: Pin<&mut Self>, context: &mut Context<'_>) -> bool {
        self.poll(context).is_ready()
    }
}

struct Task {
    future: Pin<Box<dyn Work>>,
    state: Arc<TaskWaker>,
    /// The same as `state`, made once so that polling allocates nothing.
    waker: Waker,
    /// When the timer queue shall wake it.
    deadline: u64,
}

/// See the [module](self).
pub struct Scheduler {
    clock: SimClock,
    tasks: Vec<Option<Task>>,
    /// Indices of `tasks` without a task, highest first.
    vacant: Vec<u32>,
    living: usize,
    timers: TimerQueue,
    ready: Arc<Ready>,
    /// The ready list being worked on; swapped with the shared one, so neither is reallocated.
    batch: Vec<u32>,
    polls: u64,
}

impl Scheduler {
    /// A scheduler that moves `clock`, without tasks.
    #[must_use]
    pub fn new(clock: &SimClock) -> Self {
        Self {
            clock: clock.world(),
            tasks: Vec::new(),
            vacant: Vec::new(),
            living: 0,
            timers: TimerQueue::new(),
            ready: Arc::default(),
            batch: Vec::new(),
            polls: 0,
        }
    }

    /// The clock, counting from the beginning of the world.
    #[must_use]
    pub fn clock(&self) -> &SimClock {
        &self.clock
    }

    /// The present moment of the world.
    #[must_use]
    pub fn now(&self) -> Instant {
        Instant::from_micros(self.clock.shared().now.get())
    }

    /// Number of tasks.
    #[must_use]
    pub fn tasks(&self) -> usize {
        self.living
    }

    /// How often a task was polled so far.
    #[must_use]
    pub fn polls(&self) -> u64 {
        self.polls
    }

    /// Adds a task; it is polled first at the next [`Scheduler::run`].
    ///
    /// # Panics
    /// At more than 2³² − 1 tasks.
    pub fn spawn(&mut self, future: impl Future + 'static) -> TaskId {
        let index = self.vacant.pop().unwrap_or_else(|| {
            self.tasks.push(None);
            u32::try_from(self.tasks.len() - 1).expect("fewer than 2^32 tasks")
        });
        let state = Arc::new(TaskWaker {
            task: index,
            queued: AtomicBool::new(false),
            ready: Arc::clone(&self.ready),
        });
        let waker = Waker::from(Arc::clone(&state));
        waker.wake_by_ref();
        self.tasks[index as usize] = Some(Task {
            future: Box::pin(future),
            state,
            waker,
            deadline: NEVER,
        });
        self.living += 1;
        TaskId(index)
    }

    /// Drops a task. Its wakers may outlive it and do nothing. Returns whether there was one.
    ///
    /// An identity of a task that ended by itself must not be kept: it may name a later task.
    pub fn remove(&mut self, task: TaskId) -> bool {
        let Some(slot) = self.tasks.get_mut(task.0 as usize) else {
            return false;
        };
        let removed = slot.take();
        if removed.is_some() {
            self.vacate(task.0);
        }
        removed.is_some()
    }

    fn vacate(&mut self, index: u32) {
        self.living -= 1;
        let place = self.vacant.partition_point(|&v| v > index);
        self.vacant.insert(place, index);
    }

    /// The next moment something is due: the present one when a task is ready.
    #[must_use]
    pub fn next_due(&mut self) -> Option<Instant> {
        let shared = Rc::clone(self.clock.shared());
        if self.ready.any.load(Ordering::Acquire) {
            return Some(self.now());
        }
        let foreign = shared.foreign_deadline();
        let own = loop {
            let Some(entry) = self.timers.peek() else {
                break NEVER;
            };
            if self.stands(entry) {
                break entry.at;
            }
            self.timers.pop_due(entry.at);
        };
        let due = foreign.min(own);
        (due != NEVER).then(|| Instant::from_micros(due.max(shared.now.get())))
    }

    /// Moves time on to `at`; never back. Runs nothing.
    pub fn advance_to(&mut self, at: Instant) {
        let now = &self.clock.shared().now;
        now.set(now.get().max(at.as_micros()));
    }

    /// Polls every task that is ready or due at the present moment, and what these wake, until
    /// nothing is left to do without time passing.
    ///
    /// # Panics
    /// When tasks keep waking each other without time passing: on a board that program would
    /// starve everything else, here it would never return.
    pub fn run(&mut self) {
        let shared = Rc::clone(self.clock.shared());
        let limit = self.polls + POLLS_PER_MOMENT * (self.living as u64 + 1);
        loop {
            assert!(
                self.polls < limit,
                "tasks keep waking each other without time passing, at {:?}",
                self.now()
            );
            if self.ready.any.load(Ordering::Acquire) {
                self.run_ready();
                continue;
            }
            while let Some(waker) = shared.pop_foreign() {
                waker.wake();
            }
            let now = shared.now.get();
            let mut idle = !self.ready.any.load(Ordering::Acquire);
            while let Some(entry) = self.timers.pop_due(now) {
                self.prefetch();
                if self.stands(entry) {
                    idle = false;
                    // Nothing is queued while nothing is ready: that spares a look at each.
                    if self.ready.any.load(Ordering::Acquire) {
                        self.spend_wake_up(entry.task);
                    }
                    self.poll(entry.task);
                }
            }
            if idle {
                return;
            }
        }
    }

    /// Runs until nothing is due before or at `end`, and leaves the clock there. `between` is
    /// called with each moment time is about to reach, before any task of it runs.
    pub fn run_until(&mut self, end: Instant, mut between: impl FnMut(Instant)) {
        self.run();
        while let Some(due) = self.next_due().filter(|&due| due <= end) {
            between(due);
            self.advance_to(due);
            self.run();
        }
        between(end);
        self.advance_to(end);
    }

    /// Runs all tasks until `work` is done, letting time pass as needed, but not beyond `limit`.
    ///
    /// # Errors
    /// [`Stalled`] when `work` cannot be done by then; time then stands at the last wake-up.
    pub fn block_on<F: Future>(&mut self, work: F, limit: Instant) -> Result<F::Output, Stalled> {
        struct Flag(AtomicBool);
        impl Wake for Flag {
            fn wake(self: Arc<Self>) {
                self.0.store(true, Ordering::Release);
            }
        }
        let flag = Arc::new(Flag(AtomicBool::new(true)));
        let waker = Waker::from(Arc::clone(&flag));
        let mut work = pin!(work);
        loop {
            self.run();
            if flag.0.swap(false, Ordering::AcqRel) {
                if let Poll::Ready(done) = work.as_mut().poll(&mut Context::from_waker(&waker)) {
                    return Ok(done);
                }
                continue;
            }
            match self.next_due().filter(|&due| due <= limit) {
                Some(due) => self.advance_to(due),
                None => return Err(Stalled),
            }
        }
    }

    /// Asks for `waker` to be woken once, when a task becomes ready. Returns false, and keeps
    /// nothing, when one is ready already.
    pub fn wake_outer_when_ready(&self, waker: &Waker) -> bool {
        let mut list = self.ready.lock();
        if list.tasks.is_empty() {
            list.outer = Some(waker.clone());
            true
        } else {
            false
        }
    }

    fn stands(&self, entry: Entry) -> bool {
        matches!(self.tasks.get(entry.task as usize), Some(Some(task)) if task.deadline == entry.at)
    }

    /// Has the memory of tasks that are due soon come into the cache while others are polled: thousands of robots
    /// are larger than any, and each poll would begin by waiting for it.
    fn prefetch(&self) {
        let task = |places| self.tasks.get(self.timers.ahead(places)? as usize);
        if let Some(far) = task(FAR_AHEAD) {
            prefetch_read_data::<_, 0>(from_ref(far));
        }
        if let Some(Some(near)) = task(AHEAD) {
            prefetch_read_data::<_, 0>(Arc::as_ptr(&near.state));
            let future = from_ref(&*near.future).cast::<u8>();
            for offset in (0..size_of_val(&*near.future).min(MOST_AHEAD)).step_by(CACHE_LINE) {
                prefetch_read_data::<_, 0>(future.wrapping_add(offset));
            }
        }
    }

    fn run_ready(&mut self) {
        debug_assert!(self.batch.is_empty());
        {
            let mut list = self.ready.lock();
            std::mem::swap(&mut list.tasks, &mut self.batch);
            self.ready.any.store(false, Ordering::Release);
        }
        let batch = std::mem::take(&mut self.batch);
        for &task in &batch {
            self.poll_queued(task);
        }
        self.batch = batch;
        self.batch.clear();
    }

    fn poll_queued(&mut self, index: u32) {
        // A wake-up of a task that is gone, or that ran since for another reason, is spent.
        if self.spend_wake_up(index) {
            self.poll(index);
        }
    }

    /// Whether a task was woken; not any more.
    fn spend_wake_up(&self, index: u32) -> bool {
        let Some(Some(task)) = self.tasks.get(index as usize) else {
            return false;
        };
        task.state.queued.load(Ordering::Acquire) && task.state.queued.swap(false, Ordering::AcqRel)
    }

    fn poll(&mut self, index: u32) {
        let Some(Some(task)) = self.tasks.get_mut(index as usize) else {
            return;
        };
        let shared = self.clock.shared();
        self.polls += 1;
        shared.polled.set(Some(Polled::of(&task.waker)));
        shared.deadline.set(NEVER);
        let done = task
            .future
            .as_mut()
            .go_on(&mut Context::from_waker(&task.waker));
        shared.polled.set(None);
        if done {
            self.tasks[index as usize] = None;
            self.vacate(index);
            return;
        }
        let deadline = shared.deadline.get();
        if deadline != task.deadline {
            task.deadline = deadline;
            if deadline != NEVER {
                self.timers.push(Entry {
                    at: deadline,
                    task: index,
                });
                if self.timers.len() > 2 * self.living + STALE_ENTRIES {
                    self.rebuild_timers();
                }
            }
        }
    }

    /// Drops stale entries: those of tasks that changed their mind.
    fn rebuild_timers(&mut self) {
        self.timers.clear();
        for (index, task) in self.tasks.iter().enumerate() {
            if let Some(task) = task
                && task.deadline != NEVER
            {
                self.timers.push(Entry {
                    at: task.deadline,
                    task: index as u32,
                });
            }
        }
    }
}

impl std::fmt::Debug for Scheduler {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Scheduler")
            .field("now", &self.now())
            .field("tasks", &self.living)
            .field("polls", &self.polls)
            .finish_non_exhaustive()
    }
}
