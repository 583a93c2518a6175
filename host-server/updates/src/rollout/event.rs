//! What a rollout is told, and what it answers.

use crawler_protocol::{Kind, RobotId};
use serde::{Deserialize, Serialize};

use super::document::Document;
use super::names::{BoardName, BuildId, Code, ReleaseId, ServerId};
use super::progress::PauseReason;
use super::robot::{Reason, RobotRow, UpdateState};

/// The time of a call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Now {
    /// Milliseconds since 1970. It may jump: only windows, and the time that a server was away, follow it.
    pub unix_ms: u64,
    /// Milliseconds since any moment that is the same for all calls in one process. It never goes back.
    pub monotonic_ms: u64,
}

/// Why a robot cannot take an update just now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Busy {
    /// It sleeps, and does not listen.
    Asleep,
    /// It drives, or does something else that must not be interrupted.
    Driving,
    /// Its battery is too low.
    LowBattery,
}

impl Busy {
    /// The code with which a robot that is asked all the same puts the release off.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::Asleep => "asleep",
            Self::Driving => "driving",
            Self::LowBattery => "low_battery",
        }
    }
}

/// What goes for the build of a model that no release has brought. No release of a model is rolled out that is called
/// like this.
pub const OWN_MODEL: &str = "own";

/// What is known of a robot, from its status and telemetry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sighting {
    /// The robot.
    pub robot: RobotId,
    /// Its board.
    pub board: BoardName,
    /// Its kind.
    pub kind: Kind,
    /// Whether it has the capability `vision`: models are for those that have.
    pub vision: bool,
    /// Whether it has the capability `policies`: policies are for those that have.
    pub policies: bool,
    /// The build that it runs; in a rollout of a model that of the model which it uses, [`OWN_MODEL`] where that is its
    /// program's own.
    pub build: BuildId,
    /// How often it has started.
    pub boot: u32,
    /// Whether it is online.
    pub online: bool,
    /// Why not now, if so.
    pub busy: Option<Busy>,
}

/// What a robot says about a release that it was offered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Report {
    /// Not now.
    Deferred(Code),
    /// It makes room.
    Preparing,
    /// It has so many bytes of the image.
    Receiving(u32),
    /// It has the image, and checks it.
    Verifying,
    /// It is about to start the image.
    Staged,
    /// This build runs on trial.
    Trial(BuildId),
    /// This build runs for good.
    Confirmed(BuildId),
    /// It has gone back to what it ran before.
    RolledBack(Code),
    /// It does not take the release.
    Refused {
        /// Why.
        code: Code,
        /// Whether it would say the same tomorrow.
        lasting: bool,
    },
    /// It has given the offer up, as it was told to.
    Withdrawn,
}

/// What has happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// A robot was heard of. Told for every change, and for every robot after the server has started.
    Seen(Sighting),
    /// A robot has said something about a release.
    Told {
        /// The robot.
        robot: RobotId,
        /// The release.
        release: ReleaseId,
        /// What it has said.
        report: Report,
    },
    /// Nothing, but time has passed.
    Tick,
}

/// What a person, or the server, wants of a rollout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Command {
    /// Offer nothing more. Robots that have not started the new program give it up and go on later where they
    /// were; trials come to their end.
    Pause,
    /// Go on. Failures that stopped the rollout by itself do not count any more.
    Resume,
    /// End it. As with a pause, but for good.
    Abort,
    /// Offer it to a robot again that has failed, was rolled back, or left out.
    Retry(RobotId),
    /// Leave a robot out.
    Skip(RobotId),
    /// A newer rollout has the robot.
    Supersede(RobotId),
}

/// What a robot is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Message {
    /// The release, whether for the first time or again.
    Offer,
    /// It is heard: the new program may stay.
    Confirm,
    /// It is to give up the release, unless it has started it.
    Cancel,
}

/// Something to send. Robots take each message any number of times: sending it again changes nothing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Effect {
    /// Under which ownership it was decided.
    pub epoch: u64,
    /// To whom.
    pub robot: RobotId,
    /// About which release.
    pub release: ReleaseId,
    /// What.
    pub message: Message,
}

/// What happened, for people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Happening {
    /// The rollout has begun.
    Started,
    /// A server has taken it over.
    TakenOver(ServerId),
    /// A phase has begun, counted from 0.
    PhaseBegan(u8),
    /// The robots of a phase are done; it is watched.
    PhaseSoaks(u8),
    /// A phase has passed.
    PhasePassed(u8),
    /// The rollout is paused.
    Paused(PauseReason),
    /// It goes on.
    Resumed,
    /// It is over, before its end.
    Aborted,
    /// It is over.
    Done,
    /// A robot stands elsewhere.
    Robot {
        /// The robot.
        robot: RobotId,
        /// Where it stands.
        state: UpdateState,
        /// Why.
        reason: Option<Reason>,
    },
}

/// An entry for the audit log and the list of events.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// The revision that it belongs to: of the robot's row, or of the document. With the robot, if it is about
    /// one, it names the note among all of a rollout.
    pub revision: u32,
    /// What happened.
    pub what: Happening,
}

/// What comes of a call. First `document`, `rows` and `notes` are stored, in one transaction; then `effects` are
/// carried out. Effects that get lost between the two come again.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[must_use]
pub struct Step {
    /// The rollout, if anything about it has changed.
    pub document: Option<Document>,
    /// Every robot of which anything has changed.
    pub rows: Vec<RobotRow>,
    /// What to tell people, in order. Never told twice if they are stored with the rest.
    pub notes: Vec<Note>,
    /// What to send, in order.
    pub effects: Vec<Effect>,
}
