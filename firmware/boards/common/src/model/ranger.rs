//! The US-100 at the far end of its serial line.

use crawler_hal::{Duration, Instant};
use heapless::Deque;
use rand_pcg::Pcg32;

use super::drive::Drive;
use super::{normal, uniform};

/// One byte at 9600 baud: ten bits.
pub const BYTE_TIME: Duration = Duration::from_micros(1_042);
/// How long the sensor listens when nothing answers.
const WINDOW: Duration = Duration::from_millis(50);
/// What the sensor takes to read its thermometer.
const THERMOMETER_TIME: Duration = Duration::from_millis(2);
/// Temperature of the room, degrees Celsius.
const AIR_C: i16 = 22;
/// Millimetres that sound travels there and back in a microsecond: (331.3 + 0.606 · 22) m/s / 2.
const MM_PER_US: f32 = 0.172_3;
/// Reach of the sensor, metres.
const NEAREST_M: f32 = 0.02;
const FARTHEST_M: f32 = 4.5;
/// From the middle of the body to the transducers.
const MOUNT_M: f32 = 0.06;
/// Edges of the beam, radians: 12° to each side.
const BEAM: [f32; 3] = [0.0, 0.209_44, -0.209_44];
/// A surface steeper than 60° sends no echo back.
const LEAST_COSINE: f32 = 0.5;
/// Share of measurements whose echo is lost.
const DROPOUT: f32 = 0.005;

const RANGE: u8 = 0x55;
const TEMPERATURE: u8 = 0x50;

/// State of the sensor and of the controller's receiver.
#[derive(Debug, Default)]
pub struct Sensor {
    busy_until: Instant,
    /// Bytes on their way, with their time of arrival.
    inbox: Deque<(Instant, u8), 8>,
    /// When the controller's last byte leaves its transmitter.
    pub(super) sent_until: Instant,
}

impl Sensor {
    /// Hears one byte that arrives at `at`.
    pub(super) fn hear(&mut self, byte: u8, at: Instant, drive: &Drive, rng: &mut Pcg32) {
        if at < self.busy_until || !matches!(byte, RANGE | TEMPERATURE) {
            return;
        }
        let (ready, reply) = if byte == RANGE {
            let (after, mm) = listen(drive, rng);
            (at + after, mm.to_be_bytes())
        } else {
            let code = (AIR_C + 45).clamp(0, 255) as u8;
            (at + THERMOMETER_TIME, [code, 0])
        };
        let len = if byte == RANGE { 2 } else { 1 };
        let mut arrival = ready;
        for byte in &reply[..len] {
            arrival += BYTE_TIME;
            // A receiver that is full loses what comes.
            let _ = self.inbox.push_back((arrival, *byte));
        }
        self.busy_until = arrival;
    }

    /// When the next byte is there to read.
    pub(super) fn next_arrival(&self) -> Option<Instant> {
        self.inbox.front().map(|(at, _)| *at)
    }

    /// Takes what has arrived by `now`; returns how much.
    pub(super) fn take(&mut self, buf: &mut [u8], now: Instant) -> usize {
        let mut taken = 0;
        for place in buf {
            match self.inbox.front() {
                Some((at, byte)) if *at <= now => *place = *byte,
                _ => break,
            }
            let _ = self.inbox.pop_front();
            taken += 1;
        }
        taken
    }
}

/// Sends a burst: when the sensor knows, and what it says.
fn listen(drive: &Drive, rng: &mut Pcg32) -> (Duration, u16) {
    let nearest = BEAM
        .into_iter()
        .map(|off| drive.wall(MOUNT_M, off))
        .filter(|(_, cosine)| *cosine >= LEAST_COSINE)
        .map(|(distance, _)| distance)
        .fold(f32::INFINITY, f32::min);
    // Both are drawn every time, so that a wall does not shift later draws.
    let (error, lost) = (normal(rng), uniform(rng) < DROPOUT);
    if lost || nearest > FARTHEST_M {
        let beyond = WINDOW.as_micros() as f32 * MM_PER_US;
        return (WINDOW, (beyond + 0.5) as u16);
    }
    let told_m = nearest * (1.0 + 0.002 * error) + 0.002 * error;
    let mm = told_m.clamp(NEAREST_M, FARTHEST_M) * 1e3;
    let after = Duration::from_micros((mm / MM_PER_US + 0.5) as u64);
    (after, (mm + 0.5) as u16)
}
