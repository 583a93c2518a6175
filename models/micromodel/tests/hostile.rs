//! Blobs that are none. Whatever the bytes: an error, or a model that runs.

// Each test file uses a part of it.
#[allow(dead_code)]
mod common;

use common::Network;
use crawler_micromodel::{Model, ModelError, Runner, arena_bytes};
use proptest::prelude::*;

fn blob(seed: u64) -> Vec<u8> {
    (seed..seed + 1_000)
        .find_map(|seed| Network::random(seed).blob(&[]).ok())
        .expect("some seed gives a network")
}

/// Makes the checksum right again, so that what is behind it gets a look.
fn signed(mut blob: Vec<u8>) -> Vec<u8> {
    if blob.len() < 16 {
        return blob;
    }
    let length = blob.len() as u32;
    blob[8..12].copy_from_slice(&length.to_le_bytes());
    let mut crc = u32::MAX;
    for &byte in &blob[16..] {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 {
                (crc >> 1) ^ 0xEDB8_8320
            } else {
                crc >> 1
            };
        }
    }
    blob[12..16].copy_from_slice(&(!crc).to_le_bytes());
    blob
}

/// Reads it, and runs it when it is a model of reasonable size.
fn survives(blob: &[u8]) -> Result<(), ModelError> {
    let _ = arena_bytes(blob);
    let model = Model::new(blob)?;
    assert!(model.labels().count() <= usize::from(model.output().channels));
    if model.multiplications() < 3_000_000 && model.arena_bytes() < 3_000_000 {
        let mut arena = vec![-1; model.arena_bytes()];
        let mut runner = Runner::new(model, &mut arena).expect("room");
        let output = runner.run(|row, out| out.fill(row as i8));
        assert_eq!(output.len(), model.output().values());
    }
    Ok(())
}

#[test]
fn what_is_cut_off_anywhere_is_no_model() {
    let whole = blob(3);
    for length in 0..whole.len() {
        assert!(survives(&whole[..length]).is_err(), "{length}");
        let _ = survives(&signed(whole[..length].to_vec()));
    }
}

#[test]
fn every_flipped_bit_is_noticed() {
    let whole = blob(5);
    for bit in 0..whole.len() * 8 {
        let mut blob = whole.clone();
        blob[bit / 8] ^= 1 << (bit % 8);
        assert!(survives(&blob).is_err(), "bit {bit}");
    }
}

#[test]
fn other_versions_and_other_files_are_named() {
    let mut other = blob(7);
    other[4] = 2;
    assert_eq!(survives(&other), Err(ModelError::Version(2)));
    other[0] = b'P';
    assert_eq!(survives(&other), Err(ModelError::Magic));
    let mut longer = blob(7);
    longer.push(0);
    assert!(matches!(survives(&longer), Err(ModelError::Length { .. })));
}

proptest! {
    #![proptest_config(crawler_properties::cases(2_000))]

    #[test]
    fn changed_and_signed_blobs_are_survived(
        seed in 0_u64..50,
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        early: bool,
    ) {
        let mut blob = blob(seed);
        for (place, value) in changes {
            // Header and layers are where the decisions are.
            let most = if early { blob.len().min(32 * 4) } else { blob.len() };
            let place = place.index(most);
            blob[place] = value;
        }
        let _ = survives(&signed(blob));
    }

    #[test]
    fn arbitrary_bytes_are_survived(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let mut blob = bytes;
        let _ = survives(&blob);
        if blob.len() > 8 {
            blob[..8].copy_from_slice(b"TCMM\x01\x00\x02\x00");
        }
        let _ = survives(&signed(blob));
    }
}
