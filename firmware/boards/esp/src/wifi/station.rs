//! The robot as a guest of a network.

use crawler_board::EmbassyClock;
use crawler_board::provision::fallback::{Event, Role};
use crawler_board::settings::Wifi;
use crawler_hal::{Clock, Instant, NetError};
use embassy_futures::select::{Either, Either3, select, select3};
use embassy_time::{Duration, Timer, with_timeout};
use esp_radio::wifi::sta::StationConfig;
use esp_radio::wifi::{
    AuthenticationMethodConfig, Config, ConnectionError, DisconnectReason, WifiController,
    WifiError,
};

use super::Radio;

/// How long one attempt may take: looking at eleven channels, joining, and the handshake. The link
/// waits 15 s, and DHCP comes after this.
const JOINED_WITHIN: Duration = Duration::from_secs(10);
/// How long leaving may take.
const LEFT_WITHIN: Duration = Duration::from_secs(2);
/// Time between two looks at the strength of the signal.
const MEASURE_EVERY: Duration = Duration::from_secs(2);

/// What the radio has to know of the network to join.
pub(super) fn config(wifi: &Wifi) -> Result<StationConfig, WifiError> {
    let authentication = match &wifi.passphrase {
        // WPA2 at least: what is older does not protect.
        Some(passphrase) => {
            AuthenticationMethodConfig::Wpa2Personal(passphrase.reveal().try_into()?)
        }
        None => AuthenticationMethodConfig::Open,
    };
    Ok(StationConfig::default()
        .with_ssid(wifi.ssid.as_str().try_into()?)
        .with_authentication(authentication))
}

/// What a reason means to the link: another password, or another attempt.
fn meaning(reason: DisconnectReason) -> NetError {
    match reason {
        // With a wrong password the access point falls silent in the handshake, or says so.
        DisconnectReason::FourWayHandshakeTimeout
        | DisconnectReason::HandshakeTimeout
        | DisconnectReason::MicFailure
        | DisconnectReason::AuthenticationFailed
        | DisconnectReason::_802_1xAuthenticationFailed => NetError::BadCredentials,
        // Anything else: not there, not in reach, too full, or gone. Trying again may help.
        _ => NetError::NotJoined,
    }
}

impl Radio {
    /// Joins whenever the link asks for it, until the robot has to fall back.
    pub(super) async fn station(&mut self, mut role: Role) -> Role {
        let configured = self
            .settings
            .as_ref()
            .and_then(|settings| settings.wifi.as_ref())
            .ok_or(WifiError::InvalidSsid)
            .and_then(config)
            .and_then(|config| self.controller.set_config(&Config::Station(config)));
        if let Err(error) = configured {
            // Settings without a network are of another board; the page is the way out, in time.
            defmt::error!("wifi: cannot be a station: {}", error);
        }
        while let Role::Station { .. } = role {
            match select(self.shared.asked(), until(role.deadline())).await {
                Either::First(()) => {
                    let joined = if configured.is_ok() {
                        join(&mut self.controller).await
                    } else {
                        Err(NetError::NotJoined)
                    };
                    if joined.is_ok() {
                        role = role.step(Event::Joined, EmbassyClock.now());
                        self.shared.set_joined(true);
                    }
                    self.shared.answer(joined);
                    if joined.is_ok() {
                        self.stay().await;
                        self.shared.set_joined(false);
                    }
                    role = role.step(Event::Failed, EmbassyClock.now());
                }
                Either::Second(()) => role = role.step(Event::Tick, EmbassyClock.now()),
            }
        }
        role
    }

    /// Stays joined for as long as the network lasts.
    async fn stay(&mut self) {
        loop {
            let strength = self.controller.rssi().ok();
            let strength = strength.and_then(|dbm| i8::try_from(dbm).ok());
            self.shared.set_rssi(strength.filter(|dbm| *dbm < 0));
            let lost = self.controller.wait_for_disconnect_async();
            match select3(lost, Timer::after(MEASURE_EVERY), self.shared.asked()).await {
                Either3::First(lost) => {
                    match lost {
                        Ok(lost) => defmt::warn!("wifi: lost: {}", lost.reason),
                        Err(error) => defmt::warn!("wifi: lost: {}", error),
                    }
                    return;
                }
                Either3::Second(()) => {}
                // Asked in the moment of joining.
                Either3::Third(()) => self.shared.answer(Ok(())),
            }
        }
    }
}

/// One attempt.
async fn join(controller: &mut WifiController<'_>) -> Result<(), NetError> {
    let outcome = with_timeout(JOINED_WITHIN, controller.connect_async()).await;
    match outcome {
        Ok(Ok(joined)) => {
            defmt::info!("wifi: joined on channel {=u8}", joined.channel);
            Ok(())
        }
        Ok(Err(ConnectionError::Failed(why))) => {
            defmt::warn!("wifi: not joined: {}", why.reason);
            Err(meaning(why.reason))
        }
        Ok(Err(error)) => {
            defmt::warn!("wifi: not joined: {}", error);
            Err(NetError::NotJoined)
        }
        Err(_) => {
            defmt::warn!("wifi: not joined in time");
            // Whatever the radio is doing still, it starts afresh next time.
            let _ = with_timeout(LEFT_WITHIN, controller.disconnect_async()).await;
            Err(NetError::NotJoined)
        }
    }
}

/// Returns at `deadline`; never without one.
pub(super) async fn until(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => EmbassyClock.sleep_until(deadline).await,
        None => core::future::pending().await,
    }
}
