//! Bundles: the images of the board `sim`.
//!
//! A simulated robot runs the program that it is compiled with. What goes into its slots says what that
//! program pretends to be: its version and build, parameters that it overrides, and *defects*, so that the
//! rollout of a bad release can be rehearsed. A bundle is as large as one likes, as a program is.
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0 | 4 | [`MAGIC`] |
//! | 4 | 1 | version of the format, 1 |
//! | 5 | 2 | length of the header with its checksum, at most [`HEADER_MAX`] |
//! | 7 | 4 | bytes of the whole image |
//! | 11 | 1 + n | version: length and text |
//! | | 1 + n | build: length and text |
//! | | 1 | number of parameters, at most [`PARAMETERS_MAX`] |
//! | | each 1 + n + 4 | name, and value as `f32`; sorted by name |
//! | | 1 | number of defects, at most [`DEFECTS_MAX`] |
//! | | each 1 + 1 + 4 | what it is, the share of robots in percent, and its number; sorted by what it is |
//! | | 4 | CRC-32 of the header before |
//! | behind the header | | bytes drawn from a seed |
//! | the last 8 | 8 | [`Digest`] of everything before |
//!
//! Numbers are little-endian. A bundle has one encoding, and any other is refused.
//!
//! Reading order: `defect`, then `header` for what is said, and `image` for the bytes around it.

mod defect;
mod header;
mod image;

use std::fmt;

pub use defect::{Defect, DefectFault, DefectKind};
pub use header::{Bundle, Header};
pub use image::{Digest, decode};

/// The first bytes of a bundle.
pub const MAGIC: [u8; 4] = *b"TCSB";
/// Most bytes of the header.
pub const HEADER_MAX: usize = 512;
/// Bytes of the digest behind the rest.
pub const DIGEST_BYTES: usize = 8;
/// Most bytes of a bundle: a slot of a simulated robot, without its journal.
pub const SIZE_MAX: u32 = 764 * 1_024;
/// Bytes of a bundle of which nobody says how large it is to be: as many as the program of the emulated board
/// has, in thousands.
pub const SIZE_DEFAULT: u32 = 608_000;
/// Longest version in bytes.
pub const VERSION_MAX: usize = 32;
/// Longest build id in bytes.
pub const BUILD_MAX: usize = 40;
/// Most parameters.
pub const PARAMETERS_MAX: usize = 8;
/// Longest name of a parameter in bytes.
pub const NAME_MAX: usize = 24;
/// Most defects: each kind once.
pub const DEFECTS_MAX: usize = DefectKind::ALL.len();

/// Why bytes are no bundle, or a bundle cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum BundleFault {
    /// They do not begin like one.
    NotBundle,
    /// A format of a later version.
    Format(u8),
    /// Fewer bytes than it says.
    Short,
    /// More bytes than it says.
    Long,
    /// This cannot be so.
    Malformed(&'static str),
    /// Changed since it was made.
    Checksum,
}

impl fmt::Display for BundleFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotBundle => f.write_str("not a bundle: it does not begin as one"),
            Self::Format(version) => write!(f, "a bundle of format {version}, which is not known"),
            Self::Short => f.write_str("the bundle is cut off"),
            Self::Long => f.write_str("bytes behind the bundle"),
            Self::Malformed("version") => {
                f.write_str("a version has 1 to 32 letters, digits and `.+-_`")
            }
            Self::Malformed("build") => {
                f.write_str("a build id has 1 to 40 letters, digits and `.+-_`")
            }
            Self::Malformed("size") => write!(
                f,
                "a bundle has at most {SIZE_MAX} bytes, and at least as many as its header needs"
            ),
            Self::Malformed("parameters") => write!(
                f,
                "a bundle has at most {PARAMETERS_MAX} parameters, each once, with a name of at most \
                 {NAME_MAX} letters a-z, digits and `_`, and a finite value"
            ),
            Self::Malformed("defects") => {
                f.write_str("a bundle has each defect at most once, for 1 to 100 % of the robots")
            }
            Self::Malformed(what) => write!(f, "a bundle with a wrong {what}"),
            Self::Checksum => f.write_str("the bundle was changed since it was made"),
        }
    }
}

impl std::error::Error for BundleFault {}
