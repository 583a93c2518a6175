//! Applies patches, and makes such as no tool would.

use crawler_delta::{Decoder, DeltaError, Step, add};

/// Applies a patch that comes in pieces of `piece` bytes, with a buffer of `buffer`.
pub(crate) fn apply(
    old: &[u8],
    new: usize,
    patch: &[u8],
    piece: usize,
    buffer: usize,
) -> Result<Vec<u8>, DeltaError> {
    let mut decoder = Decoder::new(old.len() as u32, new as u32);
    let (mut made, mut out) = (Vec::new(), vec![0; buffer]);
    for mut rest in patch.chunks(piece) {
        while let Step::Made { length, old: from } = decoder.step(&mut rest, &mut out)? {
            if let Some(from) = from {
                add(&mut out[..length], &old[from as usize..][..length]);
            }
            made.extend_from_slice(&out[..length]);
        }
    }
    decoder.finish().map(|()| made)
}

/// A number as detools writes it.
pub(crate) fn number(value: i64) -> Vec<u8> {
    let mut rest = value.unsigned_abs();
    let mut bytes = vec![(rest & 0x3F) as u8 | if value < 0 { 0x40 } else { 0 }];
    rest >>= 6;
    while rest > 0 {
        *bytes.last_mut().expect("a byte") |= 0x80;
        bytes.push((rest & 0x7F) as u8);
        rest >>= 7;
    }
    bytes
}

/// Bytes in heatshrink, none of them a copy.
pub(crate) fn heatshrink(bytes: &[u8]) -> Vec<u8> {
    let bit = |at: usize| match at % 9 {
        0 => 1,
        place => bytes[at / 9] >> (8 - place) & 1,
    };
    let bits: Vec<u8> = (0..9 * bytes.len()).map(bit).collect();
    let byte =
        |bits: &[u8]| (0..8).fold(0, |byte, at| byte << 1 | bits.get(at).copied().unwrap_or(0));
    bits.chunks(8).map(byte).collect()
}

/// A patch to an image of `new` bytes with these contents, uncompressed and from the data format on.
pub(crate) fn patch(new: i64, contents: &[&[u8]]) -> Vec<u8> {
    let head = [&[0x04][..], &number(new), &[0x67 & 0xF0]].concat();
    [head, heatshrink(&contents.concat())].concat()
}

/// A record: differences, bytes, and how far to go on.
pub(crate) fn record(differences: &[u8], bytes: &[u8], distance: i64) -> Vec<u8> {
    let size = |part: &[u8]| number(part.len() as i64);
    [
        &size(differences),
        differences,
        &size(bytes),
        bytes,
        &number(distance),
    ]
    .concat()
}
