//! The robot as a network of its own, with a page for a person.

use crawler_app::Config as AppConfig;
use crawler_board::EmbassyClock;
use crawler_board::boot_record::{BootRecord, End};
use crawler_board::provision::access_point::{ADDRESS, Datagrams, lend, name};
use crawler_board::provision::fallback::{Event, Role};
use crawler_board::provision::{
    Connection, Features, Nearby, Networks, Portal, ScanFailed, Scanner, Server, Token, serve,
};
use crawler_board::settings::{Broker, RangerMode, Settings, Vault};
use crawler_hal::{Clock, Instant, NetError};
use embassy_futures::select::{Either4, select, select4};
use embassy_time::{Duration, Timer};
use esp_hal::rng::Rng;
use esp_radio::wifi::ap::AccessPointConfig;
use esp_radio::wifi::scan::ScanConfig;
use esp_radio::wifi::sta::StationConfig;
use esp_radio::wifi::{
    AuthenticationMethod, AuthenticationMethodConfig, Config, WifiController, WifiError,
};
use static_cell::ConstStaticCell;

use super::Radio;
use crate::{identity, kept, system};

/// Connections served at a time: a phone opens two or three.
pub(super) const CONNECTIONS: usize = 3;
/// Phones and computers that may be joined at a time.
const GUESTS: u16 = 4;
const PORT: u16 = 80;
/// Time between two looks at whether somebody uses the page.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How long the word of success has to reach the browser before the robot restarts.
const FAREWELL: Duration = Duration::from_millis(1_500);

/// Memory of the page and of the two services beside it, used again each time.
pub(super) struct Memory {
    connections: [Connection; CONNECTIONS],
    addresses: Datagrams,
    names: Datagrams,
}

/// The memory, once.
pub(super) fn memory() -> &'static mut Memory {
    static MEMORY: ConstStaticCell<Memory> = ConstStaticCell::new(Memory {
        connections: [const { Connection::new() }; CONNECTIONS],
        addresses: Datagrams::new(),
        names: Datagrams::new(),
    });
    MEMORY.take()
}

impl Radio {
    /// Serves the page until settings are saved, which restarts the robot, or until nobody has
    /// used it for some minutes.
    pub(super) async fn access_point(&mut self, mut role: Role) -> Role {
        // Answered when opening fails, too: the link must not wait for ever.
        self.shared.answer(Err(NetError::NotJoined));
        let id = identity::default_id();
        let opened = self
            .configuration(id.as_str())
            .and_then(|config| self.controller.set_config(&config));
        match opened {
            Ok(()) => defmt::info!(
                "wifi: access point '{=str}', password '{=str}', page http://192.168.4.1/",
                id.as_str(),
                self.password.reveal()
            ),
            // The role goes on, and ends: joining is tried again after it.
            Err(error) => defmt::error!("wifi: no access point: {}", error),
        }
        let memory = &mut *self.memory;
        let portal = Portal {
            features: Features {
                wifi: true,
                scan: true,
                ranger: true,
            },
            token: Token::draw(&mut Rng::new()),
            captive: Some(ADDRESS),
            suggestion: suggestion(),
        };
        let server = Server::new(
            portal,
            Vault::new(self.vault.flash()),
            Look(&mut self.controller),
            EmbassyClock,
        );
        let shared = self.shared;
        let page = serve(self.stack, PORT, &server, &mut memory.connections);
        let services = select(
            lend(self.stack, &EmbassyClock, &mut memory.addresses),
            name(self.stack, &mut memory.names),
        );
        let refusals = async {
            loop {
                shared.asked().await;
                shared.answer(Err(NetError::NotJoined));
            }
        };
        let watch = async {
            let mut seen: Option<Instant> = None;
            while let Role::AccessPoint { .. } = role {
                Timer::after(LOOK_EVERY).await;
                let used = server.last_used();
                let event = if used == seen {
                    Event::Tick
                } else {
                    Event::PageUsed
                };
                seen = used;
                role = role.step(event, EmbassyClock.now());
            }
        };
        let ended = select4(page, services, refusals, watch).await;
        if matches!(ended, Either4::First(_)) {
            defmt::info!("settings: saved, restarting");
            Timer::after(FAREWELL).await;
            kept::put(BootRecord::ending(End::Reset, None));
            system::restart();
        }
        defmt::info!("wifi: nobody uses the page, joining again");
        role
    }

    /// An access point, and a station beside it that can look around.
    fn configuration(&self, id: &str) -> Result<Config, WifiError> {
        let access_point = AccessPointConfig::default()
            .with_ssid(id.try_into()?)
            .with_authentication(AuthenticationMethodConfig::Wpa2Personal(
                self.password.reveal().try_into()?,
            ))
            .with_max_connections(GUESTS);
        // Not joined while the page is served: looking around needs no network.
        let station =
            StationConfig::default().with_authentication(AuthenticationMethodConfig::Open);
        Ok(Config::AccessPointStation(station, access_point))
    }
}

/// What the page suggests before a person has entered anything.
fn suggestion() -> Settings {
    let AppConfig { id, fleet, .. } = identity::config(None);
    Settings {
        wifi: None,
        // Not shown.
        broker: Broker {
            host: heapless::String::new(),
            port: crawler_board::settings::BROKER_PORT,
            authority: None,
        },
        fleet,
        id,
        credentials: None,
        ranger: RangerMode::default(),
    }
}

/// The radio, looking around.
struct Look<'a>(&'a mut WifiController<'static>);

impl Scanner for Look<'_> {
    async fn scan(&mut self, networks: &mut Networks) -> Result<(), ScanFailed> {
        let config = ScanConfig::default().with_max(crawler_board::provision::MAX_NETWORKS);
        let found = self.0.scan_async(&config).await;
        let found = found.map_err(|error| {
            defmt::warn!("wifi: cannot look around: {}", error);
            ScanFailed
        })?;
        for point in found {
            // A name that is not text cannot be entered either.
            if let Ok(ssid) = heapless::String::try_from(point.ssid.as_str()) {
                networks.add(Nearby {
                    ssid,
                    rssi_dbm: point.signal_strength,
                    open: point.auth_method == Some(AuthenticationMethod::None),
                });
            }
        }
        Ok(())
    }
}
