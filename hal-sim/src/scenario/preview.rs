//! What a world of a scenario looks like when it begins, without running it.

use super::{Scenario, ScenarioError};
use crate::world::{Arena, Body, Pose, Space};

/// How a scenario begins, before anything runs: its arena, and where robots stand.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Preview {
    /// The arena.
    pub arena: Arena,
    /// Where the first robots stand, in order.
    pub poses: Vec<Pose>,
}

impl Scenario {
    /// What the world of `seed` looks like when it begins, with the places of at most `most`
    /// robots. They are those that a simulation gives them.
    ///
    /// # Errors
    /// What a simulation would fail with: see [`ScenarioError`].
    pub fn preview(&self, seed: u64, most: usize) -> Result<Preview, ScenarioError> {
        self.validate()?;
        let arena = self.arena(seed)?;
        let mut spawner = self.spawner(&arena, seed);
        let mut space = Space::new(arena.clone(), self.drawn_parameters(seed))?;
        let margin = space.parameters.chassis.radius_m + self.spawn.clearance;
        let mut poses = Vec::new();
        for robot in 0..most.min(self.robots as usize) {
            let pose = spawner.place(robot, margin, |x, y| space.clear_of(x, y, margin));
            let placed = pose.filter(|&pose| space.place(pose, seed, &Body::default()).is_ok());
            let number = robot + 1;
            poses.push(placed.ok_or_else(|| {
                ScenarioError::NoRoom(format!("robot {number} of {}", self.robots))
            })?);
        }
        Ok(Preview { arena, poses })
    }
}
