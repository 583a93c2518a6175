//! Which releases a robot takes.

use crate::envelope::Signed;
use crate::keys::PublicKeys;
use crate::manifest::{Chip, Kind, Manifest};
use crate::refusal::Refusal;

/// A place for releases in a robot: its update slot, or that of a model or of a policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Target<'a> {
    /// What belongs there.
    pub kind: Kind,
    /// Which model; `None` for programs, and where policies of any name are taken.
    pub name: Option<&'a str>,
    /// The robot's board.
    pub board: &'a str,
    /// Its chip.
    pub chip: Chip,
    /// Bytes that the place has for an image.
    pub capacity: u32,
    /// Sequence of what is installed there; 0 for what came by cable.
    pub sequence: u32,
    /// The least sequence that is taken, raised by each release that was confirmed.
    pub floor: u32,
    /// Build id of what is installed there and runs.
    pub build: &'a str,
    /// Version of the message protocol that the running program speaks.
    pub protocol: u8,
    /// The robot's clock, Unix time in seconds, once it is set.
    pub now: Option<u64>,
    /// When the running program was built, Unix time in seconds: it cannot be earlier than that.
    pub built_at: u64,
}

impl Manifest<'_> {
    /// Whether a robot takes the release. Only for a manifest that was authenticated.
    ///
    /// # Errors
    /// The first reason against it.
    pub fn admit(&self, target: &Target<'_>) -> Result<(), Refusal> {
        let now = target.now.unwrap_or(0).max(target.built_at);
        let reasons = [
            (
                self.kind != target.kind || (target.name.is_some() && self.name != target.name),
                Refusal::WrongKind,
            ),
            (self.board != target.board, Refusal::WrongBoard),
            (self.chip != target.chip, Refusal::WrongChip),
            (self.expires.is_some_and(|end| end <= now), Refusal::Expired),
            (self.sequence < target.floor, Refusal::BelowFloor),
            (self.sequence <= target.sequence, Refusal::Downgrade),
            (self.build == target.build, Refusal::SameBuild),
            (self.size > target.capacity, Refusal::TooLarge),
            (
                self.requires.sequence > target.sequence
                    || self.requires.protocol > target.protocol,
                Refusal::Requires,
            ),
        ];
        match reasons.into_iter().find(|(applies, _)| *applies) {
            Some((_, refusal)) => Err(refusal),
            None => Ok(()),
        }
    }
}

/// Everything that is asked of a release before the first byte is erased for it.
///
/// # Errors
/// The first reason against it. Before the signature is verified nothing of the manifest is looked at.
pub fn verify<'a>(
    envelope: &'a [u8],
    keys: &PublicKeys,
    target: &Target<'_>,
) -> Result<Manifest<'a>, Refusal> {
    let signed = Signed::parse(envelope)?;
    let key = keys.find(signed.key());
    let key = key.ok_or(Refusal::UnknownKey(signed.key()))?;
    let manifest = signed.authenticate(key)?;
    manifest.admit(target)?;
    Ok(manifest)
}
