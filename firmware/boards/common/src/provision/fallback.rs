//! When a robot opens its own access point, and when it closes it again.
//!
//! A robot that cannot join may have been told something wrong, so it opens an access point where
//! that can be corrected. Or the network is merely away, so it must not stay there: after some
//! minutes in which nobody used the page it tries to join again, and so on in turn.

use crawler_hal::{Duration, Instant};

/// How long joining may fail before the access point opens. A router takes up to two minutes to
/// restart.
pub const FALL_BACK_AFTER: Duration = Duration::from_secs(180);
/// How long the access point stays open after the page was last used.
pub const RETURN_AFTER: Duration = Duration::from_secs(300);

/// Why the access point is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// Nothing is known of any network.
    NoSettings,
    /// A person pressed the button.
    Button,
    /// Joining failed for [`FALL_BACK_AFTER`].
    Failing,
}

/// What the radio is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Joined to a network, or about to join.
    Station {
        /// Since when it has not been joined; `None` while it is.
        failing_since: Option<Instant>,
    },
    /// An access point with a page for a person.
    AccessPoint {
        /// Why.
        cause: Cause,
        /// When the page was used last, or when the access point was opened.
        used: Instant,
    },
}

/// What happens to the radio.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// The network was joined.
    Joined,
    /// The network was lost, or could not be joined.
    Failed,
    /// A person looked at the page or sent a form.
    PageUsed,
    /// Time has passed.
    Tick,
}

impl Role {
    /// The role at boot.
    #[must_use]
    pub const fn at_boot(has_settings: bool, button: bool, now: Instant) -> Self {
        match (has_settings, button) {
            (false, _) => Self::AccessPoint {
                cause: Cause::NoSettings,
                used: now,
            },
            (true, true) => Self::AccessPoint {
                cause: Cause::Button,
                used: now,
            },
            (true, false) => Self::Station {
                failing_since: Some(now),
            },
        }
    }

    /// Takes one step. Pure.
    #[must_use]
    pub fn step(self, event: Event, now: Instant) -> Self {
        match (self, event) {
            (Self::Station { .. }, Event::Joined) => Self::Station {
                failing_since: None,
            },
            (
                Self::Station {
                    failing_since: None,
                },
                Event::Failed,
            ) => Self::Station {
                failing_since: Some(now),
            },
            (
                Self::Station {
                    failing_since: Some(since),
                },
                Event::Failed | Event::Tick,
            ) if now.saturating_since(since) >= FALL_BACK_AFTER => Self::AccessPoint {
                cause: Cause::Failing,
                used: now,
            },
            (Self::AccessPoint { cause, .. }, Event::PageUsed) => {
                Self::AccessPoint { cause, used: now }
            }
            (
                Self::AccessPoint {
                    cause: Cause::Button | Cause::Failing,
                    used,
                },
                Event::Tick,
            ) if now.saturating_since(used) >= RETURN_AFTER => Self::Station {
                failing_since: Some(now),
            },
            // Spelled out, not `_`: a new role or event does not compile until placed.
            (Self::Station { .. }, Event::Failed | Event::PageUsed | Event::Tick)
            | (Self::AccessPoint { .. }, Event::Joined | Event::Failed | Event::Tick) => self,
        }
    }

    /// When the next [`Event::Tick`] can matter; `None` when only other events can.
    #[must_use]
    pub fn deadline(self) -> Option<Instant> {
        match self {
            Self::Station { failing_since } => failing_since.map(|since| since + FALL_BACK_AFTER),
            Self::AccessPoint {
                cause: Cause::NoSettings,
                ..
            } => None,
            Self::AccessPoint {
                cause: Cause::Button | Cause::Failing,
                used,
            } => Some(used + RETURN_AFTER),
        }
    }
}
