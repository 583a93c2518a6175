//! Fingerprints of a world with its devices.

use super::World;
use crate::world::{RobotIndex, StateFingerprint, hash_body, hash_movers};

impl World {
    /// A fingerprint of the full physical state: every bit of every body, the generators of its
    /// devices, and its flash.
    pub fn hash(&self) -> u64 {
        let mut print = StateFingerprint::new();
        print.word(self.steps());
        {
            let space = self.shared.space.borrow();
            hash_movers(&mut print, &space.movers);
            space.items.fold(&mut print);
        }
        for i in self.members.iter(self.robots.len()) {
            let own = self.robot_hash(RobotIndex::new(i as u32));
            print.word(own.unwrap_or_default());
        }
        print.value()
    }

    /// The same for one robot alone; `None` when it never existed.
    pub fn robot_hash(&self, robot: RobotIndex) -> Option<u64> {
        let ports = self.ports(robot)?;
        let mut print = StateFingerprint::new();
        hash_body(
            &mut print,
            &self.shared.space.borrow().bodies,
            ports.index(),
        );
        ports.sonar.borrow().fingerprint(|word| print.word(word));
        ports.chip.borrow().fingerprint(|word| print.word(word));
        ports.meter.borrow().fingerprint(|word| print.word(word));
        print.generator(&ports.camera_rng.borrow());
        print.word(u64::from(ports.life.get()));
        Some(print.value())
    }
}
