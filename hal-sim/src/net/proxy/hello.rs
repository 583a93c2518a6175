//! Who speaks: the client name in the first packet of an MQTT connection.

/// Most bytes looked at.
pub(super) const MOST: usize = 1_024;
/// Longest name that counts.
const LONGEST: usize = 64;

/// What the first bytes of a connection tell.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Hello {
    /// Not enough yet.
    More,
    /// A client with a name.
    Name(String),
    /// Something else, or no name that counts.
    Nobody,
}

/// Looks for the client name in a CONNECT packet of MQTT 3.1.1 or 5 (section 3.1 of both).
pub(super) fn read(bytes: &[u8]) -> Hello {
    match name(bytes) {
        Ok(name) => std::str::from_utf8(name)
            .ok()
            .filter(|name| (1..=LONGEST).contains(&name.len()))
            .filter(|name| !name.chars().any(char::is_control))
            .map_or(Hello::Nobody, |name| Hello::Name(name.to_owned())),
        Err(true) if bytes.len() < MOST => Hello::More,
        Err(_) => Hello::Nobody,
    }
}

/// The client name; the error tells whether more bytes may help.
fn name(bytes: &[u8]) -> Result<&[u8], bool> {
    let (&first, mut rest) = bytes.split_first().ok_or(true)?;
    if first != 0x10 {
        return Err(false);
    }
    number(&mut rest)?;
    if text(&mut rest)? != b"MQTT" {
        return Err(false);
    }
    let level = take(&mut rest, 1)?[0];
    // Flags and keep-alive.
    take(&mut rest, 3)?;
    match level {
        4 => {}
        5 => {
            let properties = number(&mut rest)?;
            take(&mut rest, properties)?;
        }
        _ => return Err(false),
    }
    text(&mut rest)
}

fn take<'a>(rest: &mut &'a [u8], len: usize) -> Result<&'a [u8], bool> {
    let (taken, left) = rest.split_at_checked(len).ok_or(true)?;
    *rest = left;
    Ok(taken)
}

fn text<'a>(rest: &mut &'a [u8]) -> Result<&'a [u8], bool> {
    let len = take(rest, 2)?;
    take(rest, usize::from(u16::from_be_bytes([len[0], len[1]])))
}

fn number(rest: &mut &[u8]) -> Result<usize, bool> {
    let mut value = 0;
    for place in 0..4 {
        let byte = take(rest, 1)?[0];
        value |= usize::from(byte & 0x7F) << (7 * place);
        if byte & 0x80 == 0 {
            return Ok(value);
        }
    }
    Err(false)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn connect(level: u8, properties: &[u8], name: &[u8]) -> Vec<u8> {
        let mut body = b"\x00\x04MQTT".to_vec();
        body.extend([level, 2, 0, 10]);
        body.extend(properties);
        body.extend((name.len() as u16).to_be_bytes());
        body.extend(name);
        let mut packet = vec![0x10, body.len() as u8];
        packet.extend(body);
        packet
    }

    #[test]
    fn names_are_found_as_soon_as_they_are_whole() {
        for packet in [
            connect(5, &[5, 0x11, 0, 0, 0, 60], b"sim-0001"),
            connect(4, &[], b"sim-0001"),
        ] {
            for len in 0..packet.len() {
                assert_eq!(read(&packet[..len]), Hello::More, "{len}");
            }
            assert_eq!(read(&packet), Hello::Name("sim-0001".to_owned()));
        }
    }

    #[test]
    fn what_has_no_name_is_nobody_and_nobody_waits_for_ever() {
        let long = connect(4, &[], &[b'a'; 65]);
        for packet in [
            b"GET / HTTP/1.1\r\n".to_vec(),
            b"\x16\x03\x01\x02\x00".to_vec(),
            connect(3, &[], b"a"),
            connect(4, &[], b""),
            connect(4, &[], b"\xFF\xFE"),
            connect(4, &[], b"a\nb"),
            long,
            vec![0x10, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF],
            // A name that would be longer than all we look at.
            [
                b"\x10\xFF\x7F\x00\x04MQTT\x04\x02\x00\x0A\xFF\xFF".to_vec(),
                vec![b'a'; MOST],
            ]
            .concat(),
        ] {
            assert_eq!(read(&packet), Hello::Nobody, "{packet:?}");
        }
    }
}
