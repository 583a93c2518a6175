//! A man in the middle: passes on what a robot and its controllers say to each other, between two
//! fleets of one broker, but for one lie.

use std::collections::BTreeMap;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{Client, Connection, Event, MqttOptions, RecvTimeoutError};
use serde_json::{Value, json};

/// What is wrong with the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Lie {
    /// Nothing.
    None,
    /// None either: it is of a later version of the protocol, which has more fields and words.
    Newer,
    /// The status names a version of the protocol that is gone.
    OldProtocol,
    /// Every other heartbeat is lost.
    EveryOtherHeartbeat,
    /// Heartbeats are an hour old.
    WrongTime,
    /// Heartbeats have a field that the contract does not have.
    UnknownField,
    /// Answers are longer than a message may be.
    TooLong,
    /// Refusals pass for `completed`.
    YesToEverything,
    /// Nothing is ever refused aloud.
    NoRefusals,
    /// A map that it has not was told, it says.
    EmptyMap,
    /// `set` is answered and not carried out.
    ForgetsSettings,
    /// A repeated command is a new one.
    CarriesOutTwice,
    /// Every command is a fresh one.
    NoAge,
    /// Every boot is by power-on.
    PowerOnAlways,
    /// Telemetry shows wheels at rest.
    NumbWheels,
    /// Telemetry shows wheels in motion.
    NeverRests,
    /// Telemetry takes left for right.
    SwappedWheels,
    /// `stop` is answered and not carried out while the robot moves.
    DeafToStop,
    /// `estop` is a mere `stop`.
    SoftEstop,
    /// `drive` goes on when its controller falls silent.
    Runaway,
}

/// Ends when dropped.
pub(crate) struct Impostor {
    client: Client,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Drop for Impostor {
    fn drop(&mut self) {
        let _ = self.client.disconnect();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Middle {
    client: Client,
    /// The robot's fleet, and the one it is shown in.
    inner: String,
    outer: String,
    robot: String,
    lie: Lie,
    heartbeats: u32,
    /// Numbers already seen, by source.
    last: BTreeMap<String, u64>,
    /// Numbers we gave, and those that the controller knows.
    renamed: BTreeMap<u64, u64>,
    moving: bool,
    /// The last word of who drives.
    driving: Option<Value>,
    driven_at: Instant,
    made_up: u64,
}

const WORD: Duration = Duration::from_millis(200);

fn unix_ms() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.expect("a clock after 1970").as_millis() as u64
}

impl Impostor {
    pub(crate) fn start(port: u16, inner: &str, outer: &str, robot: &str, lie: Lie) -> Self {
        let mut options = MqttOptions::new(format!("impostor-{outer}"), "127.0.0.1", port);
        options.set_keep_alive(Duration::from_mins(1));
        let (client, connection) = Client::new(options, 256);
        for topic in [
            "status",
            "heartbeat",
            "telemetry",
            "parameters",
            "logs",
            "response/robot",
        ] {
            let filter = format!("{inner}/{topic}/{robot}");
            client
                .try_subscribe(filter, QoS::AtLeastOnce)
                .expect("room");
        }
        for topic in [
            format!("command/robot/{robot}"),
            "command/swarm".into(),
            "time".into(),
        ] {
            let filter = format!("{outer}/{topic}");
            client
                .try_subscribe(filter, QoS::AtLeastOnce)
                .expect("room");
        }
        let mut middle = Middle {
            client: client.clone(),
            inner: inner.into(),
            outer: outer.into(),
            robot: robot.into(),
            lie,
            heartbeats: 0,
            last: BTreeMap::new(),
            renamed: BTreeMap::new(),
            moving: false,
            driving: None,
            driven_at: Instant::now(),
            made_up: unix_ms() * 1_000_000,
        };
        let thread = std::thread::spawn(move || middle.serve(connection));
        Self {
            client,
            thread: Some(thread),
        }
    }
}

impl Middle {
    fn serve(&mut self, mut connection: Connection) {
        // Looking at the clock in between would cut a slow connection short.
        let mut connected = false;
        loop {
            let event = if connected {
                match connection.recv_timeout(Duration::from_millis(50)) {
                    Ok(event) => event,
                    Err(RecvTimeoutError::Timeout) => {
                        self.drive_on();
                        continue;
                    }
                    Err(RecvTimeoutError::Disconnected) => return,
                }
            } else {
                match connection.recv() {
                    Ok(event) => event,
                    Err(_) => return,
                }
            };
            match event {
                Ok(Event::Incoming(Packet::Publish(publish))) => {
                    let topic = String::from_utf8_lossy(&publish.topic).into_owned();
                    self.pass(&topic, publish.payload.to_vec(), publish.retain);
                }
                Ok(Event::Incoming(Packet::SubAck(_))) => connected = true,
                Ok(Event::Outgoing(rumqttc::Outgoing::Disconnect)) | Err(_) => return,
                Ok(_) => {}
            }
            self.drive_on();
        }
    }

    fn pass(&mut self, topic: &str, payload: Vec<u8>, retained: bool) {
        if let Some(rest) = topic.strip_prefix(&format!("{}/", self.inner)) {
            let rest = rest.to_owned();
            if let Some(payload) = self.spoken(&rest, payload) {
                let keep = retained || rest.starts_with("status") || rest.starts_with("param");
                self.publish(&format!("{}/{rest}", self.outer), payload, keep);
            }
        } else if let Some(rest) = topic.strip_prefix(&format!("{}/", self.outer)) {
            let rest = rest.to_owned();
            if let Some(payload) = self.told(payload) {
                self.publish(&format!("{}/{rest}", self.inner), payload, false);
            }
        }
    }

    fn publish(&self, topic: &str, payload: Vec<u8>, keep: bool) {
        self.client
            .try_publish(topic, QoS::AtLeastOnce, keep, payload)
            .expect("room");
    }

    /// What becomes of the robot's words.
    fn spoken(&mut self, topic: &str, payload: Vec<u8>) -> Option<Vec<u8>> {
        let mut word: Value = serde_json::from_slice(&payload).expect("a robot speaks JSON");
        let kind = topic.split('/').next().unwrap_or_default();
        match (self.lie, kind) {
            (Lie::OldProtocol, "status") => word["protocol"] = 0.into(),
            (Lie::Newer, "status") => {
                word["protocol"] = 2.into();
                word["wings"] = json!({"left": 1, "right": 1});
            }
            (Lie::Newer, "heartbeat") => word["state"] = "FLYING".into(),
            (Lie::PowerOnAlways, "status") => word["boot"]["cause"] = "power-on".into(),
            (Lie::EveryOtherHeartbeat, "heartbeat") => {
                self.heartbeats += 1;
                if self.heartbeats.is_multiple_of(2) {
                    return None;
                }
            }
            (Lie::WrongTime, "heartbeat") => {
                let time = word["timestamp"].as_u64().unwrap_or_default();
                word["timestamp"] = time.saturating_sub(3_600_000).into();
            }
            (Lie::UnknownField, "heartbeat") => word["mood"] = "fine".into(),
            (Lie::TooLong, "response") => {
                let mut long = word.to_string().into_bytes();
                long.resize(1_025, b' ');
                return Some(long);
            }
            (Lie::YesToEverything, "response") if word["status"] == "rejected" => {
                word["status"] = "completed".into();
                word["reason"] = Value::Null;
            }
            (Lie::EmptyMap, "response") if word["reason"] == "no_map" => {
                word["status"] = "completed".into();
                word["reason"] = Value::Null;
            }
            (Lie::NoRefusals, "response") if word["status"] == "rejected" => return None,
            (Lie::CarriesOutTwice, "response") => {
                let seq = word["seq"].as_u64().unwrap_or_default();
                if let Some(known) = self.renamed.get(&seq) {
                    word["seq"] = (*known).into();
                }
            }
            (Lie::NumbWheels, "telemetry") => word["wheels"] = json!({"left": 0.0, "right": 0.0}),
            (Lie::NeverRests, "telemetry") => word["wheels"] = json!({"left": 0.2, "right": 0.2}),
            (Lie::SwappedWheels, "telemetry") => {
                let (left, right) = (
                    word["wheels"]["left"].take(),
                    word["wheels"]["right"].take(),
                );
                word["wheels"] = json!({"left": right, "right": left});
            }
            (Lie::DeafToStop, "telemetry") => {
                self.moving = word["wheels"] != json!({"left": 0.0, "right": 0.0});
            }
            // Byte by byte as it came.
            _ => return Some(payload),
        }
        Some(word.to_string().into_bytes())
    }

    /// What becomes of a controller's words.
    fn told(&mut self, payload: Vec<u8>) -> Option<Vec<u8>> {
        let Ok(mut word) = serde_json::from_slice::<Value>(&payload) else {
            return Some(payload);
        };
        let Some(seq) = word["seq"].as_u64() else {
            return Some(payload);
        };
        let command = word["command"].as_str().unwrap_or_default().to_owned();
        match self.lie {
            Lie::ForgetsSettings if command == "set" => {
                self.claim(seq);
                return None;
            }
            Lie::DeafToStop if command == "stop" && self.moving => {
                self.claim(seq);
                return None;
            }
            Lie::SoftEstop if command == "estop" => word["command"] = "stop".into(),
            Lie::NoAge => word["timestamp"] = unix_ms().into(),
            Lie::CarriesOutTwice => {
                let source = word["source"].as_str().unwrap_or_default().to_owned();
                if self.last.insert(source, seq) != Some(seq) {
                    return Some(payload);
                }
                self.made_up += 1;
                self.renamed.insert(self.made_up, seq);
                word["seq"] = self.made_up.into();
                word["source"] = "impostor".into();
                word["timestamp"] = unix_ms().into();
            }
            Lie::Runaway => {
                self.driving = (command == "drive").then(|| word.clone());
                self.driven_at = Instant::now();
            }
            _ => return Some(payload),
        }
        Some(word.to_string().into_bytes())
    }

    /// Answers in the robot's name.
    fn claim(&self, seq: u64) {
        let answer = json!({"robot": self.robot, "seq": seq, "status": "completed",
            "reason": null, "timestamp": unix_ms()});
        let topic = format!("{}/response/robot/{}", self.outer, self.robot);
        self.publish(&topic, answer.to_string().into_bytes(), false);
    }

    fn drive_on(&mut self) {
        if self.driven_at.elapsed() < WORD {
            return;
        }
        self.driven_at = Instant::now();
        let Some(mut word) = self.driving.clone() else {
            return;
        };
        self.made_up += 1;
        word["seq"] = self.made_up.into();
        word["source"] = "impostor".into();
        word["timestamp"] = unix_ms().into();
        let topic = format!("{}/command/robot/{}", self.inner, self.robot);
        self.publish(&topic, word.to_string().into_bytes(), false);
    }
}
