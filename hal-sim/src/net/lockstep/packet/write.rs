//! Packets of the broker, to bytes.

use super::Publication;

pub(in crate::net::lockstep) fn write_conn_ack(
    out: &mut Vec<u8>,
    session_present: bool,
    reason: u8,
) {
    // Without properties: no limit below the standard's own defaults.
    out.extend_from_slice(&[0x20, 3, u8::from(session_present), reason, 0]);
}

pub(in crate::net::lockstep) fn write_ping_resp(out: &mut Vec<u8>) {
    out.extend_from_slice(&[0xD0, 0]);
}

pub(in crate::net::lockstep) fn write_pub_ack(out: &mut Vec<u8>, id: u16) {
    let [high, low] = id.to_be_bytes();
    out.extend_from_slice(&[0x40, 2, high, low]);
}

/// SUBACK and UNSUBACK.
pub(in crate::net::lockstep) fn write_sub_ack(out: &mut Vec<u8>, first: u8, id: u16, codes: &[u8]) {
    out.push(first);
    write_varint(out, 3 + codes.len());
    out.extend_from_slice(&id.to_be_bytes());
    out.push(0);
    out.extend_from_slice(codes);
}

pub(in crate::net::lockstep) fn write_disconnect(out: &mut Vec<u8>, reason: u8) {
    out.extend_from_slice(&[0xE0, 2, reason, 0]);
}

/// Length of a PUBLISH as [`write_publish`] writes it.
pub(in crate::net::lockstep) fn publish_len(message: &Publication<'_>) -> usize {
    let rest = publish_rest(message);
    let digits = match rest {
        0..128 => 1,
        128..16_384 => 2,
        16_384..2_097_152 => 3,
        _ => 4,
    };
    1 + digits + rest
}

fn publish_rest(message: &Publication<'_>) -> usize {
    2 + message.topic.len() + 2 * usize::from(message.at_least_once) + 1 + message.payload.len()
}

/// Writes a PUBLISH; `id` counts at QoS 1 only.
pub(in crate::net::lockstep) fn write_publish(
    out: &mut Vec<u8>,
    message: &Publication<'_>,
    id: u16,
    duplicate: bool,
) {
    out.reserve(publish_len(message));
    let qos = u8::from(message.at_least_once);
    out.push(0x30 | u8::from(duplicate) << 3 | qos << 1 | u8::from(message.retain));
    write_varint(out, publish_rest(message));
    out.extend_from_slice(&(message.topic.len() as u16).to_be_bytes());
    out.extend_from_slice(message.topic.as_bytes());
    if message.at_least_once {
        out.extend_from_slice(&id.to_be_bytes());
    }
    out.push(0);
    out.extend_from_slice(message.payload);
}

pub(super) fn write_varint(out: &mut Vec<u8>, mut value: usize) {
    loop {
        let byte = (value & 0x7F) as u8;
        value >>= 7;
        if value == 0 {
            out.push(byte);
            return;
        }
        out.push(byte | 0x80);
    }
}
