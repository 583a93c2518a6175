//! Where a robot of a rollout stands.

use std::fmt;

use crawler_protocol::RobotId;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::names::{BuildId, Code};

/// Where a robot stands. Those from [`UpdateState::Offered`] to [`UpdateState::RolledBack`], but for the waiting,
/// are of the contract; the others are the server's own.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum UpdateState {
    /// No release suits it, or no phase selects it. It is left alone.
    NotApplicable,
    /// Its turn has not come, or it cannot be offered anything just now.
    Waiting,
    /// It was offered the release, and has not answered.
    Offered,
    /// It has answered that now is no good time. It is asked again.
    Deferred,
    /// It makes room for the image.
    Preparing,
    /// It receives the image.
    Receiving,
    /// It holds the image against hash and signature.
    Verifying,
    /// The image is whole; the robot is about to start it.
    Staged,
    /// It runs the new program, and may still go back.
    Trial,
    /// It runs the new program for good.
    Confirmed,
    /// It has tried the new program, and is back on the old one.
    RolledBack,
    /// It has not come to run the release, and is not asked again.
    Failed,
    /// It was left out: by a person, by the end of the rollout, or since it never came.
    Skipped,
    /// A newer rollout has it now.
    Superseded,
}

impl UpdateState {
    /// Every state.
    pub const ALL: [Self; 14] = [
        Self::NotApplicable,
        Self::Waiting,
        Self::Offered,
        Self::Deferred,
        Self::Preparing,
        Self::Receiving,
        Self::Verifying,
        Self::Staged,
        Self::Trial,
        Self::Confirmed,
        Self::RolledBack,
        Self::Failed,
        Self::Skipped,
        Self::Superseded,
    ];

    /// The name, as the API tells it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotApplicable => "not_applicable",
            Self::Waiting => "waiting",
            Self::Offered => "offered",
            Self::Deferred => "deferred",
            Self::Preparing => "preparing",
            Self::Receiving => "receiving",
            Self::Verifying => "verifying",
            Self::Staged => "staged",
            Self::Trial => "trial",
            Self::Confirmed => "confirmed",
            Self::RolledBack => "rolled_back",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
            Self::Superseded => "superseded",
        }
    }

    /// Whether the robot is at work on an offer, up to the moment when it starts the new program.
    #[must_use]
    pub const fn is_before_trial(self) -> bool {
        matches!(
            self,
            Self::Offered | Self::Preparing | Self::Receiving | Self::Verifying | Self::Staged
        )
    }

    /// Whether the robot takes one of the places of [`super::plan::Limits::parallel`].
    #[must_use]
    pub const fn is_in_flight(self) -> bool {
        self.is_before_trial() || matches!(self, Self::Trial)
    }

    /// Whether the robot may be sent parts of the image.
    #[must_use]
    pub const fn may_receive(self) -> bool {
        matches!(
            self,
            Self::Offered | Self::Preparing | Self::Receiving | Self::Verifying
        )
    }

    /// Whether the robot waits to be offered the release, for the first time or again.
    #[must_use]
    pub const fn is_waiting(self) -> bool {
        matches!(self, Self::Waiting | Self::Deferred)
    }

    /// Whether it speaks against the release.
    #[must_use]
    pub const fn is_failure(self) -> bool {
        matches!(self, Self::RolledBack | Self::Failed)
    }

    /// Whether nothing more happens to the robot unless a person asks for it, or it shows that the server was
    /// wrong about it.
    #[must_use]
    pub const fn is_over(self) -> bool {
        !self.is_in_flight() && !self.is_waiting()
    }
}

impl fmt::Display for UpdateState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Why a robot stands where it does.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = UpdateReason)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The robot says so.
    Told(Code),
    /// It took too long in this state.
    TimedOut(UpdateState),
    /// It has confirmed another build than that of the release.
    WrongBuild(BuildId),
    /// It has started anew, and reports another build than that of the release.
    OldBuild,
    /// It ran the build of the release before it was offered anything.
    AlreadyThere,
    /// No release is for its board and kind.
    NoRelease,
    /// The releases bring a model, and it does not see.
    NoVision,
    /// The releases bring a policy, and it has no room for one.
    NoPolicies,
    /// No phase selects it.
    NotSelected,
    /// It went offline on the way. It goes on where it was.
    Interrupted,
    /// The robot gave the offer up on the server's word.
    Withdrawn,
    /// The rollout was paused.
    Paused,
    /// The rollout was aborted.
    Aborted,
    /// A person left it out.
    LeftOut,
    /// A person has asked for another attempt.
    Retried,
    /// A newer rollout has it.
    NewerRollout,
    /// It did not come before the rollout ended.
    NeverReached,
}

/// What is stored of a robot of a rollout. Times are those of the rollout's own clock, in milliseconds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotRow {
    /// The robot.
    pub robot: RobotId,
    /// Rises with every change.
    pub revision: u32,
    /// Where it stands.
    pub state: UpdateState,
    /// Why.
    pub reason: Option<Reason>,
    /// Which release of the plan is for it, from 0.
    pub release: Option<u8>,
    /// Which phase it belongs to, from 0. It moves on with the phases while it waits for itself.
    pub phase: Option<u8>,
    /// Failed attempts since the last offer by hand.
    pub attempts: u8,
    /// How often it was offered the release, for whatever reason.
    pub offers: u32,
    /// Bytes of the image that it has.
    pub received: u32,
    /// How often it had started when it was last known to be where it stands.
    pub boot: u32,
    /// Its failure does not count any more: a person has let the rollout go on since.
    pub forgiven: bool,
    /// It is to give up what it was offered, and has not said that it did.
    pub recalled: bool,
    /// Since when it is in this state.
    pub since_ms: u64,
    /// When its time in this state is over: an attempt has failed, or a pause has ended.
    pub due_ms: Option<u64>,
    /// When the newest message goes to it again.
    pub resend_ms: Option<u64>,
    /// When the attempt has failed, whatever it reports meanwhile.
    pub attempt_ends_ms: Option<u64>,
}

impl RobotRow {
    pub(super) const fn new(robot: RobotId) -> Self {
        Self {
            robot,
            revision: 0,
            state: UpdateState::Waiting,
            reason: None,
            release: None,
            phase: None,
            attempts: 0,
            offers: 0,
            received: 0,
            boot: 0,
            forgiven: false,
            recalled: false,
            since_ms: 0,
            due_ms: None,
            resend_ms: None,
            attempt_ends_ms: None,
        }
    }

    /// The next moment at which something is due.
    pub(super) fn next_ms(&self) -> Option<u64> {
        let times = [self.due_ms, self.resend_ms, self.attempt_ends_ms];
        times.into_iter().flatten().min()
    }

    /// Changes the state; what was due in the old one is not any more.
    pub(super) fn enter(
        &mut self,
        state: UpdateState,
        reason: Option<Reason>,
        due_ms: Option<u64>,
        now_ms: u64,
    ) {
        if !(self.state.is_before_trial() && state.is_before_trial()) {
            self.attempt_ends_ms = None;
        }
        self.state = state;
        self.reason = reason;
        self.since_ms = now_ms;
        self.due_ms = due_ms;
        self.resend_ms = None;
    }
}
