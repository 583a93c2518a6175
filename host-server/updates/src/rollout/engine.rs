//! The engine: events in, what to store and what to send out.

use std::fmt;

use crawler_protocol::RobotId;

use super::assign::{assign, join};
use super::bucket::Bucket;
use super::check::{MOST_ROBOTS, PlanError};
use super::document::{Anchor, DOCUMENT_VERSION, Document, LoadError, Owner, RolloutClock};
use super::event::{Effect, Event, Happening, Message, Note, Now, Sighting, Step};
use super::names::{ReleaseId, RolloutId};
use super::plan::{Plan, PlannedRelease};
use super::progress::{PhaseState, RolloutState};
use super::robot::{RobotRow, UpdateState};
use super::roster::Roster;

/// How long after a restart no phase passes: robots are heard of again first.
pub const RESTART_GRACE_MS: u64 = 30_000;

/// Why a rollout does not begin.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum StartError {
    /// The plan cannot be carried out.
    Plan(PlanError),
    /// The fleet has more robots than a rollout.
    TooManyRobots,
    /// No phase selects a robot that a release suits.
    Nobody,
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Plan(error) => error.fmt(f),
            Self::TooManyRobots => write!(f, "a rollout has at most {MOST_ROBOTS} robots"),
            Self::Nobody => f.write_str("no phase selects a robot that a release is for"),
        }
    }
}

impl std::error::Error for StartError {}

/// The rollout belongs to a server with an epoch that is not below the one given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StaleEpoch(
    /// The epoch in force.
    pub u64,
);

impl fmt::Display for StaleEpoch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the rollout has an owner of epoch {}", self.0)
    }
}

impl std::error::Error for StaleEpoch {}

/// Whether bytes of the image may go to a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grant {
    /// They may, and are counted as sent.
    Now,
    /// Ask again in so many milliseconds.
    In(u64),
    /// They may not: the robot is not to receive anything, or asks for more than goes at once.
    No,
}

/// A rollout at work.
#[derive(Debug, Clone)]
pub struct Rollout {
    pub(super) document: Document,
    pub(super) roster: Roster,
    clock: RolloutClock,
    bucket: Bucket,
    /// No phase passes before that.
    grace_ends_ms: u64,
    changed: bool,
    effects: Vec<Effect>,
}

impl Rollout {
    /// Begins a rollout for the robots of `fleet`. Robots that turn up later join it.
    ///
    /// # Errors
    /// [`StartError`] when it cannot be.
    pub fn start(
        id: RolloutId,
        plan: Plan,
        owner: Owner,
        fleet: &[Sighting],
        now: Now,
    ) -> Result<(Self, Step), StartError> {
        plan.check().map_err(StartError::Plan)?;
        if fleet.len() > MOST_ROBOTS {
            return Err(StartError::TooManyRobots);
        }
        let rows = assign(&plan, &id, fleet);
        if rows.iter().all(|row| row.phase.is_none()) {
            return Err(StartError::Nobody);
        }
        let document = Document {
            version: DOCUMENT_VERSION,
            revision: 0,
            id,
            owner,
            state: RolloutState::Running,
            phase: 0,
            phases: vec![PhaseState::Pending; plan.phases.len()],
            plan,
            began_unix_ms: now.unix_ms,
            anchor: Anchor {
                elapsed_ms: 0,
                unix_ms: now.unix_ms,
            },
        };
        let mut rollout = Self::new(document, RolloutClock::start(now), 0, now);
        for row in rows {
            rollout.roster.add(row);
        }
        rollout.tell(Happening::Started);
        for seen in fleet {
            rollout.see(seen.clone(), 0);
        }
        rollout.begin_phase(0, 0);
        rollout.settle(now);
        let step = rollout.step(now);
        Ok((rollout, step))
    }

    /// Goes on from what was stored, in any order of rows. The step sends again what may have been lost. Robots
    /// must be heard of again ([`Event::Seen`]) before they are offered anything.
    ///
    /// # Errors
    /// [`LoadError`] when it is no rollout, or one of another version.
    pub fn load(
        document: Document,
        rows: impl IntoIterator<Item = RobotRow>,
        now: Now,
    ) -> Result<(Self, Step), LoadError> {
        document.check()?;
        let clock = RolloutClock::resume(document.anchor, now);
        let mut rollout = Self::new(document, clock, 0, now);
        for row in rows {
            rollout.document.check_row(&row)?;
            rollout.clock.has_been(row.since_ms);
            let robot = row.robot.clone();
            if rollout.roster.len() == MOST_ROBOTS {
                return Err(LoadError::TooManyRows);
            }
            if !rollout.roster.insert(row) {
                return Err(LoadError::Row(robot, "it is there twice"));
            }
        }
        rollout.grace_ends_ms = rollout.now_ms(now).saturating_add(RESTART_GRACE_MS);
        rollout.send_again();
        rollout.settle(now);
        let step = rollout.step(now);
        Ok((rollout, step))
    }

    fn new(document: Document, clock: RolloutClock, grace_ends_ms: u64, now: Now) -> Self {
        let roster = Roster::new(document.id.clone(), document.phases.len());
        let rate = document.plan.limits.bytes_per_second;
        Self {
            document,
            roster,
            clock,
            bucket: Bucket::new(rate, now.monotonic_ms),
            grace_ends_ms,
            changed: false,
            effects: Vec::new(),
        }
    }

    /// Takes in what has happened. Whatever the event says, nothing panics, and an event that comes again, late,
    /// or about a robot or a release that is none of the rollout's, does no harm.
    pub fn handle(&mut self, event: Event, now: Now) -> Step {
        match event {
            Event::Seen(sighting) => self.see(sighting, self.now_ms(now)),
            Event::Told {
                robot,
                release,
                report,
            } => self.told(&robot, &release, &report, now),
            Event::Tick => {}
        }
        self.settle(now);
        self.step(now)
    }

    /// Gives the rollout to another server, or to the same once more. The step sends again what the former owner
    /// may not have sent.
    ///
    /// # Errors
    /// [`StaleEpoch`] unless the epoch is above the one in force.
    pub fn take_over(&mut self, owner: Owner, now: Now) -> Result<Step, StaleEpoch> {
        let epoch = self.document.owner.epoch;
        if owner.epoch <= epoch {
            return Err(StaleEpoch(epoch));
        }
        let server = owner.server.clone();
        self.document.owner = owner;
        self.tell(Happening::TakenOver(server));
        self.send_again();
        Ok(self.step(now))
    }

    /// Whether what was decided under `epoch` is still to be carried out.
    #[must_use]
    pub const fn accepts(&self, epoch: u64) -> bool {
        epoch >= self.document.owner.epoch
    }

    /// Asks for leave to send `bytes` of the image to a robot.
    pub fn take(&mut self, robot: &RobotId, release: &ReleaseId, bytes: u32, now: Now) -> Grant {
        let row = self.roster.row(robot);
        let may = row.is_some_and(|row| {
            let own = self.release(row).is_some_and(|own| own.release == *release);
            own && row.state.may_receive()
        });
        if !may {
            return Grant::No;
        }
        match self.bucket.take(bytes, now.monotonic_ms) {
            Ok(()) => Grant::Now,
            Err(Some(wait)) => Grant::In(wait),
            Err(None) => Grant::No,
        }
    }

    /// In how many milliseconds [`Event::Tick`] has something to do, if nothing else happens before.
    #[must_use]
    pub fn wake_in_ms(&self, now: Now) -> Option<u64> {
        let at = self.now_ms(now);
        let due = self.roster.next_due_ms();
        let times = [due, self.next_phase_ms(at)].into_iter().flatten();
        let wait = times.min().map(|time| time.saturating_sub(at));
        let window = self.window_opens_in_ms(now);
        if self.document.state.is_over() {
            None
        } else {
            [wait, window].into_iter().flatten().min()
        }
    }

    /// What is stored of it beside the robots.
    #[must_use]
    pub const fn document(&self) -> &Document {
        &self.document
    }

    /// Its robots.
    pub fn rows(&self) -> impl Iterator<Item = &RobotRow> {
        self.roster.rows()
    }

    /// One of its robots.
    #[must_use]
    pub fn row(&self, robot: &RobotId) -> Option<&RobotRow> {
        self.roster.row(robot)
    }

    /// Milliseconds since it began, by its own clock.
    pub(super) fn now_ms(&self, now: Now) -> u64 {
        self.clock.read(now)
    }

    /// The release that is for a robot.
    pub(super) fn release(&self, row: &RobotRow) -> Option<&PlannedRelease> {
        let at = row.release?;
        self.document.plan.releases.get(usize::from(at))
    }

    pub(super) const fn grace_ends_ms(&self) -> u64 {
        self.grace_ends_ms
    }

    /// Takes in a robot, and what follows from what it is.
    fn see(&mut self, sighting: Sighting, at: u64) {
        if self.roster.row(&sighting.robot).is_none() {
            if self.roster.len() >= MOST_ROBOTS || self.document.state.is_over() {
                return;
            }
            let row = join(&self.document.plan, self.document.phase, &sighting);
            self.roster.add(row);
        }
        let robot = sighting.robot.clone();
        let before = self.roster.see(sighting);
        self.seen(&robot, before.as_ref(), at);
    }

    /// Enters a happening of the rollout, and changes its document.
    pub(super) fn tell(&mut self, what: Happening) {
        self.touch();
        self.roster.note(Note {
            revision: self.document.revision,
            what,
        });
    }

    /// The document has changed.
    pub(super) fn touch(&mut self) {
        self.document.revision = self.document.revision.wrapping_add(1);
        self.changed = true;
    }

    /// Sends something to a robot about its release.
    pub(super) fn send(&mut self, robot: &RobotId, message: Message) {
        let release = self.roster.row(robot).and_then(|row| self.release(row));
        if let Some(release) = release {
            self.effects.push(Effect {
                epoch: self.document.owner.epoch,
                robot: robot.clone(),
                release: release.release.clone(),
                message,
            });
        }
    }

    /// Sends whatever robots are owed.
    fn send_again(&mut self) {
        for robot in self.roster.select(|row| row.recalled) {
            self.send(&robot, Message::Cancel);
        }
        for robot in self.roster.select(|row| row.state == UpdateState::Offered) {
            self.send(&robot, Message::Offer);
        }
        for robot in self.roster.select(|row| row.state == UpdateState::Trial) {
            self.send(&robot, Message::Confirm);
        }
    }

    /// What has come of the calls since the last one.
    pub(super) fn step(&mut self, now: Now) -> Step {
        let (rows, notes) = self.roster.drain();
        // An offer that the same step takes back is not sent at all.
        let mut effects = std::mem::take(&mut self.effects);
        effects.retain(|effect| {
            let row = self.roster.row(&effect.robot);
            effect.message != Message::Offer || row.is_some_and(|row| row.state.is_before_trial())
        });
        let changed = std::mem::take(&mut self.changed);
        if changed {
            self.document.anchor = Anchor {
                elapsed_ms: self.now_ms(now),
                unix_ms: now.unix_ms,
            };
        }
        Step {
            document: changed.then(|| self.document.clone()),
            rows,
            notes,
            effects,
        }
    }
}
