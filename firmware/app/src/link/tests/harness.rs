//! A clock, a network and a broker that exist only in a test, and only as far as the link sees.

use core::cell::{Cell, RefCell};
use core::future::poll_fn;
use core::net::{IpAddr, Ipv4Addr};
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::collections::VecDeque;
use std::rc::Rc;
use std::string::{String, ToString};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::Wake;
use std::vec::Vec;

use crawler_hal::{Clock, Duration, Instant, LinkMonitor, LinkState, NetError, Network};
use crawler_protocol::{Fleet, Kind, RobotId};
use embassy_futures::select::{Either, Either3, select, select3};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};

use crate::perception::LinkHealth;
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
struct Pipe {
    to_robot: VecDeque<u8>,
    to_broker: VecDeque<u8>,
    /// The broker's end is closed.
    closed: bool,
    /// The robot's end was dropped.
    dropped: bool,
    /// The broker takes no bytes.
    stalled: bool,
    wakers: Vec<Waker>,
}

impl Pipe {
    fn changed(&mut self) {
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
        Ok(())
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

/// One MQTT packet from the robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Packet {
    pub(super) first: u8,
    pub(super) body: Vec<u8>,
}

impl Packet {
    pub(super) const fn kind(&self) -> u8 {
        self.first >> 4
    }
}

/// A PUBLISH packet from the robot, taken apart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Publish {
    pub(super) topic: String,
    pub(super) qos: u8,
    pub(super) again: bool,
    pub(super) retained: bool,
    pub(super) id: Option<u16>,
    pub(super) payload: Vec<u8>,
}

impl Publish {
    pub(super) fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.payload).expect("the robot sends JSON")
    }
}

/// What the robot asked for at CONNECT.
#[derive(Debug, Clone)]
pub(super) struct Connect {
    pub(super) clean: bool,
    pub(super) keep_alive_s: u16,
    pub(super) client_id: String,
    pub(super) will_qos: u8,
    pub(super) will_retained: bool,
    pub(super) will_topic: String,
    pub(super) will: serde_json::Value,
}

/// Takes fields off the front of a packet.
pub(super) struct Cursor<'a>(pub(super) &'a [u8]);

impl<'a> Cursor<'a> {
    pub(super) fn take(&mut self, count: usize) -> &'a [u8] {
        let (front, rest) = self.0.split_at(count);
        self.0 = rest;
        front
    }

    pub(super) fn byte(&mut self) -> u8 {
        self.take(1)[0]
    }

    pub(super) fn short(&mut self) -> u16 {
        u16::from_be_bytes([self.byte(), self.byte()])
    }

    pub(super) fn bytes(&mut self) -> &'a [u8] {
        let len = self.short();
        self.take(usize::from(len))
    }

    pub(super) fn text(&mut self) -> String {
        String::from_utf8(self.bytes().to_vec()).expect("UTF-8")
    }

    pub(super) fn length(&mut self) -> usize {
        let mut value = 0;
        for shift in [0, 7, 14, 21] {
            let byte = self.byte();
            value |= usize::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return value;
            }
        }
        panic!("a length of more than four bytes");
    }

    pub(super) fn skip_properties(&mut self) {
        let len = self.length();
        self.take(len);
    }
}

/// Writes one packet with a length of any size.
pub(super) fn packet(first: u8, body: &[u8]) -> Vec<u8> {
    let mut out = std::vec![first];
    let mut rest = body.len();
    loop {
        let byte = (rest & 0x7f) as u8;
        rest >>= 7;
        out.push(if rest > 0 { byte | 0x80 } else { byte });
        if rest == 0 {
            break;
        }
    }
    out.extend(body);
    out
}

/// The broker's end of one connection.
pub(super) struct Peer {
    pipe: Rc<RefCell<Pipe>>,
    clock: TestClock,
    next_id: u16,
    /// Whether QoS 1 messages of the robot are acknowledged.
    pub(super) acknowledging: bool,
    /// Whether pings are answered.
    pub(super) answering_pings: bool,
}

impl Peer {
    pub(super) fn send(&self, bytes: &[u8]) {
        let mut pipe = self.pipe.borrow_mut();
        pipe.to_robot.extend(bytes);
        pipe.changed();
    }

    pub(super) fn close(&self) {
        let mut pipe = self.pipe.borrow_mut();
        pipe.closed = true;
        pipe.changed();
    }

    pub(super) fn stall(&self) {
        self.pipe.borrow_mut().stalled = true;
    }

    /// Returns when the robot has dropped the connection.
    pub(super) async fn dropped(&self) {
        poll_fn(|context| {
            let mut pipe = self.pipe.borrow_mut();
            if pipe.dropped {
                return Poll::Ready(());
            }
            pipe.wakers.push(context.waker().clone());
            Poll::Pending
        })
        .await;
    }

    /// The next packet; `None` when the robot has dropped the connection.
    pub(super) async fn packet(&self) -> Option<Packet> {
        poll_fn(|context| {
            let mut pipe = self.pipe.borrow_mut();
            let bytes: Vec<u8> = pipe.to_broker.iter().copied().collect();
            if let Some((used, packet)) = split_packet(&bytes) {
                pipe.to_broker.drain(..used);
                return Poll::Ready(Some(packet));
            }
            if pipe.dropped {
                return Poll::Ready(None);
            }
            pipe.wakers.push(context.waker().clone());
            Poll::Pending
        })
        .await
    }

    pub(super) async fn connect(&self) -> Connect {
        let packet = self.packet().await.expect("CONNECT");
        assert_eq!(packet.kind(), 1);
        let mut body = Cursor(&packet.body);
        assert_eq!((body.text().as_str(), body.byte()), ("MQTT", 5));
        let flags = body.byte();
        assert_eq!(flags & 0b1100_0100, 0b0000_0100, "a will and no password");
        let keep_alive_s = body.short();
        body.skip_properties();
        let client_id = body.text();
        body.skip_properties();
        Connect {
            clean: flags & 2 != 0,
            keep_alive_s,
            client_id,
            will_qos: flags >> 3 & 3,
            will_retained: flags & 0b10_0000 != 0,
            will_topic: body.text(),
            will: serde_json::from_slice(body.bytes()).expect("JSON"),
        }
    }

    /// Answers CONNECT and the four SUBSCRIBEs. The robot is connected then.
    pub(super) async fn accept(&mut self, session_present: bool) -> (Connect, Vec<String>) {
        let connect = self.connect().await;
        self.send(&[0x20, 3, u8::from(session_present), 0, 0]);
        let mut filters = Vec::new();
        while filters.len() < 4 {
            let packet = self.packet().await.expect("SUBSCRIBE");
            if packet.kind() == 8 {
                filters.push(self.grant(&packet));
            } else {
                self.serve(&packet);
            }
        }
        (connect, filters)
    }

    /// Confirms a subscription; the filter and its options, as text.
    pub(super) fn grant(&self, packet: &Packet) -> String {
        let mut body = Cursor(&packet.body);
        let id = body.short().to_be_bytes();
        body.skip_properties();
        let filter = body.text();
        let options = body.byte();
        assert!(body.0.is_empty(), "one filter in one SUBSCRIBE");
        self.send(&[0x90, 4, id[0], id[1], 0, options & 3]);
        std::format!("{filter} {options:#04x}")
    }

    /// Acknowledges and answers what a broker would.
    fn serve(&self, packet: &Packet) -> Option<Publish> {
        match packet.kind() {
            3 => {
                let publish = split_publish(packet);
                if let (Some(id), true) = (publish.id, self.acknowledging) {
                    self.acknowledge(id);
                }
                Some(publish)
            }
            12 => {
                if self.answering_pings {
                    self.send(&[0xd0, 0]);
                }
                None
            }
            4 => None,
            other => panic!("packet of type {other} from the robot"),
        }
    }

    pub(super) fn acknowledge(&self, id: u16) {
        let [high, low] = id.to_be_bytes();
        self.send(&[0x40, 2, high, low]);
    }

    /// The next message of the robot whose topic begins with `prefix`.
    pub(super) async fn publish(&self, prefix: &str) -> Publish {
        loop {
            let packet = self.packet().await.expect("the connection stays open");
            match self.serve(&packet) {
                Some(publish) if publish.topic.starts_with(prefix) => return publish,
                Some(_) | None => {}
            }
        }
    }

    /// All messages until `span` has passed, or the robot has dropped the connection.
    pub(super) async fn publishes_for(&self, span: Duration) -> Vec<Publish> {
        let mut all = Vec::new();
        let end = self.clock.now() + span;
        loop {
            match select(self.packet(), self.clock.sleep_until(end)).await {
                Either::First(Some(packet)) => all.extend(self.serve(&packet)),
                Either::First(None) | Either::Second(()) => return all,
            }
        }
    }

    /// Sends a message at QoS 1.
    pub(super) fn deliver(&mut self, topic: &str, payload: &[u8]) {
        self.next_id += 1;
        let mut body = Vec::new();
        body.extend((topic.len() as u16).to_be_bytes());
        body.extend(topic.as_bytes());
        body.extend(self.next_id.to_be_bytes());
        body.push(0);
        body.extend(payload);
        self.send(&packet(0x32, &body));
    }

    /// Tells the time.
    pub(super) fn deliver_time(&mut self) {
        let now = EPOCH_MS + self.clock.now().as_millis();
        self.deliver(
            "swarm/time",
            std::format!("{{\"timestamp\":{now}}}").as_bytes(),
        );
    }

    /// Sends a command of `operator:ada` that was given now.
    pub(super) fn command(&mut self, seq: u64, name: &str, parameters: &str) {
        let now = EPOCH_MS + self.clock.now().as_millis();
        let text = command(name, parameters, now, seq);
        self.deliver("swarm/command/robot/sim-0001", text.as_bytes());
    }
}

/// A command as JSON.
pub(super) fn command(name: &str, parameters: &str, timestamp: u64, seq: u64) -> String {
    std::format!(
        "{{\"command\":\"{name}\",\"parameters\":{{{parameters}}},\"timestamp\":{timestamp},\
         \"seq\":{seq},\"source\":\"operator:ada\"}}"
    )
}

fn split_packet(bytes: &[u8]) -> Option<(usize, Packet)> {
    let mut len = 0;
    for (index, byte) in bytes.iter().enumerate().skip(1).take(4) {
        len |= usize::from(byte & 0x7f) << (7 * (index - 1));
        if *byte < 0x80 {
            let body = bytes.get(index + 1..index + 1 + len)?.to_vec();
            return Some((
                index + 1 + len,
                Packet {
                    first: bytes[0],
                    body,
                },
            ));
        }
    }
    None
}

pub(super) fn split_publish(packet: &Packet) -> Publish {
    let mut body = Cursor(&packet.body);
    let topic = body.text();
    let qos = packet.first >> 1 & 3;
    let id = (qos > 0).then(|| body.short());
    body.skip_properties();
    Publish {
        topic,
        qos,
        again: packet.first & 8 != 0,
        retained: packet.first & 1 != 0,
        id,
        payload: body.0.to_vec(),
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
        Peer {
            pipe,
            clock: self.clock.clone(),
            next_id: 0,
            acknowledging: true,
            answering_pings: true,
        }
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

    pub(super) fn take_network_down(&self, down: bool) {
        self.network.air.borrow_mut().down = down;
    }

    /// What control is told of the session.
    pub(super) fn health(&self) -> LinkHealth {
        self.robot.link_health.lock(Cell::get)
    }

    /// When the robot tried to connect.
    pub(super) fn attempts(&self) -> Vec<Instant> {
        self.network.air.borrow().attempts.clone()
    }

    pub(super) async fn sleep(&self, span: Duration) {
        self.clock.sleep(span).await;
    }
}

/// A small generator with a fixed seed.
pub(super) struct TestRng(pub(super) u64);

impl rand_core::TryRng for TestRng {
    type Error = core::convert::Infallible;

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

/// A robot that no activity but the link runs for.
pub(super) fn robot() -> Robot<NoopRawMutex> {
    Robot::new(Config {
        id: RobotId::new("sim-0001").expect("an id"),
        fleet: Fleet::new("swarm").expect("a fleet"),
        broker_host: heapless::String::try_from("broker").expect("a host"),
        broker_port: 1883,
        kind: Kind::Simulated,
        board: "sim",
        firmware: "0.1.0",
        geometry: Geometry::default(),
    })
}

/// Runs the link against `script`, until the script is done.
pub(super) fn run<F: Future>(script: impl FnOnce(Broker) -> F) -> F::Output {
    let clock = TestClock::default();
    let network = TestNetwork {
        air: Rc::default(),
        clock: clock.clone(),
    };
    let broker = Broker {
        network: network.clone(),
        clock: clock.clone(),
        robot: Rc::new(robot()),
    };
    let robot = Rc::clone(&broker.robot);
    let link = super::super::link(&robot, network, TestRng(1), clock.clone());
    let limit = clock.sleep(Duration::from_secs(3_600));
    match block_on(&clock, select3(link, script(broker), limit)) {
        Either3::First(never) => match never {},
        Either3::Second(output) => output,
        Either3::Third(()) => panic!("the script waits for what does not happen"),
    }
}

/// `value` of an object, as text.
pub(super) fn field(json: &serde_json::Value, name: &str) -> String {
    match &json[name] {
        serde_json::Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
