//! Fuzz targets of what a release is made of. The fuzzer and the replay of its corpus in the tests of
//! `crawler-release` include this file.

use crawler_release::chunk::{CHUNK_MAX, Chunk, HEADER, Part};
use crawler_release::{
    BlockHasher, Chip, ENVELOPE_MAX, ImageHasher, KeyId, Kind, MANIFEST_MAX, Manifest, PublicKey,
    PublicKeys, Refusal, Signed, Target, Want, verify,
};

/// The body of a target. Panics when it finds a fault.
pub type Body = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Body); 2] = [("release_manifest", manifest), ("release_chunk", chunk)];

/// The base point of the curve, whose key everybody knows.
const POINT: [u8; 33] = [
    0x03, 0x6b, 0x17, 0xd1, 0xf2, 0xe1, 0x2c, 0x42, 0x47, 0xf8, 0xbc, 0xe6, 0xe5, 0x63, 0xa4, 0x40,
    0xf2, 0x77, 0x03, 0x7d, 0x81, 0x2d, 0xeb, 0x33, 0xa0, 0xf4, 0xa1, 0x39, 0x45, 0xd8, 0x98, 0xc2,
    0x96,
];

const ROBOT: Target<'static> = Target {
    kind: Kind::Program,
    name: None,
    board: "xiao-c3",
    chip: Chip::ESP32_C3,
    capacity: 0x1e_0000,
    sequence: 11,
    floor: 2,
    build: "old",
    protocol: 1,
    now: None,
    built_at: 1_700_000_000,
};

/// What is read as a manifest is valid, is written the same, and is used without a fault; whatever is in an
/// envelope, nobody is believed.
fn manifest(data: &[u8]) {
    if let Ok(read) = Manifest::decode(data) {
        let mut buf = [0; MANIFEST_MAX];
        assert_eq!(read.encode(&mut buf), Ok(data.len()));
        assert_eq!(&buf[..data.len()], data);
        let blocks = (0..read.block_count()).map(|index| read.block_length(index));
        let sum: u32 = blocks.map(|length| length.expect("a block")).sum();
        assert_eq!(sum, read.size);
        assert!(BlockHasher::new(&read, read.block_count()).is_none());
        let _ = read.admit(&ROBOT);
        let mut hasher = ImageHasher::new(&read);
        if hasher.update(data).is_ok() {
            assert!(hasher.finish().is_err(), "a manifest is not its own image");
        }
        let mut envelope = [0; ENVELOPE_MAX];
        let signed = Signed::new(KeyId([0; 8]), &[7; 64], data).expect("not too long");
        let length = signed.write(&mut envelope).expect("room");
        assert_eq!(Signed::parse(&envelope[..length]), Ok(signed));
        assert_eq!(signed.unverified(), Ok(read));
    }
    let current = PublicKey::from_sec1(&POINT).expect("a point");
    let keys = PublicKeys {
        current,
        next: None,
    };
    let refusal = verify(data, &keys, &ROBOT).expect_err("nobody has signed");
    assert!(matches!(
        refusal,
        Refusal::Malformed(_) | Refusal::UnknownKey(_) | Refusal::BadSignature
    ));
}

/// What is read as a chunk is written the same. The checksum is made right first, or nothing would get past
/// it.
fn chunk(data: &[u8]) {
    let mut bytes = data.to_vec();
    let _ = Chunk::decode(&bytes);
    if bytes.len() > HEADER {
        let mut right = [0; CHUNK_MAX];
        let part = Part::ALL[usize::from(bytes[1]) % Part::ALL.len()];
        let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four"));
        let chunk = Chunk {
            part,
            tag: number(4),
            index: number(8),
            payload: &bytes[HEADER..],
        };
        if let Ok(length) = chunk.encode(&mut right) {
            assert_eq!(Chunk::decode(&right[..length]), Ok(chunk));
            bytes[12..HEADER].copy_from_slice(&right[12..HEADER]);
        }
    }
    if let Ok(read) = Chunk::decode(&bytes) {
        let mut again = [0; CHUNK_MAX];
        assert_eq!(read.encode(&mut again), Ok(bytes.len()));
        assert_eq!(&again[..bytes.len()], &bytes[..]);
        let mut want = Want::window(read.tag, read.part, read.index, u32::MAX);
        let asked = want.outstanding() > 0;
        assert_eq!(want.take(read.tag, read.part, read.index), asked);
        assert!(!want.take(read.tag, read.part, read.index), "twice");
    }
}
