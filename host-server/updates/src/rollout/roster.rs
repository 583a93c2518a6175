//! The robots of a rollout: their rows, what is known of them just now, and what follows from both.

use std::collections::{BTreeMap, BTreeSet};

use crawler_protocol::RobotId;

use super::event::{Happening, Note, Sighting};
use super::judge::Tally;
use super::names::RolloutId;
use super::rank::rank;
use super::robot::{RobotRow, UpdateState};

/// Robots, with every count and order that the engine asks for kept up to date, so that an event of one robot
/// costs no walk over all.
#[derive(Debug, Clone)]
pub(super) struct Roster {
    id: RolloutId,
    rows: BTreeMap<RobotId, RobotRow>,
    /// Not stored: robots are heard of again after a restart.
    seen: BTreeMap<RobotId, Sighting>,
    /// Robots that could be offered the release now, for each phase, by rank.
    ready: Vec<BTreeSet<(u64, RobotId)>>,
    /// What is due when.
    due: BTreeSet<(u64, RobotId)>,
    tallies: Vec<Tally>,
    not_applicable: u32,
    changed: BTreeSet<RobotId>,
    notes: Vec<Note>,
}

impl Roster {
    pub(super) fn new(id: RolloutId, phases: usize) -> Self {
        Self {
            id,
            rows: BTreeMap::new(),
            seen: BTreeMap::new(),
            ready: vec![BTreeSet::new(); phases],
            due: BTreeSet::new(),
            tallies: vec![Tally::default(); phases],
            not_applicable: 0,
            changed: BTreeSet::new(),
            notes: Vec::new(),
        }
    }

    /// Takes a row in as it is stored; false if there is one of that robot.
    pub(super) fn insert(&mut self, row: RobotRow) -> bool {
        if self.rows.contains_key(&row.robot) {
            return false;
        }
        self.count(&row, true);
        self.rows.insert(row.robot.clone(), row);
        true
    }

    /// Takes in the row of a robot that is new to the rollout.
    pub(super) fn add(&mut self, row: RobotRow) {
        self.changed.insert(row.robot.clone());
        self.insert(row);
    }

    pub(super) fn row(&self, robot: &RobotId) -> Option<&RobotRow> {
        self.rows.get(robot)
    }

    pub(super) fn rows(&self) -> impl Iterator<Item = &RobotRow> {
        self.rows.values()
    }

    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }

    pub(super) fn seen(&self, robot: &RobotId) -> Option<&Sighting> {
        self.seen.get(robot)
    }

    /// Changes a row; where its state changes, people are told.
    pub(super) fn change(&mut self, robot: &RobotId, change: impl FnOnce(&mut RobotRow)) {
        let Some(before) = self.rows.remove(robot) else {
            return;
        };
        self.count(&before, false);
        let mut row = before.clone();
        change(&mut row);
        if row != before {
            row.revision = row.revision.wrapping_add(1);
            self.changed.insert(robot.clone());
        }
        if row.state != before.state {
            self.notes.push(Note {
                revision: row.revision,
                what: Happening::Robot {
                    robot: robot.clone(),
                    state: row.state,
                    reason: row.reason.clone(),
                },
            });
        }
        self.count(&row, true);
        self.rows.insert(robot.clone(), row);
    }

    /// Enters something to tell people.
    pub(super) fn note(&mut self, note: Note) {
        self.notes.push(note);
    }

    /// Takes in what a robot is like now; returns what it was like.
    pub(super) fn see(&mut self, sighting: Sighting) -> Option<Sighting> {
        let robot = sighting.robot.clone();
        let row = self.rows.remove(&robot);
        if let Some(row) = &row {
            self.count(row, false);
        }
        let before = self.seen.insert(robot.clone(), sighting);
        if let Some(row) = row {
            self.count(&row, true);
            self.rows.insert(robot, row);
        }
        before
    }

    /// Whether the robot is there and has nothing better to do.
    pub(super) fn is_at_hand(&self, robot: &RobotId) -> bool {
        let seen = self.seen.get(robot);
        seen.is_some_and(|seen| seen.online && seen.busy.is_none())
    }

    /// Robots whose next moment has come, with it.
    pub(super) fn due(&self, now_ms: u64) -> Option<RobotId> {
        let (at, robot) = self.due.first()?;
        (*at <= now_ms).then(|| robot.clone())
    }

    /// When the next moment of a robot comes.
    pub(super) fn next_due_ms(&self) -> Option<u64> {
        self.due.first().map(|(at, _)| *at)
    }

    /// The robot of a phase that is next to be offered the release.
    pub(super) fn next_ready(&self, phase: u8) -> Option<RobotId> {
        let (_, robot) = self.ready.get(usize::from(phase))?.first()?;
        Some(robot.clone())
    }

    /// Counts of a phase.
    pub(super) fn tally(&self, phase: u8) -> &Tally {
        &self.tallies[usize::from(phase)]
    }

    /// Counts of every phase.
    pub(super) fn tallies(&self) -> &[Tally] {
        &self.tallies
    }

    /// Robots that belong to no phase.
    pub(super) const fn not_applicable(&self) -> u32 {
        self.not_applicable
    }

    /// Robots at work.
    pub(super) fn in_flight(&self) -> u32 {
        let of = |tally: &Tally| tally.sum(UpdateState::is_in_flight);
        self.tallies.iter().map(of).sum()
    }

    /// The robots of which `which` says yes.
    pub(super) fn select(&self, which: impl Fn(&RobotRow) -> bool) -> Vec<RobotId> {
        let rows = self.rows.values().filter(|row| which(row));
        rows.map(|row| row.robot.clone()).collect()
    }

    /// The rows that have changed since the last call, and what to tell of them.
    pub(super) fn drain(&mut self) -> (Vec<RobotRow>, Vec<Note>) {
        let changed = std::mem::take(&mut self.changed);
        let rows = changed.iter().filter_map(|robot| self.rows.get(robot));
        (rows.cloned().collect(), std::mem::take(&mut self.notes))
    }

    /// Takes a row into all counts and orders, or out of them.
    fn count(&mut self, row: &RobotRow, add: bool) {
        let at_hand = self.is_at_hand(&row.robot);
        let waits_for_us = row.state == UpdateState::Waiting && at_hand;
        match row
            .phase
            .and_then(|at| self.tallies.get_mut(usize::from(at)))
        {
            Some(tally) if add => tally.add(row, waits_for_us),
            Some(tally) => tally.remove(row, waits_for_us),
            None if add => self.not_applicable += 1,
            None => self.not_applicable -= 1,
        }
        if let Some(at) = row.next_ms() {
            let entry = (at, row.robot.clone());
            if add {
                self.due.insert(entry);
            } else {
                self.due.remove(&entry);
            }
        }
        if !waits_for_us || row.due_ms.is_some() {
            return;
        }
        let ready = row.phase.and_then(|at| self.ready.get_mut(usize::from(at)));
        if let Some(ready) = ready {
            let entry = (rank(&self.id, &row.robot), row.robot.clone());
            if add {
                ready.insert(entry);
            } else {
                ready.remove(&entry);
            }
        }
    }
}
