//! How radio waves fare, in numbers.

use serde::{Deserialize, Serialize};

use super::table::Bound::Number;
use super::table::Vary::{Fixed, Plus, Times, Within};
use super::table::{Row, row};

/// Propagation, receivers and medium access: a 2.4 GHz wireless LAN after 802.11n with one
/// spatial stream and 20 MHz.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RadioFigures {
    /// Shortest time one way beyond the air, milliseconds.
    pub latency_ms: f32,
    /// Added to it, uniformly from 0 to this, milliseconds.
    pub jitter_ms: f32,
    /// Share of segments lost beyond the air.
    pub loss: f32,
    /// Time until a lost segment is sent again, doubled each time, milliseconds.
    pub retransmit_ms: f32,
    /// Signal of an access point that has no place, dBm.
    pub rssi_dbm: f32,
    /// Power that the weaker side radiates, dBm.
    pub power_dbm: f32,
    /// Path loss at one metre, decibels.
    pub first_metre_db: f32,
    /// Path loss exponent: the loss grows by ten times this with each decade of distance.
    pub exponent: f32,
    /// Standard deviation of what walls and furniture add, fixed in place, decibels.
    pub shadowing_db: f32,
    /// Standard deviation of what changes from one moment to the next, decibels.
    pub fading_db: f32,
    /// How much less a receiver hears than its data sheet says: noise and interference, decibels.
    pub noise_db: f32,
    /// Airtime of a frame beyond its bits: waiting, preamble, acknowledgement, microseconds.
    pub overhead_us: f32,
    /// Share of the airtime that collisions take for each doubling of contending senders.
    pub contention: f32,
    /// How much stronger another access point must be for a robot to change to it, decibels.
    pub hysteresis_db: f32,
    /// Time without a link while changing, milliseconds.
    pub roaming_ms: f32,
    /// Silence after which a robot knows that it has lost its access point, milliseconds.
    pub lost_after_ms: f32,
    /// Scan, handshake and address after that, milliseconds.
    pub joining_ms: f32,
    /// Share of segments that wait for a sleeping radio or a scan.
    pub spike_share: f32,
    /// Longest such wait, milliseconds.
    pub spike_ms: f32,
}

impl Default for RadioFigures {
    fn default() -> Self {
        Self {
            latency_ms: 2.0,
            jitter_ms: 3.0,
            loss: 0.0,
            retransmit_ms: 200.0,
            rssi_dbm: -55.0,
            power_dbm: 18.5,
            first_metre_db: 40.2,
            exponent: 3.0,
            shadowing_db: 4.0,
            fading_db: 2.0,
            noise_db: 3.0,
            overhead_us: 180.0,
            contention: 0.05,
            hysteresis_db: 8.0,
            roaming_ms: 100.0,
            lost_after_ms: 6_000.0,
            joining_ms: 1_500.0,
            spike_share: 0.0,
            spike_ms: 100.0,
        }
    }
}

/// Rows of the table.
pub(super) const ROWS: &[Row] = &[
    row!(
        radio.latency_ms,
        "ms",
        Number(0.1),
        Number(10_000.0),
        Times(0.25),
        Within(0.5, 50.0),
        "shortest time one way, beyond the air",
        "estimate: access point, switch and broker of a quiet wireless LAN"
    ),
    row!(
        radio.jitter_ms,
        "ms",
        Number(0.0),
        Number(10_000.0),
        Times(0.5),
        Within(0.0, 50.0),
        "longest time added to it",
        "estimate"
    ),
    row!(
        radio.loss,
        "1",
        Number(0.0),
        Number(0.9),
        Within(0.0, 0.01),
        Within(0.0, 0.1),
        "share of segments lost beyond the air",
        "estimate: none"
    ),
    row!(
        radio.retransmit_ms,
        "ms",
        Number(1.0),
        Number(10_000.0),
        Times(0.25),
        Within(100.0, 1_000.0),
        "time until a lost segment is sent again, doubled each time",
        "RFC 6298 as Linux and lwIP have it: 200 ms at least"
    ),
    row!(
        radio.rssi_dbm,
        "dBm",
        Number(-126.0),
        Number(0.0),
        Plus(5.0),
        Within(-75.0, -40.0),
        "signal of an access point that has no place",
        "estimate: some metres away"
    ),
    row!(
        radio.power_dbm,
        "dBm",
        Number(-20.0),
        Number(30.0),
        Plus(1.0),
        Plus(4.0),
        "power that the weaker side radiates",
        "ESP32-S3 data sheet, TX power at HT20 MCS7"
    ),
    row!(
        radio.first_metre_db,
        "dB",
        Number(0.0),
        Number(100.0),
        Plus(1.0),
        Plus(4.0),
        "path loss at one metre",
        "free space at 2.44 GHz: 20 log(4π/λ)"
    ),
    row!(
        radio.exponent,
        "1",
        Number(1.0),
        Number(6.0),
        Times(0.05),
        Within(2.2, 4.0),
        "path loss exponent",
        "ITU-R P.1238: 30 dB for each decade, offices at 2.4 GHz"
    ),
    row!(
        radio.shadowing_db,
        "dB",
        Number(0.0),
        Number(20.0),
        Times(0.25),
        Within(0.0, 8.0),
        "standard deviation of what walls and furniture add, fixed in place",
        "within rooms of an office after ITU-R P.1238 less than its 10 dB between rooms: estimate"
    ),
    row!(
        radio.fading_db,
        "dB",
        Number(0.0),
        Number(20.0),
        Times(0.25),
        Within(0.0, 6.0),
        "standard deviation of what changes from moment to moment",
        "estimate: RSSI averaged over beacons"
    ),
    row!(
        radio.noise_db,
        "dB",
        Number(0.0),
        Number(30.0),
        Plus(2.0),
        Within(0.0, 10.0),
        "how much less is heard than the data sheet of the receiver says",
        "estimate: antenna and neighbours"
    ),
    row!(
        radio.overhead_us,
        "µs",
        Number(0.0),
        Number(10_000.0),
        Times(0.1),
        Times(0.5),
        "airtime of a frame beyond its bits",
        "IEEE 802.11: DIFS 28, mean backoff 67.5, preamble 36, SIFS 10, acknowledgement 38 µs"
    ),
    row!(
        radio.contention,
        "1",
        Number(0.0),
        Number(0.2),
        Times(0.25),
        Within(0.0, 0.1),
        "share of the airtime lost with each doubling of contending senders",
        "Bianchi (2000), figure 6, window 32: 0.8 at 5 stations, 0.65 at 50"
    ),
    row!(
        radio.hysteresis_db,
        "dB",
        Number(0.0),
        Number(40.0),
        Fixed,
        Within(4.0, 12.0),
        "how much stronger another access point must be to change to it",
        "choice; usual in station firmware"
    ),
    row!(
        radio.roaming_ms,
        "ms",
        Number(0.0),
        Number(60_000.0),
        Times(0.25),
        Within(20.0, 1_000.0),
        "time without a link while changing",
        "estimate: authentication, reassociation, four-way handshake"
    ),
    row!(
        radio.lost_after_ms,
        "ms",
        Number(0.0),
        Number(60_000.0),
        Fixed,
        Within(1_000.0, 10_000.0),
        "silence after which a robot knows that it has lost its access point",
        "ESP-IDF, `esp_wifi_set_inactive_time`: 6 s"
    ),
    row!(
        radio.joining_ms,
        "ms",
        Number(0.0),
        Number(60_000.0),
        Times(0.25),
        Within(500.0, 5_000.0),
        "scan, handshake and address after that",
        "estimate"
    ),
    row!(
        radio.spike_share,
        "1",
        Number(0.0),
        Number(1.0),
        Within(0.0, 0.002),
        Within(0.0, 0.02),
        "share of segments that wait for a sleeping radio or a scan",
        "estimate: none; boards keep the radio awake"
    ),
    row!(
        radio.spike_ms,
        "ms",
        Number(0.0),
        Number(10_000.0),
        Fixed,
        Within(50.0, 500.0),
        "longest such wait",
        "one beacon interval of 102.4 ms"
    ),
];
