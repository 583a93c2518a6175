//! The physical state of a world, kept to go on from later.

use super::{BodyParts, Contents, World};
use crate::world::{Bodies, Body, Inputs, Items, Pose, Presence, RobotIndex, Wiring};

/// What there is of a world beyond its arena as the scenario made it, its parameters and its seed.
#[derive(Debug, Clone)]
pub(crate) struct WorldCheckpoint {
    bodies: Bodies,
    steps: u64,
    /// How far each mover has gone on its path, metres.
    movers: Vec<f64>,
    items: Items,
    /// What is in the flash of each robot.
    flash: Vec<Contents>,
}

impl WorldCheckpoint {
    /// Number of robots ever added.
    pub(crate) fn robots(&self) -> usize {
        self.bodies.len()
    }

    /// Number of physics steps until then.
    pub(crate) const fn steps(&self) -> u64 {
        self.steps
    }

    /// Where a robot was.
    fn pose(&self, robot: usize) -> Pose {
        self.bodies.pose(robot)
    }

    /// Whether a robot had been taken out.
    pub(crate) fn is_removed(&self, robot: usize) -> bool {
        self.bodies.published.presence[robot] == Presence::Removed
    }

    /// Whether a robot's program ran: it was there, and had power.
    pub(crate) fn is_on(&self, robot: usize) -> bool {
        self.bodies.published.presence[robot] == Presence::Present
    }

    /// Memory that it takes, in bytes, as nearly as that matters.
    pub(crate) fn footprint(&self) -> usize {
        /// Of the arrays of [`Bodies`].
        const BODY: usize = 320;
        let flash = self.flash.iter().map(Contents::footprint).sum::<usize>();
        self.bodies.len() * BODY + flash
    }
}

impl World {
    /// Keeps the physical state of a whole world.
    pub(crate) fn keep(&self) -> WorldCheckpoint {
        let space = self.shared.space.borrow();
        let ports = self.robots.iter();
        let flash = ports.map(|ports| match ports {
            Some(ports) => ports.chip.borrow().contents(),
            None => Contents::default(),
        });
        WorldCheckpoint {
            bodies: space.bodies.clone(),
            steps: space.steps,
            movers: (0..space.movers.len())
                .map(|k| space.movers.way(k))
                .collect(),
            items: space.items.clone(),
            flash: flash.collect(),
        }
    }

    /// Puts a robot where one was, with what was in its slots: the place is not looked at, since it touches
    /// what it touched. One that was on starts as after a power cut, and there are parts when its slots hold a
    /// program that starts; one that was off, or had been taken out, starts nothing and has none.
    pub(crate) fn put_back(
        &mut self,
        kept: &WorldCheckpoint,
        robot: usize,
        wiring: Wiring,
        known: &Body,
    ) -> (RobotIndex, Option<BodyParts>) {
        let pose = kept.pose(robot);
        let index = self
            .shared
            .space
            .borrow_mut()
            .admit(pose, self.shared.seed, known);
        let slots = kept.flash.get(robot);
        let ports = self.furnish(index, wiring);
        if let (Some(ports), Some(contents)) = (&ports, slots) {
            ports.chip.borrow_mut().fill_slots(contents);
        }
        let ports = ports.filter(|_| kept.is_on(robot));
        let parts = ports.as_ref().and_then(Self::switch_on);
        (index, parts)
    }

    /// Goes on from what was kept of a world of the same scenario and seed, whose robots have all
    /// been put back. Nothing is driven: their programs begin anew.
    pub(crate) fn take_up(&mut self, kept: &WorldCheckpoint) {
        {
            let space = &mut *self.shared.space.borrow_mut();
            debug_assert_eq!(space.bodies.len(), kept.robots());
            space.bodies = kept.bodies.clone();
            space.bodies.inputs.fill(Inputs::default());
            space.steps = kept.steps;
            // The movers are those of the same scenario.
            let moved = space.movers.restore(&kept.movers);
            debug_assert!(moved.is_some());
            space.lay_out(kept.items.clone());
        }
        for (robot, contents) in kept.flash.iter().enumerate() {
            if let Some(Some(ports)) = self.robots.get(robot) {
                let chip = &mut *ports.chip.borrow_mut();
                chip.fill(contents);
                if !kept.is_on(robot) {
                    chip.lose_power();
                }
            }
        }
    }
}
