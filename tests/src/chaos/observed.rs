//! What robots did, from the recording of their simulation.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use crawler_sim::run::event_log::{Event, Output, What};
use crawler_sim::run::journal::Payload;
use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde::Deserialize;
use serde_json::Value;

/// A command at a robot's end.
#[derive(Debug, Clone, PartialEq)]
pub struct Delivery {
    /// Time of the world, microseconds.
    pub at_us: u64,
    /// Its number.
    pub seq: u64,
    /// Its name.
    pub command: String,
    /// What else it says.
    pub parameters: Value,
}

/// What a robot answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// As the contract names it.
    pub status: String,
    /// Why, if it says so.
    pub reason: Option<String>,
}

/// From a moment on, in microseconds, whether a wheel is driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Duty(pub u64, pub bool);

/// What one robot did.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Observed {
    /// Commands that reached it, also those that came again.
    pub deliveries: Vec<Delivery>,
    /// What it answered to each number.
    pub answers: BTreeMap<u64, Vec<Answer>>,
    /// When its wheels were driven and when not; only changes.
    pub duties: Vec<Duty>,
    /// Times it started.
    pub boots: u64,
    /// What it counted at the end: commands carried out, and the sum of their numbers modulo 2^64.
    pub carried_out: (u64, u64),
    /// What it last said its parameters are.
    pub parameters: Value,
}

/// What all of them did.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Observations {
    /// By id.
    pub robots: BTreeMap<String, Observed>,
    /// Events that the recording had no room for.
    pub lost: u64,
    /// When it ends, microseconds.
    pub end_us: u64,
}

#[derive(Deserialize)]
struct Message {
    at_us: u64,
    robot: String,
    direction: String,
    topic: String,
    payload: Payload,
}

#[derive(Deserialize)]
struct Devices {
    robot: String,
    lost: u64,
    events: Vec<Event>,
}

#[derive(Deserialize)]
struct Decisions {
    robots: Vec<Decision>,
}

#[derive(Deserialize)]
struct Decision {
    robot: String,
    carried_out: CarriedOut,
}

#[derive(Deserialize)]
struct CarriedOut {
    commands: u64,
    numbers: u64,
}

#[derive(Deserialize)]
struct Boot {
    robot: String,
}

#[derive(Deserialize)]
struct Mark {
    at_us: u64,
}

impl Observations {
    /// Reads a recording that was finished.
    ///
    /// # Panics
    /// When it is none.
    pub fn read(path: &Path) -> Self {
        let mut file = BufReader::new(File::open(path).expect("the recording"));
        let options = LinearReaderOptions::default().with_skip_end_magic(true);
        let mut reader = LinearReader::new_with_options(options);
        let (mut observed, mut channels) = (Self::default(), BTreeMap::new());
        let mut wheels = BTreeMap::new();
        while let Some(event) = reader.next_event() {
            match event.expect("an MCAP file") {
                LinearReadEvent::ReadRequest(need) => {
                    let taken = file.read(reader.insert(need)).expect("the recording");
                    reader.notify_read(taken);
                }
                LinearReadEvent::Record { data, opcode } => {
                    match mcap::parse_record(opcode, data).expect("a record") {
                        Record::Channel(channel) => {
                            channels.insert(channel.id, channel.topic);
                        }
                        Record::Message { header, data } => {
                            if let Some(topic) = channels.get(&header.channel_id) {
                                observed.take(topic, &data, &mut wheels);
                            }
                        }
                        _ => {}
                    }
                }
            }
        }
        observed
    }

    fn robot(&mut self, id: String) -> &mut Observed {
        self.robots.entry(id).or_default()
    }

    fn take(&mut self, topic: &str, data: &[u8], wheels: &mut BTreeMap<String, [u8; 2]>) {
        fn line<'a, T: Deserialize<'a>>(data: &'a [u8]) -> T {
            serde_json::from_slice(data).expect("a line of a recording")
        }
        match topic {
            "/messages" => self.message(line(data)),
            "/boots" => self.robot(line::<Boot>(data).robot).boots += 1,
            "/mark" => self.end_us = line::<Mark>(data).at_us,
            "/decisions" => {
                for Decision { robot, carried_out } in line::<Decisions>(data).robots {
                    let CarriedOut { commands, numbers } = carried_out;
                    self.robot(robot).carried_out = (commands, numbers);
                }
            }
            "/devices" => {
                let devices: Devices = line(data);
                self.lost += devices.lost;
                let duty = wheels.entry(devices.robot.clone()).or_default();
                let observed = self.robots.entry(devices.robot).or_default();
                for Event(at, what) in devices.events {
                    match what {
                        What::Set(Output::LeftDuty, value) => duty[0] = value,
                        What::Set(Output::RightDuty, value) => duty[1] = value,
                        _ => continue,
                    }
                    let driven = *duty != [0, 0];
                    if observed
                        .duties
                        .last()
                        .map_or(driven, |last| last.1 != driven)
                    {
                        observed.duties.push(Duty(at, driven));
                    }
                }
            }
            _ => {}
        }
    }

    fn message(&mut self, message: Message) {
        let kind = message.topic.split('/').nth(1).unwrap_or_default();
        let told = matches!(
            (message.direction.as_str(), kind),
            ("delivered", "command") | ("published", "response" | "parameters")
        );
        if !told {
            return;
        }
        let mut body: Value =
            serde_json::from_slice(message.payload.bytes()).expect("JSON at a robot's end");
        let seq = body["seq"].as_u64();
        let observed = self.robot(message.robot);
        match (kind, seq) {
            ("command", Some(seq)) => observed.deliveries.push(Delivery {
                at_us: message.at_us,
                seq,
                command: body["command"].as_str().unwrap_or_default().to_owned(),
                parameters: body["parameters"].take(),
            }),
            ("response", Some(seq)) => {
                let answer = Answer {
                    status: body["status"].as_str().unwrap_or_default().to_owned(),
                    reason: body["reason"].as_str().map(str::to_owned),
                };
                observed.answers.entry(seq).or_default().push(answer);
            }
            ("parameters", _) => observed.parameters = body["values"].take(),
            _ => {}
        }
    }
}
