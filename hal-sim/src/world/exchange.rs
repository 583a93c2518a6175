//! What the shards of a world tell each other about bodies at the end of a step.

use super::bodies::Presence;
use super::geometry::Vec2;
use super::members::Members;
use super::space::Space;

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
