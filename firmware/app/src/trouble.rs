//! What can be wrong, as log records and the lamp tell it. `docs/faults.md` lists it, and a test
//! holds the list to this module.

use crawler_drivers::lamp::Pattern;

use crate::state::Fault;

/// Events whose newest record is kept until the broker is known to have it, whatever else is
/// logged meanwhile: see [`outbox`](crate::outbox). Each names one thing that can be wrong, and
/// tells its beginning as well as its end.
pub const KEPT_EVENTS: [&str; 16] = [
    PANIC,
    "fault",
    "ranger",
    "motor",
    "battery",
    "flash",
    "camera",
    "lamp",
    TIME,
    LinkTrouble::NoNetwork.event(),
    LinkTrouble::Password.event(),
    LinkTrouble::NoAddress.event(),
    LinkTrouble::NoBroker.event(),
    LinkTrouble::Credentials.event(),
    LinkTrouble::Untrusted.event(),
    LINK_LOST,
];

/// The program panicked before this start.
pub const PANIC: &str = "panic";
/// The server's clock jumped.
pub const TIME: &str = "time";
/// A session ended.
pub const LINK_LOST: &str = "link-lost";

/// Whether the newest record of `event` is kept.
#[must_use]
pub fn is_kept(event: &str) -> bool {
    KEPT_EVENTS.contains(&event)
}

/// What keeps the robot from its broker. Each wants something else done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LinkTrouble {
    /// No network is joined: out of reach, switched off, or another name.
    NoNetwork,
    /// The network refuses the password.
    Password,
    /// The network hands out no address.
    NoAddress,
    /// The broker cannot be reached, does not answer, or does not understand us.
    NoBroker,
    /// The broker refuses name and password.
    Credentials,
    /// The broker has not proved who it is, or somebody is in between.
    Untrusted,
}

impl LinkTrouble {
    /// Every trouble, in the order of the way to the broker.
    pub const ALL: [Self; 6] = [
        Self::NoNetwork,
        Self::Password,
        Self::NoAddress,
        Self::NoBroker,
        Self::Credentials,
        Self::Untrusted,
    ];

    /// Name of its log records.
    #[must_use]
    pub const fn event(self) -> &'static str {
        match self {
            Self::NoNetwork => "no-network",
            Self::Password => "network-password",
            Self::NoAddress => "no-address",
            Self::NoBroker => "link-failed",
            Self::Credentials => "broker-credentials",
            Self::Untrusted => "broker-untrusted",
        }
    }

    /// What the lamp shows for it.
    #[must_use]
    pub const fn pattern(self) -> Pattern {
        match self {
            Self::NoNetwork => Pattern::NoNetwork,
            Self::Password => Pattern::NetworkPassword,
            Self::NoAddress => Pattern::NoAddress,
            Self::NoBroker => Pattern::NoLink,
            Self::Credentials => Pattern::BrokerRefuses,
            Self::Untrusted => Pattern::BrokerUntrusted,
        }
    }
}

impl Fault {
    /// What the lamp shows for a robot that stands for this.
    #[must_use]
    pub const fn pattern(self) -> Pattern {
        match self {
            Self::EmergencyStop => Pattern::Error,
            Self::Ranger => Pattern::RangerFault,
            Self::Motor => Pattern::MotorFault,
            Self::Battery => Pattern::LowBattery,
        }
    }
}
