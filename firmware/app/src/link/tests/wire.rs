//! MQTT packets and JSON, taken apart as a broker would, and put together as it would not.

use std::string::{String, ToString};
use std::vec::Vec;

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
    /// The property block, without its length.
    pub(super) properties: Vec<u8>,
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
    pub(super) username: Option<String>,
    pub(super) password: Option<Vec<u8>>,
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

    pub(super) fn properties(&mut self) -> &'a [u8] {
        let len = self.length();
        self.take(len)
    }

    pub(super) fn skip_properties(&mut self) {
        self.properties();
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

/// A command as JSON.
pub(super) fn command(name: &str, parameters: &str, timestamp: u64, seq: u64) -> String {
    std::format!(
        "{{\"command\":\"{name}\",\"parameters\":{{{parameters}}},\"timestamp\":{timestamp},\
         \"seq\":{seq},\"source\":\"operator:ada\"}}"
    )
}

pub(super) fn split_packet(bytes: &[u8]) -> Option<(usize, Packet)> {
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
    let properties = body.properties().to_vec();
    Publish {
        topic,
        properties,
        qos,
        again: packet.first & 8 != 0,
        retained: packet.first & 1 != 0,
        id,
        payload: body.0.to_vec(),
    }
}

/// `value` of an object, as text.
pub(super) fn field(json: &serde_json::Value, name: &str) -> String {
    match &json[name] {
        serde_json::Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
