//! Who the robot is: what a person told it, or a name of its own.

use core::fmt::Write;

use crawler_app::{Config, Geometry};
use crawler_board::settings::Settings;
use crawler_protocol::{Fleet, Kind, RobotId};
use esp_hal::efuse::base_mac_address;
use heapless::String;

use crate::board;

/// `robot-` and the last three bytes of the address that the factory burnt in.
pub(crate) fn default_id() -> RobotId {
    let address = base_mac_address();
    let mut id = String::<32>::new();
    // Twelve bytes, which fit; if they ever did not, the name below is as valid.
    let _ = match address.as_bytes() {
        [.., a, b, c] => write!(id, "robot-{a:02x}{b:02x}{c:02x}"),
        _ => write!(id, "robot"),
    };
    match RobotId::new(&id) {
        Ok(id) => id,
        Err(_) => unreachable!("hexadecimal digits are allowed in a name"),
    }
}

/// What the program is told about itself.
pub(crate) fn config(settings: Option<&Settings>) -> Config {
    let mut config = Config {
        id: default_id(),
        fleet: Fleet::default(),
        broker_host: String::new(),
        broker_port: crawler_board::settings::BROKER_PORT,
        kind: Kind::Physical,
        board: board::ID,
        firmware: env!("CARGO_PKG_VERSION"),
        build: Some(crate::update::build()),
        geometry: Geometry::default(),
        credentials: None,
        camera: cfg!(feature = "esp32s3"),
        #[cfg(feature = "esp32s3")]
        eyes: Some(crate::camera::LENS),
        #[cfg(not(feature = "esp32s3"))]
        eyes: None,
        faults: cfg!(feature = "faults"),
    };
    if let Some(settings) = settings {
        settings.apply_to(&mut config);
    }
    config
}
