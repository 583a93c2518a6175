//! The bodies of all robots, as a structure of arrays.

use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use super::battery::open_circuit_v;
use super::body::Body;
use super::geometry::{Pose, Vec2, wrap};
use super::members::Members;
use super::parameters::Parameters;
use super::rng::normal;

/// Draws of the spread are cut at so many standard deviations.
pub(crate) const SPREAD_CUT: f32 = 3.0;

/// The levels a robot program drives: two PWM channels and the pins, as the L298N and the lamp
/// see them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Inputs {
    pub(crate) left: Bridge,
    pub(crate) right: Bridge,
    pub(crate) lamp: bool,
}

/// Inputs of one half of the L298N.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
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
    /// What a shorted bridge does to its motor, whatever its inputs say.
    pub(crate) const SHORTED: Self = Self {
        duty: 255,
        in1: true,
        in2: false,
    };

    pub(crate) const fn drive(self) -> Drive {
        match (self.in1, self.in2) {
            (true, false) => Drive::Forward,
            (false, true) => Drive::Backward,
            (true, true) | (false, false) => Drive::Brake,
        }
    }
}

/// What is peculiar to one robot.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Build {
    /// What each motor makes of its voltage, as a share of the nominal.
    pub(crate) left: f32,
    pub(crate) right: f32,
    /// Dry friction of each motor as a share of the nominal.
    pub(crate) friction: [f32; 2],
    /// Of the whole robot.
    pub(crate) mass_kg: f32,
    /// Mass that, at the wheels, resists turning as the robot does.
    pub(crate) turn_kg: f32,
    /// One over half the track.
    pub(crate) per_half_track: f32,
    /// Distance between the wheels, as it acts.
    pub(crate) track_m: f32,
    /// Of the pack.
    pub(crate) internal_ohm: f32,
    /// Whether the bridge of the left and the right motor is shorted: it drives forward.
    pub(crate) shorted: [bool; 2],
    /// Whether the supply is held below what the controller needs.
    pub(crate) dips: bool,
}

/// The push of a robot that pushes none.
pub(crate) const NOBODY: (u32, f32) = (u32::MAX, 0.0);

/// Time of the last ping of a ranger that never sent one.
pub(crate) const NEVER_US: u64 = u64::MAX;

/// Whether a body takes part in the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Presence {
    /// It does.
    Present,
    /// Its supply is below the brown-out voltage: it stands there, dead.
    Unpowered,
    /// It was taken away.
    Removed,
}

/// What robots know of each other: their state at the end of the last step.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Published {
    pub(crate) at: Vec<Vec2>,
    /// Unit vector.
    pub(crate) heading: Vec<Vec2>,
    /// Metres per second.
    pub(crate) velocity: Vec<Vec2>,
    /// Radians per second, anticlockwise.
    pub(crate) spin: Vec<f32>,
    /// Things it touches.
    pub(crate) contacts_now: Vec<u8>,
    /// Whom it pushes, and the impulse of the step in newton seconds.
    pub(crate) push: Vec<(u32, f32)>,
    /// When the ranger last sent a ping, microseconds of world time, or [`NEVER_US`].
    pub(crate) last_ping: Vec<u64>,
    /// Changes between steps too.
    pub(crate) presence: Vec<Presence>,
}

impl Published {
    fn lengths(&self) -> [usize; 8] {
        [
            self.at.len(),
            self.heading.len(),
            self.velocity.len(),
            self.spin.len(),
            self.contacts_now.len(),
            self.push.len(),
            self.last_ping.len(),
            self.presence.len(),
        ]
    }

    fn push(&mut self, pose: Pose) {
        self.at.push(pose.position());
        self.heading.push(Vec2::unit(pose.theta));
        self.velocity.push(Vec2::default());
        self.spin.push(0.0);
        self.contacts_now.push(0);
        self.push.push(NOBODY);
        self.last_ping.push(NEVER_US);
        self.presence.push(Presence::Present);
    }
}

/// See the [module](self). All arrays have the same length; a robot's index never changes.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Bodies {
    /// What everybody reads.
    pub(crate) published: Published,
    /// What members will publish at the end of the step; presence is not used.
    pub(super) next: Published,
    /// Rim speed of the left wheel, metres per second.
    pub(crate) left: Vec<f32>,
    /// Rim speed of the right wheel.
    pub(crate) right: Vec<f32>,
    /// Whether both wheels roll: rims are as fast as the floor under them.
    pub(crate) rolls: Vec<bool>,
    pub(crate) inputs: Vec<Inputs>,
    /// Terminal voltage of the pack.
    pub(crate) supply_v: Vec<f32>,
    /// Charge left, ampere seconds. One step takes a ten-millionth of it: too little for 32 bits.
    pub(crate) charge_as: Vec<f64>,
    /// Energy drawn from the pack since the start, joules.
    pub(crate) energy_j: Vec<f64>,
    pub(crate) build: Vec<Build>,
    /// How often it began to touch something.
    pub(crate) contacts: Vec<u32>,
    /// Steps for which a new touch still counts as the same contact.
    pub(crate) hold: Vec<u16>,
}

impl Bodies {
    pub(crate) fn len(&self) -> usize {
        self.left.len()
    }

    /// Whether all arrays have the same length.
    pub(crate) fn is_whole(&self) -> bool {
        let own = [
            self.right.len(),
            self.rolls.len(),
            self.inputs.len(),
            self.supply_v.len(),
            self.charge_as.len(),
            self.energy_j.len(),
            self.build.len(),
            self.contacts.len(),
            self.hold.len(),
        ];
        let both = self
            .published
            .lengths()
            .into_iter()
            .chain(self.next.lengths());
        both.chain(own).all(|length| length == self.len())
    }

    pub(crate) fn push(
        &mut self,
        pose: Pose,
        parameters: &Parameters,
        known: &Body,
        rng: &mut Pcg32,
    ) {
        let mut draw = |deviation: f32| {
            (normal(rng) * deviation).clamp(-SPREAD_CUT * deviation, SPREAD_CUT * deviation)
        };
        let (spread, chassis) = (&parameters.spread, &parameters.chassis);
        let (left, right) = (1.0 + draw(spread.motor), 1.0 + draw(spread.motor));
        let track_m = chassis.track_m * (1.0 + draw(spread.track));
        let charge = (parameters.pack.charge + draw(spread.charge)).clamp(0.0, 1.0);
        let charge = known.charge.unwrap_or(charge);
        let friction = [1.0 + draw(spread.friction), 1.0 + draw(spread.friction)];
        let mass_kg = chassis.mass_kg * (1.0 + draw(spread.mass));
        let internal_ohm = parameters.pack.internal_ohm * (1.0 + draw(spread.cells));
        let per_half_track = 2.0 / track_m;
        let turning = chassis.gyration_m * per_half_track;
        let mut build = Build {
            left,
            right,
            friction,
            mass_kg,
            turn_kg: mass_kg * turning * turning,
            per_half_track,
            track_m,
            internal_ohm,
            shorted: [false; 2],
            dips: false,
        };
        known.put(&mut build, parameters);
        let internal_ohm = build.internal_ohm;
        self.published.push(pose);
        self.next.push(pose);
        self.left.push(0.0);
        self.right.push(0.0);
        self.rolls.push(true);
        self.inputs.push(Inputs::default());
        self.supply_v
            .push((open_circuit_v(charge) - internal_ohm * parameters.pack.quiescent_a).max(0.0));
        self.charge_as
            .push(f64::from(charge) * f64::from(parameters.pack.capacity_ah) * 3_600.0);
        self.energy_j.push(0.0);
        self.build.push(build);
        self.contacts.push(0);
        self.hold.push(0);
    }

    pub(crate) fn pose(&self, i: usize) -> Pose {
        let (at, heading) = (self.published.at[i], self.published.heading[i]);
        Pose::new(at.x, at.y, wrap(libm::atan2f(heading.y, heading.x)))
    }

    /// Puts robot `i` at `pose`, as fast as it was.
    pub(super) fn carry(&mut self, i: usize, pose: Pose) {
        let seen = &mut self.published;
        let (speed, heading) = (
            seen.velocity[i].dot(seen.heading[i]),
            Vec2::unit(pose.theta),
        );
        for of in [seen, &mut self.next] {
            of.at[i] = pose.position();
            of.heading[i] = heading;
            of.velocity[i] = heading.times(speed);
        }
    }

    /// The levels that reach the bridge of robot `i`.
    pub(super) fn acting(&self, i: usize) -> Inputs {
        let mut inputs = self.inputs[i];
        let shorted = self.build[i].shorted;
        if self.published.presence[i] == Presence::Present {
            if shorted[0] {
                inputs.left = Bridge::SHORTED;
            }
            if shorted[1] {
                inputs.right = Bridge::SHORTED;
            }
        }
        inputs
    }

    /// Publishes the new state of robot `i`.
    pub(super) fn publish(&mut self, i: usize) {
        let (seen, next) = (&mut self.published, &self.next);
        seen.at[i] = next.at[i];
        seen.heading[i] = next.heading[i];
        seen.velocity[i] = next.velocity[i];
        seen.spin[i] = next.spin[i];
        seen.contacts_now[i] = next.contacts_now[i];
        seen.push[i] = next.push[i];
        seen.last_ping[i] = next.last_ping[i];
    }

    /// Publishes the new state of `members`.
    pub(super) fn publish_all(&mut self, members: Members) {
        if members != Members::ALL {
            members.iter(self.left.len()).for_each(|i| self.publish(i));
            return;
        }
        let (seen, next) = (&mut self.published, &self.next);
        seen.at.copy_from_slice(&next.at);
        seen.heading.copy_from_slice(&next.heading);
        seen.velocity.copy_from_slice(&next.velocity);
        seen.spin.copy_from_slice(&next.spin);
        seen.contacts_now.copy_from_slice(&next.contacts_now);
        seen.push.copy_from_slice(&next.push);
        seen.last_ping.copy_from_slice(&next.last_ping);
    }

    /// The ranger of robot `i` sends a ping. Others hear of it from the next step on.
    pub(crate) fn ping(&mut self, i: usize, at_us: u64) {
        self.next.last_ping[i] = at_us;
    }

    /// Robot `i` stands still in this step, and is touched when `close`.
    pub(super) fn stand(&mut self, i: usize, close: bool, hold: u16) {
        self.count_contact(i, false, close, hold);
        self.next.contacts_now[i] = 0;
        self.next.velocity[i] = Vec2::default();
        self.next.spin[i] = 0.0;
        self.next.push[i] = NOBODY;
    }

    /// Stops robot `i` where it was, whatever it had come to.
    pub(super) fn halt(&mut self, i: usize) {
        self.left[i] = 0.0;
        self.right[i] = 0.0;
        self.rolls[i] = true;
        let (seen, next) = (&self.published, &mut self.next);
        next.at[i] = seen.at[i];
        next.heading[i] = seen.heading[i];
        next.velocity[i] = Vec2::default();
        next.spin[i] = 0.0;
        next.contacts_now[i] = 0;
        next.push[i] = NOBODY;
    }

    /// Counts a contact of robot `i`, unless it is the same as a moment ago. Things that are
    /// `close` still touch, but do not begin to.
    pub(super) fn count_contact(&mut self, i: usize, touched: bool, close: bool, hold: u16) {
        let left = &mut self.hold[i];
        if touched && *left == 0 {
            self.contacts[i] = self.contacts[i].saturating_add(1);
        }
        *left = if touched || (close && *left > 0) {
            hold
        } else {
            left.saturating_sub(1)
        };
    }
}
