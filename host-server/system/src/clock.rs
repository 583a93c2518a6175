//! Wall-clock time in the unit of the wire.

mod fleet_time;

use std::time::{SystemTime, UNIX_EPOCH};

pub use fleet_time::{FleetTime, Telling};

/// Unix milliseconds; 0 when the machine's clock stands before 1970.
pub fn unix_ms() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |elapsed| elapsed.as_millis() as u64)
}

/// Unix milliseconds, as the records have them: with a sign.
pub fn now_ms() -> i64 {
    i64::try_from(unix_ms()).unwrap_or(i64::MAX)
}

/// Unix microseconds; 0 when the machine's clock stands before 1970.
pub fn unix_us() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |elapsed| elapsed.as_micros() as u64)
}
