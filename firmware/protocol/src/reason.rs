//! What a command came to, and why, in stable codes.

use core::fmt;

use serde::{Deserialize, Serialize};

/// What a command came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ResponseStatus {
    /// Valid and under way; another answer follows.
    Accepted,
    /// Done, or in force.
    Completed,
    /// Not acceptable; nothing changed.
    Rejected,
    /// A motion command that came too late; nothing changed.
    Expired,
    /// Older than another command of the same source; nothing changed.
    Stale,
    /// Begun and not brought to its end.
    Failed,
}

impl ResponseStatus {
    /// Every status.
    pub const ALL: [Self; 6] = [
        Self::Accepted,
        Self::Completed,
        Self::Rejected,
        Self::Expired,
        Self::Stale,
        Self::Failed,
    ];

    /// The name on the wire.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Completed => "completed",
            Self::Rejected => "rejected",
            Self::Expired => "expired",
            Self::Stale => "stale",
            Self::Failed => "failed",
        }
    }

    /// Whether no further answer to the command follows.
    #[must_use]
    pub const fn is_final(self) -> bool {
        !matches!(self, Self::Accepted)
    }
}

impl fmt::Display for ResponseStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Why a command came to what it came to. The names on the wire are stable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Reason {
    /// Not one JSON object in UTF-8, or something after it.
    Malformed,
    /// More bytes, or more parameters, than a message may have.
    TooLarge,
    /// No command of this name.
    UnknownCommand,
    /// A field that the message or the command does not have.
    UnknownField,
    /// One field twice.
    DuplicateField,
    /// A field that must be there is not.
    MissingField,
    /// A field holds another type than it must.
    WrongType,
    /// The right type, and a value that is not allowed.
    OutOfRange,
    /// No behaviour of this name.
    UnknownBehaviour,
    /// No parameter of this name.
    UnknownParameter,
    /// The parameter cannot be set.
    ReadOnly,
    /// This robot cannot do that.
    Unsupported,
    /// The robot's clock is not synchronised, so the command's age is unknown.
    NoClock,
    /// The emergency stop is latched; `reset` comes first.
    Estopped,
    /// No room for another command at the moment.
    Busy,
    /// No trustworthy range reading.
    NoRange,
    /// The battery is too low to move.
    LowBattery,
    /// The way is blocked.
    Blocked,
    /// There is no way to the place, as far as the robot knows.
    Unreachable,
    /// Another command took over.
    Interrupted,
    /// The link was lost meanwhile.
    LinkLost,
    /// It took too long.
    Timeout,
    /// The flash did not take it.
    StorageFailed,
    /// A fault of the robot.
    Fault,
    /// The robot has no policy of this name.
    NoPolicy,
    /// The robot's policy is damaged, or of a kind that its program does not read.
    BadPolicy,
    /// The robot's policy was trained with another kind of observation, other actions or another shield.
    OtherObservation,
    /// The robot has no map: it was not on its way to a place for a while.
    NoMap,
}

impl Reason {
    /// Every reason.
    pub const ALL: [Self; 28] = [
        Self::Malformed,
        Self::TooLarge,
        Self::UnknownCommand,
        Self::UnknownField,
        Self::DuplicateField,
        Self::MissingField,
        Self::WrongType,
        Self::OutOfRange,
        Self::UnknownBehaviour,
        Self::UnknownParameter,
        Self::ReadOnly,
        Self::Unsupported,
        Self::NoClock,
        Self::Estopped,
        Self::Busy,
        Self::NoRange,
        Self::LowBattery,
        Self::Blocked,
        Self::Unreachable,
        Self::Interrupted,
        Self::LinkLost,
        Self::Timeout,
        Self::StorageFailed,
        Self::Fault,
        Self::NoPolicy,
        Self::BadPolicy,
        Self::OtherObservation,
        Self::NoMap,
    ];

    /// The name on the wire.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Malformed => "malformed",
            Self::TooLarge => "too_large",
            Self::UnknownCommand => "unknown_command",
            Self::UnknownField => "unknown_field",
            Self::DuplicateField => "duplicate_field",
            Self::MissingField => "missing_field",
            Self::WrongType => "wrong_type",
            Self::OutOfRange => "out_of_range",
            Self::UnknownBehaviour => "unknown_behaviour",
            Self::UnknownParameter => "unknown_parameter",
            Self::ReadOnly => "read_only",
            Self::Unsupported => "unsupported",
            Self::NoClock => "no_clock",
            Self::Estopped => "estopped",
            Self::Busy => "busy",
            Self::NoRange => "no_range",
            Self::LowBattery => "low_battery",
            Self::Blocked => "blocked",
            Self::Unreachable => "unreachable",
            Self::Interrupted => "interrupted",
            Self::LinkLost => "link_lost",
            Self::Timeout => "timeout",
            Self::StorageFailed => "storage_failed",
            Self::Fault => "fault",
            Self::NoPolicy => "no_policy",
            Self::BadPolicy => "bad_policy",
            Self::OtherObservation => "other_observation",
            Self::NoMap => "no_map",
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
