//! The US-100 without its line: what one measurement hears, whoever asked for it.

use crawler_hal::{Duration, Instant};
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use crate::faults::RangerFault;
use crate::world::{Ranger, Space, normal, uniform};

/// How long the sensor listens when nothing answers. The echo from 4.5 m takes 26 ms; the rest is
/// why a reading of nothing comes late. The data sheet does not say; with the request and the
/// reply it stays within what a caller can wait.
pub(crate) const WINDOW: Duration = Duration::from_millis(50);

/// Draws of the thermometer's error are cut at so many standard deviations.
const CUT: f32 = 3.0;

/// One sensor without its line.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct RangeSensor {
    rng: Pcg32,
    /// How much too warm its thermometer reads, degrees Celsius.
    thermometer_c: f32,
}

/// What the sensor heard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Echo {
    /// When it knows: the flight time, or the end of its window.
    pub(crate) after: Duration,
    /// What it says in millimetres, over its serial line.
    pub(crate) says_mm: u16,
}

impl RangeSensor {
    /// A sensor with the peculiarities that `build` gives it; its measurements draw from `rng`.
    pub(crate) fn new(rng: Pcg32, build: &mut Pcg32, deviation_c: f32) -> Self {
        Self {
            rng,
            thermometer_c: normal(build).clamp(-CUT, CUT) * deviation_c,
        }
    }

    /// Sends a burst at `burst` and listens.
    pub(crate) fn listen(
        &mut self,
        space: &mut Space,
        robot: usize,
        fault: Option<RangerFault>,
        burst: Instant,
    ) -> Echo {
        space.list_robots(0);
        space.bodies.ping(robot, burst.as_micros());
        let mut ranger = space.parameters.ranger;
        if let Some(RangerFault::Noisy(mm)) = fault {
            ranger.noise_mm += f32::from(mm);
        }
        let air_c = space.parameters.surroundings.air_c;
        let reach = (
            f32::from(ranger.nearest_mm) * 1e-3,
            f32::from(ranger.farthest_mm) * 1e-3,
        );
        // All are drawn every time, so that what is in front of one robot does not shift the
        // numbers of its later measurements.
        let chance = Chance {
            error: normal(&mut self.rng),
            lost: uniform(&mut self.rng),
            odd: uniform(&mut self.rng),
            place: uniform(&mut self.rng),
        };
        let heard_mm = match fault {
            Some(RangerFault::Stuck(mm)) => return self.echo(f32::from(mm), 0.0, air_c),
            Some(RangerFault::Dead) => None,
            None | Some(RangerFault::Noisy(_)) => {
                let own = space.range(robot, reach.0, reach.1);
                let own = own.map(|metres| metres * 1e3);
                let own = chance.hear(own, &ranger);
                let until = own.map_or(reach.1, |mm| (mm * 1e-3).min(reach.1));
                let speed = speed_of_sound_mm_per_us(air_c) * 1e-3;
                let other = space.crosstalk(robot, burst.as_micros(), speed, reach.0, until);
                other.map(|metres| metres * 1e3).or(own)
            }
        };
        match heard_mm {
            Some(mm) => self.echo(mm, ranger.step_mm, air_c),
            None => Echo {
                after: WINDOW,
                // What the window is long: beyond the sensor's reach, and so no range.
                says_mm: (half_path_mm(WINDOW, air_c) + 0.5) as u16,
            },
        }
    }

    /// What its thermometer tells of the air.
    pub(crate) fn temperature(&self, air_c: f32) -> f32 {
        air_c + self.thermometer_c
    }

    /// The byte that stands for its temperature.
    pub(crate) fn temperature_code(&self, air_c: f32) -> u8 {
        // 45 more than the degrees; the cast saturates.
        (libm::roundf(self.temperature(air_c)) + 45.0) as u8
    }

    /// The echo from a distance, told apart in steps.
    fn echo(&self, mm: f32, step_mm: f32, air_c: f32) -> Echo {
        let mm = if step_mm > 0.0 {
            libm::roundf(mm / step_mm) * step_mm
        } else {
            mm
        };
        let speed = speed_of_sound_mm_per_us(air_c);
        // It reckons with the sound's speed in the air as it feels it.
        let believed = speed_of_sound_mm_per_us(self.temperature(air_c));
        Echo {
            after: Duration::from_micros((2.0 * mm / speed + 0.5) as u64),
            says_mm: (mm * (believed / speed) + 0.5) as u16,
        }
    }

    /// Whether a stored sensor is one.
    pub(crate) fn is_sound(&self) -> bool {
        self.thermometer_c.abs() <= 100.0
    }

    pub(crate) fn fingerprint(&self, mut word: impl FnMut(u64)) {
        use rand_core::Rng;
        word(self.rng.clone().next_u64());
        word(u64::from(self.thermometer_c.to_bits()));
    }
}

/// What is left to chance about one measurement.
struct Chance {
    /// Normally distributed.
    error: f32,
    /// 0 to 1, like the others.
    lost: f32,
    odd: f32,
    place: f32,
}

impl Chance {
    /// What becomes of the nearest echo.
    fn hear(&self, own_mm: Option<f32>, ranger: &Ranger) -> Option<f32> {
        let (nearest, farthest) = (f32::from(ranger.nearest_mm), f32::from(ranger.farthest_mm));
        let own_mm = own_mm.filter(|_| self.lost >= ranger.dropout);
        if self.odd < ranger.ghost {
            // At any moment until the echo ends the measurement.
            let until = own_mm.unwrap_or(farthest);
            return Some(nearest + self.place * (until - nearest).max(0.0));
        }
        let detour = if self.odd < ranger.ghost + ranger.multipath {
            1.0 + self.place * ranger.detour
        } else {
            1.0
        };
        let way_mm = own_mm? * detour;
        if way_mm > farthest {
            return None;
        }
        let deviation = ranger.noise_mm + ranger.noise_share * way_mm;
        // The error cannot leave the reach.
        Some((way_mm + self.error * deviation).clamp(nearest, farthest))
    }
}

/// 331.3 m/s at 0 °C and 0.606 m/s more for each degree: the usual linear form of √T, within
/// 0.2 % from −20 °C to 50 °C.
fn speed_of_sound_mm_per_us(air_c: f32) -> f32 {
    (331.3 + 0.606 * air_c) * 1e-3
}

fn half_path_mm(time: Duration, air_c: f32) -> f32 {
    time.as_micros() as f32 * speed_of_sound_mm_per_us(air_c) * 0.5
}
