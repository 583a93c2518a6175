//! Releases to be tried.

use crawler_release::{
    BLOCK_HASH, Chip, Delta, ENVELOPE_MAX, HASH, Kind, MANIFEST_MAX, Manifest, PublicKey, Requires,
    SIGNATURE, Signed, Target, block_hash, block_size, image_hash,
};
use p256::ecdsa::signature::hazmat::PrehashSigner as _;
use p256::ecdsa::{Signature, SigningKey};
use proptest::prelude::*;

/// A manifest that owns what is in it.
#[derive(Debug, Clone)]
pub(crate) struct Draft {
    pub(crate) kind: Kind,
    pub(crate) name: Option<String>,
    pub(crate) board: String,
    pub(crate) chip: u16,
    pub(crate) version: String,
    pub(crate) build: String,
    pub(crate) sequence: u32,
    pub(crate) floor: u32,
    pub(crate) expires: Option<u64>,
    pub(crate) size: u32,
    pub(crate) sha256: [u8; HASH],
    pub(crate) block_size: u32,
    pub(crate) blocks: Vec<u8>,
    pub(crate) delta: Option<([u8; HASH], String, u32)>,
    pub(crate) requires: Requires,
}

impl Draft {
    /// A release of a program that is this image, as [`target`] takes it.
    pub(crate) fn of(image: &[u8]) -> Self {
        let size = u32::try_from(image.len()).expect("an image");
        let block_size = block_size(size).expect("a size");
        let blocks = image.chunks(block_size as usize).flat_map(block_hash);
        Self {
            kind: Kind::Program,
            name: None,
            board: "xiao-c3".into(),
            chip: 5,
            version: "0.4.0".into(),
            build: "new".into(),
            sequence: 12,
            floor: 3,
            expires: None,
            size,
            sha256: image_hash(image),
            block_size,
            blocks: blocks.collect(),
            delta: None,
            requires: Requires::default(),
        }
    }

    pub(crate) fn manifest(&self) -> Manifest<'_> {
        Manifest {
            kind: self.kind,
            name: self.name.as_deref(),
            board: &self.board,
            chip: Chip(self.chip),
            version: &self.version,
            build: &self.build,
            sequence: self.sequence,
            floor: self.floor,
            expires: self.expires,
            size: self.size,
            sha256: &self.sha256,
            block_size: self.block_size,
            blocks: &self.blocks,
            delta: self.delta.as_ref().map(|(base, build, size)| Delta {
                base,
                build,
                size: *size,
            }),
            requires: self.requires,
        }
    }

    /// The bytes of a valid one.
    pub(crate) fn encoded(&self) -> Vec<u8> {
        let mut buf = [0; MANIFEST_MAX];
        let length = self.manifest().encode(&mut buf).expect("valid");
        buf[..length].to_vec()
    }
}

/// A robot that takes `Draft::of` any image.
pub(crate) fn target() -> Target<'static> {
    Target {
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
    }
}

/// A key of the tests, by number.
pub(crate) fn key(number: u8) -> SigningKey {
    SigningKey::from_slice(&[number; 32]).expect("a key")
}

pub(crate) fn public(key: &SigningKey) -> PublicKey {
    let point = key.verifying_key().to_sec1_point(false);
    PublicKey::from_sec1(point.as_bytes()).expect("a point")
}

pub(crate) fn envelope(
    public: &PublicKey,
    signature: &[u8; SIGNATURE],
    manifest: &[u8],
) -> Vec<u8> {
    let signed = Signed::new(public.id(), signature, manifest).expect("not too long");
    let mut buf = [0; ENVELOPE_MAX];
    let length = signed.write(&mut buf).expect("room");
    buf[..length].to_vec()
}

pub(crate) fn sign(key: &SigningKey, manifest: &[u8]) -> Vec<u8> {
    let signature: Signature = key.sign_prehash(&image_hash(manifest)).expect("signed");
    envelope(&public(key), &signature.to_bytes().into(), manifest)
}

/// Any valid manifest.
pub(crate) fn drafts() -> impl Strategy<Value = Draft> {
    let kind = prop_oneof![
        Just((Kind::Program, None)),
        "[a-z0-9-]{1,16}".prop_map(|name| (Kind::Model, Some(name))),
        "[a-z0-9-]{1,16}".prop_map(|name| (Kind::Policy, Some(name))),
    ];
    let texts = (
        "[a-z0-9-]{1,16}",
        "[A-Za-z0-9.+_-]{1,32}",
        "[A-Za-z0-9.+_-]{1,40}",
    );
    let numbers = (
        any::<u16>(),
        1..=u32::MAX,
        any::<u32>(),
        any::<Option<u64>>(),
    );
    let image = (
        1..=crawler_release::MAX_IMAGE,
        any::<[u8; HASH]>(),
        any::<u64>(),
    );
    let delta = proptest::option::of((any::<[u8; HASH]>(), "[a-z0-9]{1,40}", 1..=u32::MAX));
    let requires = (any::<u32>(), any::<u8>());
    (kind, texts, numbers, image, delta, requires).prop_map(
        |((kind, name), (board, version, build), numbers, image, delta, requires)| {
            let (chip, sequence, floor, expires) = numbers;
            let (size, sha256, seed) = image;
            let block_size = block_size(size).expect("in range");
            let length = size.div_ceil(block_size) as usize * BLOCK_HASH;
            Draft {
                kind,
                name,
                board,
                chip,
                version,
                build: build.clone(),
                sequence,
                floor: floor.min(sequence),
                expires,
                size,
                sha256,
                block_size,
                blocks: seed
                    .to_le_bytes()
                    .into_iter()
                    .cycle()
                    .take(length)
                    .collect(),
                delta: delta
                    .filter(|(base, other, _)| *base != sha256 && *other != build)
                    .map(|(base, build, patch)| (base, build, patch.min(size))),
                requires: Requires {
                    sequence: requires.0 % sequence,
                    protocol: requires.1,
                },
            }
        },
    )
}

/// The bytes of a manifest that need not be valid, by an encoder of the tests' own.
pub(crate) fn forced(draft: &Draft) -> Vec<u8> {
    fn head(out: &mut Vec<u8>, major: u8, value: u64) {
        let major = major << 5;
        match value {
            0..=23 => out.push(major | value as u8),
            24..=0xFF => out.extend([major | 0x18, value as u8]),
            0x100..=0xFFFF => {
                out.push(major | 0x19);
                out.extend((value as u16).to_be_bytes());
            }
            0x1_0000..=0xFFFF_FFFF => {
                out.push(major | 0x1A);
                out.extend((value as u32).to_be_bytes());
            }
            _ => {
                out.push(major | 0x1B);
                out.extend(value.to_be_bytes());
            }
        }
    }
    let mut fields: Vec<(u8, Vec<u8>)> = Vec::new();
    let mut number = |key: u8, value: u64| {
        let mut out = Vec::new();
        head(&mut out, 0, value);
        fields.push((key, out));
    };
    number(0, 1);
    number(1, draft.kind as u64);
    number(4, draft.chip.into());
    number(7, draft.sequence.into());
    number(8, draft.floor.into());
    if let Some(expires) = draft.expires {
        number(9, expires);
    }
    number(10, draft.size.into());
    number(12, draft.block_size.into());
    let mut string = |key: u8, major: u8, value: &[u8]| {
        let mut out = Vec::new();
        head(&mut out, major, value.len() as u64);
        out.extend(value);
        fields.push((key, out));
    };
    if let Some(name) = &draft.name {
        string(2, 3, name.as_bytes());
    }
    string(3, 3, draft.board.as_bytes());
    string(5, 3, draft.version.as_bytes());
    string(6, 3, draft.build.as_bytes());
    string(11, 2, &draft.sha256);
    string(13, 2, &draft.blocks);
    if let Some((base, build, size)) = &draft.delta {
        let mut out = vec![0x83];
        head(&mut out, 2, base.len() as u64);
        out.extend(base);
        head(&mut out, 3, build.len() as u64);
        out.extend(build.as_bytes());
        head(&mut out, 0, (*size).into());
        fields.push((14, out));
    }
    if draft.requires != Requires::default() {
        let mut out = vec![0x82];
        head(&mut out, 0, draft.requires.sequence.into());
        head(&mut out, 0, draft.requires.protocol.into());
        fields.push((15, out));
    }
    fields.sort_by_key(|(key, _)| *key);
    let mut out = Vec::new();
    head(&mut out, 5, fields.len() as u64);
    for (key, value) in fields {
        out.push(key);
        out.extend(value);
    }
    out
}
