use proptest::collection::vec;
use proptest::prelude::*;

use super::*;

fn variable(mut value: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    loop {
        let byte = (value & 0x7f) as u8;
        value >>= 7;
        bytes.push(if value > 0 { byte | 0x80 } else { byte });
        if value == 0 {
            return bytes;
        }
    }
}

fn packet(first: u8, body: &[u8]) -> Vec<u8> {
    [&[first][..], &variable(body.len()), body].concat()
}

fn text(text: &[u8]) -> Vec<u8> {
    [&(text.len() as u16).to_be_bytes()[..], text].concat()
}

/// A property that a publish may have.
#[derive(Debug, Clone)]
enum Property {
    Expiry(u32),
    Format(u8),
    Text(u8, Vec<u8>),
    Subscription(u16),
    User(Vec<u8>, Vec<u8>),
}

impl Property {
    fn bytes(&self) -> Vec<u8> {
        match self {
            Self::Expiry(seconds) => [&[0x02][..], &seconds.to_be_bytes()].concat(),
            Self::Format(format) => vec![0x01, *format],
            Self::Text(id, value) => [&[*id][..], &text(value)].concat(),
            Self::Subscription(id) => [&[0x0b][..], &variable(usize::from(*id))].concat(),
            Self::User(key, value) => [&[0x26][..], &text(key), &text(value)].concat(),
        }
    }

    fn mended(&self) -> Self {
        match self {
            Self::Expiry(0) => Self::Expiry(1),
            other => other.clone(),
        }
    }
}

#[derive(Debug, Clone)]
enum Packet {
    Publish {
        qos: u8,
        topic: Vec<u8>,
        properties: Vec<Property>,
        payload: Vec<u8>,
    },
    Other(u8, Vec<u8>),
}

impl Packet {
    fn bytes(&self) -> Vec<u8> {
        match self {
            Self::Publish {
                qos,
                topic,
                properties,
                payload,
            } => {
                let mut body = text(topic);
                if *qos > 0 {
                    body.extend_from_slice(&[0, 7]);
                }
                let properties: Vec<u8> = properties.iter().flat_map(Property::bytes).collect();
                body.extend_from_slice(&variable(properties.len()));
                body.extend_from_slice(&properties);
                body.extend_from_slice(payload);
                packet(PUBLISH | qos << 1, &body)
            }
            Self::Other(first, body) => packet(*first, body),
        }
    }

    fn mended(&self) -> Self {
        let mut mended = self.clone();
        if let Self::Publish { properties, .. } = &mut mended {
            for property in properties {
                *property = property.mended();
            }
        }
        mended
    }
}

/// Bytes that look like what is searched for.
fn bytes(most: usize) -> impl Strategy<Value = Vec<u8>> {
    vec(
        prop_oneof![Just(0x02), Just(0), Just(0x23), any::<u8>()],
        0..most,
    )
}

fn property() -> impl Strategy<Value = Property> {
    prop_oneof![
        prop_oneof![Just(0), Just(1), Just(256), any::<u32>()].prop_map(Property::Expiry),
        any::<u8>().prop_map(Property::Format),
        (prop_oneof![Just(0x03), Just(0x08), Just(0x09)], bytes(20))
            .prop_map(|(id, value)| Property::Text(id, value)),
        any::<u16>().prop_map(Property::Subscription),
        (bytes(10), bytes(10)).prop_map(|(key, value)| Property::User(key, value)),
    ]
}

fn any_packet() -> impl Strategy<Value = Packet> {
    let publish = (0..3_u8, bytes(10), vec(property(), 0..4), bytes(300)).prop_map(
        |(qos, topic, properties, payload)| Packet::Publish {
            qos,
            topic,
            properties,
            payload,
        },
    );
    let first = prop_oneof![Just(0xc0), Just(0x82), Just(0x40), Just(0xa2)];
    let other = (first, bytes(200)).prop_map(|(first, body)| Packet::Other(first, body));
    prop_oneof![3 => publish, 1 => other]
}

/// Passes bytes in pieces of these lengths, over and over. How many of them counted.
fn pass(packets: &mut Packets, bytes: &mut [u8], pieces: &[usize]) -> Result<usize, TopicAlias> {
    let mut counted = 0;
    let mut rest = bytes;
    for piece in pieces.iter().cycle() {
        if rest.is_empty() {
            break;
        }
        let (piece, behind) = rest.split_at_mut(rest.len().min(*piece));
        counted += packets.pass(piece)?;
        rest = behind;
    }
    Ok(counted)
}

proptest! {
    #[test]
    fn only_an_expiry_of_zero_is_changed(
        sent in vec(any_packet(), 0..6),
        pieces in vec(1..50_usize, 1..6),
    ) {
        let mut bytes: Vec<u8> = sent.iter().flat_map(Packet::bytes).collect();
        let expected: Vec<u8> = sent.iter().flat_map(|packet| packet.mended().bytes()).collect();
        let mut packets = Packets::looked_into();
        prop_assert_eq!(pass(&mut packets, &mut bytes, &pieces), Ok(expected.len()));
        prop_assert_eq!(bytes, expected);
        prop_assert!(packets.is_between());
        prop_assert!(!packets.are_over());
    }

    #[test]
    fn nothing_counts_behind_a_disconnect(
        before in vec(any_packet(), 0..3),
        reason in bytes(20),
        behind in bytes(100),
        pieces in vec(1..50_usize, 1..6),
        into in any::<bool>(),
    ) {
        let mut bytes: Vec<u8> = before.iter().flat_map(Packet::bytes).collect();
        bytes.extend_from_slice(&packet(DISCONNECT, &reason));
        let end = bytes.len();
        bytes.extend_from_slice(&behind);
        let mut packets = if into { Packets::looked_into() } else { Packets::told_apart() };
        prop_assert_eq!(pass(&mut packets, &mut bytes, &pieces), Ok(end));
        prop_assert!(packets.are_over());
        prop_assert!(bytes.ends_with(&behind));
    }

    #[test]
    fn a_topic_alias_is_found_wherever_it_stands(
        before in vec(any_packet(), 0..3),
        properties in vec(property(), 0..3),
        pieces in vec(1..50_usize, 1..6),
    ) {
        let mut bytes: Vec<u8> = before.iter().flat_map(Packet::bytes).collect();
        let mut block: Vec<u8> = properties.iter().flat_map(Property::bytes).collect();
        block.extend_from_slice(&[0x23, 0, 1]);
        let body = [text(b"t"), variable(block.len()), block, b"x".to_vec()].concat();
        bytes.extend_from_slice(&packet(PUBLISH, &body));
        let mut packets = Packets::looked_into();
        prop_assert_eq!(pass(&mut packets, &mut bytes, &pieces), Err(TopicAlias));
    }

    #[test]
    fn no_bytes_are_too_strange(
        mut bytes in bytes(2_000),
        pieces in vec(1..50_usize, 1..6),
    ) {
        let length = bytes.len();
        let _ = pass(&mut Packets::looked_into(), &mut bytes, &pieces);
        prop_assert_eq!(bytes.len(), length);
    }

    #[test]
    fn the_end_of_a_packet_is_found(
        sent in vec(any_packet(), 1..4),
        cut in 0..100_usize,
    ) {
        let mut packets = Packets::told_apart();
        let mut first = sent[0].bytes();
        let cut = cut.clamp(1, first.len() - 1);
        let mut rest = first.split_off(cut);
        prop_assert_eq!(packets.pass(&mut first), Ok(cut));
        prop_assert!(!packets.is_between());
        let end = rest.len();
        rest.extend(sent.iter().skip(1).flat_map(Packet::bytes));
        prop_assert_eq!(packets.finish(&mut rest), end);
        prop_assert!(packets.is_between());
    }
}
