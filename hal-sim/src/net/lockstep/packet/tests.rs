use super::write::write_varint;
use super::*;
use proptest::prelude::*;

fn frame(first: u8, body: &[u8]) -> Vec<u8> {
    let mut out = vec![first];
    write_varint(&mut out, body.len());
    out.extend_from_slice(body);
    out
}

#[test]
fn a_publish_reads_as_it_was_written() {
    for (at_least_once, retain, len) in [(false, true, 0), (true, false, 200), (true, true, 40_000)]
    {
        let payload = vec![7; len];
        let message = Publication {
            topic: "swarm/time",
            payload: &payload,
            at_least_once,
            retain,
        };
        let mut out = Vec::new();
        write_publish(&mut out, &message, 513, at_least_once);
        assert_eq!(out.len(), publish_len(&message));
        assert_eq!(frame_len(&out), Ok(Some(out.len())));
        let id = if at_least_once { 513 } else { 0 };
        assert_eq!(
            parse(&out),
            Ok(Packet::Publish {
                message,
                id,
                duplicate: at_least_once
            })
        );
    }
}

#[test]
fn filters_select_what_the_standard_says() {
    for (filter, topic, selected) in [
        ("a/b", "a/b", true),
        ("a/b", "a/b/c", false),
        ("a/+", "a/b", true),
        ("a/+", "a/b/c", false),
        ("a/+/c", "a/b/c", true),
        ("a/#", "a/b/c", true),
        ("a/#", "a", true),
        ("#", "a/b", true),
        ("a/b/c", "a/b", false),
    ] {
        assert_eq!(matches(filter, topic), selected, "{filter} {topic}");
    }
}

#[test]
fn each_mistake_has_its_own_error() {
    let short_connect = frame(0x10, b"\x00\x04MQTT\x04\x02\x00\x0a\x00\x00\x01a");
    assert_eq!(parse(&short_connect), Err(PacketError::Version));
    assert_eq!(parse(&frame(0x13, b"")), Err(PacketError::Flags));
    assert_eq!(
        parse(&frame(0x34, b"\x00\x01a\x00\x01\x00")),
        Err(PacketError::Unsupported(0x34))
    );
    assert_eq!(
        parse(&frame(0x30, b"\x00\x01+\x00")),
        Err(PacketError::Topic)
    );
    assert_eq!(
        parse(&frame(0x32, b"\x00\x01a\x00\x00\x00")),
        Err(PacketError::Identifier)
    );
    assert_eq!(
        parse(&frame(0x82, b"\x00\x01\x00\x00\x03a#b\x00")),
        Err(PacketError::Topic)
    );
    assert_eq!(
        parse(&frame(0x30, b"\x00\x01a\x02\x7f\x00")),
        Err(PacketError::Property(0x7F))
    );
    assert_eq!(parse(&frame(0xC0, b"x")), Err(PacketError::Malformed));
    assert_eq!(
        frame_len(&[0x30, 0xFF, 0xFF, 0xFF, 0xFF]),
        Err(PacketError::Malformed)
    );
    assert_eq!(
        frame_len(&[0x30, 0xFF, 0xFF, 0x7F]),
        Err(PacketError::TooLarge)
    );
    assert_eq!(frame_len(&[0x30, 0x80]), Ok(None));
}

proptest! {
    #[test]
    fn no_bytes_panic(kind in any::<u8>(), body in proptest::collection::vec(any::<u8>(), 0..64)) {
        let frame = frame(kind, &body);
        let _ = frame_len(&frame);
        let _ = parse(&frame);
        let _ = frame_len(&body);
        let _ = parse(&body);
    }
}
