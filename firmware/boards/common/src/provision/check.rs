//! From what was entered to settings, or to the words beside the fields.

use crawler_app::Credentials;
use crawler_protocol::{Fleet, RobotId};

use super::Features;
use super::form::{Form, Value};
use crate::settings::{
    Broker, Flaw, Passphrase, RangerMode, SECURE_BROKER_PORT, Settings, Ssid, Wifi, credentials,
};

/// What is wrong, field by field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Flaws {
    /// Name of the Wi-Fi network.
    pub ssid: Option<Flaw>,
    /// Its password.
    pub wifi_password: Option<Flaw>,
    /// Broker.
    pub broker: Option<Flaw>,
    /// Key of its authority.
    pub authority: Option<Flaw>,
    /// Name of the robot.
    pub id: Option<Flaw>,
    /// Name of the fleet.
    pub fleet: Option<Flaw>,
    /// User name for the broker.
    pub username: Option<Flaw>,
    /// Password for the broker.
    pub password: Option<Flaw>,
    /// Wiring of the ranger.
    pub ranger: Option<Flaw>,
}

/// Something is wrong, and the flaws say what.
struct Flawed;

/// Reads one field; a flaw goes to its place.
fn read<T>(
    value: &Value,
    flaw: &mut Option<Flaw>,
    parse: impl FnOnce(&str) -> Result<T, Flaw>,
) -> Option<T> {
    let parsed = if value.is_cut() {
        Err(Flaw::TooLong)
    } else {
        parse(value.as_str())
    };
    parsed.map_err(|found| *flaw = Some(found)).ok()
}

impl Form {
    /// Makes settings of what was entered. An empty password keeps the one in `current`, as long
    /// as it still goes to whom it was meant for: the same network; the same user at the same
    /// broker, with the same authority or without TLS as before. Otherwise a stored password could be sent to someone else by who does not know it.
    ///
    /// # Errors
    /// All [`Flaws`] at once.
    pub fn check(&self, features: Features, current: Option<&Settings>) -> Result<Settings, Flaws> {
        let mut flaws = Flaws::default();
        let broker = self.broker(&mut flaws);
        let id = read(&self.id, &mut flaws.id, |text| Ok(RobotId::new(text)?));
        let fleet = read(&self.fleet, &mut flaws.fleet, |text| Ok(Fleet::new(text)?));
        let wifi = if features.wifi {
            self.wifi(current, &mut flaws).map(Some)
        } else {
            Some(current.and_then(|settings| settings.wifi.clone()))
        };
        let ranger = if features.ranger {
            read(&self.ranger, &mut flaws.ranger, RangerMode::parse)
        } else {
            Some(current.map(|settings| settings.ranger).unwrap_or_default())
        };
        let account = self.account(current, broker.as_ref(), &mut flaws);
        match (broker, id, fleet, wifi, ranger, account) {
            (Some(broker), Some(id), Some(fleet), Some(wifi), Some(ranger), Ok(account))
                if flaws == Flaws::default() =>
            {
                Ok(Settings {
                    wifi,
                    broker,
                    fleet,
                    id,
                    credentials: account,
                    ranger,
                })
            }
            _ => Err(flaws),
        }
    }

    fn broker(&self, flaws: &mut Flaws) -> Option<Broker> {
        let broker = read(&self.broker, &mut flaws.broker, str::parse::<Broker>);
        if self.authority.is_empty() {
            return broker;
        }
        let authority = read(&self.authority, &mut flaws.authority, |text| {
            text.parse().map_err(|_| Flaw::Authority)
        });
        let mut broker = broker?;
        broker.authority = Some(authority?);
        if !self.broker.as_str().contains(':') {
            broker.port = SECURE_BROKER_PORT;
        }
        Some(broker)
    }

    fn wifi(&self, current: Option<&Settings>, flaws: &mut Flaws) -> Option<Wifi> {
        let ssid = read(&self.ssid, &mut flaws.ssid, Ssid::new)?;
        let known = current
            .and_then(|settings| settings.wifi.as_ref())
            .filter(|wifi| wifi.ssid == ssid);
        let passphrase = match (self.wifi_open.is_empty(), self.wifi_password.is_empty()) {
            (false, true) => None,
            (false, false) => {
                flaws.wifi_password = Some(Flaw::Contradiction);
                return None;
            }
            (true, true) => {
                if known.is_none() {
                    flaws.wifi_password = Some(Flaw::NoPassword);
                }
                known?.passphrase.clone()
            }
            (true, false) => Some(read(
                &self.wifi_password,
                &mut flaws.wifi_password,
                Passphrase::new,
            )?),
        };
        Some(Wifi { ssid, passphrase })
    }

    fn account(
        &self,
        current: Option<&Settings>,
        broker: Option<&Broker>,
        flaws: &mut Flaws,
    ) -> Result<Option<Credentials>, Flawed> {
        if self.username.is_empty() {
            if self.password.is_empty() {
                return Ok(None);
            }
            flaws.username = Some(Flaw::NoUser);
            return Err(Flawed);
        }
        // Any password serves to look at the name alone.
        let name = read(&self.username, &mut flaws.username, |text| {
            credentials(text, "-").map(|account| account.username)
        })
        .ok_or(Flawed)?;
        if self.password.is_empty() {
            let known = current
                .filter(|settings| broker.is_none_or(|broker| *broker == settings.broker))
                .and_then(|settings| settings.credentials.as_ref())
                .filter(|account| account.username == name);
            if known.is_none() {
                flaws.password = Some(Flaw::NoPassword);
            }
            return known.cloned().map(Some).ok_or(Flawed);
        }
        read(&self.password, &mut flaws.password, |text| {
            credentials(&name, text)
        })
        .map(Some)
        .ok_or(Flawed)
    }
}
