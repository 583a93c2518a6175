//! The ultrasonic ranger.

use serde::{Deserialize, Serialize};

use super::table::Bound::{Number, Of};
use super::table::Vary::{Fixed, Plus, Times, Within};
use super::table::{Row, row};

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
    /// Share of measurements that miss the straight echo and take one over a detour for it.
    pub multipath: f32,
    /// Longest detour, as a share of the straight way.
    pub detour: f32,
    /// Share of measurements that end early, at an echo that is not of their own burst: a ping of
    /// another robot by way of a wall, or a clatter in the band.
    pub ghost: f32,
    /// Farthest ranger whose ping is heard straight, metres; 0 leaves cross-talk out.
    pub crosstalk_m: f32,
    /// What the sensor tells distances apart by, millimetres.
    pub step_mm: f32,
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
            multipath: 0.002,
            detour: 0.5,
            ghost: 0.001,
            crosstalk_m: 4.5,
            step_mm: 1.0,
        }
    }
}

/// Rows of the table.
pub(super) const ROWS: &[Row] = &[
    row!(
        ranger.mount_m,
        "m",
        Number(0.0),
        Of("chassis.radius_m"),
        Plus(0.002),
        Plus(0.005),
        "distance from the robot's centre to the transducers",
        "estimate: just behind the rim"
    ),
    row!(
        ranger.half_angle,
        "rad",
        Number(0.01),
        Number(0.8),
        Times(0.05),
        Times(0.3),
        "half the opening angle of the beam",
        "estimate: 12°; the US-100 data sheet says 7.5°, large surfaces answer from further out"
    ),
    row!(
        ranger.max_incidence,
        "rad",
        Number(0.1),
        Number(1.5),
        Times(0.05),
        Times(0.2),
        "steepest angle from a surface's normal that still sends an echo back",
        "estimate: 60°"
    ),
    row!(
        ranger.farthest_mm,
        "mm",
        Number(100.0),
        Number(4_500.0),
        Fixed,
        Times(0.2),
        "farthest echo that is heard",
        "US-100 data sheet"
    ),
    row!(
        ranger.nearest_mm,
        "mm",
        Number(0.0),
        Of("ranger.farthest_mm"),
        Fixed,
        Fixed,
        "nearest echo that is told from the transmitter's ringing",
        "US-100 data sheet"
    ),
    row!(
        ranger.noise_mm,
        "mm",
        Number(0.0),
        Number(200.0),
        Times(0.25),
        Times(1.0),
        "standard deviation of a range, at any distance",
        "estimate"
    ),
    row!(
        ranger.noise_share,
        "1",
        Number(0.0),
        Number(0.2),
        Times(0.25),
        Times(1.0),
        "part of the deviation that grows with the distance",
        "estimate"
    ),
    row!(
        ranger.dropout,
        "1",
        Number(0.0),
        Number(1.0),
        Times(0.5),
        Within(0.0, 0.05),
        "share of measurements whose echo is lost",
        "estimate"
    ),
    row!(
        ranger.multipath,
        "1",
        Number(0.0),
        Number(1.0),
        Times(0.5),
        Within(0.0, 0.02),
        "share of measurements that take an echo over a detour for the straight one",
        "estimate: one in 500"
    ),
    row!(
        ranger.detour,
        "1",
        Number(0.0),
        Number(4.0),
        Times(0.2),
        Times(0.8),
        "longest detour of such an echo, as a share of the straight way",
        "estimate: a bounce between robot and wall adds up to half the way"
    ),
    row!(
        ranger.ghost,
        "1",
        Number(0.0),
        Number(1.0),
        Times(0.5),
        Within(0.0, 0.01),
        "share of measurements that end early at a sound that is no echo of theirs",
        "estimate: one in 1,000"
    ),
    row!(
        ranger.crosstalk_m,
        "m",
        Number(0.0),
        Number(9.0),
        Times(0.2),
        Within(0.0, 9.0),
        "farthest ranger whose ping is heard straight; 0 leaves cross-talk out",
        "choice: the reach; a ping that comes straight has less far to go than an echo from there"
    ),
    row!(
        ranger.step_mm,
        "mm",
        Number(0.001),
        Number(100.0),
        Fixed,
        Within(0.5, 10.0),
        "what the sensor tells distances apart by",
        "US-100 data sheet: resolution 1 mm"
    ),
];
