//! The switch between the two antennas of the XIAO ESP32C6.

use esp_hal::gpio::{Level, Output, OutputConfig};

use crate::board::AntennaPins;

/// Powers the switch and chooses the antenna on the board. Without power it passes little of
/// either.
pub(crate) fn choose(pins: AntennaPins) {
    // The pins stay as they are when their drivers go.
    let _power = Output::new(pins.power, Level::Low, OutputConfig::default());
    let _select = Output::new(pins.select, Level::Low, OutputConfig::default());
}
