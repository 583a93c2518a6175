//! Who is heard where, how well, and what a segment costs there.

use super::figures::{ATTEMPTS, HEADERS, SCHEMES, SEGMENT};
use super::{Radio, Setup};
use crate::world::{RadioFigures, mix};

/// Edge of the squares at whose corners shadowing is drawn, metres.
const SHADOW_M: f32 = 2.0;
/// Share of frames lost beyond which a sender does not try harder.
const MOST_ERRORS: f32 = 0.95;
/// Nearest that anything is to an antenna, metres.
const NEAREST_M: f32 = 0.2;

/// What a segment costs on a link as it is now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Quality {
    /// Airtime of a segment and its acknowledgement without any payload, nanoseconds.
    segment_ns: u32,
    /// Airtime of a byte, in 1/256 of a nanosecond.
    byte: u32,
    /// Share of segments that are lost in the air.
    pub(super) loss: f32,
}

impl Quality {
    /// Airtime of `len` bytes, in as many segments as that takes.
    pub(super) fn airtime_ns(&self, len: usize) -> u64 {
        let segments = len.div_ceil(SEGMENT).max(1) as u64;
        segments * u64::from(self.segment_ns) + ((len as u64 * u64::from(self.byte)) >> 8)
    }
}

/// The places and strengths of access points.
#[derive(Debug)]
pub(super) struct Survey {
    pub(super) radio: Radio,
    pub(super) figures: RadioFigures,
    /// Channels in use, and which of them each access point is on.
    pub(super) channels: Vec<u8>,
    channel_of: Vec<u16>,
    everywhere_dbm: f32,
    seed: u64,
}

impl Survey {
    pub(super) fn new(setup: &Setup, radio: Radio) -> Self {
        let mut channels: Vec<u8> = radio.access_points.iter().map(|a| a.channel).collect();
        channels.sort_unstable();
        channels.dedup();
        let place = |channel: u8| channels.iter().position(|&c| c == channel).unwrap_or(0);
        let channel_of = radio
            .access_points
            .iter()
            .map(|point| place(point.channel) as u16)
            .collect();
        if channels.is_empty() {
            channels.push(1);
        }
        Self {
            radio,
            figures: setup.figures,
            channels,
            channel_of,
            everywhere_dbm: setup.link.rssi_dbm.into(),
            seed: setup.seed,
        }
    }

    /// Number of access points that can be told apart.
    pub(super) fn points(&self) -> usize {
        self.radio.access_points.len().max(1)
    }

    /// Which of `channels` an access point is on.
    pub(super) fn channel_of(&self, point: usize) -> usize {
        self.channel_of.get(point).copied().unwrap_or(0).into()
    }

    /// How strong access point number `point` is at a place, without fading, dBm.
    pub(super) fn level(&self, point: usize, place: Option<(f32, f32)>) -> f32 {
        let (Some(access), Some((x, y))) = (self.radio.access_points.get(point), place) else {
            return self.everywhere_dbm;
        };
        let (dx, dy) = (x - access.x, y - access.y);
        let metres = (dx * dx + dy * dy).sqrt().max(NEAREST_M);
        let figures = &self.figures;
        let loss = figures.first_metre_db + 10.0 * figures.exponent * libm::log10f(metres);
        let shadow = figures.shadowing_db * self.shadow(point, (x, y));
        figures.power_dbm - access.attenuation_db - loss - shadow
    }

    /// The strongest access point at a place, and its level.
    pub(super) fn best(&self, place: Option<(f32, f32)>) -> (usize, f32) {
        let mut best = (0, self.level(0, place));
        for point in 1..self.points() {
            let level = self.level(point, place);
            if level > best.1 {
                best = (point, level);
            }
        }
        best
    }

    /// The weakest signal that carries anything, dBm.
    pub(super) fn floor_dbm(&self) -> f32 {
        SCHEMES[0].1 + self.figures.noise_db
    }

    /// What segments cost at a signal of so many dBm. `behind` is the share lost elsewhere.
    pub(super) fn quality(&self, dbm: f32, behind: f32) -> Quality {
        let dbm = dbm - self.figures.noise_db;
        let overhead_ns = self.figures.overhead_us * 1_000.0;
        // The scheme that is fastest for a full segment: a sender tries those around its own
        // all the time.
        let (mut cheapest, mut bit_ns, mut frame_ns, mut lost) = (f32::MAX, 0.0, 0.0, 0.0);
        for (mbps, sensitivity) in SCHEMES {
            let errors = frame_errors(dbm - sensitivity).min(MOST_ERRORS);
            let attempts = 1.0 / (1.0 - errors);
            let (bit, frame) = (attempts * 1_000.0 / mbps, attempts * overhead_ns);
            let full = frame + bit * (SEGMENT * 8) as f32;
            if full < cheapest {
                (cheapest, bit_ns, frame_ns, lost) = (full, bit, frame, errors);
            }
        }
        // The segment and the frame that acknowledges it.
        let segment_ns = 2.0 * (frame_ns + (HEADERS * 8) as f32 * bit_ns);
        let in_air = libm::powf(lost, ATTEMPTS as f32);
        Quality {
            segment_ns: segment_ns as u32,
            byte: (bit_ns * 8.0 * 256.0) as u32,
            loss: in_air + behind - in_air * behind,
        }
    }

    /// Shadowing of an access point at a place in standard deviations: drawn at the corners of
    /// squares, smooth between them.
    fn shadow(&self, point: usize, (x, y): (f32, f32)) -> f32 {
        if self.figures.shadowing_db == 0.0 {
            return 0.0;
        }
        let (column, row) = (libm::floorf(x / SHADOW_M), libm::floorf(y / SHADOW_M));
        let (u, v) = (x / SHADOW_M - column, y / SHADOW_M - row);
        let (column, row) = (column as i32, row as i32);
        let (mut sum, mut squares) = (0.0, 0.0);
        for (dx, dy, weight) in [
            (0, 0, (1.0 - u) * (1.0 - v)),
            (1, 0, u * (1.0 - v)),
            (0, 1, (1.0 - u) * v),
            (1, 1, u * v),
        ] {
            sum += weight * self.corner(point, column + dx, row + dy);
            squares += weight * weight;
        }
        // As wide between the corners as at them.
        sum / squares.sqrt()
    }

    /// Four uniform numbers added up: close enough to normal, and without a logarithm.
    fn corner(&self, point: usize, column: i32, row: i32) -> f32 {
        let place = u64::from(column as u32) << 32 | u64::from(row as u32);
        let bits = mix(self.seed ^ mix(place) ^ mix(0x7368_6164 + point as u64));
        let quarter = |n: u32| (bits >> (16 * n) & 0xFFFF) as f32 * (1.0 / 65_536.0) - 0.5;
        // Each has a variance of 1/12.
        (quarter(0) + quarter(1) + quarter(2) + quarter(3)) * 1.732_050_8
    }

    /// Whether a partition is for a robot of this number, whatever the time and place.
    pub(super) fn is_drawn(&self, partition: usize, number: u32) -> bool {
        let share = self.radio.partitions[partition].share;
        let place = u64::from(number) << 32 | partition as u64;
        let bits = mix(self.seed ^ mix(place ^ 0x7061_7274));
        ((bits >> 40) as f32 * (1.0 / 16_777_216.0)) < share
    }
}

/// Share of frames that do not get through at so many decibels above the sensitivity: a tenth at
/// none, by its definition, and half at one and a half less.
fn frame_errors(margin_db: f32) -> f32 {
    const HALF_DB: f32 = -1.5;
    // ln 9 / 1.5 dB.
    const STEEPNESS: f32 = 1.464_816_4;
    1.0 / (1.0 + libm::expf((margin_db - HALF_DB) * STEEPNESS))
}
