//! Robots come into a space, are looked at, and go.

use crawler_hal::Millivolts;

use super::bodies::{Bridge, Drive, Inputs, Presence};
use super::fingerprint::StateFingerprint;
use super::geometry::wrap_any;
use super::hash;
use super::rng::{Purpose, stream};
use super::space::Space;
use super::{Body, MAX_ROBOTS, Observation, PlacementError, Pose, RobotIndex};

impl Space {
    /// Puts a robot of the world with this seed at `pose`, with what is known of its body.
    ///
    /// # Errors
    /// See [`PlacementError`]; nothing has changed then.
    pub(crate) fn place(
        &mut self,
        pose: Pose,
        seed: u64,
        known: &Body,
    ) -> Result<RobotIndex, PlacementError> {
        if !pose.is_finite() {
            return Err(PlacementError::NotFinite);
        }
        if self.bodies.len() >= MAX_ROBOTS {
            return Err(PlacementError::Full);
        }
        let radius = self.parameters.chassis.radius_m;
        if self.clearance(pose.position(), 2.0 * radius) < radius {
            return Err(PlacementError::Occupied);
        }
        Ok(self.admit(pose, seed, known))
    }

    /// Puts a robot at `pose`, whatever is there.
    pub(crate) fn admit(&mut self, pose: Pose, seed: u64, known: &Body) -> RobotIndex {
        let robot = RobotIndex::new(self.bodies.len() as u32);
        let mut rng = stream(seed, robot.get(), Purpose::Build);
        let pose = Pose::new(pose.x, pose.y, wrap_any(pose.theta));
        self.bodies.push(pose, &self.parameters, known, &mut rng);
        if let Some(motors) = known.motors {
            self.allow_for(motors);
        }
        robot
    }

    /// Picks a robot up and puts it down at `pose`; its wheels turn as they did. Does nothing when there is none.
    ///
    /// # Errors
    /// [`PlacementError`]; it is where it was then.
    pub(crate) fn carry(&mut self, i: usize, pose: Pose) -> Result<(), PlacementError> {
        if !pose.is_finite() {
            return Err(PlacementError::NotFinite);
        }
        if i >= self.bodies.len() || self.bodies.published.presence[i] == Presence::Removed {
            return Ok(());
        }
        let radius = self.parameters.chassis.radius_m;
        let pose = Pose::new(pose.x, pose.y, wrap_any(pose.theta));
        if self.clearance_but(pose.position(), 2.0 * radius, Some(i)) < radius {
            return Err(PlacementError::Occupied);
        }
        self.bodies.carry(i, pose);
        self.rebuild_grid();
        Ok(())
    }

    /// Takes a robot out. Does nothing when there is none.
    pub(crate) fn remove(&mut self, i: usize) {
        if i < self.bodies.len() {
            self.bodies.halt(i);
            self.bodies.publish(i);
            self.bodies.published.presence[i] = Presence::Removed;
            self.bodies.inputs[i] = Inputs::default();
        }
    }

    /// The truth about a body, which knows of no program; `None` when there is none.
    pub(crate) fn observe(&self, i: usize) -> Option<Observation> {
        let bodies = &self.bodies;
        let inputs = bodies.inputs.get(i)?;
        let duty = |bridge: Bridge| match bridge.drive() {
            Drive::Forward => i16::from(bridge.duty),
            Drive::Backward => -i16::from(bridge.duty),
            Drive::Brake => 0,
        };
        let seen = &bodies.published;
        let (speed, spin) = (seen.velocity[i].dot(seen.heading[i]), seen.spin[i]);
        let half_track = bodies.build[i].track_m * 0.5;
        Some(Observation {
            pose: bodies.pose(i),
            speed,
            turn: spin,
            slip: [
                bodies.left[i] - (speed - spin * half_track),
                bodies.right[i] - (speed + spin * half_track),
            ],
            contacts: bodies.contacts[i],
            battery: Millivolts((bodies.supply_v[i] * 1_000.0) as u16),
            charge: (bodies.charge_as[i] * self.per_capacity) as f32,
            energy_j: bodies.energy_j[i],
            duty: [duty(inputs.left), duty(inputs.right)],
            lamp: inputs.lamp,
            powered: seen.presence[i] == Presence::Present,
            present: seen.presence[i] != Presence::Removed,
            starvations: 0,
            flash_violations: 0,
        })
    }

    /// Folds every bit of the physical state into a fingerprint.
    pub(crate) fn fold(&self, print: &mut StateFingerprint) {
        print.word(self.steps);
        hash::movers(print, &self.movers);
        for i in 0..self.bodies.len() {
            hash::body(print, &self.bodies, i);
        }
    }

    /// The fingerprint of the physical state alone.
    pub(crate) fn fingerprint(&self) -> u64 {
        let mut print = StateFingerprint::new();
        self.fold(&mut print);
        print.value()
    }
}
