//! Set-up by a person, instead of by the command line alone.
//!
//! With `provision=1` the board has the page of the other boards: as long as its flash holds no
//! settings it serves it on port 80, and no robot runs. Settings that are saved there count from
//! the restart that follows, before those of the command line. They lie in two erase blocks of
//! the flash, behind the parameters.

use crawler_board::EmbassyClock;
use crawler_board::arguments::Arguments;
use crawler_board::provision::{Connection, Features, NoScanner, Portal, Server, Token, serve};
use crawler_board::settings::{Broker, RangerMode, Settings, Vault};
use crawler_hal::System;
use embassy_executor::{SpawnError, Spawner};
use embassy_net::{DhcpConfig, Runner, Stack, StackResources};
use embassy_time::{Duration, Timer};
use rand_core::Rng;
use rand_pcg::Pcg32;
use static_cell::{ConstStaticCell, StaticCell};

use crate::ethernet::Ethernet;
use crate::flash::{self, SettingsFlash};
use crate::system::VirtSystem;

/// Connections served at a time.
const CONNECTIONS: usize = 3;
const PORT: u16 = 80;
/// How long the word of success has to reach the browser before the machine restarts.
const FAREWELL: Duration = Duration::from_millis(1_000);

const fn vault() -> Vault<SettingsFlash> {
    Vault::new(flash::settings())
}

/// Puts the settings that a person has saved in place of those in `arguments`. Whether there are
/// any.
pub fn adopt(arguments: &mut Arguments) -> bool {
    let kept = embassy_futures::block_on(vault().load()).unwrap_or_else(|error| {
        defmt::error!("settings: {}", defmt::Display2Format(&error));
        crawler_board::settings::Kept::default()
    });
    let Some(settings) = kept.settings else {
        return false;
    };
    arguments.id = settings.id;
    arguments.fleet = settings.fleet;
    arguments.broker_host = settings.broker.host;
    arguments.broker_port = settings.broker.port;
    arguments.authority = settings.broker.authority;
    arguments.credentials = settings.credentials;
    true
}

/// Spawns the page in place of the robot.
///
/// # Errors
/// When it was spawned before.
pub fn spawn(
    arguments: &Arguments,
    ethernet: Ethernet,
    entropy: u64,
    spawner: Spawner,
) -> Result<(), SpawnError> {
    // The stack's own two are DHCP and DNS.
    static RESOURCES: StaticCell<StackResources<{ CONNECTIONS + 2 }>> = StaticCell::new();

    let mut rng = Pcg32::new(entropy, 0x7061_6765);
    let config = embassy_net::Config::dhcpv4(DhcpConfig::default());
    let resources = RESOURCES.init(StackResources::new());
    let (stack, runner) = embassy_net::new(ethernet, config, resources, rng.next_u64());
    let portal = Portal {
        features: Features {
            wifi: false,
            scan: false,
            ranger: false,
        },
        token: Token::draw(&mut rng),
        captive: None,
        suggestion: Settings {
            wifi: None,
            // Not shown.
            broker: Broker {
                host: arguments.broker_host.clone(),
                port: arguments.broker_port,
                authority: None,
            },
            fleet: arguments.fleet.clone(),
            id: arguments.id.clone(),
            credentials: None,
            ranger: RangerMode::Uart,
        },
    };
    spawner.spawn(net(runner)?);
    spawner.spawn(page(stack, portal)?);
    Ok(())
}

#[embassy_executor::task]
async fn net(mut runner: Runner<'static, Ethernet>) -> ! {
    runner.run().await
}

// The future lies in the static memory of its task, and no robot runs beside it.
#[allow(clippy::large_futures)]
#[embassy_executor::task]
async fn page(stack: Stack<'static>, portal: Portal) {
    static MEMORY: ConstStaticCell<[Connection; CONNECTIONS]> =
        ConstStaticCell::new([const { Connection::new() }; CONNECTIONS]);

    stack.wait_config_up().await;
    defmt::info!("provisioning: page on port {=u16}", PORT);
    let server = Server::new(portal, vault(), NoScanner, EmbassyClock);
    let settings = serve(stack, PORT, &server, MEMORY.take()).await;
    defmt::info!(
        "provisioning: saved for robot {=str}, restarting",
        settings.id.as_str()
    );
    Timer::after(FAREWELL).await;
    match VirtSystem::new().reset().await {}
}
