//! The fuzz target of patches. The fuzzer and the replay of its corpus in the tests of `crawler-delta` include
//! this file.

use crawler_delta::{Decoder, DeltaError, Step, add};

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 1] = [("delta_patch", patch)];

/// Reads a patch in pieces of `piece` bytes into a buffer of `buffer`. The steps must come to an end.
fn read(
    old: &[u8],
    new: u32,
    patch: &[u8],
    (piece, buffer): (usize, usize),
) -> (Vec<u8>, Result<(), DeltaError>) {
    let mut decoder = Decoder::new(old.len() as u32, new);
    let (mut made, mut out) = (Vec::new(), vec![0; buffer]);
    let mut steps = 0;
    for mut rest in patch.chunks(piece) {
        loop {
            let before = rest.len();
            match decoder.step(&mut rest, &mut out) {
                Ok(Step::More) => {
                    assert!(rest.is_empty(), "not before the piece is used up");
                    break;
                }
                Ok(Step::Done) => {
                    assert!(rest.is_empty() && made.len() == new as usize);
                    break;
                }
                Ok(Step::Made { length, old: from }) => {
                    if let Some(from) = from {
                        let from = from as usize;
                        add(&mut out[..length], &old[from..from + length]);
                    }
                    made.extend_from_slice(&out[..length]);
                    assert_eq!(made.len(), decoder.made() as usize);
                    assert!(made.len() <= new as usize);
                }
                Err(error) => {
                    assert_eq!(decoder.step(&mut &patch[..0], &mut out), Err(error));
                    assert_eq!(decoder.finish(), Err(error));
                    return (made, Err(error));
                }
            }
            assert!(rest.len() <= before);
            steps += 1;
        }
    }
    // A record can be read without a byte of the image, but not more of them than it has bytes.
    assert!(
        steps <= 3 * (new as usize + 1),
        "{steps} steps to {new} bytes"
    );
    (made, decoder.finish())
}

/// Bytes as the compressed part of a patch, none of them a copy.
fn uncompressed(records: &[u8], new: u32) -> Vec<u8> {
    let mut patch = vec![0x04];
    let mut rest = new >> 6;
    patch.push((new & 0x3F) as u8 | if rest > 0 { 0x80 } else { 0 });
    while rest > 0 {
        patch.push((rest & 0x7F) as u8 | if rest > 0x7F { 0x80 } else { 0 });
        rest >>= 7;
    }
    patch.push(0x00);
    let (mut bits, mut held) = (0_u32, 0);
    for byte in records {
        bits = bits << 9 | 0x100 | u32::from(*byte);
        held += 9;
        while held >= 8 {
            held -= 8;
            patch.push((bits >> held) as u8);
        }
        bits &= (1 << held) - 1;
    }
    if held > 0 {
        patch.push((bits << (8 - held)) as u8);
    }
    patch
}

/// The sizes of both images, then the patch, or its records without compression. However the patch is cut
/// into pieces and whatever room there is for what it makes, the same comes of it, and no more than the new
/// image.
fn patch(data: &[u8]) {
    let Some((&[old, o, new, n, how], rest)) = data.split_first_chunk() else {
        return;
    };
    let old: Vec<u8> = (0..u32::from(u16::from_le_bytes([old, o & 0x1F])))
        .map(|at| ((at * at) >> 5) as u8)
        .collect();
    let new = u32::from(u16::from_le_bytes([new, n & 0x1F]));
    let patch = if how & 1 == 0 {
        rest.to_vec()
    } else {
        uncompressed(rest, new)
    };
    let whole = read(&old, new, &patch, (patch.len().max(1), 8_192));
    for sizes in [(1, 1), (1 + usize::from(how), 7), (3, 256)] {
        assert_eq!(read(&old, new, &patch, sizes), whole, "{sizes:?}");
    }
}
