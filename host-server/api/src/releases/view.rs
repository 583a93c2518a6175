//! What is said of releases.

use crawler_records::KeptRelease;
use crawler_release::Signed;
use crawler_system::text::hex;
use serde::Serialize;
use utoipa::ToSchema;

use crate::problem::Problem;

/// The latest time that is told, in Unix milliseconds: readers of JSON have whole numbers up to 2^53 - 1.
const END_OF_TIME: i64 = (1 << 53) - 1;

/// Who has withdrawn a release.
#[derive(Serialize, ToSchema)]
#[schema(as = ReleaseWithdrawal)]
pub(crate) struct WithdrawalView {
    /// The account.
    by: String,
    /// When, in Unix milliseconds.
    at: i64,
    /// Why.
    reason: String,
}

/// A release.
#[derive(Serialize, ToSchema)]
#[schema(as = Release)]
pub(crate) struct ReleaseView {
    /// Its id.
    id: String,
    /// `program`, `model` or `policy`.
    kind: String,
    /// Name of the model or the policy; `null` for programs.
    name: Option<String>,
    /// The board that it is for.
    board: String,
    /// Version, for people.
    version: String,
    /// Build id, by which a robot proves that it runs it.
    build: String,
    /// Its number among the releases for the board.
    sequence: u32,
    /// The least sequence that a robot takes once it has confirmed this release.
    floor: u32,
    /// From when on no robot takes it, in Unix milliseconds; `null` for never.
    expires_at: Option<i64>,
    /// Bytes of its image.
    size: u32,
    /// The account that added it.
    by: String,
    /// When it was added, in Unix milliseconds.
    added_at: i64,
    /// What its gate says, the report on what it was tried on: `passed` or `failed`; `null` where there is none.
    #[schema(value_type = Option<String>)]
    gate: Option<&'static str>,
    /// Who has withdrawn it; `null` while nobody has.
    withdrawn: Option<WithdrawalView>,
}

impl ReleaseView {
    pub(crate) fn new(release: KeptRelease) -> Self {
        let ends = |end: i64| end.saturating_mul(1_000).min(END_OF_TIME);
        Self {
            kind: match release.what() {
                Some(kind) => kind.name().to_owned(),
                None => release.kind,
            },
            id: release.id,
            name: release.name,
            board: release.board,
            version: release.version,
            build: release.build,
            sequence: release.sequence,
            floor: release.floor,
            expires_at: release.expires.map(ends),
            size: release.size,
            by: release.by,
            added_at: release.added,
            gate: release
                .passed
                .map(|passed| if passed { "passed" } else { "failed" }),
            withdrawn: release.withdrawn.map(|withdrawal| WithdrawalView {
                by: withdrawal.by,
                at: withdrawal.at,
                reason: withdrawal.why,
            }),
        }
    }
}

/// Releases.
#[derive(Serialize, ToSchema)]
#[schema(as = Releases)]
pub(crate) struct ReleaseList {
    /// Those that were added last first.
    pub(super) releases: Vec<ReleaseView>,
    /// `before` of the next page; `null` where there is none.
    pub(super) next: Option<String>,
    /// Whether this server has a public key to believe releases by. Without one it takes none.
    pub(super) can_add: bool,
}

/// A patch that makes an image out of another.
#[derive(Serialize, ToSchema)]
#[schema(as = ReleaseDelta)]
pub(crate) struct DeltaView {
    /// SHA-256 of the image that it starts from.
    base: String,
    /// Build id of that image.
    build: String,
    /// Bytes of the patch.
    size: u32,
}

/// What must run on a robot before.
#[derive(Serialize, ToSchema)]
#[schema(as = ReleaseRequires)]
pub(crate) struct RequiresView {
    /// The least sequence; 0 asks for nothing.
    sequence: u32,
    /// The least version of the protocol; 0 asks for nothing.
    protocol: u8,
}

/// A release, with what its manifest says.
#[derive(Serialize, ToSchema)]
#[schema(as = ReleaseDetail)]
pub(crate) struct ReleaseDetail {
    /// What is in the list of releases as well.
    #[serde(flatten)]
    release: ReleaseView,
    /// Id of the key that has signed it.
    key: String,
    /// The chip that it is for.
    chip: String,
    /// SHA-256 of its image.
    sha256: String,
    /// Bytes of a block of the image, each of which has a hash of its own.
    block_size: u32,
    /// How many blocks there are.
    blocks: usize,
    /// A patch that makes the same image out of another; `null` where there is none.
    delta: Option<DeltaView>,
    /// What must run on a robot before.
    requires: RequiresView,
}

impl ReleaseDetail {
    pub(super) fn new(release: KeptRelease) -> Result<Self, Problem> {
        let unreadable = || Problem::internal("a manifest in the records cannot be read");
        let envelope = release.envelope.clone();
        let signed = Signed::parse(&envelope).map_err(|_| unreadable())?;
        // Who signed it was found out when it came here.
        let manifest = signed.unverified().map_err(|_| unreadable())?;
        Ok(Self {
            release: ReleaseView::new(release),
            key: signed.key().to_string(),
            chip: manifest.chip.to_string(),
            sha256: hex(manifest.sha256),
            block_size: manifest.block_size,
            blocks: manifest.block_count(),
            delta: manifest.delta.map(|delta| DeltaView {
                base: hex(delta.base),
                build: delta.build.to_owned(),
                size: delta.size,
            }),
            requires: RequiresView {
                sequence: manifest.requires.sequence,
                protocol: manifest.requires.protocol,
            },
        })
    }
}
