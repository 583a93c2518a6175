//! A whole world, kept: in memory or in a file.
//!
//! The programs of robots are futures, which nothing can copy. So a snapshot is no image of the
//! world but how to make it again: the scenario, the seed, the journal of what was done to it,
//! and the moment. [`Snapshot::restore`] runs all of it once more and compares the fingerprint
//! of every second. It takes as long as the world took; lockstep worlds run many times as fast
//! as real time. A world without programs can be copied as it is.

mod error;
mod file;

use crawler_hal::Instant;

pub use error::{RestoreError, SnapshotError};
pub use file::{MAX_FILE, read_from, write_to};

use crate::run::journal::Entry;
use crate::run::{Link, Simulation};
use crate::scenario::Scenario;

/// See the [module](self).
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// The build that made it, for error messages.
    pub(super) build: String,
    pub(super) link: Link,
    pub(super) scenario: Scenario,
    pub(super) seed: u64,
    pub(super) at: Instant,
    pub(super) hash: u64,
    pub(super) seconds: Vec<u64>,
    pub(super) entries: Vec<Entry>,
}

/// Name of this build.
pub(crate) const BUILD: &str = crate::VERSION;

impl Snapshot {
    /// Keeps a world as it is now.
    ///
    /// # Errors
    /// [`SnapshotError`] when it cannot be made again: it is live, or its journal does not tell
    /// the whole story.
    pub fn of(simulation: &Simulation) -> Result<Self, SnapshotError> {
        let link = simulation.link().ok_or(SnapshotError::Live)?;
        let journal = simulation.journal();
        if journal.lost() > 0 {
            return Err(SnapshotError::Lost(journal.lost()));
        }
        if journal.withheld() > 0 {
            return Err(SnapshotError::Withheld(journal.withheld()));
        }
        Ok(Self {
            build: BUILD.to_owned(),
            link,
            scenario: simulation.scenario().clone(),
            seed: simulation.seed(),
            at: simulation.now(),
            hash: simulation.history_hash(),
            seconds: simulation.second_hashes().to_vec(),
            entries: journal.entries().to_vec(),
        })
    }

    /// The scenario.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The seed.
    #[must_use]
    pub const fn seed(&self) -> u64 {
        self.seed
    }

    /// How its robots reach their broker.
    #[must_use]
    pub const fn link(&self) -> Link {
        self.link
    }

    /// When it was taken.
    #[must_use]
    pub const fn at(&self) -> Instant {
        self.at
    }

    /// The fingerprint of the history up to then.
    #[must_use]
    pub const fn hash(&self) -> u64 {
        self.hash
    }

    /// What was done to the world up to then.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// The same, where robots that have a camera see with `detector`: a file holds none.
    #[must_use]
    pub fn with_detector(mut self, detector: Option<&'static [u8]>) -> Self {
        self.scenario.detector = detector;
        self
    }

    /// Makes the world again.
    ///
    /// # Errors
    /// [`RestoreError::Differs`] when the same recipe makes another world, as it does with
    /// another build of the program: it names the first second that differs.
    pub fn restore(&self) -> Result<Simulation, RestoreError> {
        let mut simulation = Simulation::linked(self.link, self.scenario.clone(), self.seed)?;
        self.replay(&mut simulation)?;
        Ok(simulation)
    }

    /// Makes the world again, and records it from its beginning.
    ///
    /// # Errors
    /// Like [`Snapshot::restore`], and [`RestoreError::Record`] when the file takes no more.
    #[cfg(feature = "recording")]
    pub fn restore_recorded(
        &self,
        recorder: &mut super::recording::Recorder,
    ) -> Result<Simulation, RestoreError> {
        let (scenario, event_logs) = (self.scenario.clone(), recorder.event_logs());
        let mut simulation = Simulation::recorded(self.link, scenario, self.seed, event_logs)?;
        for entry in &self.entries {
            let at = Instant::from_micros(entry.at_us);
            if entry.settled || at > simulation.now() {
                recorder.run_until(&mut simulation, at)?;
            }
            simulation.apply(&entry.input);
        }
        recorder.run_until(&mut simulation, self.at)?;
        if simulation.history_hash() == self.hash {
            return Ok(simulation);
        }
        let pairs = self.seconds.iter().zip(simulation.second_hashes());
        let same = pairs.take_while(|(before, now)| before == now).count();
        Err(self.differs(same as u64 + 1))
    }

    /// Brings a world that has just begun to the moment of the snapshot.
    pub(super) fn replay(&self, simulation: &mut Simulation) -> Result<(), RestoreError> {
        let mut followed = 0;
        for (number, &expected) in self.seconds.iter().enumerate() {
            let end = Instant::from_micros((number as u64 + 1) * 1_000_000);
            // What was done at the very end of the second came after its fingerprint.
            let due = self.entries[followed..]
                .iter()
                .take_while(|entry| entry.at_us < end.as_micros())
                .count();
            simulation.follow(&self.entries[followed..followed + due], end);
            followed += due;
            let found = simulation.second_hashes().get(number).copied();
            if found != Some(expected) {
                return Err(self.differs(number as u64 + 1));
            }
        }
        simulation.follow(&self.entries[followed..], self.at);
        if simulation.history_hash() == self.hash {
            Ok(())
        } else {
            Err(self.differs(self.seconds.len() as u64 + 1))
        }
    }

    fn differs(&self, second: u64) -> RestoreError {
        RestoreError::Differs {
            second,
            made_by: self.build.clone(),
        }
    }
}

#[cfg(test)]
mod tests;
