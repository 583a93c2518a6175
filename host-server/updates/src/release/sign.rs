//! Making a release.

use std::fmt;

use crawler_release::{
    Chip, ENVELOPE_MAX, Kind, MANIFEST_MAX, Malformed, Manifest, Requires, Signed, block_hash,
    block_size, image_hash,
};

use super::image::{ImageFault, check_names, chip_for};
use super::keys::SecretKey;

/// Why nothing was signed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SignFault {
    /// The image cannot be one for the board.
    Image(ImageFault),
    /// What is to be said of it cannot be.
    Manifest(Malformed),
    /// A program without a build id: nobody could tell whether it runs.
    NoBuild,
}

impl fmt::Display for SignFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Image(fault) => fault.fmt(f),
            Self::Manifest(Malformed::OutOfRange("floor")) => {
                f.write_str("the floor is above the sequence")
            }
            Self::Manifest(Malformed::OutOfRange("requires")) => {
                f.write_str("a release cannot require its own sequence, or a later one")
            }
            Self::Manifest(Malformed::OutOfRange("name")) => {
                f.write_str("a model or a policy has a name of at most 16 letters a-z, digits and `-`, a program none")
            }
            Self::Manifest(Malformed::OutOfRange("board")) => {
                f.write_str("a board has a name of at most 16 letters a-z, digits and `-`")
            }
            Self::Manifest(Malformed::OutOfRange("version")) => {
                f.write_str("a version has at most 32 letters, digits and `.+-_`")
            }
            Self::Manifest(Malformed::OutOfRange("build")) => {
                f.write_str("a build id has at most 40 letters, digits and `.+-_`")
            }
            Self::Manifest(fault) => fault.fmt(f),
            Self::NoBuild => f.write_str(
                "the build id of a program has to be named (--build): by it a robot proves that it runs",
            ),
        }
    }
}

impl std::error::Error for SignFault {}

impl From<ImageFault> for SignFault {
    fn from(fault: ImageFault) -> Self {
        Self::Image(fault)
    }
}

impl From<Malformed> for SignFault {
    fn from(fault: Malformed) -> Self {
        Self::Manifest(fault)
    }
}

/// What is to be signed. The fields are those of [`Manifest`].
#[derive(Debug, Clone)]
pub struct SignOptions<'a> {
    /// What the image is.
    pub kind: Kind,
    /// Name of the model or the policy.
    pub name: Option<&'a str>,
    /// The board that it is for.
    pub board: &'a str,
    /// Its chip, where the board's name or the image does not tell.
    pub chip: Option<Chip>,
    /// Version for people.
    pub version: &'a str,
    /// Build id; without it a model or a policy goes by the first half of its SHA-256, in 32 digits.
    pub build: Option<&'a str>,
    /// Sequence.
    pub sequence: u32,
    /// The least sequence that is taken once this release is confirmed.
    pub floor: u32,
    /// Unix time in seconds from which on it is not taken.
    pub expires: Option<u64>,
    /// What must run before.
    pub requires: Requires,
}

impl SignOptions<'_> {
    /// The envelope of a release of `image`.
    ///
    /// # Errors
    /// [`SignFault`] says why no robot could take it.
    pub fn sign(&self, image: &[u8], key: &SecretKey) -> Result<Vec<u8>, SignFault> {
        let chip = chip_for(self.kind, self.board, self.chip, image)?;
        if self.kind == Kind::Program {
            check_names(image, self.version, self.build)?;
        }
        let size = u32::try_from(image.len()).map_err(|_| ImageFault::TooLarge)?;
        let block_size = block_size(size).ok_or(ImageFault::TooLarge)?;
        let blocks: Vec<u8> = image
            .chunks(block_size as usize)
            .flat_map(block_hash)
            .collect();
        let sha256 = image_hash(image);
        let digits = format!("{:032x}", u128::from_be_bytes(block_hash(image)));
        let build = match (self.build, self.kind) {
            (Some(build), _) => build,
            (None, Kind::Model | Kind::Policy) => &digits,
            (None, Kind::Program) => return Err(SignFault::NoBuild),
        };
        let manifest = Manifest {
            kind: self.kind,
            name: self.name,
            board: self.board,
            chip,
            version: self.version,
            build,
            sequence: self.sequence,
            floor: self.floor,
            expires: self.expires,
            size,
            sha256: &sha256,
            block_size,
            blocks: &blocks,
            delta: None,
            requires: self.requires,
        };
        let mut encoded = [0; MANIFEST_MAX];
        let length = manifest.encode(&mut encoded)?;
        let encoded = &encoded[..length];
        let signature = key.sign(&image_hash(encoded));
        let signed = Signed::new(key.public().id(), &signature, encoded)?;
        let mut envelope = [0; ENVELOPE_MAX];
        let length = signed.write(&mut envelope)?;
        Ok(envelope[..length].to_vec())
    }
}
