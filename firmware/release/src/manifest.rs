//! What a release says of itself.

use core::fmt;

use crate::encoding::Malformed;

/// Version of the manifest's format that this crate reads and writes.
pub const FORMAT: u8 = 1;

/// Most bytes of an encoded manifest.
pub const MANIFEST_MAX: usize = 900;

/// Bytes of a SHA-256.
pub const HASH: usize = 32;

/// Bytes of a block's hash: the first half of its SHA-256. To find another block with the same one takes
/// 2^128 attempts, and the whole image is held against its full SHA-256 as well.
pub const BLOCK_HASH: usize = 16;

/// The sizes that blocks may have, in bytes; see [`block_size`].
pub const BLOCK_SIZES: [u32; 2] = [64 * 1024, 128 * 1024];

/// Most blocks of an image. With so many, and every other field at its longest, a manifest still fits
/// [`MANIFEST_MAX`].
pub const MAX_BLOCKS: usize = 36;

/// Most bytes of an image: 4.5 MiB, above the slots of a board with 8 MB of flash (3.5 MiB).
pub const MAX_IMAGE: u32 = BLOCK_SIZES[1] * MAX_BLOCKS as u32;

/// Most bytes of the name of a board, of a model and of a policy.
pub const MAX_NAME: usize = 16;

/// Most bytes of a version.
pub const MAX_VERSION: usize = 32;

/// Most bytes of a build id.
pub const MAX_BUILD: usize = 40;

/// The size of the blocks that an image of `size` bytes is hashed in; `None` when it is larger than
/// [`MAX_IMAGE`], or empty.
#[must_use]
pub const fn block_size(size: u32) -> Option<u32> {
    if size == 0 || size > MAX_IMAGE {
        None
    } else if size <= BLOCK_SIZES[0] * MAX_BLOCKS as u32 {
        Some(BLOCK_SIZES[0])
    } else {
        Some(BLOCK_SIZES[1])
    }
}

/// What an image is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A robot program, for an update slot.
    Program,
    /// A model of a neural network that looks: what the program's detector runs.
    Model,
    /// A policy: a model of a neural network that drives.
    Policy,
}

impl Kind {
    /// Every kind, in the order of their numbers in a manifest.
    pub const ALL: [Self; 3] = [Self::Program, Self::Model, Self::Policy];

    /// Its name in JSON, on the command line and in texts.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Program => "program",
            Self::Model => "model",
            Self::Policy => "policy",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The chip that an image is made for, by the number that Espressif gives it in the header of an image
/// (ESP-IDF, `esp_chip_id_t`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Chip(pub u16);

impl Chip {
    /// No chip of Espressif: the emulated board, a simulated robot, a model that any chip can run.
    pub const NONE: Self = Self(0xFFFF);
    /// ESP32-C3.
    pub const ESP32_C3: Self = Self(5);
    /// ESP32-S3.
    pub const ESP32_S3: Self = Self(9);
    /// ESP32-C6.
    pub const ESP32_C6: Self = Self(13);

    /// The chips that have a name here.
    pub const ALL: [Self; 4] = [Self::NONE, Self::ESP32_C3, Self::ESP32_S3, Self::ESP32_C6];

    /// Its name; `None` for a number that this crate does not know.
    #[must_use]
    pub const fn name(self) -> Option<&'static str> {
        match self {
            Self::NONE => Some("none"),
            Self::ESP32_C3 => Some("esp32c3"),
            Self::ESP32_S3 => Some("esp32s3"),
            Self::ESP32_C6 => Some("esp32c6"),
            Self(_) => None,
        }
    }
}

impl fmt::Display for Chip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.name() {
            Some(name) => f.write_str(name),
            None => write!(f, "chip-{}", self.0),
        }
    }
}

/// A patch that makes the image out of one that the robot already has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delta<'a> {
    /// SHA-256 of the image that it starts from.
    pub base: &'a [u8; HASH],
    /// Build id of that image.
    pub build: &'a str,
    /// Bytes of the patch. What it makes is held against the hashes of the manifest, so the patch needs
    /// none of its own.
    pub size: u32,
}

/// What must run on a robot before it may take the release. Zero asks for nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Requires {
    /// Least sequence that is installed: the way from an older one leads over a release in between.
    pub sequence: u32,
    /// Least version of the message protocol that the running program speaks.
    pub protocol: u8,
}

/// What a release says of itself. Borrows from the bytes that were signed.
///
/// A manifest that was decoded is valid: every field is within the limits that its description names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Manifest<'a> {
    /// What the image is.
    pub kind: Kind,
    /// Name of the model or the policy, of `a-z`, `0-9` and `-`, at most [`MAX_NAME`] bytes; `None` for programs.
    pub name: Option<&'a str>,
    /// The board that it is for, as the robot's `status` tells it; written as a name of a model is.
    pub board: &'a str,
    /// The chip that it is for.
    pub chip: Chip,
    /// Version for people: letters, digits and `.`, `+`, `-`, `_`, at most [`MAX_VERSION`] bytes.
    pub version: &'a str,
    /// Build id by which a robot proves that it runs the image; written as a version is, at most
    /// [`MAX_BUILD`] bytes.
    pub build: &'a str,
    /// Rises with every release of a board: a robot takes none that is not above its own. At least 1.
    pub sequence: u32,
    /// Once this release is confirmed, the least sequence that the robot will ever take. At most `sequence`.
    pub floor: u32,
    /// From this moment on no robot takes the release: Unix time, in seconds.
    pub expires: Option<u64>,
    /// Bytes of the image, 1 to [`MAX_IMAGE`].
    pub size: u32,
    /// SHA-256 of the image.
    pub sha256: &'a [u8; HASH],
    /// Bytes of a block, one of [`BLOCK_SIZES`]; the last block may be shorter.
    pub block_size: u32,
    /// The hash of each block, [`BLOCK_HASH`] bytes after [`BLOCK_HASH`] bytes.
    pub blocks: &'a [u8],
    /// A patch that makes the same image out of another.
    pub delta: Option<Delta<'a>>,
    /// What must run on a robot before.
    pub requires: Requires,
}

/// Whether `text` is a name of a board or a model.
fn is_name(text: &str) -> bool {
    let fits = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
    (1..=MAX_NAME).contains(&text.len()) && text.bytes().all(fits)
}

/// Whether `text` is a version or a build id of at most `most` bytes.
fn is_version(text: &str, most: usize) -> bool {
    let fits = |byte: u8| byte.is_ascii_alphanumeric() || b".+-_".contains(&byte);
    (1..=most).contains(&text.len()) && text.bytes().all(fits)
}

impl<'a> Manifest<'a> {
    /// Holds every field against its limits, and those that belong together against each other.
    ///
    /// # Errors
    /// [`Malformed::OutOfRange`] names the field.
    pub fn validate(&self) -> Result<(), Malformed> {
        let fits = |fits: bool, field| {
            if fits {
                Ok(())
            } else {
                Err(Malformed::OutOfRange(field))
            }
        };
        fits(
            match (self.kind, self.name) {
                (Kind::Program, name) => name.is_none(),
                (Kind::Model | Kind::Policy, name) => name.is_some_and(is_name),
            },
            "name",
        )?;
        fits(is_name(self.board), "board")?;
        fits(is_version(self.version, MAX_VERSION), "version")?;
        fits(is_version(self.build, MAX_BUILD), "build")?;
        fits(self.sequence > 0, "sequence")?;
        fits(self.floor <= self.sequence, "floor")?;
        fits((1..=MAX_IMAGE).contains(&self.size), "size")?;
        fits(BLOCK_SIZES.contains(&self.block_size), "block_size")?;
        let blocks = self.size.div_ceil(self.block_size) as usize;
        fits(
            blocks <= MAX_BLOCKS && self.blocks.len() == blocks * BLOCK_HASH,
            "blocks",
        )?;
        if let Some(delta) = self.delta {
            fits(is_version(delta.build, MAX_BUILD), "delta")?;
            // A patch that is larger than what it makes is of no use, nor is one that makes its base.
            fits((1..=self.size).contains(&delta.size), "delta")?;
            fits(
                delta.base != self.sha256 && delta.build != self.build,
                "delta",
            )?;
        }
        fits(self.requires.sequence < self.sequence, "requires")
    }

    /// How many blocks the image has.
    #[must_use]
    pub const fn block_count(&self) -> usize {
        self.blocks.len() / BLOCK_HASH
    }

    /// The hash of a block; `None` past the last.
    #[must_use]
    pub fn block(&self, index: usize) -> Option<&'a [u8; BLOCK_HASH]> {
        self.blocks.as_chunks().0.get(index)
    }

    /// Bytes of a block; `None` past the last.
    #[must_use]
    pub fn block_length(&self, index: usize) -> Option<u32> {
        self.block(index)?;
        let begin = self.block_size.checked_mul(u32::try_from(index).ok()?)?;
        Some(self.size.checked_sub(begin)?.min(self.block_size))
    }
}
