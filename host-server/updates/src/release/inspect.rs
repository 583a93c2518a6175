//! What a release is worth, with every reason against it.

use crawler_protocol::ReleaseId;
use crawler_release::{ImageHasher, KeyId, Kind, Manifest, PublicKey, Refusal, Signed};

use super::image::check_names;
use super::{FileFault, ImageFault, chip_for, split};

/// A reason against a release.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// A stable name.
    pub code: &'static str,
    /// The same for people.
    pub text: String,
}

impl Fault {
    fn new(code: &'static str, text: impl Into<String>) -> Self {
        Self {
            code,
            text: text.into(),
        }
    }

    fn of(refusal: Refusal) -> Self {
        Self::new(refusal.code(), refusal.to_string())
    }
}

/// What somebody asks of a release beside that it is genuine.
#[derive(Debug, Clone, Copy, Default)]
pub struct Expected<'a> {
    /// The board that it must be for.
    pub board: Option<&'a str>,
    /// The sequence that it must be above.
    pub above: Option<u32>,
    /// The image that must be the one in the file.
    pub image: Option<&'a [u8]>,
    /// Unix time in seconds.
    pub now: u64,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Inspection<'a> {
    /// Which release it is.
    pub id: ReleaseId,
    /// The key that the release says it is signed with.
    pub key: KeyId,
    /// Whether one of the keys that were given has signed it. Until then its manifest is a claim.
    pub authentic: bool,
    /// What it says of itself.
    pub manifest: Option<Manifest<'a>>,
    /// Every reason against it; without one it is genuine, and what was expected.
    pub faults: Vec<Fault>,
}

/// Looks at a file with a release.
///
/// # Errors
/// When it is no such file at all.
pub fn inspect<'a>(
    file: &'a [u8],
    keys: &[PublicKey],
    expected: &Expected<'_>,
) -> Result<Inspection<'a>, FileFault> {
    let (envelope, image) = split(file)?;
    // What does not even begin like one is something else.
    let signed = Signed::parse(envelope).map_err(|_| FileFault)?;
    let mut faults = Vec::new();
    let key = keys.iter().find(|key| key.id() == signed.key());
    let authenticated = match key {
        Some(key) => signed.authenticate(key),
        None => Err(Refusal::UnknownKey(signed.key())),
    };
    let manifest = match authenticated {
        Ok(manifest) => Some(manifest),
        Err(refusal) => {
            faults.push(if keys.is_empty() {
                Fault::new("no_key", "not verified: no public key was given (--public)")
            } else {
                Fault::of(refusal)
            });
            signed.unverified().ok()
        }
    };
    if let Some(manifest) = &manifest {
        check(manifest, image, expected, &mut faults);
    } else if authenticated != Err(Refusal::BadSignature) && !faults.iter().any(is_malformed) {
        faults.push(Fault::new("malformed", "its manifest cannot be read"));
    }
    Ok(Inspection {
        id: ReleaseId::new(signed.id()),
        key: signed.key(),
        authentic: authenticated.is_ok(),
        manifest,
        faults,
    })
}

fn is_malformed(fault: &Fault) -> bool {
    ["malformed", "unknown_format"].contains(&fault.code)
}

/// Whether an image can be the one of its release.
fn check_image(manifest: &Manifest<'_>, image: &[u8]) -> Result<(), ImageFault> {
    chip_for(manifest.kind, manifest.board, Some(manifest.chip), image)?;
    match manifest.kind {
        Kind::Program => check_names(image, manifest.version, Some(manifest.build)),
        Kind::Model | Kind::Policy => Ok(()),
    }
}

fn check(manifest: &Manifest<'_>, image: &[u8], expected: &Expected<'_>, faults: &mut Vec<Fault>) {
    let mut hasher = ImageHasher::new(manifest);
    if let Err(error) = hasher.update(image).and_then(|()| hasher.finish()) {
        faults.push(Fault::new(error.code(), error.to_string()));
    } else if let Err(error) = check_image(manifest, image) {
        // What an image says of itself counts once it is the one that was signed.
        let code = match error {
            ImageFault::OtherChip(..) | ImageFault::Esp(_) => Refusal::WrongChip.code(),
            _ => "wrong_image",
        };
        faults.push(Fault::new(code, error.to_string()));
    }
    if expected.image.is_some_and(|other| other != image) {
        let text = "the image of the release is not the one that was given";
        faults.push(Fault::new("other_image", text));
    }
    if let Some(board) = expected.board
        && board != manifest.board
    {
        let text = format!("for the board {}, not {board}", manifest.board);
        faults.push(Fault::new(Refusal::WrongBoard.code(), text));
    }
    if manifest.expires.is_some_and(|end| end <= expected.now) {
        faults.push(Fault::of(Refusal::Expired));
    }
    if let Some(above) = expected.above
        && manifest.sequence <= above
    {
        let text = format!("its sequence {} is not above {above}", manifest.sequence);
        faults.push(Fault::new(Refusal::Downgrade.code(), text));
    }
}
