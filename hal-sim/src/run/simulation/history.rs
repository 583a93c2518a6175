//! What the history of a simulation comes to, in one number.

use super::{Simulation, Way};
use crate::run::hashes::{self, Hashes};
use crate::world::Fingerprint;

impl Simulation {
    /// A fingerprint of all that happened so far: the full physical state once a second and now,
    /// every boot, and in lockstep every message that robots published.
    #[must_use]
    pub fn history_hash(&self) -> u64 {
        hashes::total(self.now(), self.partial_history())
    }

    /// The same for one robot: the first one whose fingerprint differs between two runs is where
    /// they part. `None` when it never existed, or another shard runs it.
    #[must_use]
    pub fn robot_history(&self, robot: usize) -> Option<u64> {
        let state = self.world.robot_hash(self.machines.get(robot)?.index)?;
        let mut history = self.noted(robot);
        history.word(state);
        Some(history.value())
    }

    /// The fingerprint of the history at the end of each second: two runs of one recipe part
    /// within the first one that differs.
    #[must_use]
    pub fn hashes(&self) -> &Hashes {
        &self.hashes
    }

    /// The same as mere numbers, the first second first.
    #[must_use]
    pub fn second_hashes(&self) -> &[u64] {
        self.hashes.as_slice()
    }

    /// The share of this shard's robots in [`Simulation::history_hash`].
    pub(crate) fn partial_history(&self) -> u64 {
        self.share(|robot| self.robot_history(robot).unwrap_or_default())
    }

    /// Takes the state of every robot into its history, at the end of a second.
    pub(super) fn note_state(&mut self) {
        for robot in self.world.members().iter(self.machines.len()) {
            let machine = &mut self.machines[robot];
            let state = self.world.robot_hash(machine.index);
            machine.history.word(state.unwrap_or_default());
        }
        let share = self.share(|robot| self.noted(robot).value());
        self.hashes.push(share);
    }

    /// What has gone into a robot's history so far.
    fn noted(&self, robot: usize) -> Fingerprint {
        let machine = &self.machines[robot];
        let mut history = machine.history;
        history.word(u64::from(machine.boots));
        if let Way::Lockstep(network) = &self.way {
            history.word(network.fingerprint(machine.link));
        }
        history
    }

    /// The sum over the robots of this shard. Those of all shards are added up, so that it does
    /// not matter whose a robot is.
    fn share(&self, of: impl Fn(usize) -> u64) -> u64 {
        let members = self.world.members().iter(self.machines.len());
        members
            .map(|robot| {
                let mut share = Fingerprint::new();
                share.word(robot as u64);
                share.word(of(robot));
                share.value()
            })
            .fold(0, u64::wrapping_add)
    }
}
