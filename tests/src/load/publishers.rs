//! Many publishers on one thread.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::{Qos, packet};

/// Messages that a publisher leaves unacknowledged before it waits.
const MOST_UNACKNOWLEDGED: u64 = 100;
/// The longest rest between two looks at what is due.
const REST: Duration = Duration::from_micros(500);
/// For a broker to let a client in.
const PATIENCE: Duration = Duration::from_secs(20);
/// Bytes at the beginning of a payload that say who wrote it, and when.
pub(super) const STAMP: usize = 16;

/// Makes a payload: publisher, its number there, and the time since the load began in nanoseconds.
pub type Payload = dyn Fn(usize, u64, u64) -> Vec<u8>;

/// Who publishes what, and how often.
pub struct Plan<'a> {
    /// Port of the broker on loopback.
    pub port: u16,
    /// Quality of service.
    pub qos: Qos,
    /// Connections.
    pub clients: usize,
    /// Pause between two messages of one of them.
    pub every: Duration,
    /// The topic of each.
    pub topic: &'a dyn Fn(usize) -> String,
    /// What they write.
    pub payload: &'a Payload,
}

/// What was published in a span of time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sent {
    /// Messages written.
    pub messages: u64,
    /// Turns skipped because the broker was slow to read or to acknowledge.
    pub skipped: u64,
    /// Acknowledgements of success, of all messages so far.
    pub acknowledged: u64,
    /// Acknowledgements that say no, of all messages so far.
    pub refused: u64,
}

struct Client {
    stream: TcpStream,
    topic: String,
    sent: u64,
    answered: u64,
    /// What the socket did not take.
    out: Vec<u8>,
    /// The beginning of a packet.
    into: Vec<u8>,
}

/// All publishers of a load, connected.
pub struct Publishers<'a> {
    plan: Plan<'a>,
    clients: Vec<Client>,
    begun: Instant,
    /// Turns so far; they go round.
    turns: u64,
    /// What the turns before this moment were is forgotten.
    began_sending: Option<Instant>,
    acknowledged: u64,
    refused: u64,
}

/// The first bytes of a payload.
pub fn stamp(client: usize, number: u64, at_ns: u64) -> [u8; STAMP] {
    let mut stamp = [0; STAMP];
    stamp[..8].copy_from_slice(&at_ns.to_be_bytes());
    stamp[8..12].copy_from_slice(&(client as u32).to_be_bytes());
    stamp[12..].copy_from_slice(&(number as u32).to_be_bytes());
    stamp
}

impl<'a> Publishers<'a> {
    /// Connects everybody. Times in payloads count from `begun`.
    ///
    /// # Panics
    /// When the broker does not let somebody in.
    pub fn connect(plan: Plan<'a>, begun: Instant) -> Self {
        let clients = (0..plan.clients)
            .map(|number| Client {
                stream: open(plan.port, &format!("load-{number:04}")),
                topic: (plan.topic)(number),
                sent: 0,
                answered: 0,
                out: Vec::new(),
                into: Vec::new(),
            })
            .collect();
        Self {
            plan,
            clients,
            begun,
            turns: 0,
            began_sending: None,
            acknowledged: 0,
            refused: 0,
        }
    }

    /// Publishes for so long, evenly spread over time and clients.
    ///
    /// # Panics
    /// When the broker ends a connection.
    pub fn run(&mut self, span: Duration) -> Sent {
        let pause = self.plan.every / self.clients.len() as u32;
        let from = *self.began_sending.get_or_insert_with(Instant::now);
        let end = Instant::now() + span;
        let mut sent = Sent::default();
        loop {
            let now = Instant::now();
            if now >= end {
                break;
            }
            let due = (now - from).as_nanos() / pause.as_nanos().max(1);
            if u128::from(self.turns) > due {
                std::thread::sleep(REST);
                continue;
            }
            let index = (self.turns % self.clients.len() as u64) as usize;
            self.turns += 1;
            if self.turn(index) {
                sent.messages += 1;
            } else {
                sent.skipped += 1;
            }
        }
        self.tell(sent)
    }

    /// Publishes nothing more and waits until all is acknowledged, for `patience` at most.
    ///
    /// # Panics
    /// As [`Publishers::run`].
    pub fn settle(&mut self, patience: Duration) -> Sent {
        let end = Instant::now() + patience;
        while Instant::now() < end {
            let mut open = false;
            for index in 0..self.clients.len() {
                self.flush(index);
                self.hear(index);
                let client = &self.clients[index];
                let owed = self.plan.qos == Qos::One && client.answered < client.sent;
                open |= owed || !client.out.is_empty();
            }
            if !open {
                break;
            }
            std::thread::sleep(REST);
        }
        self.tell(Sent::default())
    }

    fn tell(&self, sent: Sent) -> Sent {
        Sent {
            acknowledged: self.acknowledged,
            refused: self.refused,
            ..sent
        }
    }

    /// One client's turn; whether it wrote a message.
    fn turn(&mut self, index: usize) -> bool {
        self.flush(index);
        self.hear(index);
        let client = &mut self.clients[index];
        let owed = match self.plan.qos {
            Qos::Zero => 0,
            Qos::One => client.sent - client.answered,
        };
        if !client.out.is_empty() || owed >= MOST_UNACKNOWLEDGED {
            return false;
        }
        // From 1 to 65,535; far fewer are ever open.
        let id = (client.sent % 65_535 + 1) as u16;
        let at = self.begun.elapsed().as_nanos() as u64;
        let payload = (self.plan.payload)(index, client.sent, at);
        client.out = packet::publish(&client.topic, self.plan.qos, id, &payload);
        client.sent += 1;
        self.flush(index);
        true
    }

    fn flush(&mut self, index: usize) {
        let client = &mut self.clients[index];
        while !client.out.is_empty() {
            match client.stream.write(&client.out) {
                Ok(0) => panic!("the broker has gone"),
                Ok(taken) => drop(client.out.drain(..taken)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) => panic!("publisher {index}: {error}"),
            }
        }
    }

    fn hear(&mut self, index: usize) {
        let client = &mut self.clients[index];
        let mut buffer = [0; 4_096];
        loop {
            match client.stream.read(&mut buffer) {
                Ok(0) => panic!("the broker ended the session of publisher {index}"),
                Ok(taken) => client.into.extend_from_slice(&buffer[..taken]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) => panic!("publisher {index}: {error}"),
            }
        }
        let mut used = 0;
        while let Some((first, body, length)) = packet::next(&client.into[used..]) {
            match first >> 4 {
                packet::PUBACK => {
                    client.answered += 1;
                    if packet::is_success(first, body) {
                        self.acknowledged += 1;
                    } else {
                        self.refused += 1;
                    }
                }
                packet::DISCONNECT => panic!("publisher {index} was sent away: {body:?}"),
                _ => {}
            }
            used += length;
        }
        client.into.drain(..used);
    }
}

/// Connects one client and leaves its socket without blocking.
fn open(port: u16, name: &str) -> TcpStream {
    let mut stream = greet(port, name);
    let (first, body) = read_packet(&mut stream);
    assert!(
        first >> 4 == packet::CONNACK && packet::is_success(first, &body),
        "{name} is not let in: {body:?}"
    );
    stream.set_nonblocking(true).expect("a socket");
    stream
}

/// A connection that has said who it is.
pub(super) fn greet(port: u16, name: &str) -> TcpStream {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("the broker listens");
    stream.set_nodelay(true).expect("a socket");
    stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    stream
        .write_all(&packet::connect(name))
        .expect("the broker reads");
    stream
}

/// One packet of a connection on which nothing else is under way.
pub(super) fn read_packet(stream: &mut TcpStream) -> (u8, Vec<u8>) {
    let (mut bytes, mut byte) = (Vec::new(), [0]);
    loop {
        stream
            .read_exact(&mut byte)
            .expect("an answer of the broker");
        bytes.push(byte[0]);
        if let Some((first, body, _)) = packet::next(&bytes) {
            return (first, body.to_vec());
        }
    }
}
