//! One subscriber that gets everything.

use std::collections::HashSet;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::publishers::{STAMP, greet, read_packet};
use super::{Qos, packet};

/// How often it looks whether it is to end.
const LOOK: Duration = Duration::from_millis(100);

/// What arrived of the messages that were written in a span of time.
#[derive(Debug, Clone, Default)]
pub struct Heard {
    /// Different messages.
    pub messages: u64,
    /// Messages that had been there before.
    pub again: u64,
    /// From just before the write to the arrival, microseconds, sorted.
    pub latencies_us: Vec<u32>,
}

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    arrived: AtomicU64,
    /// When each message was written, and how long it took.
    all: Mutex<Vec<(u64, u32)>>,
    again: Mutex<Vec<u64>>,
}

/// A subscriber on a thread of its own.
pub struct Subscriber {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Subscriber {
    /// Subscribes to `filter`; when this returns, the broker has agreed.
    ///
    /// # Panics
    /// When the broker does not.
    pub fn start(port: u16, filter: &str, qos: Qos, begun: Instant) -> Self {
        let mut stream = greet(port, "load-listens");
        let (first, body) = read_packet(&mut stream);
        assert!(packet::is_success(first, &body), "not let in: {body:?}");
        stream
            .write_all(&packet::subscribe(filter, qos))
            .expect("the broker reads");
        let (first, body) = read_packet(&mut stream);
        assert!(
            first >> 4 == packet::SUBACK && packet::is_success(first, &body),
            "the subscription is refused: {body:?}"
        );
        stream.set_read_timeout(Some(LOOK)).expect("a socket");
        let shared = Arc::new(Shared::default());
        let thread = std::thread::spawn({
            let shared = Arc::clone(&shared);
            move || listen(stream, &shared, begun)
        });
        Self {
            shared,
            thread: Some(thread),
        }
    }

    /// Messages so far, also those that came twice.
    pub fn arrived(&self) -> u64 {
        self.shared.arrived.load(Ordering::Relaxed)
    }

    /// Waits until `count` have arrived, or `patience` is over.
    pub fn wait(&self, count: u64, patience: Duration) {
        let end = Instant::now() + patience;
        while self.arrived() < count && Instant::now() < end {
            std::thread::sleep(LOOK);
        }
    }

    /// Ends it, and tells what arrived of messages that were written in a span, nanoseconds since
    /// the load began.
    ///
    /// # Panics
    /// When the broker had ended its session.
    pub fn finish(mut self, written_ns: std::ops::Range<u64>) -> Heard {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().expect("the subscriber kept its session");
        }
        let all = self.shared.all.lock();
        let all = all.unwrap_or_else(PoisonError::into_inner);
        let within = all.iter().filter(|(at, _)| written_ns.contains(at));
        let mut latencies_us: Vec<u32> = within.map(|(_, took)| *took).collect();
        latencies_us.sort_unstable();
        let again = self.shared.again.lock();
        let again = again.unwrap_or_else(PoisonError::into_inner);
        Heard {
            messages: latencies_us.len() as u64,
            again: again.iter().filter(|at| written_ns.contains(at)).count() as u64,
            latencies_us,
        }
    }
}

impl Drop for Subscriber {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }
}

fn listen(mut stream: TcpStream, shared: &Shared, begun: Instant) {
    let mut known = HashSet::new();
    let (mut into, mut acks) = (Vec::new(), Vec::new());
    let mut buffer = vec![0; 64 * 1024];
    while !shared.stop.load(Ordering::Relaxed) {
        let taken = match stream.read(&mut buffer) {
            Ok(0) => panic!("the broker ended the session of the subscriber"),
            Ok(taken) => taken,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                continue;
            }
            Err(error) => panic!("the subscriber: {error}"),
        };
        let now = begun.elapsed().as_nanos() as u64;
        into.extend_from_slice(&buffer[..taken]);
        let (mut used, mut fresh, mut twice) = (0, Vec::new(), Vec::new());
        while let Some((first, body, length)) = packet::next(&into[used..]) {
            used += length;
            if first >> 4 != packet::PUBLISH {
                continue;
            }
            let (id, payload) = packet::published(first, body).expect("a message of ours");
            if let Some(id) = id {
                acks.extend_from_slice(&packet::puback(id));
            }
            let (stamp, _) = payload.split_first_chunk::<STAMP>().expect("a stamp");
            let [at @ .., _, _, _, _, _, _, _, _] = stamp;
            let at = u64::from_be_bytes(*at);
            if known.insert(*stamp) {
                fresh.push((at, (now.saturating_sub(at) / 1_000) as u32));
            } else {
                twice.push(at);
            }
        }
        into.drain(..used);
        if !acks.is_empty() {
            stream.write_all(&acks).expect("the broker reads");
            acks.clear();
        }
        let count = fresh.len() + twice.len();
        let mut all = shared.all.lock().unwrap_or_else(PoisonError::into_inner);
        all.append(&mut fresh);
        drop(all);
        let mut again = shared.again.lock().unwrap_or_else(PoisonError::into_inner);
        again.append(&mut twice);
        drop(again);
        shared.arrived.fetch_add(count as u64, Ordering::Relaxed);
    }
}
