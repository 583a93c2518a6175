//! Wi-Fi: station, fall-back access point, provisioning.
//!
//! One task owns the radio and is in one of two roles, which the shared state machine of
//! `crawler_board::provision::fallback` chooses: a station that joins when the link asks for it,
//! or an access point with a page where a person enters the settings. The program runs on in
//! both; without a network it has no link, and says so with its lamp.

mod access_point;
mod medium;
mod station;

use crawler_app::Inline;
use crawler_board::provision::fallback::Role;
use crawler_board::settings::{AccessPointPassword, Kept, Settings, Vault};
use crawler_board::{EmbassyClock, StackNetwork};
use crawler_hal::Clock;
use crawler_tls::{Authority, Buffers, Secured, Security};
use embassy_executor::Spawner;
use embassy_net::{Config, DhcpConfig, Runner, Stack, StackResources};
use esp_hal::peripherals::WIFI;
use esp_hal::rng::{Rng, Trng};
use esp_radio::wifi::{ControllerConfig, Interface, WifiController};
use static_cell::{ConstStaticCell, StaticCell};

use crate::activities::Context;
use crate::flash::Region;
use crate::identity;
use crate::randomness::Noise;
use crate::update::Updates;
use medium::{Antenna, Shared};

/// Bytes under way in each direction of the connection to the broker.
const SOCKET_BUFFER: usize = 2_048;
/// DHCP, DNS, and the connection to the broker.
const STATION_SOCKETS: usize = 3;
/// Pages in parallel, addresses and names; and a resolver, which every stack has.
const ACCESS_POINT_SOCKETS: usize = access_point::CONNECTIONS + 3;

/// What the radio is started with.
pub(crate) struct Start {
    /// The radio.
    pub(crate) wifi: WIFI<'static>,
    /// What all activities share.
    pub(crate) robot: &'static Context,
    /// What the link and the update activity share.
    pub(crate) updates: &'static Updates,
    /// Where settings are kept.
    pub(crate) vault: Vault<Region>,
    /// What it held at the start.
    pub(crate) kept: Kept,
    /// Whether a person asked for the page with the button.
    pub(crate) asked: bool,
}

/// The radio with all it needs, for as long as the program runs.
struct Radio {
    controller: WifiController<'static>,
    shared: &'static Shared,
    stack: Stack<'static>,
    vault: Vault<Region>,
    settings: Option<Settings>,
    password: AccessPointPassword,
    memory: &'static mut access_point::Memory,
}

/// Starts the radio and the link, and runs the radio from then on. Returns only when the radio
/// cannot be started: the robot then runs without a network.
pub(crate) async fn run(spawner: Spawner, start: Start) {
    static SHARED: StaticCell<Shared> = StaticCell::new();
    static STATION: StaticCell<StackResources<STATION_SOCKETS>> = StaticCell::new();
    static ACCESS_POINT: StaticCell<StackResources<ACCESS_POINT_SOCKETS>> = StaticCell::new();
    static RECEIVE: ConstStaticCell<[u8; SOCKET_BUFFER]> = ConstStaticCell::new([0; SOCKET_BUFFER]);
    static TRANSMIT: ConstStaticCell<[u8; SOCKET_BUFFER]> =
        ConstStaticCell::new([0; SOCKET_BUFFER]);

    let Start {
        wifi,
        robot,
        updates,
        mut vault,
        kept,
        asked,
    } = start;
    // Channels 1 to 11, which every country allows.
    let config = ControllerConfig::default().with_country_info(*b"01");
    let controller = match WifiController::new(wifi, config) {
        Ok(controller) => controller,
        Err(error) => {
            defmt::error!("wifi: the radio does not start: {}", error);
            return;
        }
    };
    // The radio runs now, and its noise is what the random generator lives on.
    let Kept {
        settings,
        access_point,
    } = kept;
    let password = match access_point {
        Some(password) => password,
        None => draw_password(&mut vault, settings.as_ref()).await,
    };
    let shared = SHARED.init(Shared::new());
    let rng = Rng::new();
    let seed = || u64::from(rng.random()) << 32 | u64::from(rng.random());
    let (station, station_runner) = embassy_net::new(
        Interface::station(),
        Config::dhcpv4(DhcpConfig::default()),
        STATION.init(StackResources::new()),
        seed(),
    );
    let (stack, access_point_runner) = embassy_net::new(
        Interface::access_point(),
        Config::ipv4_static(crawler_board::provision::access_point::configuration()),
        ACCESS_POINT.init(StackResources::new()),
        seed(),
    );
    let network = StackNetwork::new(
        station,
        Antenna::new(shared),
        RECEIVE.take(),
        TRANSMIT.take(),
    );
    let authority = settings
        .as_ref()
        .and_then(|settings| settings.broker.authority);
    let spawned = [net(station_runner), net(access_point_runner)]
        .into_iter()
        .try_for_each(|task| task.map(|task| spawner.spawn(task)))
        .and_then(|()| link(robot, updates, network, authority).map(|task| spawner.spawn(task)));
    crate::expect(spawned, "network tasks");

    let role = Role::at_boot(settings.is_some(), asked, EmbassyClock.now());
    let mut radio = Radio {
        controller,
        shared,
        stack,
        vault,
        settings,
        password,
        memory: access_point::memory(),
    };
    radio.work(role).await;
}

impl Radio {
    /// Takes one role after the other.
    async fn work(&mut self, mut role: Role) -> ! {
        loop {
            role = match role {
                Role::Station { .. } => self.station(role).await,
                Role::AccessPoint { .. } => self.access_point(role).await,
            };
        }
    }
}

/// Draws the password of the access point, once in the life of a flash.
async fn draw_password(
    vault: &mut Vault<Region>,
    settings: Option<&Settings>,
) -> AccessPointPassword {
    let password = match Trng::try_new() {
        Ok(mut trng) => AccessPointPassword::draw(&mut trng),
        // The radio runs, so the plain generator has the same noise.
        Err(_) => AccessPointPassword::draw(&mut Rng::new()),
    };
    let kept = Kept {
        settings: settings.cloned(),
        access_point: Some(password.clone()),
    };
    if let Err(error) = vault.store(&kept).await {
        defmt::error!(
            "settings: the password of the access point is for this start only: {}",
            defmt::Display2Format(&error)
        );
    }
    defmt::info!(
        "write on the label: network '{=str}', password '{=str}'",
        identity::default_id().as_str(),
        password.reveal()
    );
    password
}

#[embassy_executor::task(pool_size = 2)]
async fn net(mut runner: Runner<'static, Interface>) -> ! {
    runner.run().await
}

#[embassy_executor::task]
async fn link(
    robot: &'static Context,
    updates: &'static Updates,
    network: StackNetwork<'static, Antenna>,
    authority: Option<Authority>,
) {
    static TLS: ConstStaticCell<Buffers> = ConstStaticCell::new(Buffers::new());

    let security = authority.map(|authority| Security {
        authority,
        rng: Noise::new(),
        buffers: TLS.take(),
        clock: || robot.unix_ms(EmbassyClock.now()).map(|ms| ms / 1_000),
    });
    let network = Secured::new(network, security);
    #[cfg(feature = "esp32s3")]
    let link = {
        let images = crate::camera::images();
        crawler_app::link_with_images_and_updates_held::<Inline, _, _, _, _, _, _>(
            robot,
            images,
            updates,
            network,
            Rng::new(),
            EmbassyClock,
        )
    };
    #[cfg(not(feature = "esp32s3"))]
    let link = crawler_app::link_with_updates_held::<Inline, _, _, _, _, _>(
        robot,
        updates,
        network,
        Rng::new(),
        EmbassyClock,
    );
    match link.await {}
}
