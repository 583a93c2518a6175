use proptest::prelude::*;

use super::*;
use client::read;

/// What a client reads, independent of what writes: topic, properties without the number, payload.
mod client {
    /// Of every packet: a publish with its topic looked up, or the bytes of anything else.
    pub(super) fn read(mut bytes: &[u8]) -> Vec<(String, Vec<u8>, Vec<u8>)> {
        let mut alias: Option<String> = None;
        let mut all = Vec::new();
        while !bytes.is_empty() {
            let first = bytes[0];
            let (mut length, mut at, mut shift) = (0, 1, 0);
            loop {
                length |= usize::from(bytes[at] & 0x7f) << shift;
                shift += 7;
                at += 1;
                if bytes[at - 1] < 0x80 {
                    break;
                }
            }
            let (body, rest) = bytes[at..].split_at(length);
            bytes = rest;
            if first & 0xf6 != 0x30 {
                all.push((format!("{first:02x}"), Vec::new(), body.to_vec()));
                continue;
            }
            let count = usize::from(u16::from_be_bytes([body[0], body[1]]));
            let (topic, body) = body[2..].split_at(count);
            let mut topic = String::from_utf8(topic.to_vec()).expect("text");
            let count = usize::from(body[0]);
            assert!(count < 0x80, "one byte of length");
            let (properties, payload) = body[1..].split_at(count);
            let mut properties = properties.to_vec();
            if properties.starts_with(&[0x23, 0, 1]) {
                properties.drain(..3);
                if topic.is_empty() {
                    topic = alias.clone().expect("it was explained");
                }
                alias = Some(topic.clone());
            }
            assert!(!topic.is_empty(), "neither a topic nor a number");
            all.push((topic, properties, payload.to_vec()));
        }
        all
    }
}

const TAKES_ONE: Announced = Announced {
    aliases: 1,
    largest: 1_280,
};

fn packet(first: u8, body: &[u8]) -> Vec<u8> {
    let (mut bytes, mut length) = (vec![first], body.len());
    while length >= 0x80 {
        bytes.push(length as u8 | 0x80);
        length >>= 7;
    }
    bytes.push(length as u8);
    [&bytes[..], body].concat()
}

fn publish(topic: &str, properties: &[u8], payload: usize) -> Vec<u8> {
    let mut body = (topic.len() as u16).to_be_bytes().to_vec();
    body.extend(topic.as_bytes());
    body.push(properties.len() as u8);
    body.extend(properties);
    body.extend(std::iter::repeat_n(b'x', payload));
    packet(0x30, &body)
}

fn pass(announced: Announced, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut aliases = Aliases::new(announced).expect("it takes them");
    aliases.pass(bytes, &mut out);
    out
}

#[test]
fn the_topic_of_chunks_is_sent_once() {
    const CHUNK: usize = 1_040;
    let chunk = publish("swarm/ota/sim-0001", &[], CHUNK);
    let sixteen = chunk.repeat(16);
    let out = pass(TAKES_ONE, &sixteen);
    assert_eq!(read(&out), read(&sixteen));
    // First byte, length, no topic, the number, and the properties' length.
    let around = 1 + 2 + 2 + 1 + 3;
    let first = chunk.len() + 3;
    assert_eq!(out.len(), first + 15 * (CHUNK + around));
    assert_eq!(sixteen.len() - out.len(), 15 * 15 - 3);
}

#[test]
fn what_is_small_or_for_sure_or_too_large_keeps_its_topic() {
    let at_qos_1 = {
        let mut body = vec![0, 1, b't', 0, 9, 0];
        body.extend([b'x'; 600]);
        packet(0x32, &body)
    };
    let full = publish("t", &[], 1_273);
    assert_eq!(full.len(), 1_280);
    let long = publish("t", &[0x26; 125], 600);
    let unreadable = publish(&"t".repeat(300), &[], 600);
    for bytes in [
        publish("t", &[], 100),
        at_qos_1,
        full,
        long,
        unreadable,
        packet(0xd0, &[]),
    ] {
        assert_eq!(pass(TAKES_ONE, &bytes), bytes);
    }
}

#[test]
fn what_a_client_announces_is_read_from_its_connect() {
    let connect = |properties: &[u8]| {
        let mut body = b"\0\x04MQTT\x05\x02\0\x06".to_vec();
        body.push(properties.len() as u8);
        body.extend(properties);
        body.extend(b"\0\x01a");
        packet(0x10, &body)
    };
    let none = Announced {
        aliases: 0,
        largest: u32::MAX,
    };
    assert_eq!(Announced::of(&connect(&[])), none);
    let all = [
        &[0x11, 0, 0, 0, 60, 0x26, 0, 1, b'a', 0, 2, b'b', b'c'][..],
        &[0x27, 0, 0, 5, 0, 0x15, 0, 1, b'm', 0x22, 0, 1, 0x17, 1],
    ];
    assert_eq!(Announced::of(&connect(&all.concat())), TAKES_ONE);
    for broken in [&[0x22, 0][..], &[0x22, 0, 1, 0x7f, 0], &[0x26, 0, 9, b'a']] {
        assert_eq!(Announced::of(&connect(broken)).aliases, 0, "{broken:?}");
    }
    let whole = connect(&all.concat());
    for end in 0..whole.len() - 3 {
        assert_eq!(Announced::of(&whole[..end]).aliases, 0, "{end}");
    }
    assert!(Aliases::new(none).is_none());
}

proptest! {
    #[test]
    fn a_client_reads_the_same_whatever_pieces_it_comes_in(
        messages in proptest::collection::vec((0_u8..3, 0_usize..40, 0_usize..1_400), 1..20),
        pieces in proptest::collection::vec(1_usize..2_000, 1..60),
        largest in 100_u32..3_000,
    ) {
        let mut bytes = Vec::new();
        for (topic, properties, payload) in messages {
            let topic = ["swarm/ota/sim-0001", "swarm/cell/1/2", "t"][usize::from(topic)];
            let expiry = [0x02, 0, 0, 0, 5].repeat(properties / 5);
            bytes.extend(publish(topic, &expiry, payload));
            bytes.extend(packet(0xd0, &[]));
        }
        let announced = Announced { aliases: 1, largest };
        let mut aliases = Aliases::new(announced).expect("it takes them");
        let (mut out, mut rest) = (Vec::new(), &bytes[..]);
        for piece in pieces.iter().cycle() {
            let (now, next) = rest.split_at((*piece).min(rest.len()));
            aliases.pass(now, &mut out);
            rest = next;
            if rest.is_empty() {
                break;
            }
        }
        prop_assert_eq!(read(&out), read(&bytes));
        prop_assert_eq!(&out, &pass(announced, &bytes));
    }

    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..2_000)) {
        Announced::of(&bytes);
        let out = pass(TAKES_ONE, &bytes);
        prop_assert!(out.len() <= bytes.len() + 3 * (bytes.len() / 512 + 1));
    }
}
