//! What a person tells a robot once: its network, its broker, its name.
//!
//! [`Settings`] is valid by construction: every part checks what it is made from, with the
//! protocol's own types where there is one. [`Vault`] keeps it in flash.

mod broker;
mod codec;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod text;
mod vault;

use crawler_app::{Config, Credentials};
use crawler_protocol::{Fleet, RobotId};

pub use broker::{BROKER_PORT, Broker, MAX_HOST, SECURE_BROKER_PORT};
pub use codec::DecodeError;
pub use text::{AccessPointPassword, Flaw, Passphrase, Ssid, credentials};
pub use vault::{Kept, Vault, VaultError};

/// How the US-100 is wired: its jumper decides, so a person has to say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RangerMode {
    /// Jumper set: serial line, which also tells the temperature.
    #[default]
    Uart,
    /// Jumper open: a pulse out, a pulse back.
    Pulse,
}

impl RangerMode {
    /// The word for it in a form.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Uart => "uart",
            Self::Pulse => "pulse",
        }
    }

    /// Reads the word for it.
    ///
    /// # Errors
    /// [`Flaw::Choice`] for any other word.
    pub fn parse(text: &str) -> Result<Self, Flaw> {
        match text {
            "uart" => Ok(Self::Uart),
            "pulse" => Ok(Self::Pulse),
            _ => Err(Flaw::Choice),
        }
    }
}

/// A network to join.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wifi {
    /// Its name.
    pub ssid: Ssid,
    /// Its password; `None` for an open network.
    pub passphrase: Option<Passphrase>,
}

/// What a person tells a robot once.
///
/// `Debug` tells everything but the two passwords.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// The network to join; `None` on a board without Wi-Fi.
    pub wifi: Option<Wifi>,
    /// Where the broker is.
    pub broker: Broker,
    /// Root of every topic.
    pub fleet: Fleet,
    /// Name of the robot.
    pub id: RobotId,
    /// Name and password for the broker; `None` where it asks for none.
    pub credentials: Option<Credentials>,
    /// How the ranger is wired.
    pub ranger: RangerMode,
}

impl Settings {
    /// Puts identity, broker and credentials into what the program is told at boot.
    pub fn apply_to(&self, config: &mut Config) {
        config.id = self.id.clone();
        config.fleet = self.fleet.clone();
        config.broker_host.clone_from(&self.broker.host);
        config.broker_port = self.broker.port;
        config.credentials.clone_from(&self.credentials);
    }
}
