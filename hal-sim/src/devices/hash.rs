//! Fingerprints of a world with its devices.

use super::World;
use crate::world::{Hasher, RobotIndex, hash_body, hash_movers};

impl World {
    /// A fingerprint of the full physical state: every bit of every body, the generators of its
    /// devices, and its flash.
    pub fn hash(&self) -> u64 {
        let mut hasher = Hasher::new();
        hasher.word(self.steps());
        {
            let space = self.shared.space.borrow();
            hash_movers(&mut hasher, &space.movers);
            space.items.fold(&mut hasher);
        }
        for i in self.members.iter(self.robots.len()) {
            let own = self.robot_hash(RobotIndex::new(i as u32));
            hasher.word(own.unwrap_or_default());
        }
        hasher.finish()
    }

    /// The same for one robot alone; `None` when it never existed.
    pub fn robot_hash(&self, robot: RobotIndex) -> Option<u64> {
        let ports = self.ports(robot)?;
        let mut hasher = Hasher::new();
        hash_body(
            &mut hasher,
            &self.shared.space.borrow().bodies,
            ports.index(),
        );
        ports.sonar.borrow().fingerprint(|word| hasher.word(word));
        ports.chip.borrow().fingerprint(|word| hasher.word(word));
        ports.meter.borrow().fingerprint(|word| hasher.word(word));
        hasher.generator(&ports.camera_rng.borrow());
        hasher.word(u64::from(ports.life.get()));
        Some(hasher.finish())
    }
}
