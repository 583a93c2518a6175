//! Log records of the robot program on the debug line.

use crawler_protocol::Level;

/// A record as it goes to the broker, link or no link.
pub(crate) fn echo(level: Level, event: &str, text: core::fmt::Arguments<'_>) {
    let text = defmt::Display2Format(&text);
    match level {
        Level::Error => defmt::error!("{=str}: {}", event, text),
        Level::Warn => defmt::warn!("{=str}: {}", event, text),
        Level::Info => defmt::info!("{=str}: {}", event, text),
        Level::Debug => defmt::debug!("{=str}: {}", event, text),
    }
}
