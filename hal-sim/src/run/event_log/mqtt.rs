//! Published messages in a stream of MQTT 5 packets (OASIS MQTT Version 5.0, section 3.3).

/// Longest packet that is looked into; longer ones are passed over.
const MAX_PACKET: usize = 256 * 1024;

/// A message on its way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Publish {
    pub(crate) topic: String,
    pub(crate) payload: Vec<u8>,
    pub(crate) qos: u8,
    pub(crate) retain: bool,
    /// Sent again because nobody had acknowledged it.
    pub(crate) repeated: bool,
}

/// Finds the messages in one direction of a connection, however its bytes are split.
#[derive(Debug, Default)]
pub(crate) struct Packets {
    bytes: Vec<u8>,
    /// Bytes of a packet that is too long to look into.
    skip: usize,
}

impl Packets {
    /// Takes in what was sent next, and gives `found` every message that is whole now.
    pub(crate) fn feed(&mut self, mut bytes: &[u8], mut found: impl FnMut(Publish)) {
        let skipped = self.skip.min(bytes.len());
        self.skip -= skipped;
        bytes = &bytes[skipped..];
        self.bytes.extend_from_slice(bytes);
        let mut used = 0;
        while let Some((head, length)) = frame(&self.bytes[used..]) {
            let all = head + length;
            let there = self.bytes.len() - used;
            if all > MAX_PACKET {
                self.skip = all.saturating_sub(there);
                used += all.min(there);
                continue;
            }
            if all > there {
                break;
            }
            let packet = &self.bytes[used..used + all];
            if let Some(publish) = publish(packet[0], &packet[head..]) {
                found(publish);
            }
            used += all;
        }
        self.bytes.drain(..used);
    }
}

/// Lengths of the fixed header and of what follows it; `None` when there is too little to say. A
/// length that is none ends the stream, as it does for a broker.
fn frame(bytes: &[u8]) -> Option<(usize, usize)> {
    let (length, size) = varint(bytes.get(1..)?)?;
    Some((1 + size, length))
}

fn varint(bytes: &[u8]) -> Option<(usize, usize)> {
    let mut value = 0;
    for (at, &byte) in bytes.iter().enumerate().take(4) {
        value |= usize::from(byte & 0x7F) << (7 * at);
        if byte & 0x80 == 0 {
            return Some((value, at + 1));
        }
    }
    // Four bytes that all go on are no length: whatever follows cannot be told apart.
    (bytes.len() >= 4).then_some((usize::MAX / 2, 4))
}

fn publish(first: u8, body: &[u8]) -> Option<Publish> {
    if first >> 4 != 3 {
        return None;
    }
    let (length, rest) = body.split_first_chunk::<2>()?;
    let (topic, rest) = rest.split_at_checked(usize::from(u16::from_be_bytes(*length)))?;
    let qos = first >> 1 & 3;
    let rest = if qos == 0 { rest } else { rest.get(2..)? };
    let (properties, size) = varint(rest)?;
    let payload = rest.get(size..)?.get(properties..)?;
    Some(Publish {
        topic: String::from_utf8_lossy(topic).into_owned(),
        payload: payload.to_vec(),
        qos,
        retain: first & 1 != 0,
        repeated: first & 8 != 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(first: u8, body: &[u8]) -> Vec<u8> {
        let mut bytes = vec![first];
        let mut length = body.len();
        loop {
            let more = if length > 127 { 0x80 } else { 0 };
            bytes.push(length as u8 & 0x7F | more);
            length >>= 7;
            if more == 0 {
                break;
            }
        }
        bytes.extend_from_slice(body);
        bytes
    }

    #[test]
    fn messages_are_found_however_the_bytes_are_split() {
        let mut stream = packet(0xC0, &[]);
        stream.extend(packet(0x31, b"\x00\x03a/b\x00hello"));
        // QoS 1, again, with a subscription identifier.
        stream.extend(packet(0x3A, b"\x00\x01t\x12\x34\x02\x0B\x05{}"));
        // A broken one: its topic is longer than it.
        stream.extend(packet(0x30, b"\xFF\xFFx"));
        stream.extend(packet(0x30, &vec![0; MAX_PACKET + 5]));
        stream.extend(packet(0x30, b"\x00\x01u\x00"));
        for size in [1, 2, 3, 7, 1_000, stream.len()] {
            let (mut packets, mut found) = (Packets::default(), Vec::new());
            for part in stream.chunks(size) {
                packets.feed(part, |publish| found.push(publish));
            }
            let topics: Vec<_> = found.iter().map(|f| f.topic.as_str()).collect();
            assert_eq!(topics, ["a/b", "t", "u"], "in pieces of {size}");
            assert_eq!(found[0].payload, b"hello");
            assert!(found[0].retain && !found[0].repeated && found[0].qos == 0);
            assert_eq!(found[1].payload, b"{}");
            assert!(found[1].repeated && found[1].qos == 1);
        }
    }

    #[test]
    fn a_stream_that_is_no_mqtt_finds_nothing_and_keeps_little() {
        let mut packets = Packets::default();
        for _ in 0..100 {
            packets.feed(&[0xFF; 10_000], |publish| panic!("{publish:?}"));
        }
        assert!(packets.bytes.len() < 20_000);
    }
}
