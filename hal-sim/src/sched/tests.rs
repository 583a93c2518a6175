use std::cell::{Cell, RefCell};
use std::rc::Rc;

use crawler_hal::{Clock, Duration, Ticker, with_deadline};
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::channel::Channel;

use std::sync::Mutex;

use super::*;

fn ms(value: u64) -> Instant {
    Instant::from_millis(value)
}

type Log = Rc<RefCell<Vec<(u64, &'static str)>>>;

fn note(log: &Log, clock: &SimClock, what: &'static str) {
    log.borrow_mut().push((clock.now().as_millis(), what));
}

#[test]
fn a_ticker_beats_at_exactly_its_times() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let log: Rc<RefCell<Vec<u64>>> = Rc::default();
    sched.spawn({
        let (clock, log) = (clock.clone(), Rc::clone(&log));
        async move {
            let mut ticker = Ticker::every(Duration::from_millis(20), clock.now());
            loop {
                ticker.tick(&clock).await;
                log.borrow_mut().push(clock.now().as_micros());
            }
        }
    });
    sched.run_until(ms(10_000), |_| {});
    let expected: Vec<u64> = (1..=500).map(|n| n * 20_000).collect();
    assert_eq!(*log.borrow(), expected);
    // One poll for each beat and one for the start: it is polled only when woken.
    assert_eq!(sched.polls(), 501);
    assert_eq!(sched.now(), ms(10_000));
}

#[test]
fn a_tick_that_is_late_does_not_shift_the_next_ones() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let log: Rc<RefCell<Vec<u64>>> = Rc::default();
    sched.spawn({
        let (clock, log) = (clock.clone(), Rc::clone(&log));
        async move {
            let mut ticker = Ticker::every(Duration::from_millis(80), clock.now());
            for (late, work) in [
                (0, 0),
                (32, 0),
                (5, 0),
                (30, 60),
                (4, 0),
                (0, 200),
                (7, 0),
                (0, 0),
            ] {
                ticker.tick_late(&clock, Duration::from_millis(late)).await;
                log.borrow_mut().push(clock.now().as_millis());
                clock
                    .sleep_until(clock.now() + Duration::from_millis(work))
                    .await;
            }
        }
    });
    sched.run_until(ms(10_000), |_| {});
    // Behind by 10 ms at 400, and by 120 at 480: there two ticks are skipped.
    assert_eq!(*log.borrow(), [80, 192, 245, 350, 414, 480, 687, 767]);
}

#[test]
fn tasks_due_at_one_moment_run_in_order_of_their_identity() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let log: Rc<RefCell<Vec<usize>>> = Rc::default();
    for index in 0..50_usize {
        let (clock, log) = (clock.clone(), Rc::clone(&log));
        sched.spawn(async move {
            // Arrive in another order than the one they shall run in.
            clock.sleep_until(ms(100 - index as u64)).await;
            clock.sleep_until(ms(200)).await;
            log.borrow_mut().push(index);
        });
    }
    sched.run_until(ms(300), |_| {});
    assert_eq!(*log.borrow(), (0..50).collect::<Vec<_>>());
    assert_eq!(sched.tasks(), 0);
}

#[test]
fn a_channel_wakes_its_reader_at_the_same_moment() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let log = Log::default();
    let channel: Rc<Channel<NoopRawMutex, u8, 4>> = Rc::new(Channel::new());
    sched.spawn({
        let (clock, log, channel) = (clock.clone(), Rc::clone(&log), Rc::clone(&channel));
        async move {
            while channel.receive().await != 0 {
                note(&log, &clock, "received");
            }
            note(&log, &clock, "end");
        }
    });
    sched.spawn({
        let clock = clock.clone();
        async move {
            for value in [3, 2, 0] {
                clock.sleep(Duration::from_millis(7)).await;
                channel.send(value).await;
            }
        }
    });
    sched.run_until(ms(100), |_| {});
    assert_eq!(
        *log.borrow(),
        [(7, "received"), (14, "received"), (21, "end")]
    );
}

#[test]
fn the_losing_sleep_of_a_select_wakes_at_most_once() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    sched.spawn({
        let clock = clock.clone();
        async move {
            for _ in 0..10 {
                let short = clock.sleep(Duration::from_millis(1));
                let long = clock.sleep(Duration::from_millis(50));
                assert!(matches!(select(long, short).await, Either::Second(())));
            }
            std::future::pending::<()>().await;
        }
    });
    sched.run_until(ms(10), |_| {});
    let polls = sched.polls();
    sched.run_until(ms(1_000), |_| {});
    // The last of the long ones was polled before the short one won; the others left no trace.
    assert!(sched.polls() <= polls + 1);
    assert_eq!(sched.next_due(), None);
}

#[test]
fn changing_deadlines_leave_nothing_behind() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let channel: Rc<Channel<NoopRawMutex, (), 1>> = Rc::new(Channel::new());
    sched.spawn({
        let (clock, channel) = (clock.clone(), Rc::clone(&channel));
        async move {
            loop {
                // A new deadline far ahead at each word, as of a keep-alive.
                let deadline = clock.now() + Duration::from_secs(3_600);
                if with_deadline(&clock, deadline, channel.receive())
                    .await
                    .is_err()
                {
                    return;
                }
            }
        }
    });
    for step in 0..50_000 {
        assert!(channel.try_send(()).is_ok());
        sched.run_until(Instant::from_micros(step), |_| {});
    }
    assert!(sched.timers.len() <= 2 + STALE_ENTRIES);
    assert_eq!(
        sched.next_due().map(Instant::as_micros),
        Some(3_600_049_998)
    );
}

#[test]
fn wakers_of_other_combinators_and_threads_work() {
    struct Inner(Waker, AtomicBool);
    impl Wake for Inner {
        fn wake(self: Arc<Self>) {
            self.1.store(true, Ordering::Release);
            self.0.wake_by_ref();
        }
    }
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let done = Rc::new(Cell::new(0));
    sched.spawn({
        let (clock, done) = (clock.clone(), Rc::clone(&done));
        async move {
            // Polls its child only when the child's own waker was called.
            let mut sleep = Box::pin(clock.sleep_until(ms(30)));
            let mut inner: Option<Arc<Inner>> = None;
            std::future::poll_fn(|cx| {
                let inner = inner.get_or_insert_with(|| {
                    Arc::new(Inner(cx.waker().clone(), AtomicBool::new(true)))
                });
                if inner.1.swap(false, Ordering::AcqRel) {
                    let waker = Waker::from(Arc::clone(inner));
                    return sleep.as_mut().poll(&mut Context::from_waker(&waker));
                }
                Poll::Pending
            })
            .await;
            done.set(clock.now().as_millis());
        }
    });
    sched.run_until(ms(100), |_| {});
    assert_eq!(done.get(), 30);

    // From another thread, with an outer waker that tells the host executor.
    let slot: Arc<Mutex<Option<Waker>>> = Arc::default();
    sched.spawn({
        let slot = Arc::clone(&slot);
        let mut first = true;
        std::future::poll_fn(move |cx| {
            *slot.lock().unwrap() = Some(cx.waker().clone());
            if std::mem::take(&mut first) {
                Poll::Pending
            } else {
                Poll::Ready(())
            }
        })
    });
    sched.run();
    let outer = Arc::new(TaskWaker {
        task: 0,
        queued: AtomicBool::new(false),
        ready: Arc::default(),
    });
    assert!(sched.wake_outer_when_ready(&Waker::from(Arc::clone(&outer))));
    let waker = slot.lock().unwrap().take().unwrap();
    std::thread::spawn(move || waker.wake()).join().unwrap();
    assert!(outer.queued.load(Ordering::Acquire));
    assert!(!sched.wake_outer_when_ready(&Waker::from(outer)));
    assert_eq!(sched.next_due(), Some(ms(100)));
    sched.run();
    assert_eq!(sched.tasks(), 0);
}

#[test]
fn a_dropped_foreign_sleep_is_forgotten() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let mut sleep = Box::pin(clock.sleep_until(ms(5)));
    let waker = Waker::noop();
    assert!(
        sleep
            .as_mut()
            .poll(&mut Context::from_waker(waker))
            .is_pending()
    );
    assert_eq!(sched.next_due(), Some(ms(5)));
    drop(sleep);
    assert_eq!(sched.next_due(), None);
}

#[test]
fn a_removed_task_is_dropped_at_once_and_its_wakers_do_nothing() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let held = Rc::new(());
    let channel: Rc<Channel<NoopRawMutex, (), 1>> = Rc::new(Channel::new());
    let tasks: Vec<TaskId> = (0..3)
        .map(|index| {
            let (held, clock, channel) = (Rc::clone(&held), clock.clone(), Rc::clone(&channel));
            sched.spawn(async move {
                if index == 1 {
                    select(clock.sleep_until(ms(10)), channel.receive()).await;
                }
                std::future::pending::<()>().await;
                drop(held);
            })
        })
        .collect();
    sched.run();
    assert_eq!(Rc::strong_count(&held), 4);
    assert!(sched.remove(tasks[1]));
    assert!(!sched.remove(tasks[1]));
    assert_eq!(Rc::strong_count(&held), 3);
    assert_eq!(sched.tasks(), 2);
    // The vacant place is used again, and the old deadline means nothing to its new task.
    let log = Log::default();
    let again = sched.spawn({
        let (clock, log) = (clock.clone(), Rc::clone(&log));
        async move {
            clock.sleep_until(ms(40)).await;
            note(&log, &clock, "again");
        }
    });
    assert_eq!(again, tasks[1]);
    assert!(channel.try_send(()).is_ok());
    sched.run_until(ms(50), |_| {});
    assert_eq!(*log.borrow(), [(40, "again")]);
}

#[test]
fn physics_is_told_of_each_moment_before_its_tasks_run() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let world = Rc::new(Cell::new(Instant::BOOT));
    sched.spawn({
        let (clock, world) = (clock.clone(), Rc::clone(&world));
        async move {
            for at in [3, 20, 21, 45] {
                clock.sleep_until(ms(at)).await;
                assert_eq!(world.get(), clock.now());
            }
        }
    });
    sched.run_until(ms(60), |at| world.set(at));
    assert_eq!(world.get(), ms(60));
    assert_eq!(sched.tasks(), 0);
}

#[test]
fn a_body_that_boots_later_counts_from_its_boot() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    sched.run_until(ms(500), |_| {});
    let body = clock.boot_now();
    assert_eq!(body.now(), Instant::BOOT);
    sched.block_on(body.sleep_until(ms(20)), ms(1_000)).unwrap();
    assert_eq!(body.now(), ms(20));
    assert_eq!(clock.now(), ms(520));
    assert_eq!(body.world().now(), ms(520));
}

#[test]
fn block_on_says_when_nothing_can_happen_any_more() {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    assert_eq!(
        sched.block_on(std::future::pending::<()>(), ms(10)),
        Err(Stalled)
    );
    assert_eq!(
        sched.block_on(clock.sleep_until(ms(20)), ms(10)),
        Err(Stalled)
    );
    assert_eq!(sched.block_on(async { 7 }, ms(10)), Ok(7));
}

#[test]
#[should_panic(expected = "without time passing")]
fn tasks_that_only_wake_each_other_are_caught() {
    let mut sched = Scheduler::new(&SimClock::new());
    sched.spawn(std::future::poll_fn(|cx| {
        cx.waker().wake_by_ref();
        Poll::<()>::Pending
    }));
    sched.run();
}
