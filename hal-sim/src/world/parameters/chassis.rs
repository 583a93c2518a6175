//! Shape and drive train.

use serde::{Deserialize, Serialize};

use super::table::Bound::{Number, Of};
use super::table::Vary::{Fixed, Times};
use super::table::{Row, row};

/// Shape and drive train of a robot.
///
/// Nominal values are those of the common yellow 1:48 gear motor (200 rpm at 6 V without load,
/// stall about 0.9 A at 6 V) on 65 mm wheels behind an L298N.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Chassis {
    /// Radius of the round body, metres.
    pub radius_m: f32,
    /// Distance between the wheels, metres.
    pub track_m: f32,
    /// Mass of the whole robot, kilograms.
    pub mass_kg: f32,
    /// Radius of gyration about the vertical axis, metres: the moment of inertia is the mass times
    /// its square.
    pub gyration_m: f32,
    /// Share of the weight that stands on the driven wheels; the rest is on the castor.
    pub wheel_load: f32,
    /// Coefficient of friction between tyre and floor.
    pub grip: f32,
    /// Rim speed for each volt at the motor beyond `running_v`, metres per second.
    pub speed_per_volt: f32,
    /// Volts that dry friction costs while the wheel turns.
    pub running_v: f32,
    /// Volts it takes to set a standing wheel in motion: stiction.
    pub breakaway_v: f32,
    /// Armature resistance and the slope of the bridge's drop together, ohms.
    pub winding_ohm: f32,
    /// Force at the rim for each ampere, newtons.
    pub force_per_amp: f32,
    /// Share of a turning motor's damping that is grease and bearings, not back voltage: what
    /// slows it down when it is disconnected.
    pub drag_share: f32,
    /// Inertia of one wheel, gear and rotor, as a mass at the rim, kilograms.
    pub rotor_kg: f32,
    /// Volts the bridge keeps for itself (L298 data sheet, January 2000, table "Electrical
    /// characteristics": total drop 1.8 V at 1 A; its slope is in `winding_ohm`).
    pub bridge_drop_v: f32,
}

impl Default for Chassis {
    fn default() -> Self {
        Self {
            radius_m: 0.085,
            track_m: 0.14,
            mass_kg: 0.4,
            gyration_m: 0.07,
            wheel_load: 0.85,
            grip: 0.9,
            speed_per_volt: 0.128,
            running_v: 0.7,
            breakaway_v: 0.9,
            winding_ohm: 6.6,
            force_per_amp: 3.9,
            drag_share: 0.18,
            rotor_kg: 0.215,
            bridge_drop_v: 1.4,
        }
    }
}

impl Chassis {
    /// Rim speed in metres per second at full duty when the pack delivers `supply_v`.
    pub fn speed_at(&self, supply_v: f32) -> f32 {
        (supply_v - self.bridge_drop_v - self.running_v).max(0.0) * self.speed_per_volt
    }

    /// Share of the duty that friction takes when the pack delivers `supply_v`, 0 to 1.
    ///
    /// A turning wheel settles at [`Self::speed_at`] · (duty − dead band) / (1 − dead band). A
    /// standing one starts a little later, at `breakaway_v`.
    pub fn dead_band(&self, supply_v: f32) -> f32 {
        let motor_v = supply_v - self.bridge_drop_v;
        if motor_v > self.running_v {
            self.running_v / motor_v
        } else {
            1.0
        }
    }

    /// Force at a driven rim for each metre per second, newtons: what makes a motor slower than
    /// its voltage asks for.
    pub(crate) fn damping(&self) -> f32 {
        self.force_per_amp / (self.winding_ohm * self.speed_per_volt)
    }

    /// Time constant of the speed straight ahead while driven, seconds.
    pub fn time_constant(&self) -> f32 {
        (self.mass_kg * 0.5 + self.rotor_kg) / self.damping()
    }
}

/// Rows of the table.
pub(super) const ROWS: &[Row] = &[
    row!(
        chassis.radius_m,
        "m",
        Number(0.03),
        Number(0.1),
        Fixed,
        Fixed,
        "radius of the round body",
        "estimate: a two-wheel chassis kit"
    ),
    row!(
        chassis.track_m,
        "m",
        Number(0.02),
        Number(0.3),
        Times(0.01),
        Times(0.03),
        "distance between the wheels",
        "estimate: a two-wheel chassis kit"
    ),
    row!(
        chassis.mass_kg,
        "kg",
        Number(0.05),
        Number(5.0),
        Times(0.05),
        Times(0.25),
        "mass of the whole robot",
        "estimate: kit with motors 0.2 kg, two cells 0.1 kg, boards and sensors 0.1 kg"
    ),
    row!(
        chassis.gyration_m,
        "m",
        Number(0.01),
        Number(0.1),
        Times(0.05),
        Times(0.2),
        "radius of gyration about the vertical axis",
        "estimate: between an even disc (0.060 m) and a rim (0.085 m)"
    ),
    row!(
        chassis.wheel_load,
        "1",
        Number(0.1),
        Number(1.0),
        Times(0.03),
        Times(0.1),
        "share of the weight on the driven wheels",
        "estimate: cells above the axle, castor behind"
    ),
    row!(
        chassis.grip,
        "1",
        Number(0.05),
        Number(2.0),
        Times(0.1),
        Times(0.5),
        "coefficient of friction between tyre and floor",
        "estimate: rubber on a smooth floor is 0.6 to 1.0"
    ),
    row!(
        chassis.speed_per_volt,
        "m/s per V",
        Number(0.01),
        Number(0.25),
        Times(0.05),
        Times(0.15),
        "rim speed for each volt at the motor beyond `running_v`",
        "data sheet of the 1:48 gear motor: 200 rpm at 6 V without load; on 65 mm wheels \
         200 · π · 0.065 m / 60 s / (6 V − 0.7 V)"
    ),
    row!(
        chassis.running_v,
        "V",
        Number(0.0),
        Number(3.0),
        Times(0.1),
        Times(0.3),
        "volts that dry friction costs while the wheel turns",
        "data sheet: 0.1 A to 0.2 A without load, through the winding"
    ),
    row!(
        chassis.breakaway_v,
        "V",
        Of("chassis.running_v"),
        Number(4.0),
        Times(0.1),
        Times(0.3),
        "volts it takes to set a standing wheel in motion",
        "estimate: 1.3 times the running friction"
    ),
    row!(
        chassis.winding_ohm,
        "Ω",
        Number(1.0),
        Number(100.0),
        Times(0.05),
        Times(0.15),
        "armature resistance and the slope of the bridge's drop together",
        "data sheet: stall about 0.9 A at 6 V"
    ),
    row!(
        chassis.force_per_amp,
        "N/A",
        Number(0.1),
        Number(50.0),
        Times(0.05),
        Times(0.2),
        "force at the rim for each ampere",
        "estimate: half of the 7.8 N/A that the back voltage allows; the gear takes the rest"
    ),
    row!(
        chassis.drag_share,
        "1",
        Number(0.0),
        Number(0.8),
        Times(0.1),
        Times(0.5),
        "share of the damping that is grease and bearings, not back voltage",
        "estimate: a disconnected wheel takes about twice as long to stop as a driven one"
    ),
    row!(
        chassis.rotor_kg,
        "kg",
        Number(0.01),
        Number(5.0),
        Times(0.1),
        Times(0.3),
        "inertia of one wheel, gear and rotor, as a mass at the rim",
        "estimate: rotor of 1 × 10⁻⁷ kg m² times 48² over the square of the wheel's radius"
    ),
    row!(
        chassis.bridge_drop_v,
        "V",
        Number(0.0),
        Number(4.0),
        Times(0.05),
        Times(0.2),
        "volts the bridge keeps for itself",
        "L298 data sheet (January 2000): total drop 1.8 V at 1 A, less its slope"
    ),
];
