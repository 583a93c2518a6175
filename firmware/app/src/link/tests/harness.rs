//! A clock, a network and a broker that exist only in a test, and only as far as the link sees.

use core::cell::{Cell, RefCell};
use core::convert::Infallible;
use core::future::poll_fn;
use core::net::{IpAddr, Ipv4Addr};
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::Wake;
use std::vec::Vec;

use crawler_hal::{Clock, Duration, Instant, LinkMonitor, LinkState, NetError, Network};
use crawler_protocol::{BuildId, Fleet, Kind, RobotId};
use embassy_futures::select::{Either3, select3};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};

use super::peer::Peer;
use crate::camera::ImageSlot;
use crate::hold::Inline;
use crate::perception::LinkHealth;
use crate::update::Updates;
use crate::{Config, Geometry, Robot};

/// Unix time at which the test's server believes the robot booted.
pub(super) const EPOCH_MS: u64 = 1_800_000_000_000;

struct Flag(AtomicBool);

impl Wake for Flag {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[derive(Default)]
struct Time {
    now: Cell<u64>,
    sleepers: RefCell<Vec<(u64, Waker)>>,
}

/// Virtual time: it passes only when everybody waits.
#[derive(Clone, Default)]
pub(super) struct TestClock(Rc<Time>);

impl TestClock {
    fn advance(&self) {
        let mut sleepers = self.0.sleepers.borrow_mut();
        let next = sleepers.iter().map(|(at, _)| *at).min();
        let next = next.expect("everybody waits for something that will not happen");
        self.0.now.set(next.max(self.0.now.get()));
        sleepers.retain(|(at, waker)| {
            if *at <= next {
                waker.wake_by_ref();
            }
            *at > next
        });
    }
}

impl Clock for TestClock {
    fn now(&self) -> Instant {
        Instant::from_micros(self.0.now.get())
    }

    async fn sleep_until(&self, at: Instant) {
        poll_fn(|context| {
            if self.now() >= at {
                return Poll::Ready(());
            }
            let sleeper = (at.as_micros(), context.waker().clone());
            self.0.sleepers.borrow_mut().push(sleeper);
            Poll::Pending
        })
        .await;
    }
}

/// Runs `future` in virtual time.
fn block_on<F: Future>(clock: &TestClock, future: F) -> F::Output {
    let flag = Arc::new(Flag(AtomicBool::new(true)));
    let waker = Waker::from(Arc::clone(&flag));
    let mut context = Context::from_waker(&waker);
    let mut future = pin!(future);
    loop {
        while flag.0.swap(false, Ordering::Relaxed) {
            if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
                return output;
            }
        }
        clock.advance();
    }
}

/// One TCP connection, seen from both ends.
#[derive(Default)]
pub(super) struct Pipe {
    pub(super) to_robot: VecDeque<u8>,
    pub(super) to_broker: VecDeque<u8>,
    /// The broker's end is closed.
    pub(super) closed: bool,
    /// The robot's end was dropped.
    pub(super) dropped: bool,
    /// The broker takes no bytes.
    pub(super) stalled: bool,
    pub(super) wakers: Vec<Waker>,
}

impl Pipe {
    pub(super) fn changed(&mut self) {
        self.wakers.drain(..).for_each(Waker::wake);
    }
}

/// The robot's end.
pub(super) struct Stream(Rc<RefCell<Pipe>>);

impl Drop for Stream {
    fn drop(&mut self) {
        let mut pipe = self.0.borrow_mut();
        pipe.dropped = true;
        pipe.changed();
    }
}

impl ErrorType for Stream {
    type Error = ErrorKind;
}

impl Read for Stream {
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, ErrorKind> {
        poll_fn(|context| {
            let mut pipe = self.0.borrow_mut();
            if pipe.to_robot.is_empty() && !pipe.closed {
                pipe.wakers.push(context.waker().clone());
                return Poll::Pending;
            }
            let count = bytes.len().min(pipe.to_robot.len());
            for (byte, arrived) in bytes.iter_mut().zip(pipe.to_robot.drain(..count)) {
                *byte = arrived;
            }
            Poll::Ready(Ok(count))
        })
        .await
    }
}

impl Write for Stream {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        poll_fn(|context| {
            let mut pipe = self.0.borrow_mut();
            if pipe.closed {
                return Poll::Ready(Err(ErrorKind::BrokenPipe));
            }
            if pipe.stalled {
                pipe.wakers.push(context.waker().clone());
                return Poll::Pending;
            }
            pipe.to_broker.extend(bytes);
            pipe.changed();
            Poll::Ready(Ok(bytes.len()))
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

#[derive(Default)]
struct Air {
    waiting: VecDeque<Rc<RefCell<Pipe>>>,
    /// When each connection was attempted.
    attempts: Vec<Instant>,
    refusing: bool,
    down: bool,
    /// Why joining fails; [`NetError::TimedOut`] stands for one that never answers.
    unjoinable: Option<NetError>,
    wakers: Vec<Waker>,
}

/// The network as both sides hold it.
#[derive(Clone, Default)]
pub(super) struct TestNetwork {
    air: Rc<RefCell<Air>>,
    clock: TestClock,
}

impl LinkMonitor for TestNetwork {
    fn state(&self) -> LinkState {
        if self.air.borrow().down {
            return LinkState::Down;
        }
        LinkState::Up {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            rssi_dbm: Some(-61),
        }
    }
}

impl Network for TestNetwork {
    type Stream<'a> = Stream;
    type Monitor = Self;

    fn monitor(&self) -> Self {
        self.clone()
    }

    async fn join(&mut self) -> Result<(), NetError> {
        if self.air.borrow().down {
            return Err(NetError::NotJoined);
        }
        let unjoinable = self.air.borrow().unjoinable;
        match unjoinable {
            None => Ok(()),
            Some(NetError::TimedOut) => core::future::pending().await,
            Some(error) => Err(error),
        }
    }

    async fn connect(&mut self, host: &str, port: u16) -> Result<Stream, NetError> {
        assert_eq!((host, port), ("broker", 1883));
        let mut air = self.air.borrow_mut();
        air.attempts.push(self.clock.now());
        if air.refusing {
            return Err(NetError::Refused);
        }
        let pipe = Rc::new(RefCell::new(Pipe::default()));
        air.waiting.push_back(Rc::clone(&pipe));
        air.wakers.drain(..).for_each(Waker::wake);
        Ok(Stream(pipe))
    }
}

/// The broker's side of a test.
#[derive(Clone)]
pub(super) struct Broker {
    network: TestNetwork,
    pub(super) clock: TestClock,
    pub(super) robot: Rc<Robot<NoopRawMutex>>,
}

impl Broker {
    /// Waits for the robot to open a stream.
    pub(super) async fn peer(&self) -> Peer {
        let pipe = poll_fn(|context| {
            let mut air = self.network.air.borrow_mut();
            while let Some(pipe) = air.waiting.pop_front() {
                // Not one that the robot has given up already.
                if !pipe.borrow().dropped {
                    return Poll::Ready(pipe);
                }
            }
            air.wakers.push(context.waker().clone());
            Poll::Pending
        })
        .await;
        Peer::new(pipe, self.clock.clone())
    }

    /// Waits for the robot, accepts it, and tells it the time.
    pub(super) async fn connected(&self) -> Peer {
        let mut peer = self.peer().await;
        peer.accept(false).await;
        peer.deliver_time();
        peer
    }

    pub(super) fn refuse_connections(&self, refusing: bool) {
        self.network.air.borrow_mut().refusing = refusing;
    }

    pub(super) fn fail_joining(&self, why: Option<NetError>) {
        self.network.air.borrow_mut().unjoinable = why;
    }

    pub(super) fn take_network_down(&self, down: bool) {
        self.network.air.borrow_mut().down = down;
    }

    /// What control is told of the session.
    pub(super) fn health(&self) -> LinkHealth {
        self.robot.link_health()
    }

    /// When the robot tried to connect.
    pub(super) fn attempts(&self) -> Vec<Instant> {
        self.network.air.borrow().attempts.clone()
    }

    pub(super) fn now(&self) -> Instant {
        self.clock.now()
    }

    pub(super) async fn sleep(&self, span: Duration) {
        self.clock.sleep(span).await;
    }
}

/// A small generator with a fixed seed.
pub(super) struct TestRng(pub(super) u64);

impl rand_core::TryRng for TestRng {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Self::Error> {
        self.try_next_u64().map(|value| (value >> 32) as u32)
    }

    fn try_next_u64(&mut self) -> Result<u64, Self::Error> {
        // splitmix64
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        Ok(z ^ (z >> 31))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Self::Error> {
        for chunk in bytes.chunks_mut(8) {
            let value = self.try_next_u64()?.to_le_bytes();
            chunk.copy_from_slice(&value[..chunk.len()]);
        }
        Ok(())
    }
}

/// Images on their way to the link.
pub(super) type Slot = ImageSlot<NoopRawMutex, Vec<u8>>;

/// A robot that no activity but the link runs for.
pub(super) fn robot() -> Robot<NoopRawMutex> {
    Robot::new(config())
}

pub(super) fn config() -> Config {
    Config {
        id: RobotId::new("sim-0001").expect("an id"),
        fleet: Fleet::new("swarm").expect("a fleet"),
        broker_host: heapless::String::try_from("broker").expect("a host"),
        broker_port: 1883,
        kind: Kind::Simulated,
        board: "sim",
        firmware: "0.1.0",
        build: Some(BuildId::development("0.1.0")),
        geometry: Geometry::default(),
        credentials: None,
        camera: false,
        eyes: None,
        faults: false,
    }
}

/// Runs the link against `script`, until the script is done.
pub(super) fn run<F: Future>(script: impl FnOnce(Broker) -> F) -> F::Output {
    run_as(robot(), script)
}

/// The same, for a robot of another sort.
pub(super) fn run_as<F: Future>(
    robot: Robot<NoopRawMutex>,
    script: impl FnOnce(Broker) -> F,
) -> F::Output {
    run_robot(robot, &Slot::new(Vec::new()), script)
}

/// The same, with images to deliver.
pub(super) fn run_with<F: Future>(slot: &Slot, script: impl FnOnce(Broker) -> F) -> F::Output {
    run_robot(robot(), slot, script)
}

/// The same, for a robot that takes updates.
pub(super) fn run_updated<F: Future>(
    updates: &Updates<NoopRawMutex>,
    script: impl FnOnce(Broker) -> F,
) -> F::Output {
    run_link(robot(), script, |robot, network, clock| {
        super::super::link_with_updates_held::<Inline, _, _, _, _, _>(
            robot,
            updates,
            network,
            TestRng(1),
            clock,
        )
    })
}

fn run_robot<F: Future>(
    robot: Robot<NoopRawMutex>,
    slot: &Slot,
    script: impl FnOnce(Broker) -> F,
) -> F::Output {
    run_link(robot, script, |robot, network, clock| {
        super::super::link_with_images(robot, slot, network, TestRng(1), clock)
    })
}

fn run_link<F: Future, L: Future<Output = Infallible>>(
    robot: Robot<NoopRawMutex>,
    script: impl FnOnce(Broker) -> F,
    link: impl FnOnce(Rc<Robot<NoopRawMutex>>, TestNetwork, TestClock) -> L,
) -> F::Output {
    let clock = TestClock::default();
    let network = TestNetwork {
        air: Rc::default(),
        clock: clock.clone(),
    };
    let broker = Broker {
        network: network.clone(),
        clock: clock.clone(),
        robot: Rc::new(robot),
    };
    let link = link(Rc::clone(&broker.robot), network, clock.clone());
    let limit = clock.sleep(Duration::from_secs(3_600));
    match block_on(&clock, select3(link, script(broker), limit)) {
        Either3::First(never) => match never {},
        Either3::Second(output) => output,
        Either3::Third(()) => panic!("the script waits for what does not happen"),
    }
}
