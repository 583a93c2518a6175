//! What the tests of this crate share: a clock, an executor, a random generator and ports, all
//! values, none of them real.

pub(crate) mod flash;
pub(crate) mod ports;

use core::cell::{Cell, RefCell};
use core::convert::Infallible;
use core::future::poll_fn;
use core::pin::Pin;
use core::task::{Context, Poll, Waker};
use std::boxed::Box;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::Wake;
use std::vec::Vec;

use crawler_hal::{Clock, Duration, Instant};
use crawler_protocol::{Fleet, Kind, RobotId, Source};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use rand_core::TryRng;

use crate::config::{Config, Geometry};
use crate::context::Robot;
use crate::controller::Inputs;
use crate::order::{self, Order, Sender, UpdateWish};
use crate::perception::{Charge, LinkHealth, Reading, SensorHealth, Sight};
use crate::policy::Policies;

pub(crate) type TestRobot = Robot<NoopRawMutex>;

pub(crate) fn robot(id: &str) -> TestRobot {
    robot_with(id, |_| {})
}

pub(crate) fn robot_with(id: &str, change: impl FnOnce(&mut Config)) -> TestRobot {
    let mut config = Config {
        id: RobotId::new(id).expect("legal"),
        fleet: Fleet::default(),
        broker_host: "broker".try_into().expect("short"),
        broker_port: 1883,
        kind: Kind::Simulated,
        board: "test",
        firmware: "0.0.0",
        build: None,
        geometry: Geometry::default(),
        credentials: None,
        camera: false,
        eyes: None,
        faults: false,
    };
    change(&mut config);
    Robot::new(config)
}

pub(crate) fn source(name: &str) -> Source {
    Source::new(name).expect("legal")
}

/// What an operator asks for now.
pub(crate) fn asked(task: order::Task, now: Instant) -> Order {
    Order {
        task,
        sender: Sender {
            source: source("operator:ada"),
            seq: 1,
        },
        arrived: now,
    }
}

/// A control step of a robot that nothing is wrong with and that sees this.
pub(crate) fn inputs(sight: Sight, now: Instant, order: Option<&Order>) -> Inputs<'_> {
    Inputs {
        reading: Reading {
            sight: Some((sight, now)),
            health: SensorHealth::Good,
            temperature: None,
        },
        charge: Charge::Good,
        voltage: None,
        fix: None,
        view: None,
        near: &[],
        own: 0,
        guide: None,
        leeway: crate::behaviour::Leeway::ALL,
        link: LinkHealth::Up,
        loaded: true,
        motor_fault: false,
        halt: None,
        order,
        update: UpdateWish::None,
        policies: Policies::NONE,
        decision: None,
    }
}

/// Marsaglia's xorshift64.
#[derive(Debug, Clone)]
pub(crate) struct TestRng(pub(crate) u64);

impl TryRng for TestRng {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        Ok((self.try_next_u64()? >> 32) as u32)
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        Ok(self.0)
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        for byte in bytes {
            *byte = self.try_next_u32()? as u8;
        }
        Ok(())
    }
}

#[derive(Default)]
struct Timers {
    now: Cell<Instant>,
    waiting: RefCell<Vec<(Instant, Waker)>>,
}

/// A clock that stands until the executor moves it.
#[derive(Clone, Default)]
pub(crate) struct TestClock(Rc<Timers>);

impl Clock for TestClock {
    fn now(&self) -> Instant {
        self.0.now.get()
    }

    async fn sleep_until(&self, at: Instant) {
        poll_fn(|context| {
            if at <= self.now() {
                return Poll::Ready(());
            }
            let waker = context.waker().clone();
            self.0.waiting.borrow_mut().push((at, waker));
            Poll::Pending
        })
        .await;
    }
}

impl TestClock {
    fn earliest(&self) -> Option<Instant> {
        self.0.waiting.borrow().iter().map(|(at, _)| *at).min()
    }

    fn advance_to(&self, now: Instant) {
        self.0.now.set(now);
        self.0.waiting.borrow_mut().retain(|(at, waker)| {
            if *at <= now {
                waker.wake_by_ref();
            }
            *at > now
        });
    }
}

struct Flag(AtomicBool);

impl Wake for Flag {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

struct Task<'a> {
    future: Pin<Box<dyn Future<Output = Infallible> + 'a>>,
    woken: Arc<Flag>,
    polls: u64,
}

/// Polls what was woken, and moves the clock when nothing was.
#[derive(Default)]
pub(crate) struct Executor<'a> {
    pub(crate) clock: TestClock,
    tasks: Vec<Task<'a>>,
}

impl<'a> Executor<'a> {
    pub(crate) fn spawn(&mut self, future: impl Future<Output = Infallible> + 'a) {
        self.tasks.push(Task {
            future: Box::pin(future),
            woken: Arc::new(Flag(AtomicBool::new(true))),
            polls: 0,
        });
    }

    /// Polls of the task spawned at `index`, so far.
    pub(crate) fn polls(&self, index: usize) -> u64 {
        self.tasks[index].polls
    }

    pub(crate) fn run_for(&mut self, span: Duration) {
        let end = self.clock.now() + span;
        loop {
            self.run_woken();
            match self.clock.earliest() {
                Some(at) if at <= end => self.clock.advance_to(at),
                Some(_) | None => break,
            }
        }
        self.clock.advance_to(end);
    }

    /// Lets time pass without polling anyone, then polls.
    pub(crate) fn starve(&mut self, span: Duration) {
        self.clock.advance_to(self.clock.now() + span);
        self.run_woken();
    }

    /// Runs until nothing is woken at the present moment.
    pub(crate) fn run_woken(&mut self) {
        let mut rounds = 0;
        loop {
            let mut idle = true;
            for task in &mut self.tasks {
                if !task.woken.0.swap(false, Ordering::Relaxed) {
                    continue;
                }
                idle = false;
                task.polls += 1;
                let waker = Waker::from(task.woken.clone());
                let mut context = Context::from_waker(&waker);
                assert!(task.future.as_mut().poll(&mut context).is_pending());
            }
            if idle {
                return;
            }
            rounds += 1;
            assert!(rounds < 1_000, "a task wakes itself without end");
        }
    }
}
