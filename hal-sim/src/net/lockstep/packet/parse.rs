//! Packets of clients, from bytes.

use super::reader::{Properties, Reader};
use super::{Connect, Packet, PacketError, Publication};

/// Reads one whole packet.
///
/// # Errors
/// See [`PacketError`].
pub(in crate::net::lockstep) fn parse(frame: &[u8]) -> Result<Packet<'_>, PacketError> {
    let mut r = Reader(frame);
    let first = r.byte()?;
    r.varint()?;
    let flags = first & 0x0F;
    let packet = match first >> 4 {
        1 => {
            require(flags == 0)?;
            Packet::Connect(connect(&mut r)?)
        }
        3 => return publish(&mut r, first),
        4 => {
            require(flags == 0)?;
            let id = r.identifier()?;
            // Reason code and properties may be left out.
            if !r.0.is_empty() {
                r.byte()?;
                if !r.0.is_empty() {
                    r.properties()?;
                }
            }
            Packet::PubAck { id }
        }
        8 => {
            require(flags == 2)?;
            let id = r.identifier()?;
            r.properties()?;
            let mut filters = Vec::new();
            while !r.0.is_empty() {
                let filter = r.filter()?;
                let options = r.byte()?;
                if options & 0x03 == 3 || options & 0xC0 != 0 {
                    return Err(PacketError::Malformed);
                }
                filters.push((filter, options));
            }
            if filters.is_empty() {
                return Err(PacketError::Malformed);
            }
            Packet::Subscribe { id, filters }
        }
        10 => {
            require(flags == 2)?;
            let id = r.identifier()?;
            r.properties()?;
            let mut filters = Vec::new();
            while !r.0.is_empty() {
                filters.push(r.filter()?);
            }
            if filters.is_empty() {
                return Err(PacketError::Malformed);
            }
            Packet::Unsubscribe { id, filters }
        }
        12 => {
            require(flags == 0)?;
            Packet::PingReq
        }
        14 => {
            require(flags == 0)?;
            let reason = if r.0.is_empty() { 0 } else { r.byte()? };
            let properties = if r.0.is_empty() {
                Properties::default()
            } else {
                r.properties()?
            };
            Packet::Disconnect {
                reason,
                session_expiry_s: properties.session_expiry_s,
            }
        }
        _ => return Err(PacketError::Unsupported(first)),
    };
    if r.0.is_empty() {
        Ok(packet)
    } else {
        Err(PacketError::Malformed)
    }
}

fn require(right: bool) -> Result<(), PacketError> {
    if right {
        Ok(())
    } else {
        Err(PacketError::Flags)
    }
}

fn connect<'a>(r: &mut Reader<'a>) -> Result<Connect<'a>, PacketError> {
    if r.text()? != "MQTT" || r.byte()? != 5 {
        return Err(PacketError::Version);
    }
    let flags = r.byte()?;
    let keep_alive_s = r.word()?;
    let properties = r.properties()?;
    let client = r.text()?;
    if client.is_empty() {
        return Err(PacketError::Malformed);
    }
    let will_qos = flags >> 3 & 3;
    let will = if flags & 0x04 == 0 {
        require(flags & 0x38 == 0)?;
        None
    } else {
        r.properties()?;
        let topic = r.topic()?;
        let payload = r.binary()?;
        if will_qos > 1 {
            return Err(PacketError::Unsupported(0x10));
        }
        Some(Publication {
            topic,
            payload,
            at_least_once: will_qos == 1,
            retain: flags & 0x20 != 0,
        })
    };
    let username = (flags & 0x80 != 0).then(|| r.text()).transpose()?;
    let password = (flags & 0x40 != 0).then(|| r.binary()).transpose()?;
    require(flags & 0x01 == 0)?;
    if properties.receive_maximum == Some(0) || properties.maximum_packet == Some(0) {
        return Err(PacketError::Malformed);
    }
    Ok(Connect {
        client,
        clean_start: flags & 0x02 != 0,
        keep_alive_s,
        session_expiry_s: properties.session_expiry_s.unwrap_or(0),
        receive_maximum: properties.receive_maximum.unwrap_or(u16::MAX),
        maximum_packet: properties.maximum_packet.unwrap_or(u32::MAX),
        will,
        username,
        password,
    })
}

fn publish<'a>(r: &mut Reader<'a>, first: u8) -> Result<Packet<'a>, PacketError> {
    let qos = first >> 1 & 3;
    if qos > 1 {
        return Err(PacketError::Unsupported(first));
    }
    let duplicate = first & 0x08 != 0;
    require(qos == 1 || !duplicate)?;
    let topic = r.topic()?;
    let id = if qos == 1 { r.identifier()? } else { 0 };
    r.properties()?;
    let payload = std::mem::take(&mut r.0);
    Ok(Packet::Publish {
        message: Publication {
            topic,
            payload,
            at_least_once: qos == 1,
            retain: first & 0x01 != 0,
        },
        id,
        duplicate,
    })
}
