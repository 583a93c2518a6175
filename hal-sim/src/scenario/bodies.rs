//! Robots whose bodies are known, where the others' are drawn.

use serde::{Deserialize, Serialize};

use super::Selector;
use crate::world::Body;

/// What is known of the bodies of some robots: what a calibration has found, for example. What is not given is drawn as for
/// every robot. Of several that name a robot the last one counts.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownBody {
    /// Whose.
    #[serde(default)]
    pub robots: Selector,
    /// What the left and the right motor make of their voltage, as a share of `parameters.chassis.speed_per_volt`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motors: Option<[f32; 2]>,
    /// Dry friction of the left and the right motor, as a share of that of `parameters.chassis`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<[f32; 2]>,
    /// Distance between the wheels, as it acts, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub track_m: Option<f32>,
    /// Mass of the robot, kilograms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mass_kg: Option<f32>,
    /// Its radius of gyration, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gyration_m: Option<f32>,
    /// Internal resistance of its pack, ohms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub internal_ohm: Option<f32>,
    /// Charge of its pack in the beginning, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub charge: Option<f32>,
}

impl KnownBody {
    /// What is known.
    #[must_use]
    pub const fn body(&self) -> Body {
        Body {
            motors: self.motors,
            friction: self.friction,
            track_m: self.track_m,
            mass_kg: self.mass_kg,
            gyration_m: self.gyration_m,
            internal_ohm: self.internal_ohm,
            charge: self.charge,
        }
    }
}
