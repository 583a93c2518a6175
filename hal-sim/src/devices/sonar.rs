//! The US-100 itself, behind its serial line or its pins.
//!
//! One measurement: the sensor sends a burst, listens until the nearest echo or the end of its
//! window, and tells what it heard. The world is asked when the request is made, and only then:
//! see [`RangeSensor`].

use std::collections::VecDeque;
use std::task::Waker;

use crawler_hal::Instant;
use rand_pcg::Pcg32;

use super::ports::Ports;
use super::range_sensor::{Echo, RangeSensor};
use crate::faults::RangerFault;
use crate::world::uniform;

/// Bytes that may wait on a line. An ESP32's receive FIFO holds as many.
pub(crate) const FIFO_BYTES: usize = 128;

/// State of one sensor and of the receiver behind its line.
#[derive(Debug)]
pub(crate) struct Sonar {
    sensor: RangeSensor,
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

impl Sonar {
    pub(crate) fn new(sensor: RangeSensor, line_rng: Pcg32) -> Self {
        Self {
            sensor,
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
        if ports.ranger_fault() == Some(RangerFault::Dead) {
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

    /// Sends a burst at `burst` and listens.
    pub(crate) fn listen(&mut self, ports: &Ports, burst: Instant) -> Echo {
        let space = &mut *ports.shared.space.borrow_mut();
        let fault = ports.ranger_fault();
        self.sensor.listen(space, ports.index(), fault, burst)
    }

    /// The byte that stands for the temperature.
    pub(crate) fn temperature_code(&self, ports: &Ports) -> u8 {
        let air_c = ports.shared.space.borrow().parameters.surroundings.air_c;
        self.sensor.temperature_code(air_c)
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
        self.sensor.fingerprint(&mut word);
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
