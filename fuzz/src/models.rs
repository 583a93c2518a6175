//! Fuzz target of what is read as a model. The fuzzer and the replay of its corpus in the tests of
//! `crawler-micromodel` include this file.

use crawler_micromodel::{Model, Runner, arena_bytes};

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 1] = [("model", model)];

/// What is larger than this takes too long under a fuzzer.
const MOST: usize = 1 << 20;

/// Whatever is accepted runs, in the memory that it asked for. The checksum is made right first, or
/// nothing would get past it.
fn model(data: &[u8]) {
    let mut blob = data.to_vec();
    let _ = Model::new(&blob);
    if let Some(length) = blob.get_mut(8..12) {
        length.copy_from_slice(&(data.len() as u32).to_le_bytes());
    }
    let checksum = checksum(blob.get(16..).unwrap_or(&[]));
    if let Some(place) = blob.get_mut(12..16) {
        place.copy_from_slice(&checksum.to_le_bytes());
    }
    let needed = arena_bytes(&blob);
    let Ok(model) = Model::new(&blob) else {
        return;
    };
    assert_eq!(needed, Ok(model.arena_bytes()));
    if model.arena_bytes() > MOST || model.multiplications() > MOST as u64 {
        return;
    }
    let mut arena = vec![0; model.arena_bytes()];
    let output = model.output().values();
    let mut runner = Runner::new(model, &mut arena).expect("room was made");
    let first = runner.run(|row, out| out.fill(row as i8)).to_vec();
    assert_eq!(first.len(), output);
    assert_eq!(runner.run(|row, out| out.fill(row as i8)), first);
}

/// CRC-32 (ISO-HDLC), bit by bit.
fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for &byte in bytes {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            let carry = crc & 1 == 1;
            crc = (crc >> 1) ^ if carry { 0xEDB8_8320 } else { 0 };
        }
    }
    !crc
}
