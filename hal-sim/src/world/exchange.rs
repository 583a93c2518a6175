//! What the shards of a world tell each other about bodies at the end of a step.

use std::rc::Rc;

use super::bodies::Presence;
use super::geometry::{Pose, Vec2};
use super::members::Members;
use super::space::Space;
use super::{PlacementError, Ports, RobotIndex, Wiring, World};
use crate::devices::BodyParts;

/// All that others may know of a robot between two steps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Published {
    at: Vec2,
    heading: Vec2,
    velocity: Vec2,
    spin: f32,
    contacts: u32,
    contacts_now: u8,
    push: (u32, f32),
    presence: Presence,
    last_ping: u64,
}

impl Space {
    /// Writes the published state of the members over `out`, in order.
    pub(crate) fn publish(&self, members: Members, out: &mut Vec<Published>) {
        let bodies = &self.bodies;
        let seen = &bodies.published;
        out.clear();
        out.extend(members.iter(bodies.len()).map(|i| Published {
            at: seen.at[i],
            heading: seen.heading[i],
            velocity: seen.velocity[i],
            spin: seen.spin[i],
            contacts: bodies.contacts[i],
            contacts_now: seen.contacts_now[i],
            push: seen.push[i],
            presence: seen.presence[i],
            last_ping: seen.last_ping[i],
        }));
    }

    /// Takes over what another shard published of its `members`.
    pub(crate) fn take_over(&mut self, members: Members, published: &[Published]) {
        let bodies = &mut self.bodies;
        let seen = &mut bodies.published;
        for (i, robot) in members.iter(bodies.left.len()).zip(published) {
            seen.at[i] = robot.at;
            seen.heading[i] = robot.heading;
            seen.velocity[i] = robot.velocity;
            seen.spin[i] = robot.spin;
            bodies.contacts[i] = robot.contacts;
            seen.contacts_now[i] = robot.contacts_now;
            seen.push[i] = robot.push;
            seen.presence[i] = robot.presence;
            seen.last_ping[i] = robot.last_ping;
        }
    }
}

impl World {
    pub(super) fn ports(&self, robot: RobotIndex) -> Option<&Rc<Ports>> {
        self.robots.get(robot.0 as usize)?.as_ref()
    }

    /// Puts a robot at `pose`, with devices when it is a member.
    pub(crate) fn place(
        &mut self,
        pose: Pose,
        wiring: Wiring,
    ) -> Result<(RobotIndex, Option<BodyParts>), PlacementError> {
        let seed = self.shared.seed;
        let index = self.shared.space.borrow_mut().place(pose, seed)?;
        Ok((index, self.furnish(index, wiring)))
    }

    /// Gives the newest robot its devices, when it is a member.
    pub(super) fn furnish(&mut self, index: RobotIndex, wiring: Wiring) -> Option<BodyParts> {
        let ports = self
            .members
            .contains(index.0 as usize)
            .then(|| Rc::new(Ports::new(Rc::clone(&self.shared), index, wiring)));
        let parts = ports.as_ref().map(BodyParts::new);
        self.robots.push(ports);
        parts
    }

    /// The robots whose devices are here.
    pub(crate) fn members(&self) -> Members {
        self.members
    }

    /// Writes what other shards need to know of the members over `out`.
    pub(crate) fn publish(&self, out: &mut Vec<Published>) {
        self.shared.space.borrow().publish(self.members, out);
    }

    /// Takes over what another shard told of its members.
    pub(crate) fn take_over(&mut self, members: Members, published: &[Published]) {
        let mut space = self.shared.space.borrow_mut();
        space.take_over(members, published);
    }

    /// Where a robot is, and how fast forward and anticlockwise, in metres and radians per second;
    /// member or not.
    pub(crate) fn motion(&self, robot: RobotIndex) -> Option<(Pose, [f32; 2])> {
        let pose = self.pose(robot)?;
        let i = robot.0 as usize;
        let space = self.shared.space.borrow();
        let seen = &space.bodies.published;
        let forward = seen.velocity.get(i)?.dot(*seen.heading.get(i)?);
        Some((pose, [forward, *seen.spin.get(i)?]))
    }

    /// Where a robot is, member or not; `None` when it never existed or was taken away.
    pub(crate) fn pose(&self, robot: RobotIndex) -> Option<Pose> {
        let i = robot.0 as usize;
        let space = self.shared.space.borrow();
        let presence = *space.bodies.published.presence.get(i)?;
        (presence != Presence::Removed).then(|| space.bodies.pose(i))
    }
}
