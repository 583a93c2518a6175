//! Public keys in PEM, as `terracrawler release keygen` and OpenSSL write them.

use std::vec::Vec;

use crate::keys::KEY;

const BEGIN: &str = "-----BEGIN PUBLIC KEY-----";
const END: &str = "-----END PUBLIC KEY-----";
/// What stands before the point of a key of P-256 in DER (RFC 5480, section 2.1.1.1).
const PREFIX: [u8; 26] = [
    0x30, 0x59, 0x30, 0x13, 0x06, 0x07, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x02, 0x01, 0x06, 0x08, 0x2a,
    0x86, 0x48, 0xce, 0x3d, 0x03, 0x01, 0x07, 0x03, 0x42, 0x00,
];

/// The keys in `text`, in their order; `None` when there is none, or something else where one should be.
#[must_use]
pub fn public_keys(text: &str) -> Option<Vec<[u8; KEY]>> {
    let mut keys = Vec::new();
    let mut rest = text;
    while let Some((_, after)) = rest.split_once(BEGIN) {
        let (body, after) = after.split_once(END)?;
        let der = base64(body)?;
        let point = der.strip_prefix(&PREFIX)?;
        keys.push(
            point
                .try_into()
                .ok()
                .filter(|key: &[u8; KEY]| key[0] == 4)?,
        );
        rest = after;
    }
    (!keys.is_empty()).then_some(keys)
}

/// RFC 4648, section 4, with line breaks.
fn base64(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let (mut bits, mut held) = (0_u32, 0);
    let letters = text.bytes().filter(|byte| !byte.is_ascii_whitespace());
    for letter in letters {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            b'=' => continue,
            _ => return None,
        };
        bits = (bits << 6 | u32::from(value)) & 0xFFFF;
        held += 6;
        if held >= 8 {
            held -= 8;
            bytes.push((bits >> held) as u8);
        }
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use std::string::String;

    use super::*;

    /// Made by `openssl ecparam -name prime256v1 -genkey | openssl ec -pubout`, and its point by
    /// `openssl pkey -pubin -outform DER | tail -c 65`.
    const PEM: &str = "\
-----BEGIN PUBLIC KEY-----
MFkwEwYHKoZIzj0CAQYIKoZIzj0DAQcDQgAEFL3Z2e29NcM0UvimlB55zaG0oDVa
eVwpM0/1ghs+2ZVeSVs0vLeJOsxoQ1cF7ht3dh3w4L18X/+5it5A2oLGaA==
-----END PUBLIC KEY-----
";
    const POINT: &str = "0414bdd9d9edbd35c33452f8a6941e79cda1b4a0355a795c29334ff5821b3ed9955e495b34bcb7893acc68435705ee1b77761df0e0bd7c5fffb98ade40da82c668";

    fn hex(bytes: &[u8]) -> String {
        let digits = bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]);
        let digits = digits.filter_map(|digit| char::from_digit(digit.into(), 16));
        digits.collect()
    }

    #[test]
    fn keys_of_openssl_are_read() {
        let keys = public_keys(PEM).expect("a key");
        assert_eq!(keys.iter().map(|key| hex(key)).collect::<Vec<_>>(), [POINT]);
        let two = public_keys(&std::format!("# ours\n{PEM}\nnext:\n{PEM}")).expect("two");
        assert_eq!(two.len(), 2);
    }

    #[test]
    fn what_is_no_key_is_none() {
        let cut = &PEM[..PEM.len() - 30];
        let other = PEM.replace("PUBLIC", "PRIVATE");
        let letter = PEM.replacen('M', "*", 1);
        let curve = PEM.replacen("MFkw", "MFkx", 1);
        let short = PEM.replacen("MFkw", "", 1);
        for text in ["", "text", cut, &other, &letter, &curve, &short] {
            assert_eq!(public_keys(text), None, "{text}");
        }
    }
}
