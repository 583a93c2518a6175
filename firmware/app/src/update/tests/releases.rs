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
    /// What makes the image out of the program `old`, if the server has such a patch.
    pub(super) patch: Option<Vec<u8>>,
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
    /// The image is the program `old` and more of it, of which every so manieth byte is another; with a patch.
    pub(super) changed: Option<usize>,
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
            changed: None,
        }
    }

    pub(super) fn release(&self) -> Release {
        let old = image("old", OLD_SIZE);
        let own = image(self.build, self.size);
        let image = match self.changed {
            Some(every) => (0..self.size)
                .map(|at| match at % every {
                    0 => own[at],
                    _ => old[at % OLD_SIZE],
                })
                .collect(),
            None => own,
        };
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
            patch: self.changed.map(|_| patch(&old, &image)),
            image,
        }
    }
}

/// Bytes of the program `old`.
pub(super) const OLD_SIZE: usize = 100_000;

/// A patch in which the bytes of `new` are differences to those of `old`, from its beginning and again from there.
pub(super) fn patch(old: &[u8], new: &[u8]) -> Vec<u8> {
    let mut contents = Vec::from([0]);
    for part in new.chunks(old.len()) {
        number(&mut contents, part.len() as i64);
        let differences = part.iter().zip(old);
        contents.extend(differences.map(|(new, old)| new.wrapping_sub(*old)));
        number(&mut contents, 0);
        number(&mut contents, -(part.len() as i64));
    }
    let mut patch = Vec::from([0x04]);
    number(&mut patch, new.len() as i64);
    // A window of 8 bits, of which one byte is used, and lengths of 7 bits.
    patch.push(0x44);
    let (mut bits, mut held) = (0_u32, 0);
    let mut push = |value: u32, count: u32| {
        bits = bits << count | value;
        held += count;
        while held >= 8 {
            held -= 8;
            patch.push((bits >> held) as u8);
        }
    };
    let mut at = 0;
    while let Some(byte) = contents.get(at) {
        let before = at.checked_sub(1).map(|before| contents[before]);
        let same = contents[at..].iter().take(128);
        let run = same.take_while(|same| Some(**same) == before).count();
        if run > 1 {
            push(0, 9);
            push(run as u32 - 1, 7);
            at += run;
        } else {
            push(1 << 8 | u32::from(*byte), 9);
            at += 1;
        }
    }
    push(0, 7);
    patch
}

/// A number as patches have it.
fn number(out: &mut Vec<u8>, value: i64) {
    let mut rest = value.unsigned_abs();
    let mut byte = (rest & 0x3F) as u8 | if value < 0 { 0x40 } else { 0 };
    rest >>= 6;
    while rest > 0 {
        out.push(byte | 0x80);
        byte = (rest & 0x7F) as u8;
        rest >>= 7;
    }
    out.push(byte);
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
