//! The US-100 itself, behind its serial line or its pins.
//!
//! One measurement: the sensor sends a burst, listens until the nearest echo or the end of its
//! window, and tells what it heard. The distance is asked of the world when the burst leaves, and
//! only then.

use std::collections::VecDeque;
use std::task::Waker;

use crawler_hal::{Duration, Instant};
use rand_pcg::Pcg32;

use crate::faults::RangerFault;
use crate::world::{Ports, Ranger, normal, uniform};

/// How long the sensor listens when nothing answers. The echo from 4.5 m takes 26 ms; the rest is
/// why a reading of nothing comes late. The data sheet does not say; with the request and the
/// reply it stays within what a caller can wait.
pub(crate) const WINDOW: Duration = Duration::from_millis(50);

/// Bytes that may wait on a line. An ESP32's receive FIFO holds as many.
pub(crate) const FIFO_BYTES: usize = 128;

/// State of one sensor and of the receiver behind its line.
#[derive(Debug)]
pub(crate) struct Sonar {
    rng: Pcg32,
    /// Of the line, not of the sensor: which bits flip.
    line_rng: Pcg32,
    /// The sensor hears nothing new before this moment.
    busy_until: Instant,
    /// Bytes under way to the controller or waiting there, by time of arrival.
    pub(crate) inbox: VecDeque<(Instant, u8)>,
    /// When the controller's last byte has left its transmitter.
    pub(crate) sent_until: Instant,
    /// Bytes in a transmitter that hangs.
    pub(crate) hanging: usize,
    /// Since when the trigger pin is high.
    pub(crate) trigger_since: Option<Instant>,
    /// When the echo pin rises and falls, while that lies ahead or goes on.
    pub(crate) pulse: Option<(Instant, Instant)>,
    /// Who waits for a pulse that nobody has triggered yet.
    pub(crate) waiting: Option<Waker>,
    /// Requests ignored because a measurement was under way.
    pub(crate) overlaps: u32,
}

/// What the sensor heard.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Echo {
    /// When it knows: the flight time, or the end of its window.
    pub(crate) after: Duration,
    /// What it says in millimetres.
    pub(crate) says_mm: u16,
}

impl Sonar {
    pub(crate) fn new(rng: Pcg32, line_rng: Pcg32) -> Self {
        Self {
            rng,
            line_rng,
            busy_until: Instant::BOOT,
            inbox: VecDeque::new(),
            sent_until: Instant::BOOT,
            hanging: 0,
            trigger_since: None,
            pulse: None,
            waiting: None,
            overlaps: 0,
        }
    }

    /// The controller restarted: its side of the line is empty. The sensor goes on.
    pub(crate) fn restart(&mut self) {
        self.inbox.clear();
        self.sent_until = Instant::BOOT;
        self.hanging = 0;
        self.trigger_since = None;
        self.waiting = None;
    }

    /// Claims the sensor from `at` for a measurement; false when it is busy or dead.
    pub(crate) fn claim(&mut self, ports: &Ports, at: Instant) -> bool {
        if ports.faults.get().ranger == Some(RangerFault::Dead) {
            return false;
        }
        if at < self.busy_until {
            self.overlaps = self.overlaps.saturating_add(1);
            return false;
        }
        true
    }

    pub(crate) fn occupy(&mut self, until: Instant) {
        self.busy_until = until;
    }

    /// Sends a burst and listens.
    pub(crate) fn listen(&mut self, ports: &Ports) -> Echo {
        let (distance_mm, air_c, ranger) = {
            let mut space = ports.shared.space.borrow_mut();
            space.list_robots(0);
            let ranger = space.parameters.ranger;
            let distance = match ports.faults.get().ranger {
                Some(RangerFault::Stuck(mm)) => Some(f32::from(mm) * 1e-3),
                Some(RangerFault::Dead) => None,
                None => space.range(
                    ports.index(),
                    f32::from(ranger.nearest_mm) * 1e-3,
                    f32::from(ranger.farthest_mm) * 1e-3,
                ),
            };
            (
                distance.map(|metres| metres * 1e3),
                space.parameters.surroundings.air_c,
                ranger,
            )
        };
        // Both are drawn every time, so that what is in front of one robot does not shift the
        // numbers of its later measurements.
        let error = normal(&mut self.rng);
        let lost = uniform(&mut self.rng) < ranger.dropout;
        let stuck = matches!(ports.faults.get().ranger, Some(RangerFault::Stuck(_)));
        match distance_mm {
            Some(true_mm) if stuck => Echo::at(true_mm, air_c),
            Some(true_mm) if !lost => Echo::at(heard(true_mm, error, &ranger), air_c),
            Some(_) | None => Echo {
                after: WINDOW,
                // What the window is long: beyond the sensor's reach, and so no range.
                says_mm: (half_path_mm(WINDOW, air_c) + 0.5) as u16,
            },
        }
    }

    /// Passes one byte over the line, with the bits that flip on it.
    pub(crate) fn over_the_line(&mut self, byte: u8, flip_share: f32) -> u8 {
        if flip_share <= 0.0 {
            return byte;
        }
        (0..8).fold(byte, |byte, bit| {
            if uniform(&mut self.line_rng) < flip_share {
                byte ^ (1 << bit)
            } else {
                byte
            }
        })
    }

    pub(crate) fn fingerprint(&self, mut word: impl FnMut(u64)) {
        use rand_core::Rng;
        word(self.rng.clone().next_u64());
        word(self.line_rng.clone().next_u64());
        word(self.busy_until.as_micros());
        word(self.sent_until.as_micros());
        word(self.hanging as u64);
        word(u64::from(self.overlaps));
        for &(at, byte) in &self.inbox {
            word(at.as_micros() << 8 | u64::from(byte));
        }
        if let Some((rise, fall)) = self.pulse {
            word(rise.as_micros());
            word(fall.as_micros());
        }
    }
}

impl Echo {
    fn at(says_mm: f32, air_c: f32) -> Self {
        let speed = speed_of_sound_mm_per_us(air_c);
        Self {
            after: Duration::from_micros((2.0 * says_mm / speed + 0.5) as u64),
            says_mm: (says_mm + 0.5) as u16,
        }
    }
}

/// A range with the sensor's error, which cannot leave its reach.
fn heard(true_mm: f32, error: f32, ranger: &Ranger) -> f32 {
    let deviation = ranger.noise_mm + ranger.noise_share * true_mm;
    (true_mm + error * deviation).clamp(f32::from(ranger.nearest_mm), f32::from(ranger.farthest_mm))
}

/// 331.3 m/s at 0 °C and 0.606 m/s more for each degree: the usual linear form of √T, within
/// 0.2 % from −20 °C to 50 °C.
fn speed_of_sound_mm_per_us(air_c: f32) -> f32 {
    (331.3 + 0.606 * air_c) * 1e-3
}

fn half_path_mm(time: Duration, air_c: f32) -> f32 {
    time.as_micros() as f32 * speed_of_sound_mm_per_us(air_c) * 0.5
}
