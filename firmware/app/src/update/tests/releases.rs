//! Signed releases.

use std::string::String;
use std::vec::Vec;

use crawler_protocol::ReleaseId;
use crawler_release::{
    Chip, ENVELOPE_MAX, Kind, MANIFEST_MAX, Manifest, PublicKey, PublicKeys, Requires, Signed,
    block_hash, block_size, image_hash,
};
use p256::ecdsa::signature::hazmat::PrehashSigner as _;
use p256::ecdsa::{Signature, SigningKey};

/// A release as a server has it.
#[derive(Debug, Clone)]
pub(super) struct Release {
    pub(super) build: String,
    pub(super) envelope: Vec<u8>,
    pub(super) image: Vec<u8>,
}

/// What is written into a manifest.
#[derive(Debug, Clone)]
pub(super) struct Draft {
    pub(super) key: u8,
    pub(super) board: &'static str,
    pub(super) chip: Chip,
    pub(super) build: &'static str,
    pub(super) sequence: u32,
    pub(super) floor: u32,
    pub(super) expires: Option<u64>,
    pub(super) requires: Requires,
    pub(super) size: usize,
    /// Whether the hash of the whole image is another one than that of the image whose blocks are named.
    pub(super) wrong_whole: bool,
}

impl Draft {
    /// A release that the robots of these tests take.
    pub(super) fn new(build: &'static str, sequence: u32) -> Self {
        Self {
            key: 1,
            board: "test",
            chip: Chip::NONE,
            build,
            sequence,
            floor: 0,
            expires: None,
            requires: Requires::default(),
            size: 150_001,
            wrong_whole: false,
        }
    }

    pub(super) fn release(&self) -> Release {
        let image = image(self.build, self.size);
        let size = image.len() as u32;
        let block_size = block_size(size).expect("a size");
        let blocks: Vec<u8> = image
            .chunks(block_size as usize)
            .flat_map(block_hash)
            .collect();
        let mut whole = image_hash(&image);
        whole[31] ^= u8::from(self.wrong_whole);
        let manifest = Manifest {
            kind: Kind::Program,
            name: None,
            board: self.board,
            chip: self.chip,
            version: "1.0.0",
            build: self.build,
            sequence: self.sequence,
            floor: self.floor,
            expires: self.expires,
            size,
            sha256: &whole,
            block_size,
            blocks: &blocks,
            delta: None,
            requires: self.requires,
        };
        let mut bytes = [0; MANIFEST_MAX];
        let length = manifest.encode(&mut bytes).expect("valid");
        let bytes = &bytes[..length];
        let key = SigningKey::from_slice(&[self.key; 32]).expect("a key");
        let signature: Signature = key.sign_prehash(&image_hash(bytes)).expect("signed");
        let signature = signature.to_bytes().into();
        let signed = Signed::new(public(self.key).id(), &signature, bytes).expect("short");
        let mut envelope = [0; ENVELOPE_MAX];
        let length = signed.write(&mut envelope).expect("fits");
        Release {
            build: self.build.into(),
            envelope: envelope[..length].to_vec(),
            image,
        }
    }
}

impl Release {
    pub(super) fn id(&self) -> ReleaseId {
        let signed = Signed::parse(&self.envelope).expect("an envelope");
        ReleaseId::new(signed.id())
    }
}

fn public(number: u8) -> PublicKey {
    let key = SigningKey::from_slice(&[number; 32]).expect("a key");
    let point = key.verifying_key().to_sec1_point(false);
    PublicKey::from_sec1(point.as_bytes()).expect("a point")
}

/// The keys that robots of these tests believe.
pub(super) fn keys() -> PublicKeys {
    PublicKeys {
        current: public(1),
        next: Some(public(2)),
    }
}

/// The program of a build.
pub(super) fn image(build: &str, size: usize) -> Vec<u8> {
    let seed = build
        .bytes()
        .fold(7_u8, |seed, byte| seed.wrapping_mul(31).wrapping_add(byte));
    (0..size)
        .map(|at| (at as u8).wrapping_mul(seed | 1) ^ (at >> 8) as u8 ^ seed)
        .collect()
}
