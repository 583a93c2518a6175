//! Where MQTT packets begin and end in a stream of bytes.

/// Where in the stream of MQTT packets a connection stands (section 2.1 of the standard).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Boundary {
    /// Between two packets.
    #[default]
    Between,
    /// In the length of a packet: what is known of it, and how many bits.
    Length(usize, u32),
    /// So many bytes before the end of a packet.
    Within(usize),
}

impl Boundary {
    pub(super) const fn is_between(self) -> bool {
        matches!(self, Self::Between)
    }

    pub(super) fn advance(&mut self, mut bytes: &[u8]) {
        while let Some((&byte, rest)) = bytes.split_first() {
            *self = match *self {
                Self::Between => Self::Length(0, 0),
                Self::Length(value, bits) => {
                    let value = value | usize::from(byte & 0x7F) << bits;
                    if byte & 0x80 != 0 && bits < 21 {
                        Self::Length(value, bits + 7)
                    } else if value == 0 {
                        Self::Between
                    } else {
                        Self::Within(value)
                    }
                }
                Self::Within(left) => {
                    let part = left.min(bytes.len());
                    bytes = &bytes[part..];
                    *self = if part == left {
                        Self::Between
                    } else {
                        Self::Within(left - part)
                    };
                    continue;
                }
            };
            bytes = rest;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packet_boundaries_are_found_however_the_bytes_are_split() {
        let mut stream = vec![0xC0, 0];
        stream.extend([0x30, 3, 1, 2, 3]);
        let long = stream.len();
        stream.extend([0x30, 0xC8, 0x01]);
        stream.extend([9; 200]);
        let ends = [2, long, stream.len()];
        for split in 1..stream.len() {
            let mut boundary = Boundary::default();
            boundary.advance(&stream[..split]);
            assert_eq!(
                boundary.is_between(),
                ends.contains(&split),
                "after {split}"
            );
            boundary.advance(&stream[split..]);
            assert!(boundary.is_between());
        }
    }
}
