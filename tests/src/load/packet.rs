//! The few packets that a load needs (OASIS MQTT Version 5.0, chapter 3).

use super::Qos;

/// Longest that anybody may be silent, seconds: nobody sends pings here.
const KEEP_ALIVE: u16 = 600;
/// Longest packet that is looked at.
const MAX_PACKET: usize = 64 * 1024;

pub(super) const CONNACK: u8 = 2;
pub(super) const PUBLISH: u8 = 3;
pub(super) const PUBACK: u8 = 4;
pub(super) const SUBACK: u8 = 9;
pub(super) const DISCONNECT: u8 = 14;

fn framed(first: u8, body: &[u8]) -> Vec<u8> {
    let mut packet = vec![first];
    let mut length = body.len();
    loop {
        let more = if length > 127 { 0x80 } else { 0 };
        packet.push((length & 0x7F) as u8 | more);
        length >>= 7;
        if length == 0 {
            break;
        }
    }
    packet.extend_from_slice(body);
    packet
}

fn text(into: &mut Vec<u8>, text: &str) {
    let length = u16::try_from(text.len()).expect("a short text");
    into.extend_from_slice(&length.to_be_bytes());
    into.extend_from_slice(text.as_bytes());
}

/// CONNECT, with a clean start.
pub(crate) fn connect(client: &str) -> Vec<u8> {
    let mut body = Vec::new();
    text(&mut body, "MQTT");
    body.extend_from_slice(&[5, 0x02]);
    body.extend_from_slice(&KEEP_ALIVE.to_be_bytes());
    body.push(0);
    text(&mut body, client);
    framed(0x10, &body)
}

/// SUBSCRIBE to one filter.
pub(crate) fn subscribe(filter: &str, qos: Qos) -> Vec<u8> {
    let mut body = vec![0, 1, 0];
    text(&mut body, filter);
    body.push(qos.number());
    framed(0x82, &body)
}

/// PUBLISH. `id` counts at QoS 1 alone.
pub(crate) fn publish(topic: &str, qos: Qos, id: u16, payload: &[u8]) -> Vec<u8> {
    let mut body = Vec::with_capacity(topic.len() + payload.len() + 8);
    text(&mut body, topic);
    if qos == Qos::One {
        body.extend_from_slice(&id.to_be_bytes());
    }
    body.push(0);
    body.extend_from_slice(payload);
    framed(0x30 | qos.number() << 1, &body)
}

/// PUBACK of success.
pub(super) const fn puback(id: [u8; 2]) -> [u8; 4] {
    [0x40, 2, id[0], id[1]]
}

/// A packet in `bytes`: its first byte, what follows the fixed header, and the length of all of it.
/// `None` while it is not whole.
///
/// # Panics
/// When it is longer than anything that a load sends.
pub(super) fn next(bytes: &[u8]) -> Option<(u8, &[u8], usize)> {
    let (&first, rest) = bytes.split_first()?;
    let (mut length, mut head) = (0, 0);
    loop {
        let byte = *rest.get(head)?;
        length |= usize::from(byte & 0x7F) << (7 * head);
        head += 1;
        assert!(length <= MAX_PACKET && head <= 4, "no packet of ours");
        if byte & 0x80 == 0 {
            break;
        }
    }
    let body = rest.get(head..head + length)?;
    Some((first, body, 1 + head + length))
}

/// What is in a PUBLISH: its identifier at QoS 1, and its payload.
pub(super) fn published(first: u8, body: &[u8]) -> Option<(Option<[u8; 2]>, &[u8])> {
    let (length, rest) = body.split_first_chunk::<2>()?;
    let mut rest = rest.get(usize::from(u16::from_be_bytes(*length))..)?;
    let mut id = None;
    if first >> 1 & 3 > 0 {
        let (bytes, after) = rest.split_first_chunk::<2>()?;
        (id, rest) = (Some(*bytes), after);
    }
    let (&properties, after) = rest.split_first()?;
    // Brokers add few properties here, if any: fewer bytes than take two to say.
    let payload = after.get(usize::from(properties & 0x7F)..)?;
    Some((id, payload))
}

/// Whether a CONNACK, SUBACK or PUBACK says yes.
pub(super) fn is_success(first: u8, body: &[u8]) -> bool {
    let reason = match first >> 4 {
        CONNACK => body.get(1),
        SUBACK => body.last(),
        // A PUBACK without a reason is one of success (section 3.4.2.1).
        _ => body.get(2).or(Some(&0)),
    };
    reason.is_some_and(|reason| *reason < 0x80)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        for (qos, id) in [(Qos::Zero, None), (Qos::One, Some([1, 2]))] {
            let packet = publish("a/b", qos, 0x0102, &[9; 200]);
            let (first, body, length) = next(&packet).expect("whole");
            assert_eq!((first >> 4, length), (PUBLISH, packet.len()));
            assert_eq!(published(first, body), Some((id, &[9; 200][..])));
            assert_eq!(next(&packet[..packet.len() - 1]), None);
        }
        assert_eq!(next(&[]), None);
        assert_eq!(next(&[0x40]), None);
        assert_eq!(published(0x30, &[0, 9, 1]), None);
    }

    #[test]
    fn refusals_are_seen() {
        assert!(is_success(0x20, &[0, 0, 0]));
        assert!(!is_success(0x20, &[0, 0x87, 0]));
        assert!(is_success(0x90, &[0, 1, 0, 1]));
        assert!(!is_success(0x90, &[0, 1, 0, 0x87]));
        assert!(is_success(0x40, &[0, 1]));
        assert!(is_success(0x40, &[0, 1, 0x10]));
        assert!(!is_success(0x40, &[0, 1, 0x97, 0]));
    }
}
