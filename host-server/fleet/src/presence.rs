//! Whether a robot is there.

use std::time::Duration;

use serde::Serialize;

/// Without heartbeat and telemetry for so long a robot is stale.
pub(crate) const STALE_AFTER: Duration = Duration::from_secs(3);
/// And for so long, offline.
pub(crate) const OFFLINE_AFTER: Duration = Duration::from_secs(15);

/// Whether a robot is there, as far as the server can tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Presence {
    /// It has spoken within the last three seconds.
    Online,
    /// It has been silent for three seconds, or only its retained status is known yet.
    Stale,
    /// It said goodbye, its last will said so, or it has been silent for 15 seconds.
    Offline,
}

impl Presence {
    /// As the API says it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Online => "online",
            Self::Stale => "stale",
            Self::Offline => "offline",
        }
    }

    /// Judges a robot.
    ///
    /// `goodbye`: its newest word is that it is going. `silence`: since its last live word; `None`
    /// when it has not spoken since the server runs. `known`: since the server knows of it.
    pub fn judge(goodbye: bool, silence: Option<Duration>, known: Duration) -> Self {
        match silence {
            _ if goodbye => Self::Offline,
            Some(silence) if silence < STALE_AFTER => Self::Online,
            None if known < OFFLINE_AFTER => Self::Stale,
            Some(silence) if silence < OFFLINE_AFTER => Self::Stale,
            Some(_) | None => Self::Offline,
        }
    }
}
