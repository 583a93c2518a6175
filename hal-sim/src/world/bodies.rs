//! The bodies of all robots, as a structure of arrays.

use rand_pcg::Pcg32;

use super::battery::{FULL_V, open_circuit_v};
use super::geometry::{Pose, Vec2};
use super::parameters::Parameters;
use super::rng::normal;

/// Draws of the spread are cut at so many standard deviations.
pub(crate) const SPREAD_CUT: f32 = 3.0;

/// The levels a robot program drives: two PWM channels and the pins, as the L298N and the lamp
/// see them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Inputs {
    pub(crate) left: Bridge,
    pub(crate) right: Bridge,
    pub(crate) lamp: bool,
}

/// Inputs of one half of the L298N.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Bridge {
    /// Duty of the enable input, 255 = always on.
    pub(crate) duty: u8,
    pub(crate) in1: bool,
    pub(crate) in2: bool,
}

/// What a half bridge does to its motor (L298 data sheet, table "Bidirectional DC motor control").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Drive {
    /// IN1 high, IN2 low.
    Forward,
    /// IN1 low, IN2 high.
    Backward,
    /// Both alike: the motor is shorted while enabled.
    Brake,
}

impl Bridge {
    pub(crate) const fn drive(self) -> Drive {
        match (self.in1, self.in2) {
            (true, false) => Drive::Forward,
            (false, true) => Drive::Backward,
            (true, true) | (false, false) => Drive::Brake,
        }
    }
}

/// What is peculiar to one robot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Build {
    /// Speed of each motor as a share of the nominal one.
    pub(crate) left: f32,
    pub(crate) right: f32,
    /// Distance between the wheels, as it acts.
    pub(crate) track_m: f32,
    /// Of the pack.
    pub(crate) internal_ohm: f32,
}

/// Whether a body takes part in the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Presence {
    /// It does.
    Present,
    /// Its supply is below the brown-out voltage: it stands there, dead.
    Unpowered,
    /// It was taken away.
    Removed,
}

/// See the [module](self). All arrays have the same length; a robot's index never changes.
#[derive(Debug, Default)]
pub(crate) struct Bodies {
    pub(crate) at: Vec<Vec2>,
    pub(crate) theta: Vec<f32>,
    /// Rim speed of the left wheel, metres per second.
    pub(crate) left: Vec<f32>,
    /// Rim speed of the right wheel.
    pub(crate) right: Vec<f32>,
    pub(crate) inputs: Vec<Inputs>,
    /// Terminal voltage of the pack.
    pub(crate) supply_v: Vec<f32>,
    /// Charge left, ampere seconds. One step takes a ten-millionth of it: too little for 32 bits.
    pub(crate) charge_as: Vec<f64>,
    pub(crate) build: Vec<Build>,
    /// How often it began to touch something.
    pub(crate) contacts: Vec<u32>,
    /// Steps for which a new touch still counts as the same contact.
    pub(crate) hold: Vec<u8>,
    pub(crate) presence: Vec<Presence>,
}

impl Bodies {
    pub(crate) fn len(&self) -> usize {
        self.at.len()
    }

    pub(crate) fn push(&mut self, pose: Pose, parameters: &Parameters, rng: &mut Pcg32) {
        let mut draw = |deviation: f32| {
            (normal(rng) * deviation).clamp(-SPREAD_CUT * deviation, SPREAD_CUT * deviation)
        };
        let spread = &parameters.spread;
        let build = Build {
            left: 1.0 + draw(spread.motor),
            right: 1.0 + draw(spread.motor),
            track_m: parameters.chassis.track_m * (1.0 + draw(spread.track)),
            internal_ohm: parameters.pack.internal_ohm,
        };
        let charge = (parameters.pack.charge + draw(spread.charge)).clamp(0.0, 1.0);
        self.at.push(pose.position());
        self.theta.push(pose.theta);
        self.left.push(0.0);
        self.right.push(0.0);
        self.inputs.push(Inputs::default());
        self.supply_v.push(
            open_circuit_v(charge).min(FULL_V) - build.internal_ohm * parameters.pack.quiescent_a,
        );
        self.charge_as
            .push(f64::from(charge) * f64::from(parameters.pack.capacity_ah) * 3_600.0);
        self.build.push(build);
        self.contacts.push(0);
        self.hold.push(0);
        self.presence.push(Presence::Present);
    }

    pub(crate) fn pose(&self, i: usize) -> Pose {
        Pose::new(self.at[i].x, self.at[i].y, self.theta[i])
    }
}
