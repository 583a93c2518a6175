//! The time as certificates have it.

use crawler_system::clock::unix_ms;

/// Unix time in seconds.
pub(crate) fn unix_now() -> i64 {
    (unix_ms() / 1000) as i64
}
