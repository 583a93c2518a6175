//! Who is at work in a cycle.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::floods;
use super::follow::{Acknowledged, Follower};
use crate::{Terracrawler, agent};

const OPERATORS: usize = 4;
/// Of one operator. All of them stay below what one address may ask of a server.
const COMMAND_EVERY: Duration = Duration::from_millis(70);
const VIEWERS: usize = 6;
/// How long a viewer looks, and then comes again.
const LOOK: Duration = Duration::from_secs(10);
const FAULT_EVERY: Duration = Duration::from_secs(2);
/// How long a fault lasts, milliseconds.
const FAULT_MS: u64 = 3_000;
/// After something went wrong.
const BACK_OFF: Duration = Duration::from_millis(200);

/// What the crowd has done in a cycle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct CrowdCounts {
    /// Commands acknowledged with 202.
    pub(super) acknowledged: u64,
    /// Commands refused, or not answered while the server was down.
    pub(super) refused: u64,
    /// Times somebody looked at the live feed.
    pub(super) looks: u64,
    /// Faults that robots were given.
    pub(super) faults: u64,
    /// Connections and requests of floods.
    pub(super) floods: u64,
}

/// What those at work share.
#[derive(Default)]
pub(super) struct Work {
    stop: AtomicBool,
    acknowledged: AtomicU64,
    refused: AtomicU64,
    looks: AtomicU64,
    faults: AtomicU64,
    pub(super) floods: AtomicU64,
}

impl Work {
    /// Works at regular times, until it is over; gets the number of the turn.
    pub(super) fn regularly(&self, pause: Duration, mut work: impl FnMut(usize)) {
        let mut due = Instant::now();
        for turn in 0.. {
            if self.is_over() {
                return;
            }
            work(turn);
            // What could not be done in time is not made up for.
            due = (due + pause).max(Instant::now());
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
    }

    pub(super) fn is_over(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Everybody at work.
pub(super) struct Crowd {
    work: Arc<Work>,
    threads: Vec<JoinHandle<()>>,
}

impl Crowd {
    /// Sets everybody to work.
    pub(super) fn start(
        server: &Terracrawler,
        robots: usize,
        cycle: usize,
        follower: &Follower,
    ) -> Self {
        let mut crowd = Self {
            work: Arc::default(),
            threads: Vec::new(),
        };
        let (http, mqtt) = (server.http(), server.mqtt());
        for operator in 0..OPERATORS {
            let (url, follow) = (server.url(), follower.hand());
            crowd.add(move |work| {
                let first = cycle * 7 + operator;
                command(work, &url, first, robots, &follow);
            });
        }
        for _ in 0..VIEWERS {
            crowd.add(move |work| look(work, http));
        }
        let url = server.url();
        crowd.add(move |work| break_robots(work, &url, cycle, robots));
        for flood in floods::ALL {
            let url = server.url();
            crowd.add(move |work| flood(work, &url, mqtt));
        }
        crowd
    }

    fn add(&mut self, work: impl FnOnce(&Work) + Send + 'static) {
        let shared = Arc::clone(&self.work);
        self.threads.push(std::thread::spawn(move || work(&shared)));
    }

    /// Sends everybody home.
    pub(super) fn stop(self) -> CrowdCounts {
        self.work.stop.store(true, Ordering::Relaxed);
        for thread in self.threads {
            thread.join().expect("somebody at work");
        }
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        CrowdCounts {
            acknowledged: count(&self.work.acknowledged),
            refused: count(&self.work.refused),
            looks: count(&self.work.looks),
            faults: count(&self.work.faults),
            floods: count(&self.work.floods),
        }
    }
}

/// Gives one robot after the other something to do.
fn command(work: &Work, url: &str, first: usize, robots: usize, follow: &impl Fn(Acknowledged)) {
    let agent = agent();
    work.regularly(COMMAND_EVERY, |turn| {
        let robot = (first + turn * OPERATORS) % robots;
        let (body, is_durable) = match turn % 8 {
            0 | 4 => (json!({ "command": "identify" }), true),
            1 | 5 => {
                let value = 300 + turn % 100;
                let parameters = json!({ "safe_distance_mm": value });
                (json!({ "command": "set", "parameters": parameters }), true)
            }
            2 | 6 => {
                let parameters = json!({ "direction": "left", "speed": 50, "duration": 300 });
                (
                    json!({ "command": "move", "parameters": parameters }),
                    false,
                )
            }
            3 => (json!({ "command": "stop" }), false),
            _ => {
                let parameters = json!({ "behaviour": "wander" });
                (
                    json!({ "command": "behave", "parameters": parameters }),
                    false,
                )
            }
        };
        let answer = agent
            .post(format!("{url}/api/v1/robots/sim-{:04}/commands", robot + 1))
            .send_json(&body);
        match answer {
            Ok(mut answer) if answer.status() == 202 => {
                work.acknowledged.fetch_add(1, Ordering::Relaxed);
                // Acknowledged, whether or not the rest of the answer arrives.
                let view: Option<Value> = answer.body_mut().read_json().ok();
                let id = view.and_then(|view| Some(view["id"].as_str()?.to_owned()));
                if let Some(id) = id.filter(|_| is_durable) {
                    follow(Acknowledged::now(id));
                }
            }
            Ok(mut answer) => {
                // To its end, so that the connection can be used again.
                let _ = answer.body_mut().read_to_string();
                work.refused.fetch_add(1, Ordering::Relaxed);
            }
            Err(_) => {
                work.refused.fetch_add(1, Ordering::Relaxed);
                std::thread::sleep(BACK_OFF);
            }
        }
    });
}

/// Looks at the live feed for a while, again and again.
fn look(work: &Work, port: u16) {
    let mut bytes = vec![0; 64 * 1024];
    while !work.is_over() {
        let looked = (|| -> std::io::Result<()> {
            let mut stream = TcpStream::connect(("127.0.0.1", port))?;
            stream.set_read_timeout(Some(Duration::from_millis(500)))?;
            // RFC 6455, with the key of its example.
            write!(
                stream,
                "GET /api/v1/live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n\
                 Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
                 Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
            )?;
            let until = Instant::now() + LOOK;
            while Instant::now() < until && !work.is_over() {
                // The feed of a fleet is never silent for long.
                if stream.read(&mut bytes)? == 0 {
                    return Err(std::io::ErrorKind::UnexpectedEof.into());
                }
            }
            Ok(())
        })();
        match looked {
            Ok(()) => {
                work.looks.fetch_add(1, Ordering::Relaxed);
            }
            Err(_) => std::thread::sleep(BACK_OFF),
        }
    }
}

/// Breaks one robot after the other for a while.
fn break_robots(work: &Work, url: &str, cycle: usize, robots: usize) {
    let agent = agent();
    work.regularly(FAULT_EVERY, |turn| {
        let robot = (cycle * 31 + turn * 17) % robots;
        let fault = match turn % 3 {
            0 => json!({ "fault": "ranger-dead" }),
            1 => json!({ "fault": "ranger-stuck", "mm": 300 }),
            _ => json!({ "fault": "link-loss", "how": "silent" }),
        };
        let body = json!({ "fault": fault, "lasting_ms": FAULT_MS });
        let answer = agent
            .post(format!("{url}/api/v1/robots/sim-{:04}/faults", robot + 1))
            .send_json(&body);
        if answer.is_ok_and(|answer| answer.status().is_success()) {
            work.faults.fetch_add(1, Ordering::Relaxed);
        }
    });
}
