//! Gauge for a pack of two lithium-ion cells in series, read through a resistor divider.
//!
//! The voltage of the pack is smoothed, translated to a state of charge by the [`curve`] of a cell
//! at rest, and classified with hysteresis. No current is measured, so the state of charge is low
//! by the sag of the load while the robot drives: about 0.1 Ω × 1 A per cell, some ten percent in
//! the flat middle of the curve. The smoothing keeps single bursts out of it.

use core::fmt;

use crawler_hal::{Millivolts, Percent};

pub mod curve;

#[cfg(test)]
mod tests;

/// Cells in series.
pub const CELLS: u16 = 2;

/// A setting makes no sense.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ConfigError {
    /// A resistor of the divider is zero.
    Resistor,
    /// A full pack would drive the pin beyond what the converter can tell.
    PinRange,
    /// Thresholds not in order, or outside what a pack can have; see [`Thresholds`].
    Thresholds,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Resistor => "a resistor of the battery divider is zero",
            Self::PinRange => "the battery divider drives the pin beyond the converter's range",
            Self::Thresholds => "battery thresholds are out of order",
        })
    }
}

impl core::error::Error for ConfigError {}

/// The divider between pack and pin: pin = pack · bottom / (top + bottom).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Divider {
    top_ohms: u32,
    bottom_ohms: u32,
}

impl Divider {
    /// A divider of `top_ohms` (pack to pin) and `bottom_ohms` (pin to ground), read by a
    /// converter that tells voltages up to `pin_limit` apart.
    ///
    /// # Errors
    /// [`ConfigError::Resistor`] when one is zero; [`ConfigError::PinRange`] when
    /// [`Thresholds::HIGHEST`] would be beyond `pin_limit`.
    pub const fn new(
        top_ohms: u32,
        bottom_ohms: u32,
        pin_limit: Millivolts,
    ) -> Result<Self, ConfigError> {
        if top_ohms == 0 || bottom_ohms == 0 {
            return Err(ConfigError::Resistor);
        }
        let divider = Self {
            top_ohms,
            bottom_ohms,
        };
        if divider.pack(pin_limit).0 < Thresholds::HIGHEST.0 {
            return Err(ConfigError::PinRange);
        }
        Ok(divider)
    }

    /// The voltage of the pack when the pin has `pin`, to the nearest millivolt; saturates.
    #[must_use]
    pub const fn pack(self, pin: Millivolts) -> Millivolts {
        let bottom = self.bottom_ohms as u64;
        let sum = self.top_ohms as u64 + bottom;
        // At most 2^16 · 2^33, far from overflow.
        let pack = (pin.0 as u64 * sum + bottom / 2) / bottom;
        Millivolts(if pack > u16::MAX as u64 {
            u16::MAX
        } else {
            pack as u16
        })
    }

    /// The voltage of the pin when the pack has `pack`, to the nearest millivolt. The other way
    /// round, for models of the divider.
    #[must_use]
    pub const fn pin(self, pack: Millivolts) -> Millivolts {
        let bottom = self.bottom_ohms as u64;
        let sum = self.top_ohms as u64 + bottom;
        Millivolts(((pack.0 as u64 * bottom + sum / 2) / sum) as u16)
    }
}

/// Where the classes begin, in voltage of the smoothed pack.
///
/// Voltages, and not states of charge, because what has to be prevented happens at voltages:
/// brown-out, and damage to the cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Thresholds {
    low: Millivolts,
    critical: Millivolts,
    hysteresis: Millivolts,
}

impl Thresholds {
    /// Below, no pack is connected (a board on its USB plug); half a volt per cell.
    pub const ABSENT: Millivolts = Millivolts(1_000);
    /// Below, a pack is damaged or the reading is: 2.5 V per cell, where the discharge behind
    /// [`curve`] ended.
    pub const LOWEST: Millivolts = Millivolts(5_000);
    /// Above, it is no pack of two cells: 4.2 V per cell when full, 0.05 V tolerance of the
    /// charger, 1 % of the divider.
    pub const HIGHEST: Millivolts = Millivolts(8_600);

    /// Low below `low`, critical below `critical`; back up only `hysteresis` above them.
    ///
    /// # Errors
    /// [`ConfigError::Thresholds`] unless [`Self::LOWEST`] < `critical`, `critical` +
    /// `hysteresis` ≤ `low`, `low` + `hysteresis` ≤ 4.2 V per cell, and `hysteresis` is not zero.
    pub const fn new(
        low: Millivolts,
        critical: Millivolts,
        hysteresis: Millivolts,
    ) -> Result<Self, ConfigError> {
        let (low_mv, critical_mv, hysteresis_mv) =
            (low.0 as u32, critical.0 as u32, hysteresis.0 as u32);
        if hysteresis_mv == 0
            || critical_mv <= Self::LOWEST.0 as u32
            || critical_mv + hysteresis_mv > low_mv
            || low_mv + hysteresis_mv > CELLS as u32 * 4_200
        {
            return Err(ConfigError::Thresholds);
        }
        Ok(Self {
            low,
            critical,
            hysteresis,
        })
    }
}

/// How the gauge reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// The divider.
    pub divider: Divider,
    /// Where the classes begin.
    pub thresholds: Thresholds,
}

impl Config {
    /// The usual robot: 100 kΩ over 47 kΩ brings 8.6 V down to 2.75 V, within the 3.1 V an
    /// ESP32-S3 measures at 12 dB attenuation (an ESP32-C3 ends at 2.5 V and wants another
    /// divider). Low at 7.0 V, 3.5 V per cell. Critical at 6.6 V: the L298N takes 2 V of it, and
    /// small geared motors are weak below 4.5 V. 0.2 V of hysteresis is more than the pack
    /// recovers when the motors stop.
    pub const STANDARD: Self = {
        // Checked when this is compiled.
        let Ok(divider) = Divider::new(100_000, 47_000, Millivolts(3_100)) else {
            panic!("divider")
        };
        let Ok(thresholds) = Thresholds::new(Millivolts(7_000), Millivolts(6_600), Millivolts(200))
        else {
            panic!("thresholds")
        };
        Self {
            divider,
            thresholds,
        }
    };
}

impl Default for Config {
    fn default() -> Self {
        Self::STANDARD
    }
}

/// What the voltage means. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Charge {
    /// Go on.
    Ok,
    /// Slow down, come home, tell someone.
    Low,
    /// Stop.
    Critical,
    /// No pack is connected: the supply is another one.
    Absent,
    /// No pack of two cells can have this voltage, or none could be read: trust nothing, look at
    /// the wiring.
    Absurd,
}

/// What the gauge knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Reading {
    /// Voltage of the pack: smoothed, or what was last read where [`Charge`] is `Absent` or
    /// `Absurd`.
    pub pack: Millivolts,
    /// State of charge; zero where [`Charge`] is `Absent` or `Absurd`.
    pub percent: Percent,
    /// What it means.
    pub charge: Charge,
}

/// The gauge. Give it one voltage per period (1 s).
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Gauge {
    // Settings come from whoever restores the gauge.
    #[cfg_attr(feature = "serde", serde(skip))]
    config: Config,
    filter: Option<Filter>,
    /// Implausible readings in a row.
    strikes: u8,
    reading: Option<Reading>,
}

impl Gauge {
    /// Implausible readings in a row that make a state: one alone is a glitch of the converter.
    pub const STRIKES: u8 = 3;

    /// A gauge that has read nothing.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        Self {
            config,
            filter: None,
            strikes: 0,
            reading: None,
        }
    }

    /// The latest reading; `None` before the first voltage.
    #[must_use]
    pub const fn reading(&self) -> Option<Reading> {
        self.reading
    }

    /// Other thresholds, from the next voltage on. The smoothed voltage and the class stay, so a
    /// pack that is critical does not recover by a change of settings alone.
    pub const fn set_thresholds(&mut self, thresholds: Thresholds) {
        self.config.thresholds = thresholds;
    }

    /// Takes the voltage at the pin in.
    pub fn update(&mut self, pin: Millivolts) -> Reading {
        let pack = self.config.divider.pack(pin);
        if pack < Thresholds::ABSENT {
            self.implausible(pack, Charge::Absent)
        } else if pack < Thresholds::LOWEST || pack > Thresholds::HIGHEST {
            self.implausible(pack, Charge::Absurd)
        } else {
            self.plausible(pack)
        }
    }

    /// Takes in that the converter failed: a gauge that cannot be read is a state, not the last
    /// number for ever.
    pub fn missed(&mut self) -> Reading {
        let pack = self.reading.map_or(Millivolts(0), |reading| reading.pack);
        self.implausible(pack, Charge::Absurd)
    }

    fn plausible(&mut self, pack: Millivolts) -> Reading {
        self.strikes = 0;
        let filter = match self.filter {
            Some(filter) => filter.push(pack),
            None => Filter::start(pack),
        };
        self.filter = Some(filter);
        let pack = filter.value();
        let before = self.reading.map(|reading| reading.charge);
        self.keep(Reading {
            pack,
            percent: curve::state_of_charge(Millivolts(pack.0 / CELLS)),
            charge: classify(before, pack, &self.config.thresholds),
        })
    }

    fn implausible(&mut self, pack: Millivolts, charge: Charge) -> Reading {
        self.strikes = self.strikes.saturating_add(1);
        match self.reading {
            // A class is held until the strikes are counted; with no reading before, or none to
            // hold, there is nothing to wait for.
            Some(
                held @ Reading {
                    charge: Charge::Ok | Charge::Low | Charge::Critical,
                    ..
                },
            ) if self.strikes < Self::STRIKES => held,
            Some(_) | None => {
                // What comes after is another pack, or another contact: start afresh.
                self.filter = None;
                self.keep(Reading {
                    pack,
                    percent: Percent::default(),
                    charge,
                })
            }
        }
    }

    fn keep(&mut self, reading: Reading) -> Reading {
        self.reading = Some(reading);
        reading
    }
}

/// The class of a smoothed `pack`, after the class `before`. Pure.
#[must_use]
pub fn classify(before: Option<Charge>, pack: Millivolts, thresholds: &Thresholds) -> Charge {
    let (low, critical) = (thresholds.low.0, thresholds.critical.0);
    let up = thresholds.hysteresis.0;
    // The bar to be in a better class is higher for whoever comes from a worse one.
    let (low, critical) = match before {
        Some(Charge::Critical) => (low + up, critical + up),
        Some(Charge::Low) => (low + up, critical),
        Some(Charge::Ok | Charge::Absent | Charge::Absurd) | None => (low, critical),
    };
    if pack.0 < critical {
        Charge::Critical
    } else if pack.0 < low {
        Charge::Low
    } else {
        Charge::Ok
    }
}

/// First-order low pass: each step goes an eighth of the way. At one reading a second the time
/// constant is about 8 s, longer than a burst of the motors and shorter than anything a battery
/// does by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Filter {
    /// Millivolts · 256: the fraction keeps small steps from being rounded away.
    level: u32,
}

impl Filter {
    const FRACTION_BITS: u32 = 8;
    const WEIGHT_BITS: u32 = 3;

    const fn start(first: Millivolts) -> Self {
        Self {
            level: (first.0 as u32) << Self::FRACTION_BITS,
        }
    }

    const fn push(self, sample: Millivolts) -> Self {
        let sample = (sample.0 as u32) << Self::FRACTION_BITS;
        // Both parts are below 2^24; subtracting first would need a sign.
        let weighted = self.level * ((1 << Self::WEIGHT_BITS) - 1) + sample;
        // Rounded down: the fraction is fine enough that the level told is still right.
        Self {
            level: weighted >> Self::WEIGHT_BITS,
        }
    }

    const fn value(self) -> Millivolts {
        let half = 1 << (Self::FRACTION_BITS - 1);
        Millivolts(((self.level + half) >> Self::FRACTION_BITS) as u16)
    }
}
