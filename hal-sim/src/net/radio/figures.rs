//! What a receiver takes, and what surrounds a payload.

/// Modulation and coding schemes of 802.11n, one stream, 20 MHz, long guard interval: bits in a
/// microsecond (IEEE 802.11-2020, table 19-27), and the weakest signal that the receiver of an
/// ESP32-S3 takes with one frame in ten lost (data sheet, table "RX Sensitivity", HT20), dBm.
pub(super) const SCHEMES: [(f32, f32); 8] = [
    (6.5, -92.6),
    (13.0, -91.0),
    (19.5, -88.2),
    (26.0, -85.0),
    (39.0, -81.8),
    (52.0, -77.4),
    (58.5, -75.8),
    (65.0, -74.2),
];

/// Attempts at a frame before the sender gives it up to TCP (dot11ShortRetryLimit).
pub(super) const ATTEMPTS: i32 = 7;
/// Bytes around the payload of a segment: 802.11 and LLC 38, IP 20, TCP 32.
pub(super) const HEADERS: usize = 90;
/// Most payload of a segment.
pub(crate) const SEGMENT: usize = 1_460;
