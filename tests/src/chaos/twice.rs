//! Sends commands to robots a second time, as a broker may that has not heard an acknowledgement, and
//! as somebody may who has listened.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Filter, Packet};
use rumqttc::v5::{Client, Event, MqttOptions, RecvTimeoutError};
use serde_json::Value;

/// Of so many commands one is sent again.
const ONE_OF: u64 = 20;
/// Between two tries to reach the broker.
const PAUSE: Duration = Duration::from_millis(300);
/// How long one may wait for the next message.
const LOOK: Duration = Duration::from_millis(100);
/// What a forged command's number is raised by.
const FORGED: u64 = 1;

/// See the [module](self).
pub(super) struct Twice {
    stop: Arc<AtomicBool>,
    /// Commands that went again.
    sent: Arc<AtomicU64>,
    thread: JoinHandle<()>,
}

impl Twice {
    /// Listens at the broker on `port`. `forge`: what goes again gets a number of its own, as no
    /// broker does.
    pub(super) fn start(port: u16, forge: bool) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let sent = Arc::new(AtomicU64::new(0));
        let thread = std::thread::spawn({
            let (stop, sent) = (Arc::clone(&stop), Arc::clone(&sent));
            move || {
                while !stop.load(Ordering::Relaxed) {
                    session(port, forge, &stop, &sent);
                    std::thread::sleep(PAUSE);
                }
            }
        });
        Self { stop, sent, thread }
    }

    /// How many commands went again so far.
    pub(super) fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    pub(super) fn stop(self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("whoever sends commands again");
    }
}

/// One session with the broker, to its end.
fn session(port: u16, forge: bool, stop: &AtomicBool, sent: &AtomicU64) {
    let mut options = MqttOptions::new("twice", "127.0.0.1", port);
    options.set_keep_alive(Duration::from_secs(10));
    options.set_clean_start(true);
    let (client, mut connection) = Client::new(options, 1_024);
    let mut filter = Filter::new("swarm/command/robot/+", QoS::AtLeastOnce);
    // Otherwise it would repeat itself.
    filter.nolocal = true;
    if client.try_subscribe_many([filter]).is_err() {
        return;
    }
    let mut heard = 0_u64;
    while !stop.load(Ordering::Relaxed) {
        match connection.recv_timeout(LOOK) {
            Ok(Ok(Event::Incoming(Packet::Publish(publish)))) => {
                heard += 1;
                if !heard.is_multiple_of(ONE_OF) {
                    continue;
                }
                let topic = String::from_utf8_lossy(&publish.topic).into_owned();
                let mut payload = publish.payload.to_vec();
                if forge && let Some(forged) = forged(&payload) {
                    payload = forged;
                }
                // A full queue costs one that would have been sent again.
                if client
                    .try_publish(topic, QoS::AtLeastOnce, false, payload)
                    .is_ok()
                {
                    sent.fetch_add(1, Ordering::Relaxed);
                }
            }
            Ok(Ok(_)) | Err(RecvTimeoutError::Timeout) => {}
            Ok(Err(_)) | Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

fn forged(payload: &[u8]) -> Option<Vec<u8>> {
    let mut command: Value = serde_json::from_slice(payload).ok()?;
    let seq = command["seq"].as_u64()?;
    command["seq"] = (seq + FORGED).into();
    serde_json::to_vec(&command).ok()
}
