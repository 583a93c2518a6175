//! A delta from one file with a release to another.

use std::fmt;

use crawler_release::{ImageError, ImageHasher, Manifest, Signed};

use super::{apply, make};
use crate::release::{FileFault, split};

/// One of both releases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The one that a robot has.
    From,
    /// The one that it is to get.
    To,
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::From => "the release to start from",
            Self::To => "the release to make",
        })
    }
}

/// Why there is no delta between two releases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum BetweenFault {
    /// One is no release.
    File(Side, FileFault),
    /// One has another image than its manifest says.
    Image(Side, ImageError),
    /// They are for different boards or chips, of different kinds, or models of different names.
    Unlike,
    /// They are of the same build, or have the same image.
    Same,
    /// The patch has this many bytes, and the image has no more.
    Useless(usize),
    /// The patch does not make the image. A fault of this program, found before a robot would have found it.
    Wrong,
}

impl fmt::Display for BetweenFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(side, fault) => write!(f, "{side}: {fault}"),
            Self::Image(side, fault) => write!(f, "{side}: {fault}"),
            Self::Unlike => f.write_str("the releases are not for the same board, chip and kind"),
            Self::Same => f.write_str("the releases are of the same build"),
            Self::Useless(bytes) => write!(
                f,
                "the delta would have {bytes} bytes, no fewer than the image itself"
            ),
            Self::Wrong => {
                f.write_str("the delta does not make the image (a fault of this program)")
            }
        }
    }
}

impl std::error::Error for BetweenFault {}

/// A delta, and what it is between. A robot takes it when it runs the build `from`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Between<'a> {
    /// The manifest of the release that it starts from, by whomever it is signed.
    pub from: Manifest<'a>,
    /// The manifest of the release that it makes, by whomever it is signed.
    pub to: Manifest<'a>,
    /// The patch.
    pub patch: Vec<u8>,
}

/// Makes the delta between two files with releases, and applies it once to be sure. Who has signed them makes
/// no difference here: a robot believes nothing but the manifest of what comes out.
///
/// # Errors
/// [`BetweenFault`] says why there is none, or none of any use.
pub fn between<'a>(from: &'a [u8], to: &'a [u8]) -> Result<Between<'a>, BetweenFault> {
    let (from, old) = open(from, Side::From)?;
    let (to, new) = open(to, Side::To)?;
    if (from.kind, from.name, from.board, from.chip) != (to.kind, to.name, to.board, to.chip) {
        return Err(BetweenFault::Unlike);
    }
    if from.build == to.build || old == new {
        return Err(BetweenFault::Same);
    }
    let patch = make(old, new);
    if apply(old, to.size, &patch).as_deref() != Ok(new) {
        return Err(BetweenFault::Wrong);
    }
    if patch.len() >= new.len() {
        return Err(BetweenFault::Useless(patch.len()));
    }
    Ok(Between { from, to, patch })
}

/// Manifest and image of a release, which belong together.
fn open(file: &[u8], side: Side) -> Result<(Manifest<'_>, &[u8]), BetweenFault> {
    let (envelope, image) = split(file).map_err(|fault| BetweenFault::File(side, fault))?;
    let signed = Signed::parse(envelope).and_then(|signed| signed.unverified());
    let manifest = signed.map_err(|_| BetweenFault::File(side, FileFault))?;
    let mut hasher = ImageHasher::new(&manifest);
    let held = hasher.update(image).and_then(|()| hasher.finish());
    held.map_err(|error| BetweenFault::Image(side, error))?;
    Ok((manifest, image))
}
