//! What the bodies of a world are made of, in numbers.
//!
//! One file for each section; [`TABLE`] has a row for each number, from which validation,
//! randomisation and `docs/parameters.md` come.

mod camera;
mod chassis;
mod gauge;
mod look;
mod pack;
mod page;
mod profile;
mod radio;
mod ranger;
mod spread;
mod surroundings;
mod table;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use camera::Camera;
pub use chassis::Chassis;
pub use gauge::Gauge;
pub use look::Look;
pub use pack::Pack;
pub use page::page;
pub use profile::Profile;
pub use radio::RadioFigures;
pub use ranger::{Ranger, Wiring};
pub use spread::Spread;
pub use surroundings::Surroundings;
pub use table::{Bound, Row, TABLE, Vary};

/// Every physical constant of a world. Nominal by default.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Parameters {
    /// Shape and drive train.
    pub chassis: Chassis,
    /// Battery pack.
    pub pack: Pack,
    /// Ultrasonic ranger.
    pub ranger: Ranger,
    /// Voltage divider and converter.
    pub gauge: Gauge,
    /// Camera.
    pub camera: Camera,
    /// What the world looks like, and what a camera makes of it.
    pub look: Look,
    /// Radio waves, and the network behind them.
    pub radio: RadioFigures,
    /// How much robots differ from each other.
    pub spread: Spread,
    /// Everything else.
    pub surroundings: Surroundings,
}

/// This parameter is not finite or lies outside of its range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterError {
    /// Name of the parameter, as in a scenario file.
    pub name: &'static str,
    /// Smallest value allowed.
    pub least: f32,
    /// Largest value allowed.
    pub most: f32,
}

impl core::fmt::Display for ParameterError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "{} must be between {} and {}",
            self.name, self.least, self.most
        )
    }
}

impl core::error::Error for ParameterError {}

impl Parameters {
    /// Checks that a world can run with them.
    ///
    /// The ranges of the [`TABLE`] are those within which the collision grid and the solver are
    /// known to hold.
    ///
    /// # Errors
    /// The first parameter outside of its range.
    pub fn validate(&self) -> Result<(), ParameterError> {
        TABLE.iter().try_for_each(|row| row.check(self))
    }

    /// No robot of this world drives faster that is drawn, metres per second.
    pub fn top_speed(&self) -> f32 {
        self.top_speed_of(1.0 + super::bodies::SPREAD_CUT * self.spread.motor)
    }

    /// The same of a motor that makes this share of the nominal of its voltage: with hardly any friction on a full pack.
    pub(crate) fn top_speed_of(&self, motor: f32) -> f32 {
        (super::battery::FULL_V - self.chassis.bridge_drop_v).max(0.0)
            * motor
            * self.chassis.speed_per_volt
    }
}
