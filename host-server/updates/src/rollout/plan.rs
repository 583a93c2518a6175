//! What a rollout is to do: which releases, to whom, in which order, and within which limits.

use crawler_protocol::{Kind, ModelName, RobotId};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::names::{BoardName, BuildId, ReleaseId, Version};
use super::window::Window;

/// A plan, as the API takes it. [`Plan::check`] says what is wrong with one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutPlan)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The releases: at most one that suits a robot. Robots that none suits are left alone.
    pub releases: Vec<PlannedRelease>,
    /// The phases, first to last. A robot belongs to the first that selects it.
    pub phases: Vec<Phase>,
    /// How much at once.
    #[serde(default)]
    pub limits: Limits,
    /// When robots may be offered a release; at any time without one. What has begun by its end goes on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<Window>,
    /// What becomes of attempts that fail without saying anything about the release.
    #[serde(default)]
    pub retries: Retries,
    /// How long a robot may take.
    #[serde(default)]
    pub timeouts: Timeouts,
    /// Set where releases go out although no report says that they passed what they were to be tried on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub override_gate: Option<GateOverride>,
}

/// Releases without a passing gate that an administrator rolls out all the same.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutGateOverride)]
#[serde(deny_unknown_fields)]
pub struct GateOverride {
    /// Why, in the words of whoever does it.
    pub why: String,
    /// Which.
    #[schema(value_type = Vec<String>)]
    pub releases: Vec<ReleaseId>,
}

/// A release, and the robots that it suits.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PlannedRelease {
    /// The release.
    #[schema(value_type = String)]
    pub release: ReleaseId,
    /// The board that it is for.
    #[schema(value_type = String)]
    pub board: BoardName,
    /// The kind of robot that it is for; all on that board without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub kind: Option<Kind>,
    /// The model, or the policy, that it brings; a program without one. All releases of a plan bring the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub model: Option<ModelName>,
    /// Whether that is a policy.
    #[serde(default, skip_serializing_if = "is_false")]
    pub policy: bool,
    /// What a robot that runs it reports as its build, or as that of the model.
    #[schema(value_type = String)]
    pub build: BuildId,
    /// Its version, for people.
    #[schema(value_type = String)]
    pub version: Version,
    /// Its place in the order of releases: robots refuse one that is not above what they run.
    pub sequence: u64,
    /// Size of the image.
    pub bytes: u32,
}

// The form that serde asks for.
#[allow(clippy::trivially_copy_pass_by_ref)]
const fn is_false(value: &bool) -> bool {
    !*value
}

/// What of a robot a release replaces. Each has an order of releases, and rollouts, of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Replaced<'a> {
    /// Its program.
    Program,
    /// A model that looks.
    Model(&'a ModelName),
    /// The one policy that a release may have brought, whatever it is called.
    Policy,
}

impl Plan {
    /// The model or the policy that the releases bring; `None` for programs.
    #[must_use]
    pub fn model(&self) -> Option<&ModelName> {
        self.releases.first()?.model.as_ref()
    }

    /// What the releases replace; `None` where there are none.
    #[must_use]
    pub fn replaces(&self) -> Option<Replaced<'_>> {
        self.releases.first().map(PlannedRelease::replaces)
    }
}

impl PlannedRelease {
    /// What it replaces.
    #[must_use]
    pub fn replaces(&self) -> Replaced<'_> {
        match &self.model {
            None => Replaced::Program,
            Some(_) if self.policy => Replaced::Policy,
            Some(name) => Replaced::Model(name),
        }
    }

    /// Whether it is for robots of this kind on this board.
    #[must_use]
    pub fn suits(&self, board: &BoardName, kind: Kind) -> bool {
        self.board == *board && self.kind.is_none_or(|own| own == kind)
    }

    /// Whether there may be a robot that both suit.
    pub(super) fn overlaps(&self, other: &Self) -> bool {
        self.board == other.board
            && (self.kind.is_none() || other.kind.is_none() || self.kind == other.kind)
    }
}

/// One phase.
///
/// It is *passed* when no robot of it is at work or waits for the rollout, at least `min_count` of its robots
/// have come to an end, and at least `success_percent` of those are confirmed; and when that is so again, or
/// still, `soak_s` after it first was. Robots that wait for themselves (offline, asleep, driving, low) do not hold
/// it up: they move on to the next phase, and are served there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutPhase)]
#[serde(deny_unknown_fields)]
pub struct Phase {
    /// Who belongs to it.
    #[schema(value_type = SelectionSchema)]
    pub select: Selection,
    /// How long it is watched once its robots are done, in seconds.
    #[serde(default = "soak_s")]
    pub soak_s: u32,
    /// Share of the robots that came to an end that must be confirmed.
    #[serde(default = "success_percent")]
    pub success_percent: u8,
    /// Robots that must have come to an end before it passes; all of its robots if it has fewer.
    #[serde(default = "min_count")]
    pub min_count: u32,
    /// The rollout stops by itself at this share of failures among the robots of the phase, but not below two
    /// failures.
    #[serde(default = "stop_percent")]
    pub stop_percent: u8,
    /// Robots that must have come to an end before failures stop it; all of its robots if it has fewer.
    #[serde(default = "min_count")]
    pub stop_min_count: u32,
}

/// Robots of a phase.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Selection {
    /// The first so many percent of all robots that a release suits, those of earlier phases included, rounded
    /// up. Who is first is by chance, and another in each rollout.
    Share(u8),
    /// These robots.
    Group(Vec<RobotId>),
    /// Robots on this board.
    Board(BoardName),
    /// Robots of this kind.
    Kind(Kind),
}

/// One of these: share of all robots in percent, names of robots, a board, a kind.
#[derive(ToSchema)]
#[schema(as = RolloutSelection, rename_all = "snake_case")]
#[allow(
    dead_code,
    reason = "it describes `Selection`, in types that can be described"
)]
enum SelectionSchema {
    Share(u8),
    Group(Vec<String>),
    Board(String),
    Kind(String),
}

/// How much at once.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutLimits)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Robots at work at once, from the offer to the end of the trial.
    pub parallel: u32,
    /// Bytes of images per second, to all robots together; no limit without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes_per_second: Option<u32>,
    /// How long robots that wait are waited for once the last phase has passed, in seconds; for good without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wait_s: Option<u32>,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            parallel: 50,
            bytes_per_second: None,
            wait_s: None,
        }
    }
}

/// What becomes of attempts that fail without saying anything about the release: time-outs, and refusals that
/// need not last. A release that was tried and rolled back is never tried again without a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutRetries)]
#[serde(deny_unknown_fields, default)]
pub struct Retries {
    /// Attempts before a robot has failed.
    pub attempts: u8,
    /// Pause after the first failed attempt, in seconds; it doubles with each.
    pub pause_s: u32,
    /// The longest pause, in seconds.
    pub longest_pause_s: u32,
    /// When a robot that has deferred an offer is asked again, in seconds.
    pub deferred_s: u32,
}

impl Default for Retries {
    fn default() -> Self {
        Self {
            attempts: 3,
            pause_s: 60,
            longest_pause_s: 3_600,
            deferred_s: 60,
        }
    }
}

/// How long a robot may stay in each state, in seconds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutTimeouts)]
#[serde(deny_unknown_fields, default)]
pub struct Timeouts {
    /// From the offer to any answer.
    pub offered_s: u32,
    /// Room is made for the image.
    pub preparing_s: u32,
    /// Without a byte more.
    pub receiving_s: u32,
    /// The image is held against its hash and its signature.
    pub verifying_s: u32,
    /// From a whole image to the first word of the new program.
    pub staged_s: u32,
    /// From the first word of the new program to its confirmation, or to the old program.
    pub trial_s: u32,
    /// The whole attempt up to the trial, whatever the robot reports meanwhile.
    pub attempt_s: u32,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            offered_s: 60,
            preparing_s: 180,
            receiving_s: 180,
            verifying_s: 180,
            staged_s: 600,
            trial_s: 600,
            attempt_s: 4 * 3_600,
        }
    }
}

const fn soak_s() -> u32 {
    600
}

const fn success_percent() -> u8 {
    95
}

const fn min_count() -> u32 {
    1
}

const fn stop_percent() -> u8 {
    5
}
