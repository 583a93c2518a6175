//! What the bodies of a world are made of, in numbers.

use serde::{Deserialize, Serialize};

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
    /// How much robots differ from each other.
    pub spread: Spread,
    /// Everything else.
    pub surroundings: Surroundings,
}

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
    /// Rim speed for each volt at the motor beyond `running_v`, metres per second.
    ///
    /// 200 rpm · π · 0.065 m / 60 s / (6 V − 0.7 V) = 0.128 m/s per volt.
    pub speed_per_volt: f32,
    /// Volts that friction costs while the wheel turns.
    pub running_v: f32,
    /// Volts it takes to set a standing wheel in motion: stiction.
    pub breakaway_v: f32,
    /// Time constant of the speed while driven, seconds.
    pub driven_tau_s: f32,
    /// Time constant with the motor shorted (both direction inputs equal, enable high), seconds.
    pub brake_tau_s: f32,
    /// Time constant with the motor left open (enable low), seconds.
    pub coast_tau_s: f32,
    /// Armature resistance and the slope of the bridge's drop together, ohms.
    pub winding_ohm: f32,
    /// Volts the bridge keeps for itself (L298 data sheet, January 2000, table "Electrical
    /// characteristics": total drop 1.8 V at 1 A; its slope is in `winding_ohm`).
    pub bridge_drop_v: f32,
}

impl Default for Chassis {
    fn default() -> Self {
        Self {
            radius_m: 0.085,
            track_m: 0.14,
            speed_per_volt: 0.128,
            running_v: 0.7,
            breakaway_v: 0.9,
            driven_tau_s: 0.09,
            brake_tau_s: 0.04,
            coast_tau_s: 0.18,
            winding_ohm: 6.6,
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
}

/// A 2S lithium-ion pack.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Pack {
    /// Charge of a full pack, ampere hours.
    pub capacity_ah: f32,
    /// Cells, protection circuit, switch and leads together, ohms.
    pub internal_ohm: f32,
    /// What everything but the motors draws, amperes.
    pub quiescent_a: f32,
    /// Share of the capacity at the start, 0 to 1.
    pub charge: f32,
    /// Terminal voltage below which the microcontroller resets, volts.
    pub brown_out_v: f32,
}

impl Default for Pack {
    fn default() -> Self {
        Self {
            capacity_ah: 2.0,
            internal_ohm: 0.18,
            quiescent_a: 0.15,
            charge: 0.95,
            brown_out_v: 4.5,
        }
    }
}

/// How the ranger is wired and how well it hears.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ranger {
    /// The jumper, of robots that are not given one of their own.
    pub wiring: Wiring,
    /// Distance from the robot's centre to the transducers, metres. Less than the radius, so that
    /// the blind zone lies within the body.
    pub mount_m: f32,
    /// Half the opening angle of the beam, radians. The data sheet promises 15° in all; echoes
    /// of large surfaces come from further out.
    pub half_angle: f32,
    /// Steepest angle from a surface's normal that still sends an echo back, radians.
    pub max_incidence: f32,
    /// Nearest echo that is told from the transmitter's ringing, millimetres.
    pub nearest_mm: u16,
    /// Farthest echo that is heard, millimetres.
    pub farthest_mm: u16,
    /// Standard deviation of a range, millimetres, at any distance.
    pub noise_mm: f32,
    /// The part of it that grows with the distance.
    pub noise_share: f32,
    /// Share of measurements whose echo is lost.
    pub dropout: f32,
}

/// The US-100's jumper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Wiring {
    /// Set: serial line.
    #[default]
    Uart,
    /// Open: trigger and echo.
    Pulse,
}

impl Default for Ranger {
    fn default() -> Self {
        Self {
            wiring: Wiring::Uart,
            mount_m: 0.06,
            // 12°, as measured on the like of it; 7.5° in the data sheet.
            half_angle: 0.209_44,
            // 60°.
            max_incidence: core::f32::consts::FRAC_PI_3,
            nearest_mm: 20,
            farthest_mm: 4_500,
            noise_mm: 2.0,
            noise_share: 0.002,
            dropout: 0.005,
        }
    }
}

/// The way from the pack to the converter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Gauge {
    /// Resistor from the pack to the pin, ohms.
    pub upper_ohm: f32,
    /// Resistor from the pin to ground, ohms.
    pub lower_ohm: f32,
    /// Standard deviation of one conversion at the pin, millivolts.
    pub noise_mv: f32,
}

impl Default for Gauge {
    fn default() -> Self {
        Self {
            upper_ohm: 100_000.0,
            lower_ohm: 47_000.0,
            noise_mv: 3.0,
        }
    }
}

/// How much robots differ, as standard deviations drawn once for each robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Spread {
    /// Of each motor's speed, as a share. Draws beyond three deviations are cut.
    pub motor: f32,
    /// Of the effective track, as a share: wheels that slip while turning.
    pub track: f32,
    /// Of the charge at the start, as a share of the capacity.
    pub charge: f32,
}

impl Default for Spread {
    fn default() -> Self {
        Self {
            motor: 0.01,
            track: 0.02,
            charge: 0.02,
        }
    }
}

impl Spread {
    /// All robots alike.
    pub const NONE: Self = Self {
        motor: 0.0,
        track: 0.0,
        charge: 0.0,
    };
}

/// Air and electronics.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Surroundings {
    /// Temperature of the air, degrees Celsius.
    pub air_c: f32,
    /// Longest time between two feedings of the watchdog, milliseconds; 0 switches it off.
    pub watchdog_ms: u32,
    /// Erase blocks of 4 KiB in each robot's parameter flash.
    pub flash_sectors: u16,
}

impl Default for Surroundings {
    fn default() -> Self {
        Self {
            air_c: 22.0,
            watchdog_ms: 1_000,
            flash_sectors: 4,
        }
    }
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
    /// The ranges are those within which the collision grid and the solver are known to hold, so
    /// this is also the range for randomisation.
    ///
    /// # Errors
    /// The first parameter outside of its range.
    pub fn validate(&self) -> Result<(), ParameterError> {
        let chassis = &self.chassis;
        let (pack, ranger, gauge) = (&self.pack, &self.ranger, &self.gauge);
        let (spread, around) = (&self.spread, &self.surroundings);
        let table: [(&'static str, f32, f32, f32); 31] = [
            ("chassis.radius_m", chassis.radius_m, 0.03, 0.1),
            ("chassis.track_m", chassis.track_m, 0.02, 0.3),
            ("chassis.speed_per_volt", chassis.speed_per_volt, 0.01, 0.25),
            ("chassis.running_v", chassis.running_v, 0.0, 3.0),
            (
                "chassis.breakaway_v",
                chassis.breakaway_v,
                chassis.running_v,
                4.0,
            ),
            ("chassis.driven_tau_s", chassis.driven_tau_s, 0.01, 2.0),
            ("chassis.brake_tau_s", chassis.brake_tau_s, 0.01, 2.0),
            ("chassis.coast_tau_s", chassis.coast_tau_s, 0.01, 2.0),
            ("chassis.winding_ohm", chassis.winding_ohm, 1.0, 100.0),
            ("chassis.bridge_drop_v", chassis.bridge_drop_v, 0.0, 4.0),
            ("pack.capacity_ah", pack.capacity_ah, 0.001, 100.0),
            ("pack.internal_ohm", pack.internal_ohm, 0.0, 2.0),
            ("pack.quiescent_a", pack.quiescent_a, 0.0, 2.0),
            ("pack.charge", pack.charge, 0.0, 1.0),
            ("pack.brown_out_v", pack.brown_out_v, 0.0, 8.0),
            ("ranger.mount_m", ranger.mount_m, 0.0, chassis.radius_m),
            ("ranger.half_angle", ranger.half_angle, 0.01, 0.8),
            ("ranger.max_incidence", ranger.max_incidence, 0.1, 1.5),
            (
                "ranger.nearest_mm",
                f32::from(ranger.nearest_mm),
                0.0,
                f32::from(ranger.farthest_mm),
            ),
            (
                "ranger.farthest_mm",
                f32::from(ranger.farthest_mm),
                100.0,
                4_500.0,
            ),
            ("ranger.noise_mm", ranger.noise_mm, 0.0, 200.0),
            ("ranger.noise_share", ranger.noise_share, 0.0, 0.2),
            ("ranger.dropout", ranger.dropout, 0.0, 1.0),
            ("gauge.upper_ohm", gauge.upper_ohm, 0.0, 1e7),
            ("gauge.lower_ohm", gauge.lower_ohm, 1.0, 1e7),
            ("gauge.noise_mv", gauge.noise_mv, 0.0, 500.0),
            ("spread.motor", spread.motor, 0.0, 0.05),
            ("spread.track", spread.track, 0.0, 0.1),
            ("spread.charge", spread.charge, 0.0, 0.5),
            ("surroundings.air_c", around.air_c, -40.0, 85.0),
            (
                "surroundings.flash_sectors",
                f32::from(around.flash_sectors),
                2.0,
                64.0,
            ),
        ];
        for (name, value, least, most) in table {
            // Not-a-number is in no range.
            if !(least..=most).contains(&value) {
                return Err(ParameterError { name, least, most });
            }
        }
        Ok(())
    }

    /// No robot of this world drives faster, metres per second.
    pub fn top_speed(&self) -> f32 {
        self.chassis.speed_at(super::battery::FULL_V)
            * (1.0 + super::bodies::SPREAD_CUT * self.spread.motor)
    }
}
