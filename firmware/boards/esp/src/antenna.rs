//! The switch between the two antennas of the XIAO ESP32C6.

use esp_hal::gpio::{Level, Output, OutputConfig};

use crate::board::AntennaPins;

/// Powers the switch and chooses the antenna on the board. Without power it passes little of
/// either.
pub(crate) fn choose(pins: AntennaPins) {
    let low = |pin| Output::new(pin, Level::Low, OutputConfig::default());
    // The pins stay as they are when their drivers go.
    let _power = low(esp_hal::gpio::AnyPin::from(pins.power));
    let _select = low(pins.select.into());
}
