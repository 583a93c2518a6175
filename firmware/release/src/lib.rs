//! What a release is: one definition for robot, server and command line.
//!
//! A release is an image — a program or a model — and a [`Manifest`] that says what the image is and which
//! robots may run it. The manifest is signed offline with ECDSA on P-256; [`Signed`] is the manifest with its
//! signature, at most [`ENVELOPE_MAX`] bytes, so that it travels in one chunk. Everything else is derived from
//! it: an image is believed block by block because the manifest holds the hash of each block.
//!
//! | step | by |
//! |---|---|
//! | an envelope is taken apart | [`Signed::parse`] |
//! | its signature is checked, then its manifest is read | [`Signed::authenticate`] |
//! | it is for this robot, new, and not expired | [`Manifest::admit`] |
//! | the three in one | [`verify`] |
//! | pieces of the image arrive | [`chunk`], [`Want`] |
//! | each block, and then the whole, is what was signed | [`BlockHasher`], or [`ImageHasher`] for both at once |
//!
//! No field of a manifest is looked at before its signature has been verified. Nothing here reads a clock, a
//! key or an image by itself, and nothing allocates: a manifest borrows from the bytes that were signed.
//!
//! # Reading order
//!
//! `manifest`, with its bytes in `encoding`, read by `cbor`; `keys` and `envelope`; what a robot refuses in `target` and
//! `refusal`; the image in `image`; its transfer in `chunk` and `want`.
#![no_std]

#[cfg(test)]
extern crate std;

mod cbor;
pub mod chunk;
mod encoding;
mod envelope;
mod image;
mod keys;
mod manifest;
mod refusal;
mod target;
mod want;

pub use encoding::Malformed;
pub use envelope::{ENVELOPE_MAX, Signed};
pub use image::{BlockHasher, ImageError, ImageHasher, block_hash, image_hash};
pub use keys::{KeyError, KeyId, POINT, PublicKey, PublicKeys, SIGNATURE};
pub use manifest::{
    BLOCK_HASH, BLOCK_SIZES, Chip, Delta, FORMAT, HASH, Kind, MANIFEST_MAX, MAX_BLOCKS, MAX_BUILD,
    MAX_IMAGE, MAX_NAME, MAX_VERSION, Manifest, Requires, block_size,
};
pub use refusal::Refusal;
pub use target::{Target, verify};
pub use want::{WINDOW, Want};
