//! The rollouts of this server.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

use crawler_protocol::{ModelName, ReleaseId, RobotId};
use crawler_release::chunk::{CHUNK_MAX, Chunk, Part};
use crawler_updates::rollout::{
    Effect, Grant, Message, Now, ReleaseId as PlannedId, Replaced, Rollout, UpdateState,
};

use crate::image::Blob;
use crate::patches::Patches;
use crate::pulls::Pull;

/// A rollout that belongs to this server.
pub(crate) struct Active {
    pub(crate) rollout: Rollout,
    /// Under which it is written.
    pub(crate) epoch: u64,
    /// Of each release of its plan; `None` where it is not to be had any more.
    pub(crate) blobs: Vec<Option<Arc<Blob>>>,
    /// Since when it is over.
    pub(crate) over_since: Option<Instant>,
}

impl Active {
    /// What it replaces.
    pub(crate) fn replaces(&self) -> Option<Replaced<'_>> {
        self.rollout.document().plan.replaces()
    }

    /// The model or the policy that it brings; `None` for programs.
    pub(crate) fn model(&self) -> Option<&ModelName> {
        self.rollout.document().plan.model()
    }

    /// What robots are owed, whatever was sent to them before.
    pub(crate) fn owed(&self) -> Vec<Effect> {
        let owed = self.rollout.rows().filter_map(|row| {
            let message = match row.state {
                _ if row.recalled => Message::Cancel,
                UpdateState::Offered => Message::Offer,
                UpdateState::Trial => Message::Confirm,
                _ => return None,
            };
            let release = usize::from(row.release?);
            let release = self.rollout.document().plan.releases.get(release)?;
            Some(Effect {
                epoch: self.epoch,
                robot: row.robot.clone(),
                release: release.release.clone(),
                message,
            })
        });
        owed.collect()
    }

    /// The first release of its plan that is not `in_force` any more.
    pub(crate) fn withdrawn(&self, in_force: &BTreeSet<String>) -> Option<&PlannedId> {
        let mut releases = self.rollout.document().plan.releases.iter();
        let found = releases.find(|one| !in_force.contains(one.release.as_str()));
        found.map(|one| &one.release)
    }

    /// Whether a robot has still to hear that it is to give up.
    pub(crate) fn has_recalled(&self) -> bool {
        self.rollout.rows().any(|row| row.recalled)
    }

    /// The release of this rollout that is for a robot, if it has that tag.
    fn pull(&self, robot: &RobotId, tag: u32) -> Option<u8> {
        let row = self.rollout.row(robot)?;
        let release = row.release?;
        let blob = self.blobs.get(usize::from(release))?.as_ref()?;
        (row.state.may_receive() && blob.id.tag() == tag).then_some(release)
    }
}

/// What comes of asking for a chunk.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Asked {
    /// It may go out.
    Chunk(Vec<u8>),
    /// In so many milliseconds.
    Later(u64),
    /// There is no such chunk; others there may be.
    NoSuch,
    /// The robot gets none.
    Never,
}

/// The rollouts of this server, by number.
#[derive(Default)]
pub(crate) struct ActiveRollouts(BTreeMap<i64, Active>);

impl ActiveRollouts {
    pub(crate) fn get(&self, id: i64) -> Option<&Active> {
        self.0.get(&id)
    }

    pub(crate) fn get_mut(&mut self, id: i64) -> Option<&mut Active> {
        self.0.get_mut(&id)
    }

    pub(crate) fn insert(&mut self, id: i64, active: Active) {
        self.0.insert(id, active);
    }

    pub(crate) fn remove(&mut self, id: i64) {
        self.0.remove(&id);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Its numbers, the newest first.
    pub(crate) fn ids(&self) -> Vec<i64> {
        self.0.keys().rev().copied().collect()
    }

    /// All of them.
    pub(crate) fn all(&self) -> impl Iterator<Item = (i64, &Active)> {
        self.0.iter().map(|(id, active)| (*id, active))
    }

    /// Whether a newer rollout than `id` serves a robot with the same: programs, a model, or policies.
    pub(crate) fn newer_has(&self, id: i64, robot: &RobotId) -> bool {
        let Some(own) = self.get(id) else {
            return false;
        };
        let mut newer = self.0.range(id + 1..);
        newer.any(|(_, one)| {
            let row = one.rollout.row(robot);
            let serves = row.is_some_and(|row| row.phase.is_some());
            serves && !one.rollout.document().state.is_over() && one.replaces() == own.replaces()
        })
    }

    /// Which rollout, and which of its releases, a robot may ask chunks of that carry this tag.
    pub(crate) fn source(&self, robot: &RobotId, tag: u32) -> Option<(i64, u8)> {
        let mut newest_first = self.0.iter().rev();
        newest_first.find_map(|(id, one)| Some((*id, one.pull(robot, tag)?)))
    }

    /// A release of a program that is rolled out.
    pub(crate) fn program(&self, release: ReleaseId) -> Option<Arc<Blob>> {
        let programs = self.0.values().filter(|one| one.model().is_none());
        let mut blobs = programs.flat_map(|one| one.blobs.iter().flatten());
        blobs.find(|blob| blob.id == release).cloned()
    }

    /// The release of which a robot may ask chunks that carry this tag.
    pub(crate) fn release(&self, robot: &RobotId, tag: u32) -> Option<ReleaseId> {
        let (id, release) = self.source(robot, tag)?;
        let blobs = &self.0.get(&id)?.blobs;
        Some(blobs.get(usize::from(release))?.as_ref()?.id)
    }

    /// The rollouts in which a robot was told of this release.
    pub(crate) fn with_release(&self, robot: &RobotId, release: ReleaseId) -> Vec<i64> {
        let text = release.text();
        let found = self.0.iter().filter(|(_, one)| {
            let own = one.rollout.row(robot).and_then(|row| row.release);
            let own = own.and_then(|at| {
                let releases = &one.rollout.document().plan.releases;
                releases.get(usize::from(at))
            });
            own.is_some_and(|own| own.release.as_str() == text.as_str())
        });
        found.map(|(id, _)| *id).collect()
    }

    /// Takes leave to send a chunk.
    pub(crate) fn chunk(
        &mut self,
        patches: &Patches,
        robot: &RobotId,
        pull: Pull,
        index: u32,
        now: Now,
    ) -> Asked {
        let Some(one) = self.0.get_mut(&pull.rollout) else {
            return Asked::Never;
        };
        if one.pull(robot, pull.want.tag) != Some(pull.release) {
            return Asked::Never;
        }
        let at = usize::from(pull.release);
        let (Some(Some(blob)), Some(planned)) = (
            one.blobs.get(at),
            one.rollout.document().plan.releases.get(at),
        ) else {
            return Asked::Never;
        };
        let of_patch =
            (pull.want.part == Part::Delta).then(|| patches.payload(robot, blob.id, index));
        let payload = match &of_patch {
            Some(payload) => payload.as_deref(),
            None => blob.payload(pull.want.part, index),
        };
        let Some(payload) = payload else {
            return Asked::NoSuch;
        };
        let release = planned.release.clone();
        let size = payload.len() as u32;
        match one.rollout.take(robot, &release, size, now) {
            Grant::Now => {}
            Grant::In(wait) => return Asked::Later(wait),
            Grant::No => return Asked::Never,
        }
        let chunk = Chunk {
            part: pull.want.part,
            tag: pull.want.tag,
            index,
            payload,
        };
        let mut bytes = vec![0; CHUNK_MAX];
        let Ok(length) = chunk.encode(&mut bytes) else {
            return Asked::NoSuch;
        };
        bytes.truncate(length);
        Asked::Chunk(bytes)
    }
}
