//! What is known of one robot's body.

use super::ParameterError;
use super::bodies::Build;
use super::parameters::Parameters;

/// What is known of the body of one robot, beside what is drawn for it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Body {
    /// What the left and the right motor make of their voltage, as a share of the nominal.
    pub motors: Option<[f32; 2]>,
    /// Dry friction of each motor, as a share of the nominal.
    pub friction: Option<[f32; 2]>,
    /// Distance between the wheels, as it acts, metres.
    pub track_m: Option<f32>,
    /// Mass of the whole robot, kilograms.
    pub mass_kg: Option<f32>,
    /// Radius of gyration about the vertical axis, metres.
    pub gyration_m: Option<f32>,
    /// Internal resistance of the pack, ohms.
    pub internal_ohm: Option<f32>,
    /// Charge of the pack in the beginning, 0 to 1.
    pub charge: Option<f32>,
}

impl Body {
    /// Checks that a world can run with it.
    ///
    /// # Errors
    /// The first value outside of its range.
    pub fn validate(&self) -> Result<(), ParameterError> {
        // Not-a-number is in no range. A world drives no faster than its drawn robots do, by far.
        let within = |name, value: Option<f32>, least: f32, most: f32| match value {
            Some(value) if !(least..=most).contains(&value) => {
                Err(ParameterError { name, least, most })
            }
            _ => Ok(()),
        };
        for k in 0..2 {
            within("motors", self.motors.map(|pair| pair[k]), 0.2, 2.0)?;
            within("friction", self.friction.map(|pair| pair[k]), 0.0, 2.0)?;
        }
        within("track_m", self.track_m, 0.02, 0.3)?;
        within("mass_kg", self.mass_kg, 0.05, 5.0)?;
        within("gyration_m", self.gyration_m, 0.01, 0.1)?;
        within("internal_ohm", self.internal_ohm, 0.0, 2.0)?;
        within("charge", self.charge, 0.0, 1.0)
    }

    /// Puts what is known in the place of what was drawn.
    pub(super) fn put(&self, build: &mut Build, parameters: &Parameters) {
        if let Some([left, right]) = self.motors {
            (build.left, build.right) = (left, right);
        }
        if let Some(friction) = self.friction {
            build.friction = friction;
        }
        if let Some(internal_ohm) = self.internal_ohm {
            build.internal_ohm = internal_ohm;
        }
        if self.track_m.is_none() && self.mass_kg.is_none() && self.gyration_m.is_none() {
            return;
        }
        let track_m = self.track_m.unwrap_or(build.track_m);
        let mass_kg = self.mass_kg.unwrap_or(build.mass_kg);
        let gyration_m = self.gyration_m.unwrap_or(parameters.chassis.gyration_m);
        let per_half_track = 2.0 / track_m;
        let turning = gyration_m * per_half_track;
        build.track_m = track_m;
        build.mass_kg = mass_kg;
        build.per_half_track = per_half_track;
        build.turn_kg = mass_kg * turning * turning;
    }
}
