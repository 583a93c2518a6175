//! Why a release is not taken.

use core::fmt;

use crate::encoding::Malformed;
use crate::keys::KeyId;

/// Why a robot does not take a release. Nothing has been erased for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Refusal {
    /// It is no signed release: cut off, changed on its way, or of something else.
    Malformed(Malformed),
    /// It is signed with a key that this program does not know.
    UnknownKey(KeyId),
    /// The signature is not one of that key over this manifest.
    BadSignature,
    /// It is of another kind than what belongs there, as a model where a program does, or another model.
    WrongKind,
    /// It is for another board.
    WrongBoard,
    /// It is for another chip.
    WrongChip,
    /// It may no longer be installed.
    Expired,
    /// Its sequence is not above the one that is installed.
    Downgrade,
    /// Its sequence is below what this robot will ever take again.
    BelowFloor,
    /// It is the build that runs.
    SameBuild,
    /// The image is larger than the place for it.
    TooLarge,
    /// A release in between has to be installed first.
    Requires,
}

impl Refusal {
    /// A stable name, for messages and records.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::Malformed(Malformed::Format(_)) => "unknown_format",
            Self::Malformed(_) => "malformed",
            Self::UnknownKey(_) => "unknown_key",
            Self::BadSignature => "bad_signature",
            Self::WrongKind => "wrong_kind",
            Self::WrongBoard => "wrong_board",
            Self::WrongChip => "wrong_chip",
            Self::Expired => "expired",
            Self::Downgrade => "downgrade",
            Self::BelowFloor => "below_floor",
            Self::SameBuild => "same_build",
            Self::TooLarge => "too_large",
            Self::Requires => "requires",
        }
    }
}

impl From<Malformed> for Refusal {
    fn from(malformed: Malformed) -> Self {
        Self::Malformed(malformed)
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Malformed(malformed) => return write!(f, "no signed release: {malformed}"),
            Self::UnknownKey(id) => return write!(f, "signed with the unknown key {id}"),
            Self::BadSignature => "the signature is wrong",
            Self::WrongKind => "another kind of release, or another model",
            Self::WrongBoard => "for another board",
            Self::WrongChip => "for another chip",
            Self::Expired => "expired",
            Self::Downgrade => "its sequence is not above the installed one",
            Self::BelowFloor => "its sequence is below the floor",
            Self::SameBuild => "this build runs already",
            Self::TooLarge => "the image is larger than the place for it",
            Self::Requires => "a release in between has to be installed first",
        })
    }
}

impl core::error::Error for Refusal {}
