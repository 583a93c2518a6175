//! Pieces of a release, and which of them are asked for.

use std::collections::BTreeSet;

use crawler_release::chunk::{CHUNK_MAX, Chunk, ChunkError, HEADER, PAYLOAD, Part, count, length};
use crawler_release::{WINDOW, Want};
use proptest::prelude::*;

fn parts() -> impl Strategy<Value = Part> {
    proptest::sample::select(&Part::ALL[..])
}

fn encoded(chunk: &Chunk<'_>) -> Vec<u8> {
    let mut buf = [0; CHUNK_MAX];
    let length = chunk.encode(&mut buf).expect("a payload");
    buf[..length].to_vec()
}

proptest! {
    #[test]
    fn what_is_written_is_read(
        part in parts(), tag: u32, index: u32,
        payload in proptest::collection::vec(any::<u8>(), 1..=PAYLOAD),
    ) {
        let chunk = Chunk { part, tag, index, payload: &payload };
        let bytes = encoded(&chunk);
        prop_assert_eq!(bytes.len(), HEADER + payload.len());
        prop_assert_eq!(Chunk::decode(&bytes), Ok(chunk));
        // Neither cut off nor continued.
        prop_assert!(Chunk::decode(&bytes[..bytes.len() - 1]).is_err());
        let longer = [&bytes[..], &[0]].concat();
        prop_assert_eq!(Chunk::decode(&longer), Err(ChunkError::Long));
    }

    /// A CRC-32 finds every single bit and every burst of up to 32.
    #[test]
    fn a_burst_of_errors_is_found(
        payload in proptest::collection::vec(any::<u8>(), 1..=PAYLOAD),
        at: proptest::sample::Index, burst in 1..=u32::MAX,
    ) {
        let mut bytes = encoded(&Chunk { part: Part::Image, tag: 1, index: 2, payload: &payload });
        let begin = at.index(bytes.len() - 3);
        for (byte, change) in bytes[begin..].iter_mut().zip(burst.to_le_bytes()) {
            *byte ^= change;
        }
        prop_assert!(Chunk::decode(&bytes).is_err());
    }

    #[test]
    fn anything_can_arrive(bytes in proptest::collection::vec(any::<u8>(), 0..=1_100)) {
        if let Ok(chunk) = Chunk::decode(&bytes) {
            prop_assert_eq!(encoded(&chunk), bytes);
        }
    }

    /// Chunks laid end to end are the part.
    #[test]
    fn lengths_add_up(size in 0..5_000_000_u32) {
        let lengths: Vec<_> = (0..count(size)).map(|index| length(size, index)).collect();
        let sum: usize = lengths.iter().copied().flatten().sum();
        prop_assert_eq!(sum, size as usize);
        prop_assert!(lengths.iter().all(|length| length.is_some_and(|length| length > 0)));
        prop_assert!(lengths.iter().rev().skip(1).all(|length| *length == Some(PAYLOAD)));
        prop_assert_eq!(length(size, count(size)), None);
        prop_assert_eq!(length(size, u32::MAX), None);
    }

    /// A window against a set of numbers.
    #[test]
    fn a_window_is_a_set(
        first: u32, total: u32,
        arrivals in proptest::collection::vec(0..20_u32, 0..40),
    ) {
        let mut want = Want::window(9, Part::Image, first, total);
        let mut expected: BTreeSet<u32> = (0..WINDOW)
            .filter_map(|bit| first.checked_add(bit))
            .filter(|index| *index < total)
            .collect();
        for offset in arrivals {
            let index = first.wrapping_add(offset);
            prop_assert_eq!(want.take(9, Part::Image, index), expected.remove(&index));
            prop_assert_eq!(want.indices().collect::<BTreeSet<_>>(), expected.clone());
            prop_assert_eq!(want.outstanding() as usize, expected.len());
        }
    }
}

#[test]
fn each_fault_has_its_reason() {
    let bytes = encoded(&Chunk {
        part: Part::Delta,
        tag: 0x0403_0201,
        index: 7,
        payload: b"payload",
    });
    assert_eq!(bytes[..12], [1, 2, 7, 0, 1, 2, 3, 4, 7, 0, 0, 0]);
    let changed = |at: usize, value: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = value;
        bytes
    };
    for (bytes, error) in [
        (vec![], ChunkError::Short),
        (bytes[..16].to_vec(), ChunkError::Short),
        (changed(0, 2), ChunkError::Format),
        (changed(1, 3), ChunkError::Part),
        (changed(2, 0), ChunkError::Length),
        (changed(3, 0xFF), ChunkError::Length),
        (changed(2, 8), ChunkError::Short),
        (changed(2, 6), ChunkError::Long),
        (changed(1, 1), ChunkError::Checksum),
        (changed(16, 0), ChunkError::Checksum),
    ] {
        assert_eq!(Chunk::decode(&bytes), Err(error), "{bytes:02x?}");
    }
    for payload in [&[][..], &[0; PAYLOAD + 1]] {
        let chunk = Chunk {
            part: Part::Image,
            tag: 0,
            index: 0,
            payload,
        };
        assert_eq!(chunk.encode(&mut [0; 2_000]), Err(ChunkError::Length));
    }
}

#[test]
fn what_was_not_asked_for_is_not_taken() {
    let mut want = Want::window(9, Part::Image, 100, 105);
    assert_eq!(want.missing, 0b1_1111);
    assert!(!want.take(8, Part::Image, 100), "of another transfer");
    assert!(!want.take(9, Part::Delta, 100), "of another part");
    assert!(!want.take(9, Part::Image, 99), "before the window");
    assert!(!want.take(9, Part::Image, 105), "past the end");
    assert!(!want.take(9, Part::Image, 116), "past the window");
    assert!(want.take(9, Part::Image, 103));
    assert!(!want.take(9, Part::Image, 103), "twice");
    assert_eq!(want.indices().collect::<Vec<_>>(), [100, 101, 102, 104]);
    // What a peer says it wants need not make sense.
    let odd = Want {
        first: u32::MAX,
        missing: u16::MAX,
        ..want
    };
    assert_eq!(odd.indices().collect::<Vec<_>>(), [u32::MAX]);
}
