//! Those who mean no good, or do not know better.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use serde_json::json;

use super::crowd::Work;
use crate::agent;
use crate::load::{Qos, packet};

/// Whoever floods a server at this address over HTTP, or at this port over MQTT.
type Flood = fn(&Work, &str, u16);

pub(super) const ALL: [Flood; 5] = [probes, passwords, silence, comers, talk];

const PROBE_EVERY: Duration = Duration::from_millis(10);
const PASSWORD_EVERY: Duration = Duration::from_millis(500);
const SILENT_EVERY: Duration = Duration::from_millis(100);
/// Connections that say nothing, at a time.
const SILENT: usize = 100;
const COME_EVERY: Duration = Duration::from_millis(100);
/// After a client was cut off.
const CUT_OFF: Duration = Duration::from_secs(5);
/// What talks too much says nothing of use to anybody.
const TOPIC: &str = "swarm/heartbeat/nobody";

/// Asks whether the server is well, all the time.
fn probes(work: &Work, url: &str, _mqtt: u16) {
    let agent = agent();
    work.regularly(PROBE_EVERY, |_| {
        if let Ok(mut answer) = agent.get(format!("{url}/healthz")).call() {
            let _ = answer.body_mut().read_to_string();
            work.floods.fetch_add(1, Ordering::Relaxed);
        }
    });
}

/// Guesses passwords.
fn passwords(work: &Work, url: &str, _mqtt: u16) {
    let agent = agent();
    work.regularly(PASSWORD_EVERY, |turn| {
        let body = json!({ "user": format!("guess-{turn}"), "password": "not the right one" });
        let answer = agent.post(format!("{url}/api/v1/session")).send_json(&body);
        if let Ok(mut answer) = answer {
            let _ = answer.body_mut().read_to_string();
            work.floods.fetch_add(1, Ordering::Relaxed);
        }
    });
}

/// Connects to the broker and says half a word, or nothing.
fn silence(work: &Work, _url: &str, mqtt: u16) {
    let mut held = Vec::new();
    work.regularly(SILENT_EVERY, |turn| {
        if held.len() == SILENT {
            held.remove(0);
        }
        if let Ok(mut stream) = TcpStream::connect(("127.0.0.1", mqtt)) {
            if turn % 2 == 0 {
                let _ = stream.write_all(&packet::connect("half")[..5]);
            }
            held.push(stream);
            work.floods.fetch_add(1, Ordering::Relaxed);
        }
    });
}

/// Comes, is let in and goes, with a goodbye or without.
fn comers(work: &Work, _url: &str, mqtt: u16) {
    work.regularly(COME_EVERY, |turn| {
        let Ok(mut stream) = connected(mqtt, &format!("comer-{}", turn % 50)) else {
            return;
        };
        let _ = stream.write_all(&packet::subscribe("swarm/telemetry/+", Qos::One));
        if turn % 2 == 0 {
            let _ = stream.write_all(&[0xe0, 0]);
        }
        work.floods.fetch_add(1, Ordering::Relaxed);
    });
}

/// Publishes as fast as it can, until it is cut off.
fn talk(work: &Work, _url: &str, mqtt: u16) {
    let words = packet::publish(TOPIC, Qos::Zero, 0, &[b'x'; 200]).repeat(20);
    while !work.is_over() {
        if let Ok(mut stream) = connected(mqtt, "talker") {
            let _ = stream.set_write_timeout(Some(Duration::from_secs(1)));
            while !work.is_over() && stream.write_all(&words).is_ok() {}
            work.floods.fetch_add(1, Ordering::Relaxed);
        }
        let until = Instant::now() + CUT_OFF;
        while Instant::now() < until && !work.is_over() {
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

/// A connection to the broker that has let the client in.
fn connected(port: u16, client: &str) -> std::io::Result<TcpStream> {
    let mut stream = TcpStream::connect(("127.0.0.1", port))?;
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    stream.write_all(&packet::connect(client))?;
    let mut answer = [0; 4];
    stream.read_exact(&mut answer)?;
    if answer[3] == 0 {
        Ok(stream)
    } else {
        Err(std::io::ErrorKind::ConnectionRefused.into())
    }
}
